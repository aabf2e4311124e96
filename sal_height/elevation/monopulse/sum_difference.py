"""The discriminator of a relief radar that receives Sigma and Delta of two beams (relief paper: Volosyuk et al.).

The two beams G are offset by half of delta above and below the equisignal direction theta_0. Of a surface element at
theta_0 + theta_h with the complex amplitude beta, the channels receive

    Sigma = upper + lower = 2 G(delta/2) beta,   Delta = upper - lower = gamma Sigma,   gamma = g theta_h to first order

(relief paper, eq. 3 to 9), each with noise of its own. gamma is estimated from sums of products (`Products`) by one of
`products.DISCRIMINANTS`: `ratio` is the real part of the relief paper's eq. 17; `total_least_squares` is the exact
maximum likelihood for a real gamma, tan(1/2 atan2(2 Re Sigma* Delta, |Sigma|^2 - |Delta|^2)), which eq. 17 is for a
complex one only. `discriminant.invert`, `invert_linear` or a `SlopeTable` then say which elevation has that gamma.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator
from scipy.special import gammainccinv

from sal_height.beams.array import Beams
from sal_height.beams.pattern import Pattern
from sal_height.elevation.estimate import FALSE_ALARMS, MISFIT_SHARE, ElevationEstimate, Validity
from sal_height.elevation.looks import Looks
from sal_height.elevation.monopulse.estimators import (
    Estimator,
    NoisePowers,
    Products,
    accuracy,
    discriminate,
    products_of_looks,
    total_least_squares,
    whitened_products,
)
from sal_height.elevation.monopulse.inversion import (
    LEAST_SLOPE,
    Inversion,
    Reason,
    discriminant,
    discriminant_slope,
    invert,
)
from sal_height.errors import UserError
from sal_height.sensor.channels import Channels

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Inverse = Callable[[Beams, Array, Array], Inversion]
"""Elevations from the pair of beams, gamma, and the squint of each (rad, broadcasts): see `discriminant.invert`."""

SLOPE_COLUMNS = ["angle_rad", "gamma"]
"""First line of the file of a slope table."""

MATRIX_ROUNDING = 1e-6
"""Share of a channel matrix by which it may differ from one that forms sum and difference."""


def synthesise(pulses: ComplexArray, phase: Array) -> ComplexArray:
    """Coherent sum over pulses, the last axis, after taking off the `phase` (rad) that the flight gave to each.

    Linear and the same for every channel, hence it may come before or after the forming of sum and difference. The
    estimate of gamma is not linear and must come last.
    """
    return np.asarray(np.sum(pulses * np.exp(-1j * phase), axis=-1))


def crossover_slope(pattern: Pattern, separation: float, beamwidth: float) -> float:
    """Slope g = -G'(delta/2) / G(delta/2) of gamma in the equisignal direction, 1/rad (relief paper, eq. 4).

    Args:
        pattern: G of both beams, even in elevation.
        separation: delta between the two beams' axes, rad.
        beamwidth: wavelength / aperture diameter, rad.

    Raises:
        UserError: the beams do not overlap there, or gamma does not rise.
    """
    half = separation / 2 / beamwidth
    amplitude, slope = np.asarray(pattern.amplitude(half, 0.0)).item(), np.asarray(pattern.slope(half, 0.0)).item()
    steepness = float(np.real(-slope / amplitude)) / beamwidth if amplitude else np.nan
    if not (np.isfinite(steepness) and steepness > 0):
        raise UserError(
            f"Beams {separation:.6g} rad apart have the discriminator slope {steepness:.6g} /rad half way between "
            "them; it must be finite and greater than 0."
        )
    return steepness


def invert_linear(pair: Beams, gamma: npt.ArrayLike, squint: npt.ArrayLike) -> Inversion:
    """Elevation by the tangent in the equisignal direction, theta_0 + gamma / g (relief paper, eq. 6, 7); broadcasts.

    Of unlike beams, whose gamma is not 0 half way between them, the tangent there. Exact to first order only; see
    `discriminant.invert` for the beams as they are. |gamma| up to 1 is INSIDE, as there.

    Args:
        pair: the two beams.
        gamma: NaN is NOT_FINITE.
        squint: of the targets, rad.
    """
    gamma, squint = np.broadcast_arrays(np.asarray(gamma, dtype=np.float64), np.asarray(squint, dtype=np.float64))
    middle = _equisignal(pair, squint)
    slope = discriminant_slope(pair, middle, squint)
    with np.errstate(divide="ignore", invalid="ignore"):
        elevation = middle + (gamma - discriminant(pair, middle, squint)) / slope
    rising = slope * pair.beamwidth > LEAST_SLOPE
    return _inversion(elevation, slope, gamma, (-1.0, 1.0), rising)


@dataclass(frozen=True)
class SlopeTable:
    """A measured discrimination characteristic (relief paper, figure 2): gamma over the angle off theta_0.

    Attributes:
        angle: theta_h, rad, increasing.
        gamma: Delta / Sigma there, rising or falling all along.

    Raises:
        UserError: fewer than two nodes, unequal numbers of them, values that are not finite, angles that do not
            increase, or a slope that is 0 or changes sign.
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
            raise UserError("A slope table has angles that do not increase, or is not finite; both are needed.")
        steps = np.diff(self.gamma)
        turns = np.flatnonzero(np.sign(steps) != np.sign(self.gamma[-1] - self.gamma[0]))
        if turns.size or not steps.any():
            turn = int(turns[0]) if turns.size else 0
            raise UserError(
                f"A slope table changes sign between {self.angle[turn]:.6g} and {self.angle[turn + 1]:.6g} rad, where "
                f"gamma goes from {self.gamma[turn]:.6g} to {self.gamma[turn + 1]:.6g}; it must rise or fall all along."
            )

    def invert(self, pair: Beams, gamma: npt.ArrayLike, squint: npt.ArrayLike) -> Inversion:
        """Elevation around the equisignal direction of `pair`, by a monotonic cubic through the nodes; broadcasts.

        The slope is that of the chord between the nodes. Outside the table gamma is BELOW or ABOVE. Arguments as
        of `invert_linear`.
        """
        gamma, squint = np.broadcast_arrays(np.asarray(gamma, dtype=np.float64), np.asarray(squint, dtype=np.float64))
        order = slice(None, None, 1 if self.gamma[-1] > self.gamma[0] else -1)
        angles, values = np.array(self.angle)[order], np.array(self.gamma)[order]
        section = np.clip(np.searchsorted(values, gamma, side="right") - 1, 0, len(values) - 2)
        elevation = _equisignal(pair, squint) + PchipInterpolator(values, angles)(np.clip(gamma, values[0], values[-1]))
        slope = (np.diff(values) / np.diff(angles))[section]
        return _inversion(elevation, slope, gamma, (values[0], values[-1]), np.ones(gamma.shape, dtype=np.bool_))


