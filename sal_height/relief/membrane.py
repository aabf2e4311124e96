"""The ground as a membrane that may tear: heights of cells from measurements in some of them, with honest sigma.

The heights h minimise the energy of the weak membrane (Blake and Zisserman, Visual Reconstruction, 1987),

    sum over covered cells of w (h - z)^2  +  sum over neighbours i, j of k_ij min((h_i - h_j - r_ij)^2, limit_ij^2),

so that neighbours that differ by more than the limit are on two sides of a step and do not pull at each other. A slope
is no step: r_ij is the difference that the slope of the ground makes, where it is known; else the limit is wider. A
measurement z of the variance s^2 covers the n cells of its footprint, each with the weight w = 1 / (n s^2). Given which
neighbours are joined, the posterior is Gaussian with the precision A = W + L, where W has the weights on its diagonal
and L is the Laplacian of the stiffnesses k. It is found by Gaussian belief propagation: cells send their height and its
precision to their neighbours until nothing changes. Its means are then those of A exactly; its variances are those of
the tree of messages (Weiss and Freeman, Neural Computation 13, 2001), a few per cent too small.

The stiffness is a choice and not a property of the ground, so the posterior's variance is not the one to state. If the
ground's steps have kappa times the variance 1 / k of the prior, the variance of h is

    kappa diag(A^-1) + (1 - kappa) diag(A^-1 W A^-1):

on level ground that of the averaged noise alone. kappa is estimated around each cell from how far measurements are from
the line between their neighbours. Where nothing was measured, kappa times the variance of a step is added for each cell
from there to the nearest footprint: the tree says less.

A step below the resolution in elevation, as of a kerb, is measured as a ramp of several pixels, on which
heights are wrong by up to half the step. Every ramp as short as that therefore has a sigma that allows for a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, uniform_filter
from scipy.special import ndtri

from sal_height.numeric import F64, I64, Bool
from sal_height.relief import _kernels as kernels

FREEDOM = 2.0
"""Standard deviation of the prior's steps between neighbours, over that of the better measured of the two.

Softer than most ground, so that a step below the gate moves a height by little more than its sigma.
"""


FAR = 2.0
"""Standard deviations beyond which a measurement is called far from the line between its neighbours.

