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
from functools import lru_cache, partial
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy.optimize import elementwise
from scipy.special import gammaincc, gammaln

from sal_height.beams import Beams
from sal_height.elevation._kernels import GRID_STEP
from sal_height.elevation.bounds import Numbers, information, unit_vectors
from sal_height.elevation.estimate import ElevationEstimate, Scatterer, Validity, explained_power
from sal_height.elevation.likelihood import GUARD
from sal_height.elevation.looks import Covariance, Looks
from sal_height.elevation.search import SEARCHES_HELD
from sal_height.numeric import F32, F64, Bool, Index, in_parallel

LEAST_SEPARATION = 0.1  # least distance between the elevations of a pair, beamwidths: well below what can be resolved
SUSPICIOUS = 10.0  # pairs are tried for so many times the share of single scatterers that may be taken for two
NEWTON_STEPS = 12  # maximum number of steps of the climb from the grid, each of half a step of the grid at most
SETTLED = 1e-5  # convergence threshold of the climb, beamwidths
PIXELS_AT_ONCE = 256  # pixels whose products of all pairs of nodes are held at a time, 5 MB
LEAST_RESIDUE = 0.02  # least share of |a|^2 perpendicular to another response a for which two nodes are tried as a pair


@dataclass(frozen=True, eq=False)
class TwoScatterers:
    """The two scatterers of every pixel, the one closer to nadir first; NaN where two were not detected.

    Attributes:
        elevation: rad from nadir, both within the span of the boresights, shape (rows, cols, 2).
        power: carrier-to-noise power ratio of one look in a detector looking straight at the scatterer, same shape.
        sigma: standard deviation of elevation, rad, same shape: the Cramer-Rao bound for the amplitudes of these
            looks, to first order in the ratio of noise power to theirs. Infinite where the looks do not determine it.
    """

    elevation: F64
    power: F64
    sigma: F64

    @property
    def detected(self) -> Bool:
        """Whether there are two, shape (rows, cols)."""
        return np.isfinite(self.elevation[..., 0])


def two_scatterers(looks: Looks, beams: Beams, single: F64, tried: Bool, false_alarm: float) -> TwoScatterers:
    """Find the pixels that hold two scatterers rather than one, and the elevations of both.

    A pixel holds two if the best pair explains `detection_threshold` more power than the best single elevation. To
    save time, pairs are only tried where one more scatterer beside the single one explains nearly as much.

    Args:
        looks: covariance of M channels of equal noise in each pixel; complex if the beams are.
        beams: of the M detectors, 3 or more.
        single: elevation of the most likely single scatterer (`likelihood.peak_elevation`), rad, shape (rows, cols).
        tried: pixels that are looked at, shape (rows, cols).
        false_alarm: share of single scatterers that may be taken for two, above 0 and up to 0.1.
    """
    found = np.full((3, *tried.shape, 2), np.nan)
    row, col = np.nonzero(tried)
    squints, squint_of = np.unique(looks.squint[col], return_inverse=True)
    counts, count_of = np.unique(looks.count[row, col], return_inverse=True)
    shares = np.array([SUSPICIOUS * false_alarm, false_alarm])[:, None, None]
    thresholds = detection_threshold(beams, squints[:, None], counts, shares)[:, squint_of, count_of]
    blocks = [
        (squint, pixels)
        for index, squint in enumerate(squints.tolist())
        for pixels in _blocks(np.flatnonzero(squint_of == index))
    ]
    grid_at = lru_cache(SEARCHES_HELD)(partial(_PairGrid.of, beams))

    def work(part: slice) -> None:
        for squint, pixels in blocks[part]:
            here = row[pixels], col[pixels]
            noise_power = looks.noise_power[here].astype(np.float32)
            covariance: Covariance = looks.covariance[here] / noise_power[:, None, None]
            known = looks.count[here], single[here], thresholds[:, pixels]
            found[:, *here] = _pairs_of(covariance if beams.is_complex else covariance.real, grid_at(squint), *known)

    in_parallel(work, len(blocks))
    return TwoScatterers(*found)


def _blocks(pixels: Index) -> list[Index]:
    return np.split(pixels, range(PIXELS_AT_ONCE, len(pixels), PIXELS_AT_ONCE))


