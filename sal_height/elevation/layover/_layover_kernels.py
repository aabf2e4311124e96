"""Compiled loops of layover: which scatterers of the models that were fitted to a pixel are its own.

Each has a twin in plain NumPy in the tests. NaN stands for scatterers that a model does not have.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64, Index, compiled_with_nan, squared


@compiled_with_nan
def choose_scatterers(
    models: tuple[F64, F64, F64, F64],
    taken: Index,
    probability: F64,
    limits: tuple[float, float, float, float],
    found: F64,
    counts: Index,
) -> None:
    """The scatterers of the model that each pixel is given: those inside the array, if all of these are determined.

    Args:
        models: elevation, sigma, CNR and spread of the scatterers of every model, (models, pixels, most scatterers).
        taken: number of the model of each pixel, (pixels,).
        probability: of the models, (pixels, models).
        limits: lowest and highest elevation inside, the least CNR, and the sigma from which on one is not determined.
        found: NaN; to fill with elevation, sigma over all models, CNR and spread, strongest first, (4, pixels, most
            scatterers).
        counts: to fill with the numbers of scatterers that are inside, and of those chosen, (2, pixels).
    """
    (elevation, sigma, cnr, spread), (first, last, least, greatest) = models, limits
    for i in range(len(taken)):
        model, inside, determined, chosen = taken[i], 0, True, found[:, i]
        for s in range(elevation.shape[2]):
            place, strength = elevation[model, i, s], cnr[model, i, s]
            if not (first <= place <= last and strength >= least and strength > 0):
                continue
            deviation = deviation_over_models(place, elevation[:, i], sigma[:, i], probability[i])
            determined = determined and deviation < greatest
            rank = inside
            while rank > 0 and chosen[2, rank - 1] < strength:
                chosen[:, rank] = chosen[:, rank - 1]
                rank -= 1
            chosen[0, rank], chosen[1, rank], chosen[2, rank] = place, deviation, strength
            chosen[3, rank] = spread[model, i, s]
            inside += 1
        counts[0, i], counts[1, i] = inside, inside if determined else 0
        if not determined:
            chosen[:] = np.nan


@compiled_with_nan
def deviation_over_models(place: float, elevation: F64, sigma: F64, probability: F64) -> float:
    """Standard deviation (rad) of the elevation `place` of a scatterer that may be that of any of the models.

    Each model has its own idea of the scatterer next to it: the variance over all of them is the mean of their
    variances and squared distances. Models that were not fitted, or have an infinite sigma, do not count.

    Args:
        place: rad.
        elevation: of the scatterers of every model, rad, (models, most scatterers).
        sigma: of them, rad.
        probability: of the models, (models,).
    """
    total, weight = 0.0, 0.0
    for k in range(len(elevation)):
        nearest = 0
        for s in range(1, elevation.shape[1]):
            if abs(elevation[k, s] - place) < abs(elevation[k, nearest] - place):
                nearest = s
        square = squared(sigma[k, nearest]) + squared(elevation[k, nearest] - place)
        if np.isfinite(square):
            total += probability[k] * square
            weight += probability[k]
    return np.sqrt(total / weight) if weight > 0 else np.nan