def read_slope_table(path: Path) -> SlopeTable:
    """The slope table in a CSV file: a line `angle_rad,gamma`, then one for each node.

    Raises:
        UserError: the file cannot be read, has another first line, or a line that is not two numbers; or what
            `SlopeTable` refuses.
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


def _equisignal(pair: Beams, squint: Array) -> Array:
    """Elevation (rad) at `squint` of the direction as far along the detector axis from one beam as from the other."""
    seen = squint + np.average(pair.aspects, weights=pair.weights)
    return np.asarray(np.mean(pair.boresights) - seen * np.tan(pair.rotation))


def _inversion(
    elevation: Array, slope: Array, gamma: Array, ends: tuple[float, float], exists: npt.NDArray[np.bool_]
) -> Inversion:
    """The inversion of gamma that is good between `ends`, where there `exists` a characteristic at all."""
    reason = np.select(
        [~np.isfinite(gamma), ~exists, gamma < ends[0], gamma > ends[1]],
        [Reason.NOT_FINITE, Reason.NO_DOMAIN, Reason.BELOW, Reason.ABOVE],
        Reason.INSIDE,
    ).astype(np.uint8)
    inside = reason == Reason.INSIDE
    return Inversion(np.where(inside, elevation, np.nan), np.where(inside, slope, np.nan), reason)


INVERSES: dict[str, Inverse] = {"exact": invert, "linear": invert_linear}
"""Inversions by the beams themselves, by name."""


@dataclass(frozen=True)
class Discriminator:
    """How an elevation comes from Sigma and Delta.

    Attributes:
        estimator: of gamma, one of `products.DISCRIMINANTS`.
        inverse: elevation of gamma: one of INVERSES, or the `invert` of a `SlopeTable`.
    """

    estimator: Estimator = total_least_squares
    inverse: Inverse = invert


def sum_difference_elevation(
    looks: Looks, pair: Beams, squint: Array, noise_powers: NoisePowers, discriminator: Discriminator, min_cnr: float
) -> ElevationEstimate:
    """Elevation of the scatterer in every pixel of images whose channels are Sigma and Delta.

    Sigma and CNR are those of `products.accuracy`.

    LOW_CNR: what both channels have in common is not clear of noise, or below `min_cnr`. OUTSIDE_PAIR: gamma has no
    elevation, as where there is a signal in Delta and none in Sigma. NOT_ONE_SCATTERER: of two whitened channels one
    scatterer leaves K noise powers and not more, as in `estimate.validity_of`.

    Args:
        looks: covariance of Sigma = upper + lower and Delta = upper - lower in each pixel (`sum_difference_channels`).
        pair: the two beams, lower and upper.
        squint: of each column, rad, shape (cols,).
        noise_powers: of one SLC pixel of Sigma and of Delta.
        discriminator: gamma's estimate and its inversion.
        min_cnr: pixels below this power ratio are LOW_CNR.

    Raises:
        UserError: not two channels and two beams; or noise powers as in `discriminate`.
    """
    if not looks.covariance.shape[-1] == pair.count == 2:
        raise UserError(
            f"There are {looks.covariance.shape[-1]} channels and {pair.count} beams; sum and difference need 2 of "
            "each."
        )
    sums = products_of_looks(looks)
    gamma = discriminate(sums, discriminator.estimator, noise_powers)
    found = discriminator.inverse(pair, gamma, np.broadcast_to(squint, gamma.shape))
    sigma, cnr = accuracy(sums, pair.response(found.elevation, squint), found.slope, noise_powers)
    return ElevationEstimate(found.elevation, sigma, cnr, _validity(looks, sums, noise_powers, found, cnr >= min_cnr))


def _validity(
    looks: Looks, sums: Products, noise_powers: NoisePowers, found: Inversion, strong: npt.NDArray[np.bool_]
) -> npt.NDArray[np.uint8]:
    """Reason for which each pixel's estimate cannot be used, the first that applies, or OK."""
    explained, left = _eigenvalues(whitened_products(sums, noise_powers)[0]) / noise_powers[0]
    count = looks.count
    counts, which = np.unique(count, return_inverse=True)
    detected = explained >= gammainccinv(counts, FALSE_ALARMS / 2)[which]
    outside = np.isin(found.reason, [Reason.BELOW, Reason.ABOVE, Reason.NO_DOMAIN])
    misfit = (left > count + 5 * np.sqrt(count)) & (left - count > MISFIT_SHARE * explained)
    return np.select(
        [~looks.finite, ~detected, outside, ~strong, misfit],
        [
            Validity.MISSING_DATA,
            Validity.LOW_CNR,
            Validity.OUTSIDE_PAIR,
            Validity.LOW_CNR,
            Validity.NOT_ONE_SCATTERER,
        ],
        Validity.OK,
    ).astype(np.uint8)


