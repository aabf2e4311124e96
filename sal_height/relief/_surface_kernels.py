"""Compiled loops over the scatterers of a surface: which can be used, copies of some, and single precision."""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F32, F64, Bool, compiled_with_nan
from sal_height.relief._error_kernels import fold_covariances
from sal_height.relief._kernels import find_semidefinite


@compiled_with_nan
def copy_some(
    there: Bool,
    height: F64,
    sigma: F64,
    spread: F64,
    positions: F64,
    own: F64,
    common: F64,
    new_height: F64,
    new_sigma: F64,
    new_spread: F64,
    new_positions: F64,
    new_own: F64,
    new_common: F64,
) -> None:
    """Copy the numbers of a surface `there`, shape (n,); arrays as of `mark_possible`, the new ones to be filled."""
    for i in range(len(there)):
        if there[i]:
            new_height[i], new_sigma[i], new_spread[i] = height[i], sigma[i], spread[i]
            for row in range(3):
                new_positions[i, row] = positions[i, row]
                for col in range(3):
                    new_own[i, row, col] = own[i, row, col]
            if len(common) and len(new_common):
                for row in range(3):
                    for col in range(3):
                        new_common[i, row, col] = common[i, row, col]


@compiled_with_nan
def mark_possible(
    possible: Bool,
    farthest: float,
    rounding: float,
    height: F64,
    sigma: F64,
    spread: F64,
    positions: F64,
    own: F64,
    common: F64,
) -> None:
    """Mark the scatterers of `Surface.is_possible`.

    Args:
        possible: to be filled, shape (n,).
        farthest: greatest distance, m.
        rounding: as of `find_semidefinite`.
        height: m, shape (n,).
        sigma: m, shape (n,).
        spread: m, shape (n,).
        positions: m, shape (n, 3).
        own: own covariance, m^2, shape (n, 3, 3).
        common: common covariance, m^2, the same shape, or (0, 3, 3): not known.
    """
    shared = np.ones(len(height), np.bool_)
    find_semidefinite(own, rounding, possible)
    find_semidefinite(common, rounding, shared[: len(common)])
    for i in range(len(height)):
        placed = abs(positions[i, 0] + positions[i, 1] + positions[i, 2]) < np.inf and abs(height[i]) <= farthest
        certain = 0 < np.float32(sigma[i]) < np.inf and 0 <= spread[i] <= farthest
        possible[i] = possible[i] and shared[i] and placed and certain
        for row in range(3):
            for col in range(3):
                if abs(own[i, row, col]) > farthest * farthest:
                    possible[i] = False
                if len(common) and abs(common[i, row, col]) > farthest * farthest:
                    possible[i] = False


@compiled_with_nan
def fill_singles(
    height: F64,
    sigma: F64,
    spread: F64,
    positions: F64,
    own: F64,
    common: F64,
    cnr_db: F64,
    origin: F64,
    layers: F32,
    triangles: F32,
    shared: F32,
) -> bool:
    """Fill the numbers of `Surface.singles`; true if an own covariance is known.

    Args:
        height: as of `mark_possible`, like the next five.
        sigma: of the height.
        spread: of the surface.
        positions: of the scatterers.
        own: covariance.
        common: covariance.
        cnr_db: dB, shape (n,).
        origin: place from which positions count, m, shape (3,).
        layers: to be filled, shape (6, n).
        triangles: of own covariances, to be filled, shape (n, 6).
        shared: the same of common ones, of the length of `common`.
    """
    is_known = False
    fold_covariances(own, triangles)
    fold_covariances(common, shared)
    for i in range(len(height)):
        layers[0, i], layers[1, i], layers[2, i] = height[i], sigma[i], cnr_db[i]
        layers[3, i], layers[4, i] = positions[i, 0] - origin[0], positions[i, 1] - origin[1]
        layers[5, i] = spread[i]
        is_known |= np.isfinite(own[i, 0, 0])
    return is_known