The fraction of those that are far gives the scale of all, which a step along a line of pixels hardly changes.
"""

Joints = tuple[Bool, Bool]
"""True if a cell and the next along rows are joined, shape (rows - 1, cols), and along columns, (rows, cols - 1)."""

Links = tuple[F64, F64]
"""Numbers of the same pairs of neighbours."""


@dataclass(frozen=True, eq=False)
class Membrane:
    """Heights of all cells that minimise the energy; arrays of shape (rows, cols).

    Attributes:
        height: posterior mean of the height, m; NaN where no measurement reaches.
        precision: posterior precision of that height, 1/m^2.
        joined: neighbours on the same side of all steps.
        covered: cells in the footprint of a measurement.
        nearest: row and column of the measured cell nearest to each, shape (2, rows, cols).
        beyond: distance from the footprint of that cell, cells; 0 within.
        noise: standard deviation of the nearest measurement, m.
        filled: height of that measurement, moved to the cell along the slope, m.
        weight: weight w of each cell, 1/m^2.
        stiffness: stiffness k between neighbours, 1/m^2.
        rises: rise r between neighbours, m.
    """

    height: F64
    precision: F64
    joined: Joints
    covered: Bool
    nearest: I64
    beyond: F64
    noise: F64
    filled: F64
    weight: F64
    stiffness: Links
    rises: Links


def footprint(spacing: float) -> float:
    """Reach of the footprint of a measurement, cells, at this spacing of measurements in cells.

    It is half a diagonal of their square, and a quarter of a cell, because measurements are not evenly spaced.
    """
    return spacing / np.sqrt(2) + 0.25


def fitted_membrane(
    measured: F64, sigma: F64, spacing: float, gate: float, slope: F64 | None = None, steepest: float = 0.0
) -> Membrane:
    """Fit the membrane to measured heights, of which there must be one at least; `deviation` gives its sigma.

    Args:
        measured: heights z, m, shape (rows, cols); NaN where not measured.
        sigma: standard deviations s of these heights, m, same shape.
        spacing: spacing of the measurements, cells.
        gate: greatest difference of joined neighbours, standard deviations of the difference.
        slope: slope of the ground along rows and along columns, m per cell, shape (rows, cols, 2); None: level.
        steepest: greatest slope that is not a step, in addition to `slope`, m per cell.
    """
    slope = np.zeros((*measured.shape, 2)) if slope is None else slope
    distance, nearest = distance_transform_edt(np.isnan(measured), return_indices=True)
    beyond = np.maximum(distance - footprint(spacing), 0.0)
    covered = beyond == 0
    at = tuple(nearest)
    noise = sigma[at]
    offset = np.moveaxis(np.indices(measured.shape) - nearest, 0, -1)
    filled = measured[at] + np.where(covered, np.sum(slope[at] * offset, axis=-1), 0.0)
    number = np.ravel_multi_index(at, measured.shape)
    cells = np.bincount(number[covered], minlength=measured.size)[number]
    weight = np.where(covered, 1 / (np.maximum(cells, 1) * noise**2), 0.0)
    steps = [FREEDOM**2 * np.minimum(first, second) ** 2 for first, second in _pairs(noise)]
    rises = (slope[:-1, :, 0] + slope[1:, :, 0]) / 2, (slope[:, :-1, 1] + slope[:, 1:, 1]) / 2
    limits = [
        gate**2 * (step + a**2 + b**2) + (steepest * spacing) ** 2
        for step, (a, b) in zip(steps, _pairs(noise), strict=True)
    ]
    height = filled
    rounds = 2  # of finding heights and deciding the joints again from them; more change next to none
    for _ in range(rounds):
        joined = _joints(height, rises, limits)
        stiffness = _stiffness(joined, steps)
        precision, height = _beliefs(weight, filled, stiffness, rises)
    height = np.where(precision > 2 * kernels.LEAST_PRECISION, height, np.nan)
    return Membrane(height, precision, joined, covered, nearest, beyond, noise, filled, weight, stiffness, rises)


def deviation(membrane: Membrane, spacing: float) -> F64:
    """Standard deviation of the heights of a membrane, m, shape (rows, cols); infinite where there is no height.

    Args:
        membrane: fitted membrane.
        spacing: spacing of the measurements, cells. Above 3 cells sigma becomes too small, because cells of one
            footprint share their error.
    """
    noise, posterior = membrane.noise, 1 / membrane.precision
    weight_step = 1e-3  # relative change of the weights for the derivative of the variances, -diag(A^-1 W A^-1)
    heavier = (1 + weight_step) * membrane.weight
    precision, _ = _beliefs(heavier, membrane.filled, membrane.stiffness, membrane.rises)
    averaged = (posterior - 1 / precision) / weight_step
    roughness = _roughness(membrane.filled, noise, membrane.covered, max(1, round(spacing)))
    smooth = averaged + roughness * (posterior - averaged)
    unresolved = _unresolved(membrane.height, np.sqrt(smooth), membrane.joined, spacing)
    least_roughness = 0.1  # added to kappa in gaps, where a step may hide that no measurement near it shows
    step = (roughness + least_roughness) * (FREEDOM * noise) ** 2 + unresolved[tuple(membrane.nearest)]
    variance = smooth + membrane.beyond * step + unresolved
    return np.where(np.isnan(membrane.height), np.inf, np.sqrt(variance))


def _pairs(values: F64) -> list[tuple[F64, F64]]:
    """Values of each cell and of the next along rows; and along columns."""
    return [(values[:-1], values[1:]), (values[:, :-1], values[:, 1:])]


def _joints(height: F64, rises: Links, limits: list[F64]) -> Joints:
    """Neighbours whose difference, less the rise of the slope, is within the square root of the limit (m^2)."""
    down, across = (
        (after - before - rise) ** 2 < limit
        for (before, after), rise, limit in zip(_pairs(height), rises, limits, strict=True)
    )
    return down, across


def _stiffness(joined: Joints, steps: list[F64]) -> Links:
    down, across = (np.where(joint, 1 / step, 0.0) for joint, step in zip(joined, steps, strict=True))
    return down, across


def _beliefs(weight: F64, measured: F64, stiffness: Links, rises: Links) -> tuple[F64, F64]:
    """Precision (1/m^2) and mean (m) of each cell after four sweeps of messages.

    Heights are then those of the minimum to a thousandth of their sigma.

    A cell whose height has the precision p, without the receiver's message, sends through a link of the
    stiffness k the precision k p / (k + p), as of conductors in series.
    """
    precision, moment = np.zeros((4, *weight.shape)), np.zeros((4, *weight.shape))
    kernels.propagate(weight, weight * measured, stiffness, rises, 4, precision, moment)
    total = np.maximum(weight + precision.sum(axis=0), kernels.LEAST_PRECISION)
    return total, (weight * measured + moment.sum(axis=0)) / total


def _unresolved(height: F64, noise: F64, joined: Joints, spacing: float) -> F64:
    """Variance of heights because a ramp may be a step that pixels are too coarse to show, m^2.

    A ramp has a bend upwards at its foot and one downwards at its top; a ridge or a valley has only one of them near.
    """
    bend_sigmas = 4.0  # size of a bend that noise may make, over the standard deviation of the height in its middle
    limit = bend_sigmas * noise
    down = _bent_both_ways(height, limit, joined[0], spacing)
    across = _bent_both_ways(height.T, limit.T, joined[1].T, spacing).T
    bends_per_sigma = 3.0  # size of a bend beyond that over the standard deviation of the heights on it
    return np.maximum(down, across) / bends_per_sigma**2


def _bent_both_ways(height: F64, limit: F64, joined: Bool, spacing: float) -> F64:
    """Lesser of the bends upwards and downwards along columns that reach to each cell, squared, m^2."""
    bend_pixels = (1, 2, 3)  # distances in pixels over which bends are searched for
    lags = np.rint(np.array(bend_pixels) * spacing).astype(np.int64)
    bends = np.zeros((2, *height.shape))
    there = np.ascontiguousarray(joined)
    kernels.mark_bends(np.ascontiguousarray(height), np.ascontiguousarray(limit), there, lags, bends)
    return np.asarray(bends.min(axis=0))


def _roughness(height: F64, noise: F64, covered: Bool, lag: int) -> F64:
    """Estimate kappa around each cell from measured heights (m) with the sigma `noise` (m) and those `lag` cells away.

    The bend a - 2 b + c of three measurements in a line has the variance s_a^2 + 4 s_b^2 + s_c^2 from noise, 6 s^2, and
    twice that of a step of the ground, which is kappa FREEDOM^2 s^2. A slope has none.
    """
    far, count = np.zeros(height.shape), np.zeros(height.shape)
    for axis in (0, 1):
        length = height.shape[axis] - 2 * lag
        if length <= 0:
            continue
        first, middle, last = (
            tuple(slice(start, start + length) if way == axis else slice(None) for way in (0, 1))
            for start in (0, lag, 2 * lag)
        )
        bend = (height[first] - 2 * height[middle] + height[last]) ** 2
        variance = noise[first] ** 2 + 4 * noise[middle] ** 2 + noise[last] ** 2
        known = covered[first] & covered[middle] & covered[last]
        far[middle] += known & (bend > FAR**2 * variance)
        count[middle] += known
    neighbourhood = 19  # side in cells of the square in which kappa is estimated: some hundred pixels
    far, count = (uniform_filter(values, neighbourhood) for values in (far, count))
    share = np.clip(far / np.maximum(count, 1e-6), 1e-3, 0.99)
    scale = FAR / ndtri(1 - share / 2)  # of a normal distribution with that fraction beyond FAR
    greatest_roughness = 100.0  # greatest kappa: the ground's steps are ten times as large as those of the prior
    return np.clip((scale**2 - 1) * 6 / (2 * FREEDOM**2), 0.0, greatest_roughness)