def resolve_layover(
    estimate: ElevationEstimate, looks: Looks, beams: Beams, min_cnr: float, false_alarm: float
) -> ElevationEstimate:
    """Resolve the pixels that do not fit one scatterer into two, where two are detected.

    Those become TWO_SCATTERERS: the stronger one replaces the estimate, the weaker one is the second. Both must have
    `min_cnr`. The other arguments are those of `two_scatterers`, and an estimate by all detectors.
    """
    suspicious = estimate.validity == Validity.NOT_ONE_SCATTERER
    two = two_scatterers(looks, beams, estimate.elevation, suspicious, false_alarm)
    resolved = two.detected & (two.power >= min_cnr).all(axis=-1)
    order = np.argsort(-two.power, axis=-1)
    elevation, sigma, cnr = (np.take_along_axis(f, order, axis=-1) for f in (two.elevation, two.sigma, two.power))
    strong, weak = (
        Scatterer(elevation[..., n], sigma[..., n], cnr[..., n], np.zeros_like(cnr[..., n])) for n in (0, 1)
    )
    return ElevationEstimate(
        scatterers=(strong.where(resolved, estimate.first), weak.where(resolved)),
        validity=np.where(resolved, Validity.TWO_SCATTERERS, estimate.validity).astype(np.uint8),
    )


def detection_threshold(beams: Beams, squint: npt.ArrayLike, looks: npt.ArrayLike, false_alarm: npt.ArrayLike) -> F64:
    """Gain in explained power, in sigma^2, that a second scatterer seems to bring with the probability `false_alarm`.

    If there is one scatterer only, the gain in a known direction is noise with a gamma distribution of order K. Its
    greatest value over direction exceeds a level x no more often than it starts above x or crosses x upwards (Rice;
    Davies, Biometrika 64, 1977):

        P(max > x) <= Q(x) + L sqrt(x / pi) p(x)

    Q and p are the distribution's upper tail and density, L the length of the path of a / |a| over the boresights.

    Args:
        beams: of the array.
        squint: rad; broadcasts with `looks` and `false_alarm`.
        looks: K.
        false_alarm: wanted probability.
    """
    nodes = np.linspace(*beams.span, math.ceil(np.ptp(beams.span) / (GRID_STEP * beams.beamwidth)) + 1)
    squint = np.asarray(squint)[..., None]
    length = np.trapezoid(np.sqrt(information(beams, nodes, squint) / beams.power(nodes, squint)), nodes)

    def excess(level: F64, looks: F64, length: F64, false_alarm: F64) -> F64:
        density = np.exp((looks - 1) * np.log(level) - level - gammaln(looks))
        return gammaincc(looks, level) + length * np.sqrt(level / np.pi) * density - false_alarm

    looks, length, false_alarm = np.broadcast_arrays(np.asarray(looks, np.float64), length, false_alarm)
    return np.asarray(elementwise.find_root(excess, (looks, 10 * looks + 1000), args=(looks, length, false_alarm)).x)