def _eigenvalues(sums: Products) -> Array:
    """The greater and the lesser eigenvalue of the covariance of Sigma and Delta, shape (2, ...)."""
    mean = (sums.sum_power + sums.difference_power) / 2
    apart = np.hypot((sums.sum_power - sums.difference_power) / 2, np.abs(sums.cross_power))
    return np.stack([mean + apart, mean - apart])


def sum_difference_channels(noise_covariance: ComplexArray, channel_matrix: ComplexArray) -> Channels:
    """Sigma = upper + lower and Delta = upper - lower from a sensor's channels, for `sum_difference_elevation`.

    The matrix of these `Channels` is that of the gains of the beams, lower and upper.

    Args:
        noise_covariance: E n n^H of the channels, shape (2, 2).
        channel_matrix: the channels from the beams (lower, upper), shape (2, 2): see `separated_gains`.

    Raises:
        UserError: the matrix forms no sum and difference, or the channels' noise is correlated: that of receivers
            before the hybrid that are not alike. The estimators for the whole array take any noise.
    """
    channels, beams = separated_gains(channel_matrix)
    transform = np.diag(1 / channels)
    noise = transform @ noise_covariance @ transform.conj().T
    sum_noise, difference_noise = (float(power) for power in np.diag(noise).real)
    correlation = abs(noise[0, 1]) / max(np.sqrt(abs(sum_noise * difference_noise)), np.finfo(np.float64).tiny)
    if not correlation <= MATRIX_ROUNDING:
        raise UserError(
            f"The noise of Sigma and Delta has a correlation of {correlation:.3g}; their discriminator needs it "
            "independent."
        )
    return Channels(transform, np.eye(2) * beams, np.array([sum_noise, difference_noise]))


def separated_gains(matrix: ComplexArray) -> tuple[ComplexArray, Array | ComplexArray]:
    """Gains of the two channels and of the two beams of a sensor that forms sum and difference.

    Its channels are matrix @ (lower, upper) with matrix = diag(channels) [[1, 1], [-1, 1]] diag(beams): gains of the
    receivers or couplings of the hybrid, and of what is before the hybrid.

    Args:
        matrix: channels from beams, shape (2, 2).

    Returns:
        Gains of (Sigma, Delta) and of (lower, upper); the mean power of the latter is 1, and they are real
        where they can be.

    Raises:
        UserError: the matrix is no such product, or channel 0 is not the sum.
    """
    matrix = np.asarray(matrix, dtype=np.complex128)
    error = np.inf
    if matrix.shape == (2, 2) and np.all(np.isfinite(matrix)):
        (a, b), (c, d) = matrix
        error = abs(a * d + b * c) / max(abs(a * d), abs(b * c), np.finfo(np.float64).tiny)
        if not (a * np.conj(b)).real > 0 or not abs(d) > 0:
            error = np.inf
    if not error <= MATRIX_ROUNDING:
        raise UserError(
            f"The channel matrix {matrix.tolist()} forms no sum and difference of two beams; it must be "
            "diag(channel gains) [[1, 1], [-1, 1]] diag(beam gains), with gains that add in channel 0."
        )
    direction = matrix[0].sum() / abs(matrix[0].sum())
    sum_gain = direction * np.sqrt(np.mean(np.abs(matrix[0]) ** 2))
    beams = matrix[0] / sum_gain
    real = np.all(np.abs(beams.imag) <= MATRIX_ROUNDING)
    return np.array([sum_gain, matrix[1, 1] / beams[1]]), beams.real if real else beams
