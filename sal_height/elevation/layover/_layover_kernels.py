"""Compiled loops of layover: choice of the scatterers of each pixel from the models fitted to it.

Each has a twin in plain NumPy in the tests. NaN stands for scatterers that a model does not have.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64, Index, compiled_with_nan, squared


@compiled_with_nan
def choose_scatterers(
    models: tuple[F64, F64, F64, F64],
    chosen: Index,
    probability: F64,
    limits: tuple[float, float, float, float],
    found: F64,
    counts: Index,
) -> None:
    """The scatterers of the model chosen for each pixel: those inside the array, if all of these are determined.

    Args:
        models: elevation, sigma, CNR and spread of the scatterers of every model, (models, pixels, most scatterers).
        chosen: number of the model of each pixel, (pixels,).
        probability: probability of the models, (pixels, models).
        limits: lowest and highest elevation inside, least CNR, and sigma from which a scatterer is not determined.
        found: array of NaN to fill with elevation, sigma over all models, CNR and spread, strongest first, (4, pixels,
            most scatterers).
        counts: numbers of scatterers to fill in: those inside, and those chosen, (2, pixels).
    """
    (elevation, sigma, cnr, spread), (first, last, least, greatest) = models, limits
    for i in range(len(chosen)):
        model, inside, determined, result = chosen[i], 0, True, found[:, i]
        for s in range(elevation.shape[2]):
            angle, strength = elevation[model, i, s], cnr[model, i, s]
            if not (first <= angle <= last and strength >= least and strength > 0):
                continue
            deviation = deviation_over_models(angle, elevation[:, i], sigma[:, i], probability[i])
            determined = determined and deviation < greatest
            rank = inside
            while rank > 0 and result[2, rank - 1] < strength:
                result[:, rank] = result[:, rank - 1]
                rank -= 1
            result[0, rank], result[1, rank], result[2, rank] = angle, deviation, strength
            result[3, rank] = spread[model, i, s]
            inside += 1
        counts[0, i], counts[1, i] = inside, inside if determined else 0
        if not determined:
            result[:] = np.nan


@compiled_with_nan
def deviation_over_models(angle: float, elevation: F64, sigma: F64, probability: F64) -> float:
    """Standard deviation (rad) of the elevation `angle` of a scatterer over all models.

    In each model it is the scatterer nearest to it: the variance over all models is the mean of their variances and
    squared distances. Models that were not fitted, or have an infinite sigma, do not count.

    Args:
        angle: elevation of the scatterer, rad.
        elevation: elevations of the scatterers of every model, (models, most scatterers), rad.
        sigma: standard deviations of these, rad.
        probability: probability of the models, (models,).
    """
    total, weight = 0.0, 0.0
    for k in range(len(elevation)):
        nearest = 0
        for s in range(1, elevation.shape[1]):
            if abs(elevation[k, s] - angle) < abs(elevation[k, nearest] - angle):
                nearest = s
        square = squared(sigma[k, nearest]) + squared(elevation[k, nearest] - angle)
        if np.isfinite(square):
            total += probability[k] * square
            weight += probability[k]
    return np.sqrt(total / weight) if weight > 0 else np.nan
