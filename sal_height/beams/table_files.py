"""CSV files of measured beams."""

from __future__ import annotations

import csv
from collections import defaultdict
from itertools import product
from pathlib import Path

import numpy as np

from sal_height.beams.table import (
    BeamTable,
)
from sal_height.errors import UserError

COLUMNS = ("detector", "elevation_beamwidths", "azimuth_beamwidths", "real", "imaginary")
"""Columns of a file of beam tables; the third may be missing."""


def read_beam_tables(path: Path, beamwidth: float, azimuth_beamwidth: float | None = None) -> tuple[BeamTable, ...]:
    """Read measured beams from a CSV file with the columns COLUMNS, one row for every detector and direction.

    Detectors are counted from 0, and each has a grid of its own; rows may be in any order. Offsets are from the
    boresight of each detector, in beamwidths. Without azimuth_beamwidths all rows have azimuth 0.

    Args:
        path: path of the file.
        beamwidth: wavelength / antenna diameter along the detector axis, rad.
        azimuth_beamwidth: beamwidth across the detector axis, rad; None: `beamwidth`.

    Returns:
        tuple[BeamTable, ...]: the beams of detectors 0, 1, ...

    Raises:
        UserError: the file cannot be read, a column is missing, a value is not a number, a direction is missing or
            given twice, a detector is missing, or BeamTable refuses a beam.
    """
    beams: dict[int, dict[tuple[float, float], complex]] = defaultdict(dict)
    lines: dict[tuple[int, float, float], int] = {}
    for line, row in _read_rows(path):
        detector, *direction = (_number(path, line, row, name) for name in COLUMNS[:3])
        e, a = direction
        first = lines.setdefault((int(detector), e, a), line)
        if first != line:
            raise UserError(
                f"{path}, line {line}: elevation {e:g} and azimuth {a:g} of detector {detector:g} are already in line "
                f"{first}; give every direction once."
            )
        beams[int(detector)][e, a] = complex(*(_number(path, line, row, name) for name in COLUMNS[3:]))
    if not beams:
        raise UserError(f"{path} has no rows; at least one detector's beam is needed.")
    missing = sorted(set(range(len(beams))) - set(beams))
    if missing:
        raise UserError(f"{path} has beams of {len(beams)} detectors but none of detector {missing[0]}; count from 0.")
    widths = beamwidth, azimuth_beamwidth or beamwidth
    return tuple(_table(path, detector, beams[detector], widths) for detector in range(len(beams)))


def _read_rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Return the rows that are not empty, by column, with their line numbers."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = [name.strip() for name in next(reader, [])]
            lines = [(reader.line_num, row) for row in reader if row]
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}.") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path} is no CSV text; it must be a table with the columns {', '.join(COLUMNS)}.") from error
    needed = set(COLUMNS) - {"azimuth_beamwidths"}
    if not (needed <= set(header) <= set(COLUMNS) and len(set(header)) == len(header)):
        found = ", ".join(header)[:120] or "nothing"
        raise UserError(f"{path}, line 1: the columns are {found!r}; they must be {', '.join(COLUMNS)}, once each.")
    for line, row in lines:
        if len(row) != len(header):
            raise UserError(f"{path}, line {line}: there are {len(row)} values; the header has {len(header)} columns.")
    return [(line, dict(zip(header, row, strict=True))) for line, row in lines]


def _number(path: Path, line: int, row: dict[str, str], name: str) -> float:
    """Return the number in a column of a row; 0 in a column that the file does not have."""
    text = row.get(name, "0").strip()
    convert, allowed = (int, "a whole number of 0 or more") if name == "detector" else (float, "a finite number")
    try:
        number = float(convert(text))
    except (ValueError, OverflowError):
        number = np.nan
    if not np.isfinite(number) or (name == "detector" and number < 0):
        raise UserError(f"{path}, line {line}: {name} is {text[:40]!r}; it must be {allowed}.")
    return number


def _table(
    path: Path, detector: int, beam: dict[tuple[float, float], complex], beamwidths: tuple[float, float]
) -> BeamTable:
    elevation, azimuth = (sorted(set(angles)) for angles in zip(*beam, strict=True))
    for e, a in product(elevation, azimuth):
        if (e, a) not in beam:
            raise UserError(
                f"{path}: detector {detector} has no amplitude at elevation {e:g} and azimuth {a:g}; its grid must be "
                "complete."
            )
    values = [beam[direction] for direction in product(elevation, azimuth)]
    try:
        return BeamTable(
            tuple(e * beamwidths[0] for e in elevation),
            tuple(a * beamwidths[1] for a in azimuth),
            tuple(value.real for value in values),
            tuple(value.imag for value in values),
        )
    except UserError as error:
        raise UserError(f"{path}, detector {detector}: {str(error)[0].lower()}{str(error)[1:]}") from error
