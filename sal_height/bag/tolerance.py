"""Allowed differences of values from those of a golden bag, field by field."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from sal_height.configuration import Float, StrictKeys, read_yaml, validated
from sal_height.numeric import F64

Amount = Annotated[Float, Ge(0)]


@dataclass(frozen=True)
class Tolerance(StrictKeys):
    """Allowed difference of a value from the golden one: the sum of the parts.

    Attributes:
        absolute: part in the unit of the field.
        relative: factor of the golden value's absolute value.
        rms: factor of the root mean square of the golden field in its message.
        sigma: factor of the golden standard deviation of the value (field sigma).
    """

    absolute: Amount = 0.0
    relative: Amount = 0.0
    rms: Amount = 0.0
    sigma: Amount = 0.0

    def allowed(self, golden: NDArray[Any], sigma: NDArray[Any] | None) -> F64:
        """The greatest difference that is within the tolerance, for each golden value.

        Args:
            golden: values of a field, shape (n,).
            sigma: standard deviations of the values, shape (m,) with n a multiple of m; None: absent. Where it is not
                finite, nothing is added.
        """
        total = np.full(golden.shape, self.absolute)
        if not (self.relative or self.rms or self.sigma):
            return total
        size = np.abs(np.nan_to_num(golden.astype(np.complex128), nan=0.0, posinf=0.0, neginf=0.0))
        total += self.relative * size
        if self.rms and size.size:
            total += self.rms * np.sqrt(np.mean(size**2))
        if self.sigma and sigma is not None and sigma.size and size.size % sigma.size == 0:
            finite = np.nan_to_num(sigma.astype(np.float64), nan=0.0, posinf=0.0)
            total += self.sigma * np.repeat(finite, size.size // sigma.size)
        return total


@dataclass(frozen=True)
class Tolerances:
    """Tolerances by patterns of field names.

    Attributes:
        rules: tolerances by pattern, such as "surfaces.*"; the first that matches a field's name, without the
            numbers of list elements, applies. Fields that none matches, and texts, must be equal. Of the tolerance of
            whole numbers, such as times in nanoseconds and validities, only the absolute part counts.
    """

    rules: Mapping[str, Tolerance]

    def of(self, field: str, values: NDArray[Any]) -> Tolerance:
        """The tolerance of a field with such values."""
        plain = re.sub(r"\[\d+\]", "", field)
        rule = next((rule for pattern, rule in self.rules.items() if fnmatch.fnmatchcase(plain, pattern)), NONE)
        if values.dtype.kind == "U":
            return NONE
        return rule if values.dtype.kind in "fc" else Tolerance(absolute=rule.absolute)

    def as_json(self) -> dict[str, dict[str, float]]:
        """Entry of a report: the parts that are not 0."""
        return {
            pattern: {part: amount for part, amount in vars(rule).items() if amount}
            for pattern, rule in self.rules.items()
        }


NONE = Tolerance()

EXACT = Tolerances({})

_PLACE = Tolerance(sigma=0.01, relative=1e-6)

ROUNDING = Tolerances(
    {
        "grid.*": Tolerance(absolute=1e-9),
        "aperture.*": Tolerance(absolute=1e-9, relative=1e-12),
        "order_probability": Tolerance(absolute=3e-3),
        "samples": Tolerance(rms=1.5e-4),
        "noise_power": Tolerance(relative=1e-12),
        "surfaces.height": _PLACE,
        "surfaces.east": _PLACE,
        "surfaces.north": _PLACE,
        "surfaces.sigma": Tolerance(relative=4e-3),
        "surfaces.spread": Tolerance(sigma=3e-3, relative=1e-3),
        "surfaces.cnr_db": Tolerance(absolute=0.03),
        "surfaces.covariance": Tolerance(relative=0.01, rms=1e-5),
        "surfaces.common_covariance": Tolerance(relative=0.01, rms=1e-5),
    }
)
"""Differences of rounding between processors: ten times the greatest ones that were measured between kinds of them."""


def read_tolerances(path: Path) -> Tolerances:
    """Tolerances in a YAML file, such as `surfaces.height: {sigma: 0.01, absolute: 1.0e-6}`; those of ROUNDING follow.

    Raises:
        UserError: the file cannot be read, or a part of a tolerance is unknown, negative or not a number.
    """
    source = f"Tolerance file {path}"
    content = read_yaml(path, source, f"{source} cannot be read; name a YAML file of tolerances by field.")
    rules = validated(dict[str, Tolerance], content or {}, source)
    return Tolerances({**rules, **{name: rule for name, rule in ROUNDING.rules.items() if name not in rules}})
