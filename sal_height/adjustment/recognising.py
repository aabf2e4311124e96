"""Decides whether two images show the same ground, or only ground of the same kind: by what each shows only once.

Kerbs, walls and slopes continue beyond an image. So another piece of the same street fits it as well as its own ground
does, and best where most of both images overlap. They are distinguished by what ends: a wall or a car. To find it, an
image is shifted over itself, so far that about half of it still overlaps, to where it fits itself best: along the
street. The rarity of a point is the difference between the greatest possible logarithm of the likelihood of its height
and the one found there. It is about 0 on all that continues.

Where two images overlap, points that are rare in both are evidence of the same ground. Both images are shifted over
themselves by the same distance and direction, along which the smaller one continues. A point counts by the lesser of
the two rarities, less the misfit of its height. Two pieces of a street that have nothing in common have no such points,
even if each has rare points of its own: road before a car is rare in one direction, and road behind another car in the
other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sal_height.adjustment.matching import (
    COARSE,
    LEAST_POINTS,
    OUTLIERS,
    REACH_SPACINGS,
    TEMPER,
    GriddedSurface,
    Points,
    lattice,
    likelihood_of_shifts,
)
from sal_height.numeric import F64, Index

SURE = 7.5
"""Logarithm of the likelihood by which two images must be more likely to show the same ground. Of 240 pairs of dwells
of `sal_passes` without common ground, seven exceed 4, where a car ends as another does elsewhere, and the greatest is
7.1."""


@dataclass(frozen=True, eq=False)
class Rarity:
    """Misfit of the heights of an image to the same image elsewhere.

    Attributes:
        elsewhere: shift of the image east and north, m, shape (2,); 0: it continues in no direction.
        less: rarity of each point, as a mean over neighbours, shifted by `elsewhere` and by its opposite, shape
            (2, points); 0 where the image ends.
    """

    elsewhere: F64
    less: F64

    @classmethod
    def of(cls, points: Points) -> Rarity:
        """The rarity of each point where its image fits itself best."""
        return cls.shifted(points, _most_alike(points))

    @classmethod
    def shifted(cls, points: Points, elsewhere: F64) -> Rarity:
        """The rarity of each point for a given shift, m, shape (2,)."""
        cells = np.rint(elsewhere / points.surface.step).astype(int)
        if not cells.any():
            return cls(elsewhere, np.zeros((2, len(points.place))))
        return cls(elsewhere, np.stack([_less(points, cells), _less(points, -cells)]))


def _less(points: Points, shift: Index) -> F64:
    """The mean over neighbours of the misfit of each height once the image is shifted, shape (points,)."""
    (misfit,), count = _misfits(points, points.surface, shift[None]), len(points.place)
    met = np.isfinite(misfit)
    if not met.any():
        return np.zeros(count)
    place, reach = points.place[:, :2], REACH_SPACINGS * points.spacing
    near = cKDTree(place).sparse_distance_matrix(cKDTree(place[met]), reach, output_type="ndarray")
    total = np.bincount(near["i"], misfit[met][near["j"]], count)
    return np.asarray(total / np.maximum(np.bincount(near["i"], minlength=count), 1))


def evidence(points: Points, rarity: Rarity, other: Points, shift: F64) -> float:
    """Logarithm of the likelihood ratio of two images of the same ground against ground of the same kind.

    Args:
        points: points of the smaller image.
        rarity: their rarity; the other image is shifted over itself by the same distance.
        other: points of the other image.
        shift: offset of the first image from the other east, north and up, m, shape (3,).
    """
    surface = other.surface
    (misfit,) = _misfits(points, surface, np.rint(shift[None, :2] / surface.step).astype(int))
    met = np.isfinite(misfit)
    if not met.any():
        return 0.0
    _, nearest = cKDTree(other.place[:, :2]).query(points.place[met, :2] - shift[:2])
    less_in_other = Rarity.shifted(other, rarity.elsewhere).less
    in_both = np.minimum(rarity.less[:, met], less_in_other[:, nearest]).max(axis=0)
    rare = in_both >= 0.5  # the rarity of what continues is less than half of that, by noise
    return TEMPER * float(np.sum(in_both[rare] - misfit[met][rare]))


def _most_alike(points: Points) -> F64:
    """The shift (m) at which about half of an image overlaps itself and fits itself best; 0: no such shift."""
    some, surface = points.thinned(300), points.surface
    step = int(np.clip(min(surface.height.shape) // 8, 2, COARSE))  # eight steps over the narrower side
    cells = lattice(np.array(surface.height.shape) - 1, step)
    cells = cells[len(cells) // 2 :]  # the others are the same, the other way
    likelihood, _ = likelihood_of_shifts(some, surface, cells, np.inf)
    met = np.isfinite(likelihood[0]).sum(axis=1)
    # So little overlap that what is shown once does not fit, and enough of it for what continues to fit.
    low, high = (fraction * len(some.place) for fraction in (0.25, 0.55))
    half = (met >= max(LEAST_POINTS, low)) & (met <= high)
    if not half.any():
        return np.zeros(2)
    return np.asarray(surface.step * cells[half][np.argmax(np.nansum(likelihood[0, half], axis=1) / met[half])])


def _misfits(points: Points, surface: GriddedSurface, cells: Index) -> F64:
    """The greatest possible logarithm of the likelihood of each height less the one found, shape (shifts, points).

    NaN where a point does not meet the surface.
    """
    likelihood, _ = likelihood_of_shifts(points, surface, cells, np.inf)
    bins, kernel = points.binned
    counts = np.bincount(bins, minlength=int(bins.max()) + len(kernel))
    density = np.convolve(counts, kernel, "same")[bins] / len(bins)
    sigma = np.sqrt(2) * np.hypot(points.sigma, points.roughness)
    best = np.log((1 - OUTLIERS) / (np.sqrt(2 * np.pi) * sigma * density) + OUTLIERS)
    return np.asarray(best - likelihood[0])
