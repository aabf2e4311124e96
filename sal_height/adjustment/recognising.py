"""Whether two images show the same ground, or only ground of the same kind: by what each of them shows only once.

Kerbs, walls and slopes go on beyond an image. So another piece of the same street fits it as well as its own ground
does, and best where most of both images meet. What tells them apart is what does not go on: the end of a wall or of a
car. To find it, an image is shifted over itself, so far that about the half of it still meets, to where it fits itself
best: along the street. The rarity of a point is by how much the logarithm of the likelihood of its height is less there
than it could be. It is about 0 on all that goes on.

Where two images meet, those points tell that it is the same ground which are rare in both, shifted as far the same
way, the way that goes on in the one that shows less: by the lesser one of the two rarities, less what the height itself
is less likely than it could be. Two pieces of a street that have nothing in common have no such points, even if each
has rare points of its own: road before a car is rare one way, and road behind another car the other way.
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
    said_of_shifts,
)
from sal_height.numeric import F64, Index

HALF_MET = (0.25, 0.55)
"""Share of an image that meets the image itself once it is shifted: so little that what it shows once fits no more, and
so much that what goes on is seen to."""

SEARCH_POINTS, SEARCH_STEPS = 300, 8
"""Most points with which that shift is looked for, and steps over the narrower side, of COARSE cells at most."""

RARE = 0.5
"""Least rarity of a point that counts: noise makes less than half of that of what goes on."""

SURE = 7.5
"""Logarithm of the likelihood by which two images must be more likely to show the same ground. Of 240 pairs of dwells
of `sal_passes` that share none, seven exceed 4, where a car ends as another does elsewhere, and the greatest is 7.1."""


@dataclass(frozen=True, eq=False)
class Rarity:
    """How much less likely heights are elsewhere in their own image than they could be.

    Attributes:
        elsewhere: by how much the image was shifted, m east and north, shape (2,); 0: it goes on in no direction.
        less: logarithm of the likelihood, a mean over neighbours, shifted that way and back, shape (2, points); 0 where
            the image ends.
    """

    elsewhere: F64
    less: F64

    @classmethod
    def of(cls, points: Points) -> Rarity:
        """The rarity of each point where its image fits itself best."""
        return cls.shifted(points, _most_alike(points))

    @classmethod
    def shifted(cls, points: Points, elsewhere: F64) -> Rarity:
        """The rarity of each point, shifted by so much (m)."""
        cells = np.rint(elsewhere / points.surface.step).astype(int)
        if not cells.any():
            return cls(elsewhere, np.zeros((2, len(points.place))))
        return cls(elsewhere, np.stack([_less(points, cells), _less(points, -cells)]))


def _less(points: Points, shift: Index) -> F64:
    """The mean over neighbours of how much less likely each height is once the image is shifted, shape (points,)."""
    (misfit,), count = _misfits(points, points.surface, shift[None]), len(points.place)
    met = np.isfinite(misfit)
    if not met.any():
        return np.zeros(count)
    place, reach = points.place[:, :2], REACH_SPACINGS * points.spacing
    near = cKDTree(place).sparse_distance_matrix(cKDTree(place[met]), reach, output_type="ndarray")
    total = np.bincount(near["i"], misfit[met][near["j"]], count)
    return np.asarray(total / np.maximum(np.bincount(near["i"], minlength=count), 1))


def evidence(points: Points, rarity: Rarity, other: Points, shift: F64) -> float:
    """Logarithm of how much more likely it is that two images show the same ground than ground of the same kind.

    Args:
        points: of the image that shows less.
        rarity: of these; the other image is shifted over itself as far.
        other: points of the other image.
        shift: by which the one image lies farther east, north and up, m, shape (3,).
    """
    surface = other.surface
    (misfit,) = _misfits(points, surface, np.rint(shift[None, :2] / surface.step).astype(int))
    met = np.isfinite(misfit)
    if not met.any():
        return 0.0
    _, nearest = cKDTree(other.place[:, :2]).query(points.place[met, :2] - shift[:2])
    less_in_other = Rarity.shifted(other, rarity.elsewhere).less
    in_both = np.minimum(rarity.less[:, met], less_in_other[:, nearest]).max(axis=0)
    rare = in_both >= RARE
    return TEMPER * float(np.sum(in_both[rare] - misfit[met][rare]))


def _most_alike(points: Points) -> F64:
    """The shift (m) at which about the half of an image meets itself and fits itself best; 0: there is none."""
    some, surface = points.thinned(SEARCH_POINTS), points.surface
    step = int(np.clip(min(surface.height.shape) // SEARCH_STEPS, 2, COARSE))
    cells = lattice(np.array(surface.height.shape) - 1, step)
    cells = cells[len(cells) // 2 :]  # the others are the same, the other way
    said, _ = said_of_shifts(some, surface, cells, np.inf)
    met = np.isfinite(said[0]).sum(axis=1)
    low, high = (share * len(some.place) for share in HALF_MET)
    half = (met >= max(LEAST_POINTS, low)) & (met <= high)
    if not half.any():
        return np.zeros(2)
    return np.asarray(surface.step * cells[half][np.argmax(np.nansum(said[0, half], axis=1) / met[half])])


def _misfits(points: Points, surface: GriddedSurface, cells: Index) -> F64:
    """How much less likely each height is than it could be, by the logarithm, NaN where it does not meet a surface.

    The shape is (shifts, points).
    """
    said, _ = said_of_shifts(points, surface, cells, np.inf)
    bins, kernel = points.binned
    counts = np.bincount(bins, minlength=int(bins.max()) + len(kernel))
    density = np.convolve(counts, kernel, "same")[bins] / len(bins)
    sigma = np.sqrt(2) * np.hypot(points.sigma, points.roughness)
    best = np.log((1 - OUTLIERS) / (np.sqrt(2 * np.pi) * sigma * density) + OUTLIERS)
    return np.asarray(best - said[0])
