"""Known targets from a file; apart from `known_ground`, as the engine reads no file."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path

from sal_height.adjustment.known_ground import Target
from sal_height.errors import UserError

COLUMNS = ("east_m", "north_m", "height_m")
"""Columns that a file must have."""

SIGMA = "sigma_m"
"""Column that it may have: standard deviation of each of the three."""

LEAST_SIGMA_M, FARTHEST_M = 1e-4, 1e6


def read_targets(path: Path) -> tuple[Target, ...]:
    """The targets of a CSV file with the columns east_m, north_m, height_m, and sigma_m if it is not 0.01 (all in m).

    Raises:
        UserError: it cannot be read, a column is missing or unknown, a value is not allowed, or there is no target.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            targets = tuple(_targets(csv.reader(file), path))
    except UserError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UserError(f"Cannot read {path} with targets: {reason}.") from error
    if not targets:
        raise UserError(f"File {path} has no targets; each is a line with {', '.join(COLUMNS)}.")
    return targets


def _targets(lines: Iterator[list[str]], path: Path) -> Iterator[Target]:
    """Parses the lines of a file, of which the first names the columns."""
    names = [name.strip() for name in next(lines, [])]
    if sorted(names) not in (sorted(COLUMNS), sorted([*COLUMNS, SIGMA])):
        raise UserError(
            f"File {path}: the columns are {', '.join(names) or 'none'}; they must be {', '.join(COLUMNS)}, and may be "
            f"{SIGMA}."
        )
    for number, line in enumerate(lines, 2):
        if not "".join(line).strip():
            continue
        where = f"File {path}, line {number}"
        if len(line) != len(names):
            raise UserError(f"{where}, has {len(line)} values; there must be {len(names)}, as columns.")
        values = {name: _number(text, f"{where}: {name}") for name, text in zip(names, line, strict=True)}
        sigma = values.pop(SIGMA, Target.sigma)
        if not LEAST_SIGMA_M <= sigma <= FARTHEST_M:
            raise UserError(f"{where}: {SIGMA} is {sigma:g}; it must be {LEAST_SIGMA_M:g} to {FARTHEST_M:g} m.")
        yield Target(values["east_m"], values["north_m"], values["height_m"], sigma)


def _number(text: str, what: str) -> float:
    """Parses the number in a field of a file."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= FARTHEST_M:  # NaN is refused, too
        raise UserError(f"{what} is {text.strip()!r}; it must be a number of at most {FARTHEST_M:g} m.")
    return number
