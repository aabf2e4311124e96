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
from scipy.stats import gamma

from sal_height.array_ml import GUARD
from sal_height.beams import Beams
from sal_height.bounds import beam_power, information
from sal_height.compiled import in_parallel
from sal_height.errors import UserError
from sal_height.estimate import explained_power
from sal_height.looks import Covariance

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]
"""Real, or complex if the beams are."""

GRID_STEP = 0.2
"""Spacing of the coarse search in beamwidths, as of the search for one scatterer."""

LEAST_SEPARATION = 0.25
"""Beamwidths between two scatterers; nearer ones differ by little more than the slope of one beam."""

LEAST_RESIDUE = 0.02
"""Share of a unit vector that must lie off another for the two to be tried as a pair on the grid."""

SUSPICIOUS = 10.0
"""Times the false alarms: share of single scatterers for which pairs are tried at all."""

NEWTON_STEPS = 12
"""Of the climb from the grid, each half a step of the grid at most."""

PIXELS_AT_ONCE = 256
"""Pixels whose pairs are held at a time."""


@dataclass(frozen=True)
class TwoScatterers:
    """The two scatterers of every pixel, the one nearer to nadir first; NaN where two were not detected.

    Attributes:
        detected: whether there are two, both within the span of the boresights, shape (rows, cols).
        elevation: rad from nadir, shape (rows, cols, 2).
        power: carrier-to-noise power ratio of one look in a detector looking straight at the scatterer, (rows, cols,
            2).
        sigma: standard deviation of elevation, rad, (rows, cols, 2); infinite where a power is not positive.
    """

    detected: npt.NDArray[np.bool_]
    elevation: Array
    power: Array
    sigma: Array


