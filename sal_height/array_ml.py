"""Maximum-likelihood elevation from all detectors of the array at once (SAL paper, section 5).

A target at elevation theta gives detector m the amplitude A_k h(theta - theta_m) in look k, plus noise of variance
sigma^2. With a = (h(theta - theta_m))_m and R = Re sum_k g_k g_k^H, profiling out the complex A_k leaves the objective

    normalised:  a^T R a / a^T a     (exact)
    numerator:   a^T R a             (the paper's, which takes a^T a as constant: biased inwards near the array's ends)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams
from sal_height.errors import UserError
from sal_height.estimate import ElevationEstimate, output_power, validity_of
from sal_height.looks import Looks

Array = npt.NDArray[np.float64]
Objective = Callable[[Array, Array], Array]

GRID_STEP = 0.05
"""Spacing of the coarse search in beamwidths; the objective is band-limited to 1 cycle per beamwidth."""

REFINEMENT_STEPS = (0.02, 0.002)
"""Half widths in beamwidths of the parabolas that refine the peak, in turn."""

GUARD = 3.0
"""Beamwidths beyond the array that are searched too, so that a target out there is recognised by its sidelobes.

Two detectors cannot tell: their one ratio is that of some direction inside as well, so they are searched inside only.
"""


def _normalised(output_power: Array, beam_power: Array) -> Array:
    return output_power / beam_power


def _numerator(output_power: Array, _beam_power: Array) -> Array:
    return output_power


OBJECTIVES: dict[str, Objective] = {"normalised": _normalised, "numerator": _numerator}
"""What is maximised over elevation, from a^T R a and a^T a; "numerator" is the paper's."""


def ml_elevation(
    looks: Looks, beams: Beams, squint: Array, noise_power: float, objective: Objective, min_cnr: float
) -> ElevationEstimate:
    """Elevation of the dominant scatterer in every pixel.

    Args:
        looks: covariance of M channels in each pixel.
        beams: of the M detectors.
        squint: of each column, rad, shape (cols,).
        noise_power: E|n|^2 of one SLC pixel in one channel (`estimate.common_noise`).
        objective: one of OBJECTIVES.
        min_cnr: pixels below this power ratio are LOW_CNR.

    Raises:
        UserError: fewer than two detectors.
    """
    if len(beams.boresights) < 2:
        raise UserError(f"The sensor has {len(beams.boresights)} detector; elevation needs 2 or more.")
    elevation = coarse_search(looks.covariance, beams, squint, objective)
    for step in REFINEMENT_STEPS:
        elevation = _refine(elevation, step * beams.beamwidth, looks.covariance, beams, squint, objective)

    response = beams.response(elevation, squint)
    beam_power = np.sum(response**2, axis=-1)
    energy = (output_power(looks.covariance, response) / beam_power / noise_power - looks.count) / beam_power
    return ElevationEstimate(
        elevation=elevation,
        sigma=elevation_bound(energy, looks.count, beams, elevation, squint),
        cnr=energy / looks.count,
        validity=validity_of(looks, beams, squint, noise_power, elevation, energy / looks.count, min_cnr),
    )


def elevation_bound(energy: Array, looks: int, beams: Beams, elevation: Array, squint: Array) -> Array:
    """Standard deviation (rad) of an efficient elevation estimate, given the scatterer's energy in the looks at hand.

    Conditional Cramer-Rao bound 1 / (2 E D), with E = sum_k |A_k|^2 / sigma^2 and D the part of |da/dtheta|^2 that a
    change of amplitude cannot imitate, times the loss 1 + K / (E |a|^2) of not knowing the amplitudes.
    Infinite where the energy is not positive.
    """
    response = beams.response(elevation, squint)
    slope = beams.slope(elevation, squint)
    beam_power = np.sum(response**2, axis=-1)
    information = np.sum(slope**2, axis=-1) - np.sum(slope * response, axis=-1) ** 2 / beam_power
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = (1 + looks / (energy * beam_power)) / (2 * energy * information)
    return np.sqrt(np.where(energy > 0, variance, np.inf))


def coarse_search(covariance: Array, beams: Beams, squint: Array, objective: Objective) -> Array:
    """Elevation (rad) of the greatest objective on a grid over array and guard, shape (rows, cols)."""
    first, last = beams.domain(GUARD * beams.beamwidth if len(beams.boresights) > 2 else 0.0)
    grid = np.linspace(first, last, int(np.ceil((last - first) / (GRID_STEP * beams.beamwidth))) + 1)
    best = np.empty(covariance.shape[:2])
    for col, angle in enumerate(squint):
        response = beams.response(grid, np.full_like(grid, angle))
        products = (response[:, :, None] * response[:, None, :]).reshape(len(grid), -1)
        power = covariance[:, col].reshape(len(covariance), -1) @ products.T
        best[:, col] = grid[np.argmax(objective(power, np.sum(response**2, axis=-1)), axis=-1)]
    return best


def _refine(
    elevation: Array, half_width: float, covariance: Array, beams: Beams, squint: Array, objective: Objective
) -> Array:
    """Elevation (rad) of the vertex of a parabola through the objective at `elevation` and `half_width` to each side.

    The move is limited to the half width plus what the coarser step left open, so that a flat objective stays put.
    """
    low, middle, high = (
        objective(output_power(covariance, response), np.sum(response**2, axis=-1))
        for response in (beams.response(elevation + shift, squint) for shift in (-half_width, 0.0, half_width))
    )
    curvature = low - 2 * middle + high
    concave = curvature < 0
    move = np.where(concave, (low - high) / (2 * np.where(concave, curvature, -1)), 0.0)
    limit = GRID_STEP * beams.beamwidth / half_width
    return elevation + half_width * np.clip(move, -limit, limit)
