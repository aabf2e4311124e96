"""The discriminator of a relief radar that receives Sigma and Delta of two beams (relief paper: Volosyuk et al.).

The two beams G are offset by delta / 2 above and below the equisignal direction theta_0. From a surface element at
theta_0 + theta_h with the complex amplitude beta, the channels receive

    Sigma = upper + lower = 2 G(delta/2) beta,   Delta = upper - lower = gamma Sigma,   gamma = g theta_h to first order

(relief paper, eq. 3 to 9), each with noise of its own. gamma is estimated from sums of products (`Products`) by one of
`estimators.DISCRIMINANTS`. `ratio` is the real part of the relief paper's eq. 17, which is the maximum likelihood for a
complex gamma; `total_least_squares` is that for a real one, tan(1/2 atan2(2 Re Sigma* Delta, |Sigma|^2 - |Delta|^2)).
`invert_pairs`, `invert_linear` or a `SlopeTable` then give the elevation.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt
from pydantic import field_validator, model_validator
from scipy.interpolate import PchipInterpolator

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import ElevationEstimate, Fit, Validity, decide_validity, detection_limit
from sal_height.elevation.array.height_settings import HeightSettings
from sal_height.elevation.array.likelihood import SinglePeaks
from sal_height.elevation.layover.two_channels import in_two_channels
from sal_height.elevation.looks.looks import DwellColumns, Looks
from sal_height.elevation.monopulse.estimators import (
    DISCRIMINANTS,
    Products,
    accuracy,
    discriminate,
    products_of_looks,
    whitened_products,
)
from sal_height.elevation.monopulse.inverse_table import invert_pairs
from sal_height.elevation.monopulse.inversion import (
    UNPAIRED,
    Inversion,
    PairElevation,
    equisignal_elevation,
    inversion_between,
    invert_linear,
)
from sal_height.errors import UserError
from sal_height.numeric import F64
from sal_height.settings import setting

SLOPE_COLUMNS = ["angle_rad", "gamma"]
"""Columns in the first line of a slope table's file."""

Inverse = Callable[[Beams, F64, F64, DwellColumns], PairElevation]
"""Function of the pair of beams, gamma (rows, cols), the squint of each column (rad) and the columns of each dwell that
returns elevations."""


@dataclass(frozen=True)
class SlopeTable:
    """A measured discrimination characteristic (relief paper, figure 2): gamma over the angle off theta_0.

    Attributes:
        angle: theta_h, increasing, rad.
        gamma: Delta / Sigma there, rising or falling throughout.

    Raises:
        UserError: there are fewer than two nodes or unequal numbers of angles and values, values are not finite, angles
            do not increase, or the slope is 0 or changes sign.
    """

    angle: tuple[float, ...]
    gamma: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.angle) != len(self.gamma) or len(self.angle) < 2:
            raise UserError(
                f"A slope table has {len(self.angle)} angles and {len(self.gamma)} values; it needs as many of both, "
                "2 or more."
            )
        if not (np.all(np.isfinite([self.angle, self.gamma])) and np.all(np.diff(self.angle) > 0)):
            raise UserError("A slope table has angles or values that are not finite, or angles that do not increase.")
        steps = np.diff(self.gamma)
        turns = np.flatnonzero(np.sign(steps) != np.sign(self.gamma[-1] - self.gamma[0]))
        if turns.size or not steps.any():
            turn = int(turns[0]) if turns.size else 0
            raise UserError(
                f"A slope table changes sign between {self.angle[turn]:.6g} and {self.angle[turn + 1]:.6g} rad, where "
                f"gamma goes from {self.gamma[turn]:.6g} to {self.gamma[turn + 1]:.6g}; it must rise or fall all along."
            )

    def invert(self, pair: Beams, gamma: npt.ArrayLike, squint: npt.ArrayLike) -> Inversion:
        """Find elevations around the equisignal direction of `pair` by a monotonic cubic (PCHIP) through the nodes.

        The slope is that of the chord between two nodes. Outside the table gamma is BELOW or ABOVE. Arguments as in
        `invert_linear`, which broadcast.
        """
        gamma, squint = np.broadcast_arrays(np.asarray(gamma, dtype=np.float64), np.asarray(squint, dtype=np.float64))
        order = slice(None, None, 1 if self.gamma[-1] > self.gamma[0] else -1)
        angles, values = np.array(self.angle)[order], np.array(self.gamma)[order]
        section = np.clip(np.searchsorted(values, gamma, side="right") - 1, 0, len(values) - 2)
        elevation = equisignal_elevation(pair, squint) + PchipInterpolator(values, angles)(
            np.clip(gamma, values[0], values[-1])
        )
        slope = (np.diff(values) / np.diff(angles))[section]
        return inversion_between(elevation, slope, gamma, (values[0], values[-1]), np.ones(gamma.shape, dtype=np.bool_))