@dataclass(frozen=True)
class _PairModel:
    """The beams A of a pair of elevations and the matrices of its likelihood and bound, shapes (..., rows, cols).

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
        """The model of pairs at `elevations` (..., 2) and `squint` (...), rad."""
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
        """Gauss-Newton step of f, rad, (..., 2): with the expected curvature for these amplitudes."""
        gradient = _traces(fitted, self.beyond)
        curvature = (self.slope_power * np.swapaxes(self.amplitudes(fitted), -1, -2)).real
        ridge = 1e-9 * np.trace(curvature, axis1=-2, axis2=-1)[..., None, None] * np.eye(2)
        return np.linalg.solve(curvature + ridge, gradient[..., None])[..., 0]

    def bound(self, known: Numbers, looks: npt.ArrayLike) -> F64:
        """Cramer-Rao bound of both elevations, rad, (..., 2); infinite where the information is not positive definite.

        With D = [a'(t1) a'(t2)] and the covariance S of the amplitudes over sigma^2 (Stoica and Nehorai, IEEE Trans.
        Acoustics, Speech and Signal Processing 38, 1990), * element by element:

            F = 2 K Re{(D^H (I - P) D) * known^T},    known = S (S + (A^H A)^-1)^-1 S

        Args:
            known: that matrix, or S - (A^H A)^-1, which equals it to first order in the noise; shape (..., 2, 2).
            looks: K, shape (...).
        """
        fisher = 2 * np.asarray(looks)[..., None, None] * (self.slope_power * np.swapaxes(known, -1, -2)).real
        diagonal, determinant = np.diagonal(fisher, axis1=-2, axis2=-1), np.linalg.det(fisher)[..., None]
        positive = (diagonal > 0) & (diagonal[..., ::-1] > 0) & (determinant > 0)
        variance = np.divide(diagonal[..., ::-1], determinant, where=positive, out=np.full_like(diagonal, np.inf))
        return np.sqrt(variance)


@dataclass(frozen=True)
class _PairGrid:
    """The coarse search for a pair of elevations at one squint.

    Attributes:
        beams: of the array.
        squint: rad.
        nodes: elevations, rad, shape (nodes,).
        units: u = a / |a| at the nodes, (M, nodes).
        overlap: u_i^H u_j, (nodes, nodes).
        weight: 1 / (1 - |overlap|^2) of the pairs i < j that are tried; 0 elsewhere.
    """

    beams: Beams
    squint: float
    nodes: F64
    units: Numbers
    overlap: Numbers
    weight: F32

    @classmethod
    def of(cls, beams: Beams, squint: float) -> Self:
        """The grid over the array and the guard beyond it, as in the search for one scatterer."""
        first, last = beams.domain(GUARD * beams.beamwidth)
        nodes = np.linspace(first, last, math.ceil((last - first) / (GRID_STEP * beams.beamwidth)) + 1)
        unit = unit_vectors(beams.response(nodes, squint))
        overlap = unit.conj() @ unit.T
        residue = 1 - np.abs(overlap) ** 2
        weight = np.divide(1.0, residue, where=np.triu(residue > LEAST_RESIDUE, 1), out=np.zeros_like(residue))
        kind = np.complex64 if np.iscomplexobj(unit) else np.float32
        units = np.ascontiguousarray(unit.T, dtype=kind)
        return cls(beams, squint, nodes, units, overlap.astype(kind), weight.astype(np.float32))

    def gain_beside(self, covariance: Covariance, first: F64) -> F32:
        """Greatest power that one more scatterer at a node explains beside those at `first` (rad), shape (pixels,)."""
        one = unit_vectors(self.beams.response(first, self.squint)).astype(self.units.dtype)
        overlap = one.conj() @ self.units
        along = np.abs(overlap) ** 2
        outputs = covariance @ self.units
        own = np.sum((self.units.conj() * outputs).real, axis=1)
        cross = (one.conj()[:, None] @ outputs)[:, 0]
        power = np.sum((one.conj()[:, None] @ covariance)[:, 0] * one, axis=1).real
        # The part of u_j along the first one removed.
        beyond = own - 2 * (overlap.conj() * cross).real + along * power[:, None]
        apart = 1 - along > LEAST_RESIDUE
        return np.divide(beyond, 1 - along, where=apart, out=np.zeros_like(beyond)).max(axis=1)

    def best(self, covariance: Covariance) -> F64:
        """Elevations (rad) of the two nodes that together explain most, shape (pixels, 2)."""
        products = self.units.conj().T @ covariance @ self.units
        own = np.diagonal(products, axis1=1, axis2=2).real
        both = own[:, :, None] + own[:, None] - 2 * (self.overlap.conj() * products).real
        best = np.argmax((both * self.weight).reshape(len(both), -1), axis=1)
        return self.nodes[np.stack(np.divmod(best, len(self.nodes)), axis=1)]


def _pairs_of(covariance: Covariance, grid: _PairGrid, looks: F64, single: F64, levels: F64) -> F64:
    """Elevations, powers and sigmas of the two scatterers in some pixels, (3, pixels, 2); NaN where there are no two.

    Args:
        covariance: in units of the noise power, shape (pixels, M, M).
        grid: at the pixels' squint.
        looks: K, (pixels,).
        single: elevations of the single scatterers, rad, (pixels,).
        levels: gains from which on pairs are tried, and are detected, (2, pixels).
    """
    found = np.full((3, len(covariance), 2), np.nan)
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
    found[:, suspicious[detected]] = np.stack([pair, powers, model.bound(signal - model.gram, looks)])[:, detected]
    return found


def _climb(covariance: Numbers, grid: _PairGrid, start: F64) -> F64:
    """Climb from pairs of nodes to the peaks of f near them, rad, shape (pixels, 2).

    A step after which f is not higher is undone, and the next is a quarter of it at most.
    """
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


def _traces(left: Numbers, right: Numbers) -> F64:
    """Real diagonal of `left` (..., 2, M) times `right` (..., M, 2), shape (..., 2)."""
    return np.einsum("...im,...mi->...i", left, right).real


def _adjoint(matrix: Numbers) -> Numbers:
    return np.swapaxes(matrix.conj(), -1, -2)
