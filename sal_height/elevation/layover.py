"""Two scatterers in one pixel: layover, at the same range and Doppler frequency but at different elevations.

Look k holds A_k a(t1) + B_k a(t2) plus noise of variance sigma^2. With R = sum_k g_k g_k^H, profiling out the complex
A_k and B_k leaves the conditional likelihood of a pair of elevations (Ziskind and Wax, IEEE Trans. Acoustics, Speech
and Signal Processing 36, 1988)

    f(t1, t2) = tr(P R),    P = A (A^H A)^-1 A^H,    A = [a(t1) a(t2)]

What the best pair explains beyond the best single elevation, over sigma^2, is the likelihood ratio of two scatterers
against one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.special import gammaincc, gammaln

from sal_height.beams import Beams
from sal_height.elevation.bounds import beam_power, information
from sal_height.elevation.estimate import ElevationEstimate, SecondScatterer, Validity, explained_power
from sal_height.elevation.likelihood import GUARD
from sal_height.elevation.looks import Covariance, Looks
from sal_height.errors import UserError
from sal_height.numeric import F32, F64, Bool, Index, compiled, in_parallel

Numbers = npt.NDArray[Any]
"""Real, or complex if the beams are."""

GRID_STEP = 0.2
"""Spacing of the coarse search in beamwidths, as of the search for one scatterer."""

LEAST_SEPARATION = 0.1
"""Beamwidths between the elevations of a pair: well below what can be told apart, so that none pile up there."""

LEAST_RESIDUE = 0.02
"""Share of |a|^2 that must lie off another a for the two to be tried as a pair on the grid."""

SUSPICIOUS = 10.0
"""Times the false alarms: share of single scatterers for which pairs are tried at all."""

NEWTON_STEPS = 12
"""Of the climb from the grid at most, each half a step of the grid at most."""

SETTLED = 1e-5
"""Newton step in beamwidths that is the last."""

FALSE_ALARM = 1e-3
"""Share of single scatterers that may pass for two, of the few that do not look like one."""

PIXELS_AT_ONCE = 1024
"""Pixels whose beams are held at a time."""


@dataclass(frozen=True)
class TwoScatterers:
    """The two scatterers of every pixel, the one nearer to nadir first; NaN where two were not detected.

    Attributes:
        detected: whether there are two, both within the span of the boresights, shape (rows, cols).
        elevation: rad from nadir, shape (rows, cols, 2).
        power: carrier-to-noise power ratio of one look in a detector looking straight at the scatterer, (rows, cols,
            2).
        sigma: standard deviation of elevation, rad, (rows, cols, 2): the bound for the amplitudes of these looks, to
            first order in noise power over theirs. Infinite where that much is not known of them.
    """

    detected: Bool
    elevation: F64
    power: F64
    sigma: F64


def two_scatterers(
    covariance: Covariance,
    beams: Beams,
    squint: F64,
    noise_power: float,
    looks_count: npt.ArrayLike,
    single: F64,
    false_alarm: float,
) -> TwoScatterers:
    """Find the pixels that hold two scatterers rather than one, and the elevations of both.

    A pixel counts as two if the best pair explains more than `detection_threshold` beyond the best single elevation.
    Pairs are tried where a second scatterer beside the single one explains enough to be suspicious.

    Args:
        covariance: R of M channels, shape (rows, cols, M, M), finite; complex if the beams are.
        beams: of the M detectors, 3 or more.
        squint: of each column, rad, shape (cols,).
        noise_power: E|n|^2 of one SLC pixel in one channel.
        looks_count: K, for all pixels or each.
        single: elevation of the most likely single scatterer (`array_ml.peak_elevation`), rad, shape (rows, cols).
        false_alarm: share of single scatterers that may be taken for two, above 0 and up to 0.1.

    Raises:
        UserError: too few detectors, a real covariance of complex beams, or a noise power, number of looks or share of
            false alarms out of range.
    """
    _require(covariance, beams, noise_power, looks_count, false_alarm)
    covariance = covariance if beams.is_complex else covariance.real
    shape = single.shape
    looks = np.broadcast_to(np.asarray(looks_count, dtype=np.float64), shape)
    found = np.full((*shape, 3, 2), np.nan)
    angles, angle_of = np.unique(squint, return_inverse=True)
    for index, angle in enumerate(angles.tolist()):
        cols = np.flatnonzero(angle_of == index)
        grid = _PairGrid.of(beams, angle)
        pixel = (np.repeat(np.arange(shape[0]), cols.size), np.tile(cols, shape[0]))
        levels = _thresholds(beams, angle, looks[pixel], false_alarm)

        def work(part: slice, grid: _PairGrid = grid, pixel: Any = pixel, levels: F64 = levels) -> None:
            for first in range(part.start, part.stop, PIXELS_AT_ONCE):
                block = slice(first, min(first + PIXELS_AT_ONCE, part.stop))
                here = (pixel[0][block], pixel[1][block])
                found[here] = _pairs_of(
                    covariance[here] / noise_power, grid, looks[here], single[here], levels[:, block]
                )

        in_parallel(work, pixel[0].size, PIXELS_AT_ONCE)
    return TwoScatterers(np.isfinite(found[:, :, 0, 0]), found[:, :, 0], found[:, :, 1], found[:, :, 2])


def resolve_layover(
    estimate: ElevationEstimate, looks: Looks, beams: Beams, squint: F64, noise_power: float, min_cnr: float
) -> ElevationEstimate:
    """The estimate with both scatterers of the pixels that do not fit one, where two can be told apart.

    Those become TWO_SCATTERERS, with the stronger one in the place of the estimate. Both must have `min_cnr`.

    Args:
        estimate: by all detectors (`array_ml.ml_elevation`); with fewer than three it stays as it is.
        looks: covariance of M channels in each pixel.
        beams: of the M detectors.
        squint: of each column, rad, shape (cols,).
        noise_power: E|n|^2 of one SLC pixel in every channel.
        min_cnr: least usable power ratio.
    """
    if beams.count < 3:
        return estimate
    row, col = np.nonzero(estimate.validity == Validity.NOT_ONE_SCATTERER)
    pixels, single = looks.covariance[row, col][None], estimate.elevation[row, col][None]
    two = two_scatterers(pixels, beams, squint[col], noise_power, looks.count[row, col][None], single, FALSE_ALARM)
    found = two.detected[0] & (two.power[0] >= min_cnr).all(axis=-1)
    row, col, order = row[found], col[found], np.argsort(-two.power[0][found], axis=-1)
    values = (np.take_along_axis(part[0][found], order, axis=-1).T for part in (two.elevation, two.sigma, two.power))
    surfaces = [estimate.elevation.copy(), estimate.sigma.copy(), estimate.cnr.copy()]
    second = [np.full(estimate.elevation.shape, np.nan) for _ in surfaces]
    for surface, other, (stronger, weaker) in zip(surfaces, second, values, strict=True):
        surface[row, col], other[row, col] = stronger, weaker
    validity = estimate.validity.copy()
    validity[row, col] = Validity.TWO_SCATTERERS
    elevation, sigma, cnr = surfaces
    return ElevationEstimate(elevation, sigma, cnr, validity, SecondScatterer(*second))


def _thresholds(beams: Beams, squint: float, looks: F64, false_alarm: float) -> F64:
    """Gains (sigma^2) that are suspicious, and that detect, with the looks of each pixel (pixels,): (2, pixels)."""
    counts, which = np.unique(looks, return_inverse=True)
    shares = (SUSPICIOUS * false_alarm, false_alarm)
    levels = [[detection_threshold(beams, squint, count, share) for count in counts.tolist()] for share in shares]
    return np.array(levels)[:, which]


def detection_threshold(beams: Beams, squint: float, looks: float, false_alarm: float) -> float:
    """Least gain of a second scatterer, in units of sigma^2, that one scatterer reaches with a share `false_alarm`.

    In a known direction, noise gives the gain a gamma distribution of order K. Its greatest value over direction passes
    a level x no more often than it starts above x and crosses it upwards (Rice; Davies, Biometrika 64, 1977):

        P(max > x) <= Q(x) + L sqrt(x / pi) p(x)

    Q and p are the distribution's upper tail and density, L the length of the path of a / |a| over the boresights.

    Args:
        beams: of the array.
        squint: rad.
        looks: K.
        false_alarm: wanted probability.
    """
    nodes = np.linspace(*beams.span, math.ceil(np.ptp(beams.span) / (GRID_STEP * beams.beamwidth)) + 1)
    power = beam_power(beams.response(nodes, squint))
    length = float(np.trapezoid(np.sqrt(information(beams, nodes, squint) / power), nodes))

    def excess(level: float) -> float:
        density = math.exp((looks - 1) * math.log(level) - level - gammaln(looks))
        return float(gammaincc(looks, level)) + length * math.sqrt(level / math.pi) * density - false_alarm

    return float(brentq(excess, looks, 10 * looks + 1000))


def two_source_crb(
    beams: Beams, elevations: npt.ArrayLike, squint: npt.ArrayLike, cnrs: npt.ArrayLike, looks: int
) -> F64:
    """Least standard deviation (rad) of the elevations of two independent Gaussian scatterers, shape (..., 2).

    With S the covariance of the amplitudes over sigma^2, unknown, and D = [a'(t1) a'(t2)] (Stoica and Nehorai, IEEE
    Trans. Acoustics, Speech and Signal Processing 38, 1990):

        F = 2 K Re{(D^H (I - P) D) * (S (S + (A^H A)^-1)^-1 S)^T},    * element by element

    Args:
        beams: of the array.
        elevations: of both scatterers, rad, shape (..., 2).
        squint: rad, shape (...).
        cnrs: power ratio of each in one look of a detector that looks straight at it, shape (..., 2); both bounds are
            infinite where one is not positive.
        looks: K.
    """
    elevations = np.asarray(elevations, dtype=np.float64)
    model = _PairModel.of(beams, elevations, np.asarray(squint, dtype=np.float64))
    signal = np.maximum(cnrs, 0.0)[..., None] * np.eye(2)
    return model.bound(signal @ np.linalg.inv(signal + model.gram) @ signal, looks)


@dataclass(frozen=True)
class _PairModel:
    """A pair's beams A, and what its likelihood and bound need of them; all of shape (..., ., .).

    Attributes:
        gram: (A^H A)^-1, (..., 2, 2).
        inverse: A^+ = (A^H A)^-1 A^H, (..., 2, M).
        beyond: (I - P) D, (..., M, 2).
        slope_power: D^H (I - P) D, (..., 2, 2).
        matrix: A, (..., M, 2).
    """

    matrix: Numbers
    gram: Numbers
    inverse: Numbers
    beyond: Numbers
    slope_power: Numbers

    @classmethod
    def of(cls, beams: Beams, elevations: F64, squint: F64 | float) -> Self:
        """Of pairs at `elevations` (..., 2) and `squint` (...), rad."""
        angle = np.asarray(squint)[..., None]
        matrix = np.swapaxes(beams.response(elevations, angle), -1, -2)
        slope = np.swapaxes(beams.slope(elevations, angle), -1, -2)
        gram = np.linalg.inv(_adjoint(matrix) @ matrix)
        inverse = gram @ _adjoint(matrix)
        beyond = slope - matrix @ (inverse @ slope)
        return cls(matrix, gram, inverse, beyond, _adjoint(beyond) @ beyond)

    def explained(self, fitted: Numbers) -> F64:
        """The likelihood f = tr(P R), shape (...), of `fitted` = A^+ R, (..., 2, M)."""
        return _traces(fitted, self.matrix).sum(axis=-1)

    def amplitudes(self, fitted: Numbers) -> Numbers:
        """Sum over looks of the products of the fitted amplitudes, A^+ R A^+H, noise included; (..., 2, 2)."""
        return fitted @ _adjoint(self.inverse)

    def newton_step(self, fitted: Numbers) -> F64:
        """Gauss-Newton step of f, rad, (..., 2): its curvature as it is expected of these amplitudes."""
        gradient = _traces(fitted, self.beyond)
        curvature = (self.slope_power * np.swapaxes(self.amplitudes(fitted), -1, -2)).real
        ridge = 1e-9 * np.trace(curvature, axis1=-2, axis2=-1)[..., None, None] * np.eye(2)
        return np.linalg.solve(curvature + ridge, gradient[..., None])[..., 0]

    def bound(self, known: Numbers, looks: npt.ArrayLike) -> F64:
        """1 / sqrt of F = 2 K Re{(D^H (I - P) D) * known^T}, rad, (..., 2); infinite where F is not positive definite.

        Args:
            known: covariance of the amplitudes in one look over sigma^2, less what noise makes of it, (..., 2, 2).
            looks: K, shape (...).
        """
        fisher = 2 * np.asarray(looks)[..., None, None] * (self.slope_power * np.swapaxes(known, -1, -2)).real
        diagonal, determinant = np.diagonal(fisher, axis1=-2, axis2=-1), np.linalg.det(fisher)[..., None]
        positive = (diagonal > 0) & (diagonal[..., ::-1] > 0) & (determinant > 0)
        variance = np.divide(diagonal[..., ::-1], determinant, where=positive, out=np.full_like(diagonal, np.inf))
        return np.sqrt(variance)


@dataclass(frozen=True)
class _PairGrid:
    """Coarse search for a pair, at one squint.

    Attributes:
        beams: of the array.
        squint: rad.
        nodes: elevations, rad, shape (nodes,).
        units: u = a / |a| at the nodes, (M, nodes).
        overlap: u_i^H u_j, (nodes, nodes).
        weight: 1 / (1 - |overlap|^2) of pairs that are tried, i < j; 0 elsewhere.
    """

    beams: Beams
    squint: float
    nodes: F64
    units: Numbers
    overlap: Numbers
    weight: F32

    @classmethod
    def of(cls, beams: Beams, squint: float) -> Self:
        """Over the array and as far beyond as one scatterer is searched."""
        first, last = beams.domain(GUARD * beams.beamwidth)
        nodes = np.linspace(first, last, math.ceil((last - first) / (GRID_STEP * beams.beamwidth)) + 1)
        unit = _unit(beams.response(nodes, squint))
        overlap = unit.conj() @ unit.T
        residue = 1 - np.abs(overlap) ** 2
        weight = np.divide(1.0, residue, where=np.triu(residue > LEAST_RESIDUE, 1), out=np.zeros_like(residue))
        kind = np.complex64 if np.iscomplexobj(unit) else np.float32
        units = np.ascontiguousarray(unit.T, dtype=kind)
        return cls(beams, squint, nodes, units, overlap.astype(kind), weight.astype(np.float32))

    def gain_beside(self, covariance: Covariance, first: F64) -> F32:
        """Greatest power that a node explains beyond what elevations `first` (rad, (pixels,)) do, (pixels,)."""
        one = _unit(self.beams.response(first, self.squint)).astype(self.units.dtype)
        gain = np.empty(len(covariance), np.float32)
        _gains(covariance, one, self.units, gain)
        return gain

    def best(self, covariance: Covariance) -> F64:
        """Nodes (rad) of the pair that explains most, shape (pixels, 2)."""
        place = np.empty((len(covariance), 2), dtype=np.intp)
        _best_pairs(covariance, self.units, self.overlap, self.weight, place)
        return self.nodes[place]


def _pairs_of(covariance: Covariance, grid: _PairGrid, looks: F64, single: F64, levels: F64) -> F64:
    """Elevations, powers and deviations of the pairs in some pixels, shape (pixels, 3, 2); NaN where there is none.

    Args:
        covariance: in units of the noise power, shape (pixels, M, M).
        grid: at the pixels' squint.
        looks: K, (pixels,).
        single: elevations of the single scatterers, rad, (pixels,).
        levels: gains that are suspicious, and that detect, (2, pixels).
    """
    found = np.full((len(covariance), 3, 2), np.nan)
    covariance = covariance.astype(grid.units.dtype)
    suspicious = np.flatnonzero(grid.gain_beside(covariance, single) > levels[0])
    if not suspicious.size:
        return found
    looks, needed = looks[suspicious], levels[1, suspicious]
    start = grid.best(covariance[suspicious])
    some = covariance[suspicious].astype(np.result_type(covariance, np.float64))
    pair = np.sort(_climb(some, grid, start), axis=-1)
    model = _PairModel.of(grid.beams, pair, grid.squint)
    fitted = model.inverse @ some
    one = explained_power(some, grid.beams.response(single[suspicious], grid.squint))
    first, last = grid.beams.span
    detected = (model.explained(fitted) - one > needed) & (pair[:, 0] >= first) & (pair[:, 1] <= last)
    signal = model.amplitudes(fitted) / looks[:, None, None] - model.gram
    powers = np.diagonal(signal, axis1=-2, axis2=-1).real
    found[suspicious[detected]] = np.stack([pair, powers, model.bound(signal - model.gram, looks)], axis=1)[detected]
    return found


def _climb(covariance: Numbers, grid: _PairGrid, start: F64) -> F64:
    """Pairs (pixels, 2) from nodes of the grid to peaks of f near them, rad; a step that does not rise is quartered."""
    found, active = start.copy(), np.arange(len(start))
    reach = np.full((len(start), 1), GRID_STEP * grid.beams.beamwidth / 2)
    model = _PairModel.of(grid.beams, start, grid.squint)
    fitted = model.inverse @ covariance
    height, step = model.explained(fitted), model.newton_step(fitted)
    for _ in range(NEWTON_STEPS):
        step = np.clip(step, -reach, reach)
        moving = np.abs(step).max(axis=1) > SETTLED * grid.beams.beamwidth
        active, covariance, height, step, reach = (x[moving] for x in (active, covariance, height, step, reach))
        trial = np.clip(found[active] + step, grid.nodes[0], grid.nodes[-1])
        apart = np.abs(np.diff(trial)) >= LEAST_SEPARATION * grid.beams.beamwidth
        trial = np.where(apart, trial, found[active])
        model = _PairModel.of(grid.beams, trial, grid.squint)
        fitted = model.inverse @ covariance
        trial_height = model.explained(fitted)
        rises = trial_height > height
        found[active[rises]], height = trial[rises], np.maximum(height, trial_height)
        reach = np.where(rises[:, None], reach, np.abs(step).max(axis=1, keepdims=True) / 4)
        step = np.where(rises[:, None], model.newton_step(fitted), step)
    return found


def _unit(response: Numbers) -> Numbers:
    """Responses (..., M) over their norm; 0 where no detector sees anything."""
    norm = np.linalg.norm(response, axis=-1, keepdims=True)
    return response * np.divide(1.0, norm, where=norm > 0, out=np.zeros_like(norm))


def _traces(left: Numbers, right: Numbers) -> F64:
    """Real diagonal of `left` (..., 2, M) times `right` (..., M, 2), shape (..., 2)."""
    return np.einsum("...im,...mi->...i", left, right).real


def _adjoint(matrix: Numbers) -> Numbers:
    return np.swapaxes(matrix.conj(), -1, -2)


def _require(
    covariance: Covariance, beams: Beams, noise_power: float, looks_count: npt.ArrayLike, false_alarm: float
) -> None:
    if beams.count < 3:
        raise UserError(f"The sensor has {beams.count} detectors; telling two scatterers from one needs 3 or more.")
    if beams.is_complex and not np.iscomplexobj(covariance):
        raise UserError("The covariance of complex beams is real; it must be complex (multilook with hermitian).")
    if not (np.isfinite(noise_power) and noise_power > 0):
        raise UserError(f"The noise power is {noise_power:g}; it must be finite and greater than 0.")
    if np.any(np.asarray(looks_count) < 1):
        raise UserError(f"The number of looks is {np.min(looks_count):g}; it must be 1 or more.")
    if not 0 < false_alarm <= 0.1:
        raise UserError(f"The share of false alarms is {false_alarm:g}; it must be above 0 and up to 0.1.")


# The loops below are compiled; sums over nodes are vectorised.


@compiled
def _gains(covariance: Numbers, one: Numbers, units: Numbers, gain: F32) -> None:
    """Greatest power that a node explains beyond unit vectors `one` (pixels, M), the part of u_j along them removed."""
    count = units.shape[1]
    outputs = np.empty_like(units)
    own = np.empty(count, np.float32)
    cross, overlap = np.empty(count, units.dtype), np.empty(count, units.dtype)
    for p in range(len(covariance)):
        _outputs(covariance[p], units, outputs, own)
        cross[:] = 0
        overlap[:] = 0
        power = np.float32(0)
        for m in range(len(units)):
            weight = np.conj(one[p, m])
            for n in range(len(units)):
                power += (weight * covariance[p, m, n] * one[p, n]).real
            for j in range(count):
                cross[j] += weight * outputs[m, j]
                overlap[j] += weight * units[m, j]
        gain[p] = 0
        for j in range(count):
            along = overlap[j].real ** 2 + overlap[j].imag ** 2
            if 1 - along > LEAST_RESIDUE:
                beyond = own[j] - 2 * (np.conj(overlap[j]) * cross[j]).real + along * power
                gain[p] = max(gain[p], beyond / (1 - along))


@compiled
def _best_pairs(covariance: Numbers, units: Numbers, overlap: Numbers, weight: F32, place: Index) -> None:
    """Nodes i < j of the greatest (c_ii + c_jj - 2 Re(overlap_ij^* c_ij)) weight_ij, c = u_i^H R u_j, per pixel."""
    count = units.shape[1]
    outputs, cross = np.empty_like(units), np.empty(count, units.dtype)
    own, explained = np.empty(count, np.float32), np.empty(count, np.float32)
    for p in range(len(covariance)):
        _outputs(covariance[p], units, outputs, own)
        best = np.float32(-1)
        for i in range(count):
            cross[:] = 0
            for m in range(len(units)):
                left = np.conj(units[m, i])
                for j in range(i + 1, count):
                    cross[j] += left * outputs[m, j]
            for j in range(i + 1, count):
                both = own[i] + own[j] - np.float32(2) * (np.conj(overlap[i, j]) * cross[j]).real
                explained[j] = both * weight[i, j]
            highest = np.float32(-1)
            for j in range(i + 1, count):
                highest = max(highest, explained[j])
            if highest > best:
                best, place[p, 0], place[p, 1] = highest, i, i + 1 + np.argmax(explained[i + 1 :])


@compiled
def _outputs(matrix: Numbers, units: Numbers, outputs: Numbers, own: F32) -> None:
    """R u_j of every node, shape (M, nodes), and u_j^H R u_j."""
    outputs[:] = 0
    own[:] = 0
    for m in range(len(units)):
        output = outputs[m]
        for n in range(len(units)):
            factor = matrix[m, n]
            for j in range(output.size):
                output[j] += factor * units[n, j]
        for j in range(output.size):
            own[j] += (np.conj(units[m, j]) * output[j]).real