def read_slope_table(path: Path) -> SlopeTable:
    """Read a slope table from a CSV file: a line `angle_rad,gamma`, then one line for each node.

    Raises:
        UserError: the file cannot be read, its first line or another line is wrong, or `SlopeTable` refuses its nodes.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            header, *rows = [row for row in csv.reader(stream) if row] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"Slope table {path} cannot be read: {error}.") from error
    if [name.strip() for name in header] != SLOPE_COLUMNS:
        raise UserError(f"Slope table {path} begins with {','.join(header)!r}; it must be '{','.join(SLOPE_COLUMNS)}'.")
    try:
        angle, gamma = zip(*((float(a), float(g)) for a, g in rows), strict=True) if rows else ((), ())
    except ValueError as error:
        raise UserError(f"Slope table {path} has a row that is not two numbers; all must be: {error}.") from error
    return SlopeTable(angle, gamma)


def _dwell_by_dwell(invert: Callable[[Beams, F64, F64], Inversion]) -> Inverse:
    def inverse(pair: Beams, gamma: F64, squint: F64, columns: DwellColumns) -> PairElevation:
        parts = zip(columns.split(gamma), columns.split(squint), strict=True)
        return PairElevation.side_by_side([PairElevation.of(pair, invert(pair, g, s), s) for g, s in parts])

    return inverse


def _by_tables(pair: Beams, gamma: F64, squint: F64, columns: DwellColumns) -> PairElevation:
    return invert_pairs(pair, gamma, np.zeros(gamma.shape, np.intp), squint, columns)


INVERSES: dict[str, Inverse] = {"exact": _by_tables, "linear": _dwell_by_dwell(invert_linear)}
"""Inversions that follow from the beams, by name."""


class SumDifferenceSettings(HeightSettings):
    """Settings of the discriminator of a sensor that delivers sum and difference of two beams."""

    discriminant: str = setting(
        "tls",
        "estimator of the ratio Delta / Sigma: tls (exact maximum likelihood), ratio (as published; biased at low CNR) "
        "or noise_subtraction (ratio, with the noise power subtracted from that of Sigma)",
        choices=tuple(DISCRIMINANTS),
    )
    inverse: str = setting(
        "exact",
        "how elevation follows from Delta / Sigma: exact (from the beams) or linear (as published: from the slope in "
        "the equisignal direction)",
        choices=tuple(INVERSES),
    )
    slope_table: str = setting(
        "",
        "path of a CSV file with a measured characteristic, which replaces inverse; its columns are angle_rad (from "
        "the equisignal direction) and gamma; empty: none",
        read_only=True,
        names_file=True,
    )

    @field_validator("slope_table")
    @classmethod
    def _check_slope_table(cls, path: str) -> str:
        if path:
            _slope_table(path)
        return path

    @model_validator(mode="after")
    def _check_looks(self) -> Self:
        if self.range_looks * self.azimuth_looks == 1:
            raise UserError(
                "Parameters range_looks and azimuth_looks are both 1; sum and difference need 2 looks or more, as any "
                "single look of theirs fits one scatterer."
            )
        return self


@lru_cache(maxsize=8)
def _slope_table(path: str) -> SlopeTable:
    return read_slope_table(Path(path))


def _by_slope_table(path: str) -> Inverse:
    return _dwell_by_dwell(_slope_table(path).invert)


def sum_difference_elevation(looks: Looks, pair: Beams, settings: SumDifferenceSettings) -> ElevationEstimate:
    """Estimate the elevation of the scatterer in every pixel of images whose channels are Sigma and Delta.

    The standard deviation and the CNR are those of `estimators.accuracy`.

    LOW_CNR: the part that both channels have in common, or Sigma alone, is not detected above noise, or is below
    `min_cnr`.
    OUTSIDE_PAIR: gamma has no elevation, for example because there is a signal in Delta and none in Sigma.
    NOT_ONE_SCATTERER: one scatterer in two whitened channels leaves K - 1 noise powers on average, and more is left
    (`estimate.is_explained`).

    Args:
        looks: covariance of Sigma = upper + lower and Delta = upper - lower in each pixel (`sum_difference_channels`).
        pair: beams of the lower and the upper detector.
        settings: estimator of gamma, its inversion, and the limits for valid pixels.

    Raises:
        UserError: `discriminate` refuses the noise powers.
    """
    sums, noise_powers = products_of_looks(looks), (float(looks.noise_powers[0]), float(looks.noise_powers[1]))
    gamma = discriminate(sums, DISCRIMINANTS[settings.discriminant], noise_powers)
    inverse = _by_slope_table(settings.slope_table) if settings.slope_table else INVERSES[settings.inverse]
    found = inverse(pair, gamma, looks.squint, looks.columns)
    sigma, cnr = accuracy(sums, found, noise_powers, pair.uncertainty)
    even, scale = whitened_products(sums, noise_powers)
    explained, left = _eigenvalues(even) / noise_powers[0]
    # K amplitudes and one complex gamma are estimated.
    fit = Fit(explained, left, looks.count - 1, directions=2, leaked=looks.leaked)
    outside = UNPAIRED[found.reason]
    in_sum = sums.sum_power / noise_powers[0] >= detection_limit(looks, 1, settings)
    strong = in_sum & (cnr >= settings.min_cnr) | outside
    validity = decide_validity(looks, fit, strong, ~outside, Validity.OUTSIDE_PAIR, settings)
    estimate = ElevationEstimate.of_one(found.elevation, sigma, cnr, validity)
    # Whitened, Sigma and Delta are cos and sin of an angle that turns with elevation.
    across = 1 + (scale * found.modulus) ** 2
    turning = (scale * found.slope / across) ** 2
    peaks = SinglePeaks.alone(found.elevation, explained, found.sum_gain * across / 2, turning)
    return in_two_channels(estimate, peaks, looks, pair, settings)


def _eigenvalues(sums: Products) -> F64:
    """Return the greater and the lesser eigenvalue of the covariance of Sigma and Delta, shape (2, ...)."""
    mean = (sums.sum_power + sums.difference_power) / 2
    apart = np.hypot((sums.sum_power - sums.difference_power) / 2, np.abs(sums.cross_power))
    return np.stack([mean + apart, mean - apart])