def two_scatterers(
    covariance: Covariance,
    beams: Beams,
    squint: Array,
    noise_power: float,
    looks_count: int,
    single: Array,
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
        looks_count: K.
        single: elevation of the most likely single scatterer (`array_ml.best_elevation`), rad, shape (rows, cols).
        false_alarm: share of single scatterers that may be taken for two, above 0 and up to 0.1.

    Raises:
        UserError: too few detectors, a real covariance of complex beams, or a noise power, number of looks or share of
            false alarms out of range.
    """
    _require(covariance, beams, noise_power, looks_count, false_alarm)
    shape = single.shape
    found = np.full((*shape, 3, 2), np.nan)
    angles, angle_of = np.unique(squint, return_inverse=True)
    for index, angle in enumerate(angles.tolist()):
        cols = np.flatnonzero(angle_of == index)
        grid = _PairGrid.of(beams, angle)
        pixel = (np.repeat(np.arange(shape[0]), cols.size), np.tile(cols, shape[0]))
        levels = [detection_threshold(beams, angle, looks_count, p) for p in (SUSPICIOUS * false_alarm, false_alarm)]

        def work(part: slice, grid: _PairGrid = grid, pixel: Any = pixel, levels: list[float] = levels) -> None:
            for first in range(part.start, part.stop, PIXELS_AT_ONCE):
                block = slice(first, min(first + PIXELS_AT_ONCE, part.stop))
                here = (pixel[0][block], pixel[1][block])
                found[here] = _pairs_of(covariance[here] / noise_power, grid, looks_count, single[here], levels)

        in_parallel(work, pixel[0].size, PIXELS_AT_ONCE)
    return TwoScatterers(np.isfinite(found[:, :, 0, 0]), found[:, :, 0], found[:, :, 1], found[:, :, 2])


def detection_threshold(beams: Beams, squint: float, looks: int, false_alarm: float) -> float:
    """Least gain of a second scatterer, in units of sigma^2, that one scatterer reaches with a share `false_alarm`.

    In a known direction, noise gives the gain a gamma distribution of order K. Its greatest value over direction passes
    a level x no more often than it starts above x and crosses it upwards (Rice; Davies, Biometrika 64, 1977):

        P(max > x) <= Q(x) + L sqrt(x / pi) p(x)

    Q and p are the distribution's upper tail and density, L the length of the path of a / |a| over the search domain.

    Args:
        beams: of the array.
        squint: rad.
        looks: K.
        false_alarm: wanted probability.
    """
    nodes = _nodes(beams)
    response = beams.response(nodes, squint)
    length = float(np.trapezoid(np.sqrt(information(beams, nodes, squint) / beam_power(response)), nodes))

    def excess(level: float) -> float:
        crossings = length * math.sqrt(level / math.pi) * gamma.pdf(level, looks)
        return float(gamma.sf(level, looks) + crossings) - false_alarm

    return float(brentq(excess, looks, 10 * looks + 1000))


def two_source_crb(
    beams: Beams, elevations: npt.ArrayLike, squint: npt.ArrayLike, cnrs: npt.ArrayLike, looks: int
) -> Array:
    """Least standard deviation (rad) of the elevations of two independent Gaussian scatterers, shape (..., 2).

    With S the covariance of the amplitudes over sigma^2, unknown, and D = [a'(t1) a'(t2)] (Stoica and Nehorai, IEEE
    Trans. Acoustics, Speech and Signal Processing 38, 1990):

        F = 2 K Re{(D^H (I - P) D) * (S (S + (A^H A)^-1)^-1 S)^T},    * element by element

    Args:
        beams: of the array.
        elevations: of both scatterers, rad, shape (..., 2).
        squint: rad, shape (...).
        cnrs: power ratio of each in one look of a detector that looks straight at it, shape (..., 2); the bound is
            infinite where one is not positive.
        looks: K.
    """
    elevations = np.asarray(elevations, dtype=np.float64)
    model = _PairModel.of(beams, elevations, np.asarray(squint, dtype=np.float64))
    return model.bound(np.asarray(cnrs, dtype=np.float64)[..., None] * np.eye(2), looks)


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
    def of(cls, beams: Beams, elevations: Array, squint: Array | float) -> Self:
        """Of pairs at `elevations` (..., 2) and `squint` (...), rad."""
        angle = np.asarray(squint)[..., None]
        matrix = np.swapaxes(beams.response(elevations, angle), -1, -2)
        slope = np.swapaxes(beams.slope(elevations, angle), -1, -2)
        gram = np.linalg.inv(_adjoint(matrix) @ matrix)
        inverse = gram @ _adjoint(matrix)
        beyond = slope - matrix @ (inverse @ slope)
        return cls(matrix, gram, inverse, beyond, _adjoint(beyond) @ beyond)

    def explained(self, covariance: Numbers) -> Array:
        """f = tr(P R), shape (...)."""
        return np.asarray(np.einsum("...im,...mn,...ni->...", self.inverse, covariance, self.matrix).real)

    def amplitudes(self, covariance: Numbers) -> Numbers:
        """Sum over looks of the products of the fitted amplitudes, A^+ R A^+H, noise included; (..., 2, 2)."""
        return self.inverse @ covariance @ _adjoint(self.inverse)

    def newton_step(self, covariance: Numbers) -> Array:
        """Gauss-Newton step of f, rad, (..., 2): its curvature as it is expected of these amplitudes."""
        gradient = np.einsum("...im,...mn,...ni->...i", self.inverse, covariance, self.beyond).real
        curvature = (self.slope_power * np.swapaxes(self.amplitudes(covariance), -1, -2)).real
        ridge = 1e-9 * np.trace(curvature, axis1=-2, axis2=-1)[..., None, None] * np.eye(2)
        return np.asarray(np.linalg.solve(curvature + ridge, gradient[..., None])[..., 0])

    def bound(self, signal: Numbers, looks: int) -> Array:
        """Stochastic Cramer-Rao bound, rad, (..., 2), for amplitudes of covariance `signal` over sigma^2.

        Infinite where the signal is not positive definite.
        """
        powers = np.diagonal(signal, axis1=-2, axis2=-1).real
        positive = (powers > 0).all(axis=-1) & (np.linalg.det(signal).real > 0)
        signal = np.where(positive[..., None, None], signal, np.eye(2))
        known = signal @ np.linalg.inv(signal + self.gram) @ signal
        fisher = 2 * looks * (self.slope_power * np.swapaxes(known, -1, -2)).real
        variance = np.diagonal(np.linalg.inv(fisher), axis1=-2, axis2=-1)
        return np.sqrt(np.where(positive[..., None] & (variance > 0), variance, np.inf))


@dataclass(frozen=True)
class _PairGrid:
    """Coarse search for a pair, at one squint.

    Attributes:
        beams: of the array.
        squint: rad.
        nodes: elevations, rad, shape (nodes,).
        unit: a / |a| at the nodes, (nodes, M).
        overlap: u_i^H u_j, (nodes, nodes).
        weight: 1 / (1 - |overlap|^2) of pairs that are tried, i < j; 0 elsewhere.
    """

    beams: Beams
    squint: float
    nodes: Array
    unit: Numbers
    overlap: Numbers
    weight: Array

    @classmethod
    def of(cls, beams: Beams, squint: float) -> Self:
        """Over the array and as far beyond as one scatterer is searched."""
        nodes = _nodes(beams)
        unit = _unit(beams.response(nodes, squint))
        overlap = unit.conj() @ unit.T
        residue = 1 - np.abs(overlap) ** 2
        apart = np.triu(residue > LEAST_RESIDUE) & (np.diff(np.meshgrid(nodes, nodes), axis=0)[0] != 0)
        weight = np.divide(1.0, residue, where=apart, out=np.zeros_like(residue))
        return cls(beams, squint, nodes, unit, overlap, weight)

    def gain_beside(self, covariance: Numbers, first: Array) -> Array:
        """Greatest power that a node explains beyond what elevations `first` (rad, (pixels,)) do, (pixels,)."""
        one = _unit(self.beams.response(first, self.squint))
        nodes = self.unit.T
        forms = (self.unit.conj()[:, :, None] * self.unit[:, None, :]).reshape(len(self.unit), -1)
        own = (covariance.reshape(len(covariance), -1) @ forms.T).real
        overlap = one.conj() @ nodes
        row = np.einsum("pm,pmn->pn", one.conj(), covariance)
        power = np.einsum("pm,pm->p", row, one).real[:, None]
        residue = 1 - np.abs(overlap) ** 2
        gain = own - 2 * (overlap.conj() * (row @ nodes)).real + np.abs(overlap) ** 2 * power
        gain = np.divide(gain, residue, where=residue > LEAST_RESIDUE, out=np.zeros_like(gain))
        return np.asarray(gain.max(axis=1))

    def best(self, covariance: Numbers) -> Array:
        """Nodes (rad) of the pair that explains most, shape (pixels, 2)."""
        products = self.unit.conj() @ covariance @ self.unit.T
        own = np.diagonal(products, axis1=1, axis2=2).real
        explained = own[:, :, None] + own[:, None, :] - 2 * (self.overlap.conj() * products).real
        explained *= self.weight
        place = np.argmax(explained.reshape(len(explained), -1), axis=1)
        return self.nodes[np.stack(np.divmod(place, len(self.nodes)), axis=-1)]


def _pairs_of(covariance: Numbers, grid: _PairGrid, looks: int, single: Array, levels: list[float]) -> Array:
    """Elevations, powers and deviations of the pairs in some pixels, shape (pixels, 3, 2); NaN where there is none.

    Args:
        covariance: in units of the noise power, shape (pixels, M, M).
        grid: at the pixels' squint.
        looks: K.
        single: elevations of the single scatterers, rad, (pixels,).
        levels: gains that are suspicious, and that detect.
    """
    found = np.full((len(covariance), 3, 2), np.nan)
    suspicious = np.flatnonzero(grid.gain_beside(covariance, single) > levels[0])
    if not suspicious.size:
        return found
    some = covariance[suspicious].astype(np.complex128 if grid.beams.is_complex else np.float64)
    pair = np.sort(_climb(some, grid, grid.best(some)), axis=-1)
    model = _PairModel.of(grid.beams, pair, grid.squint)
    one = explained_power(some, grid.beams.response(single[suspicious], grid.squint))
    first, last = grid.beams.span
    detected = (model.explained(some) - one > levels[1]) & (pair[:, 0] >= first) & (pair[:, 1] <= last)
    signal = model.amplitudes(some) / looks - model.gram
    powers = np.diagonal(signal, axis1=-2, axis2=-1).real
    found[suspicious[detected]] = np.stack([pair, powers, model.bound(signal, looks)], axis=1)[detected]
    return found


def _climb(covariance: Numbers, grid: _PairGrid, pair: Array) -> Array:
    """Pairs (pixels, 2) from the grid's nodes to the peaks of f near them, rad; steps that do not rise are quartered."""
    first, last = grid.nodes[0], grid.nodes[-1]
    reach = np.full((len(pair), 1), GRID_STEP * grid.beams.beamwidth / 2)
    model = _PairModel.of(grid.beams, pair, grid.squint)
    height, step = model.explained(covariance), model.newton_step(covariance)
    for _ in range(NEWTON_STEPS):
        trial = np.clip(pair + np.clip(step, -reach, reach), first, last)
        apart = np.abs(trial[:, 1] - trial[:, 0]) >= LEAST_SEPARATION * grid.beams.beamwidth
        trial = np.where(apart[:, None], trial, pair)
        model = _PairModel.of(grid.beams, trial, grid.squint)
        trial_height = model.explained(covariance)
        rises = apart & (trial_height > height)
        pair, height = np.where(rises[:, None], trial, pair), np.where(rises, trial_height, height)
        step = np.where(rises[:, None], model.newton_step(covariance), step)
        reach = np.where(rises[:, None], reach, np.minimum(reach, np.abs(step).max(axis=1, keepdims=True)) / 4)
    return pair


def _nodes(beams: Beams) -> Array:
    """Elevations (rad) of the coarse search."""
    first, last = beams.domain(GUARD * beams.beamwidth)
    return np.linspace(first, last, max(2, math.ceil((last - first) / (GRID_STEP * beams.beamwidth)) + 1))


def _unit(response: Numbers) -> Numbers:
    """Responses (..., M) over their norm; 0 where no detector sees anything."""
    norm = np.linalg.norm(response, axis=-1, keepdims=True)
    return np.asarray(response * np.divide(1.0, norm, where=norm > 0, out=np.zeros_like(norm)))


def _adjoint(matrix: Numbers) -> Numbers:
    return np.asarray(np.swapaxes(matrix.conj(), -1, -2))


def _require(
    covariance: Covariance, beams: Beams, noise_power: float, looks_count: int, false_alarm: float
) -> None:
    if beams.count < 3:
        raise UserError(f"The sensor has {beams.count} detectors; telling two scatterers from one needs 3 or more.")
    if beams.is_complex and not np.iscomplexobj(covariance):
        raise UserError("The covariance of complex beams is real; it must be complex (multilook with hermitian).")
    if not (np.isfinite(noise_power) and noise_power > 0):
        raise UserError(f"The noise power is {noise_power:g}; it must be finite and greater than 0.")
    if looks_count < 1:
        raise UserError(f"The number of looks is {looks_count}; it must be 1 or more.")
    if not 0 < false_alarm <= 0.1:
        raise UserError(f"The share of false alarms is {false_alarm:g}; it must be above 0 and up to 0.1.")
