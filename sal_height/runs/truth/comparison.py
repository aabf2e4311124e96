"""Published heights against the lit surfaces of a simulated scene: every surface of every pixel is counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from sal_height.elevation import Validity
from sal_height.geometry import sphere_coordinates
from sal_height.numeric import F64, I64, U8, Bool, Index, mean_of
from sal_height.relief import HeightField, Surface, height_variance
from sal_height.simulation.lit_surfaces import LitSurfaces

TRUE_ORDERS = ("shadow", "one", "two", "three or more", "extended")
"""True contents of a pixel: rows of the confusion table."""

FOUND_ORDERS = ("no signal", "refused", "one", "two", "three", "extended", "interpolated")
"""Contents of a pixel according to a height image: columns of the confusion table."""

EXTENDED_BEAMWIDTHS = 0.1
"""Standard deviation of the elevations of its scatterers from which on a surface is extended, beamwidths."""

_FOUND = {
    Validity.LOW_CNR: 0,
    Validity.NO_SIGNAL: 0,
    Validity.OK: 2,
    Validity.TWO_SCATTERERS: 3,
    Validity.THREE_SCATTERERS: 4,
    Validity.EXTENDED: 5,
    Validity.INTERPOLATED: 6,
}
_REFUSED = 1


@dataclass(frozen=True, eq=False)
class PublishedErrors:
    """Published surfaces of height images, one entry each.

    Attributes:
        place: arc distances east and north from the map's origin and height above the sphere, m, shape (surfaces, 3).
        validity: validity of its pixel.
        sigma: predicted standard deviation of the error, m: of height, and of along-track position times the rise of
            the true surface, because a pixel is compared with the surfaces at its range and Doppler; of what is
            published as extended, with its spread.
        common: part of sigma due to errors that all pixels share, m.
        nearest: height minus that of the nearest true surface in the pixel, m; in a pixel without scatterers, of the
            surfaces in the eight pixels around it; NaN if these have no surface either. A surface that extends over
            elevations, such as a crown, has all heights between its scatterers. What is published as extended stands
            for all of its pixel: its height minus the mean of all surfaces, weighted by their power.
        own: height minus that of the true surface it should be, m: the strongest chooses the nearest, the others the
            nearest of the rest; NaN where nothing is left.
        ghost: True where neither the pixel nor a neighbour has a lit surface.
    """

    place: F64
    validity: U8
    sigma: F64
    common: F64
    nearest: F64
    own: F64
    ghost: Bool

    @property
    def own_beyond_5_sigma(self) -> float:
        """Fraction that is farther than 5 sigma from the surface it should be, or has none; NaN of no surfaces."""
        return mean_of(~(np.abs(self.own) <= 5 * self.sigma))

    @property
    def within_extent(self) -> Bool:
        """True between the scatterers of a surface that extends over elevations, where the error is 0 by definition."""
        return self.nearest == 0.0

    @property
    def from_one_height(self) -> PublishedErrors:
        """Those with an error from one true height: neither where nothing is lit nor within the extent of a surface."""
        return self.where(np.isfinite(self.nearest) & ~self.within_extent)

    def where(self, chosen: Bool) -> PublishedErrors:
        """Some of the surfaces."""
        return PublishedErrors(*(getattr(self, entry.name)[chosen] for entry in fields(self)))


_NONE = np.zeros(0)

NO_SURFACES = PublishedErrors(np.zeros((0, 3)), _NONE.astype(np.uint8), _NONE, _NONE, _NONE, _NONE, _NONE.astype(bool))
"""The errors of height images in which nothing is published."""


def joined_errors(parts: Sequence[PublishedErrors]) -> PublishedErrors:
    """The surfaces of several images."""
    names = [entry.name for entry in fields(PublishedErrors)]
    return PublishedErrors(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True, eq=False)
class SurfaceComparison:
    """Height images against the lit surfaces.

    Attributes:
        errors: errors of every published surface.
        pixels: number of pixels with a lit surface inside the array.
        valid: number of those pixels with a height.
        surfaces: lit surfaces inside the array that are not weak.
        missed: number of those surfaces without a published one.
        shadow: pixels in shadow.
        ghosts: number of those pixels with a height.
        confusion: pixels by TRUE_ORDERS (rows) and FOUND_ORDERS (columns); lit pixels inside the array only.
    """

    errors: PublishedErrors
    pixels: int
    valid: int
    surfaces: int
    missed: int
    shadow: int
    ghosts: int
    confusion: I64


def joined_comparisons(parts: Sequence[SurfaceComparison]) -> SurfaceComparison:
    """The comparisons of several images as one."""
    errors = joined_errors([part.errors for part in parts])
    sums = (sum(getattr(part, entry.name) for part in parts) for entry in fields(SurfaceComparison)[1:])
    return SurfaceComparison(errors, *sums)


def compare(field: HeightField, truth: LitSurfaces, beamwidth: float) -> SurfaceComparison:
    """Compare every surface that a height image publishes with the lit surfaces of its pixels.

    Where their places along the flight are uncertain by more than a pixel, as of leaves in the wind, the surfaces of
    all pixels of the row within `reach_along` count, too.

    Args:
        field: height image of shape (rows, cols).
        truth: lit surfaces of its pixels, and of as many columns on both sides of them as are within reach.
        beamwidth: beamwidth of the detectors, rad.
    """
    reach = (truth.rise.shape[2] - field.grid.cols) // 2
    rows, truth = truth, truth.middle(field.grid.cols)
    order, shadow = true_order(truth, beamwidth), truth.shadow
    # An extended surface has one option, the mean; it uses up all surfaces of the pixel.
    whole = (field.validity == Validity.EXTENDED) & np.isfinite(truth.height[0])
    heights = np.where(whole, np.nan, truth.height)
    heights[0] = np.where(whole, truth.mean_height, heights[0])
    reaches = _reaches(truth, beamwidth) * ~whole
    candidates, rises, free = _candidates(heights), _candidates(truth.rise), heights
    extents = np.stack([_candidates(bound) for bound in reaches])
    along, parts = field.grid.col_direction, []
    if reach:
        shadow = np.broadcast_to(rows.shadow.all(axis=1, keepdims=True), shadow.shape)
    for surface in field.surfaces:
        there = np.isfinite(surface.height)
        index, nearest = _nearest(candidates, extents, surface.height)
        rise = np.take_along_axis(rises, index, axis=0)[0]
        own = _nearest(free, reaches, surface.height)[1]
        if reach:
            elsewhere, rise_there = _nearest_in_row(rows, _reaches(rows, beamwidth), surface.height)
            rise = np.where(_is_nearer(elsewhere, nearest), rise_there, rise)
            nearest, own = (np.where(_is_nearer(elsewhere, one), elsewhere, one) for one in (nearest, own))
        spread = np.where(field.validity == Validity.EXTENDED, surface.spread, 0.0)
        by_place = np.nan_to_num(rise**2 * (along @ surface.covariance @ along))
        parts.append(
            PublishedErrors(
                place=np.stack(sphere_coordinates(surface.positions[there]), axis=-1),
                validity=field.validity[there],
                sigma=np.sqrt(surface.sigma**2 + by_place + spread**2)[there],
                common=_common_sigma(surface)[there],
                nearest=nearest[there],
                own=own[there],
                ghost=shadow[there],
            )
        )
        free = _without_nearest(free, reaches, surface.height)

    valid = np.isfinite(field.first.height)
    lit = truth.count > 0
    return SurfaceComparison(
        errors=joined_errors(parts),
        pixels=int(np.count_nonzero(lit)),
        valid=int(np.count_nonzero(lit & valid)),
        surfaces=int(np.count_nonzero(truth.counted)),
        missed=int(np.count_nonzero(truth.counted & np.isfinite(free))),
        shadow=int(np.count_nonzero(shadow)),
        ghosts=int(np.count_nonzero(shadow & valid)),
        confusion=_confusion(order[lit | shadow], field.validity[lit | shadow]),
    )


def _common_sigma(surface: Surface) -> F64:
    """Part of sigma due to errors that all pixels share, m, shape (rows, cols); NaN where it is not known."""
    if surface.common_covariance is None:
        return np.full_like(surface.sigma, np.nan)
    with np.errstate(invalid="ignore"):
        return np.sqrt(height_variance(surface.common_covariance, surface.positions))


def true_order(truth: LitSurfaces, beamwidth: float) -> I64:
    """Number in TRUE_ORDERS of the contents of each pixel, -1 for one without scatterers that is not in shadow."""
    one, three = TRUE_ORDERS.index("one"), TRUE_ORDERS.index("three or more")
    several = np.minimum(truth.count - 1 + one, three)
    wide = (truth.count == 1) & (truth.spread[0] >= EXTENDED_BEAMWIDTHS * beamwidth)
    return np.select(
        [truth.shadow, wide, truth.count > 0], [TRUE_ORDERS.index("shadow"), TRUE_ORDERS.index("extended"), several], -1
    ).astype(np.int64)


def _confusion(order: I64, validity: U8) -> I64:
    """Pixels by their contents and by the estimate."""
    found = np.array([_FOUND.get(value, _REFUSED) for value in Validity])[validity]
    shape = len(TRUE_ORDERS), len(FOUND_ORDERS)
    return np.bincount(order * shape[1] + found, minlength=shape[0] * shape[1]).reshape(shape).astype(np.int64)


def reach_along(field: HeightField) -> int:
    """Pixels along the row by which a place may be off: three standard deviations, without errors that all share."""
    along = field.grid.col_direction
    variance = [(along @ surface.own_covariance @ along)[np.isfinite(surface.height)] for surface in field.surfaces]
    return int(3 * np.sqrt(np.concatenate(variance).max(initial=0.0)) / field.grid.col_spacing)


def _reaches(truth: LitSurfaces, beamwidth: float) -> F64:
    """Lowest and highest scatterer of each surface over its plane, m, shape (2, surfaces, rows, cols).

    Zeros for surfaces that do not extend over elevations; NaN where there is none.
    """
    wide = truth.spread >= EXTENDED_BEAMWIDTHS * beamwidth
    return np.where(wide, np.stack([truth.lowest, truth.highest]), 0 * truth.height)


def _nearest_in_row(rows: LitSurfaces, reaches: F64, height: F64) -> tuple[F64, F64]:
    """Height minus that of the nearest surface within reach in the row, m, and the rise there; NaN without any."""
    error, rise = np.full((2, *height.shape), np.nan)
    reach = (rows.height.shape[2] - height.shape[1]) // 2
    for row, published in enumerate(height):
        col, number = np.nonzero(np.isfinite(rows.height[:, row]).T)
        away = np.abs(col - reach - np.arange(len(published))[:, None])
        off = published[:, None] - rows.height[number, row, col]
        errors = np.where(away <= reach, off - np.clip(off, *reaches[:, number, row, col]), np.inf)
        if len(col):
            there, nearest = np.arange(len(published)), np.argmin(np.abs(errors), axis=1)
            error[row], rise[row] = errors[there, nearest], rows.rise[number, row, col][nearest]
    return np.where(np.isinf(error), np.nan, error), rise


def _is_nearer(error: F64, other: F64) -> Bool:
    """True where an error is less than another one, or there is no other."""
    return np.abs(error) < np.where(np.isnan(other), np.inf, np.abs(other))


def _candidates(heights: F64) -> F64:
    """Heights of the surfaces in each pixel; in an empty one, of those in its neighbours: (candidates, rows, cols)."""
    padded = np.pad(heights, ((0, 0), (1, 1), (1, 1)), constant_values=np.nan)
    rows, cols = heights.shape[1:]
    around = [padded[:, r : r + rows, c : c + cols] for r in range(3) for c in range(3) if (r, c) != (1, 1)]
    empty = ~np.isfinite(heights[0])
    return np.concatenate([heights, np.where(empty, np.concatenate(around), np.nan)])


def _nearest(options: F64, reaches: F64, height: F64) -> tuple[Index, F64]:
    """Index of the option nearest to each height, and the height minus it (m); NaN without any option.

    Options reach from the first of `reaches` below them to the second above them, both of the shape of the options.
    """
    off = height - options
    error = off - np.clip(off, *reaches)
    index = np.argmin(np.where(np.isfinite(error), np.abs(error), np.inf), axis=0)[None]
    return index, np.take_along_axis(error, index, axis=0)[0]


def _without_nearest(options: F64, reaches: F64, height: F64) -> F64:
    """The options without those that are nearest to the heights."""
    left = options.copy()
    index, error = _nearest(options, reaches, height)
    kept = np.take_along_axis(options, index, axis=0)[0]
    np.put_along_axis(left, index, np.where(np.isfinite(error), np.nan, kept)[None], axis=0)
    return left
