"""Heights of bright points: an estimator of elevation on the peaks of the images in all boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from sal_height.elevation import (
    CellResponse,
    ElevationEstimate,
    ElevationEstimator,
    HeightSettings,
    Looks,
    Validity,
    Window,
    windowed_looks,
    with_foreign_power,
    without_imprecise,
)
from sal_height.numeric import C64, F32, F64, Bool, Index, ShortRepr
from sal_height.passes.array import resolution
from sal_height.passes.boxes import MARGIN, Box, Lattice, brightest
from sal_height.passes.tie import Tie
from sal_height.relief import height_field
from sal_height.sensor import Channels

ONE_LOOK = Window.named("boxcar", 1, 0)

POSITION_FACTOR = float(np.sqrt(12) / (2 * np.pi * np.sqrt(2)))
"""Standard deviation of the position of a point over the cell, times the root of its energy: the Cramer-Rao bound.

Of a flat spectrum of bandwidth B it is 1 / (2 pi B / sqrt(12) sqrt(2 E)) of the delay.
"""


@dataclass(frozen=True, eq=False)
class PointHeights(ShortRepr):
    """Points with a height; arrays of shape (points, ...).

    Attributes:
        positions: positions in map, (points, 3), m.
        height: heights, m.
        own_covariance: covariance of the position, (points, 3, 3), m^2.
        common_covariance: covariance by errors of phase and range of the passes, which points near each other share,
            m^2.
        cnr_db: ratio of clutter to noise of one pass, dB.
        power: mean power over the passes, over the background.
    """

    positions: F64
    height: F64
    own_covariance: F64
    common_covariance: F64
    cnr_db: F64
    power: F64

    @property
    def sigma(self) -> F64:
        """Standard deviation of height, without the common part, m."""
        return np.asarray(np.sqrt(self.own_covariance[:, 2, 2]))

    @property
    def common_sigma(self) -> F64:
        """Standard deviation of the part of the height's error that points near each other share, m."""
        return np.asarray(np.sqrt(self.common_covariance[:, 2, 2]))

    @property
    def total_sigma(self) -> F64:
        """Standard deviation of height, m."""
        return np.hypot(self.sigma, self.common_sigma)

    def of(self, some: Index) -> Self:
        """Some of the points."""
        return type(self)(*(getattr(self, field.name)[some] for field in fields(self)))

    @classmethod
    def together(cls, several: Sequence[Self]) -> Self:
        """Points of several boxes."""
        return cls(*(np.concatenate([getattr(one, field.name) for one in several]) for field in fields(cls)))

    @classmethod
    def none(cls) -> Self:
        """No points."""
        flat, matrices = np.zeros(0), np.zeros((0, 3, 3))
        return cls(np.zeros((0, 3)), flat, matrices, matrices, flat, flat)


@dataclass(frozen=True, eq=False)
class PointDetections:
    """Result of the search of the volume.

    Attributes:
        points: points with a height.
        peaks: number of bright pixels.
        reasons: number of these by `Validity`.
    """

    points: PointHeights
    peaks: int
    reasons: dict[int, int]


def find_points(
    lattice: Lattice,
    tie: Tie,
    background: F64,
    estimator: ElevationEstimator,
    settings: HeightSettings,
    least_power: float,
) -> PointDetections:
    """Heights of the peaks of power in the volume.

    Args:
        lattice: lattice of the boxes, with the antennas at the positions of the tie.
        tie: tie of the passes.
        background: power of the background in each pass, (passes,).
        estimator: estimator of elevation.
        settings: settings of the estimator.
        least_power: least power of a peak, mean over the passes, over the background.
    """
    columns_at_once = 32  # which bounds the memory
    several, reasons, peaks = [PointHeights.none()], np.zeros(256, np.int64), 0
    columns, turn = lattice.columns(), (np.exp(-1j * tie.phase) / np.sqrt(background)).astype(np.complex64)
    for first in range(0, len(columns), columns_at_once):
        boxes, where = _lit(lattice, columns[first : first + columns_at_once], np.abs(turn), least_power)
        for box, image in zip(boxes, lattice.images(boxes, where) if boxes else [], strict=True):
            seen = PowerPeaks.of(box, image * turn[:, None, None], lattice.response, least_power)
            if seen is None:
                continue
            estimate = seen.estimate(tie.uncertainty, estimator, settings)
            several.append(seen.placed(estimate, tie, lattice))
            reasons += np.bincount(estimate.validity.ravel(), minlength=256)
            peaks += estimate.validity.size
    counts = {number: int(count) for number, count in enumerate(reasons.tolist()) if count}
    points = PointHeights.together(several)
    low, high = lattice.heights
    inside = lattice.covers(points.positions) & (points.height >= low) & (points.height <= high)
    return PointDetections(_once(points.of(np.flatnonzero(inside)), lattice), peaks, counts)


def _lit(
    lattice: Lattice, columns: Sequence[Sequence[tuple[int, int, int]]], gains: F32, least_power: float
) -> tuple[list[Box], list[Bool]]:
    """The boxes of columns with bright points, and the pixels around these.

    A point in one box of a column is seen in the others in the same rows and columns, though not in register. So every
    sixth box is searched: in those between, points are up to half a cell off and have 0.4 of their power.

    Args:
        lattice: lattice of the boxes.
        columns: numbers of their boxes.
        gains: factors of the passes that make the background's power 1, (passes,).
        least_power: least power of a bright point in register.
    """
    looked_at = [column[len(column) % 6 // 2 :: 6] for column in columns]
    planes = [lattice.box(number) for numbers in looked_at for number in numbers]
    images = iter(zip(planes, lattice.images(planes), strict=True))
    boxes, where = list[Box](), list[Bool]()
    for column, numbers in zip(columns, looked_at, strict=True):
        bright = np.zeros(planes[0].grid.shape, np.bool_)
        for _ in numbers:
            box, image = next(images)
            power = np.mean(np.abs(image * gains[:, None, None]) ** 2, axis=0)
            row, col = (np.rint(place).astype(np.intp) for place in brightest(power, box, 0.4 * least_power))
            bright[row, col] = True
        if bright.any():
            around = np.ones((2 * MARGIN + 3, 2 * MARGIN + 3), np.bool_)
            boxes += [lattice.box(number) for number in column]
            where += [binary_dilation(bright, around)] * len(column)
    return boxes, where


@dataclass(frozen=True, eq=False)
class PowerPeaks:
    """The peaks of power in a box.

    Attributes:
        box: box with the peaks.
        looks: looks, one per peak, shape (1, peaks).
        power: mean power over the passes, (peaks,).
    """

    box: Box
    looks: Looks
    power: F64

    @classmethod
    def of(cls, box: Box, image: C64, response: CellResponse, least_power: float) -> Self | None:
        """The peaks of an image with the background's power 1 in all passes; None: it has no peak."""
        passes = len(image)
        power = np.mean(np.abs(image) ** 2, axis=0)
        row, col = brightest(power, box, least_power)
        if not len(row):
            return None
        alone = Channels(np.eye(passes, dtype=np.complex128), np.eye(passes), np.ones(passes))
        nowhere = np.zeros(box.grid.cols)
        looks = windowed_looks(image, (ONE_LOOK, ONE_LOOK), nowhere, alone, hermitian=True, response=response)
        here = np.rint(row).astype(np.intp), np.rint(col).astype(np.intp)
        energy = np.maximum(passes * (power[here] - 1), 1.0)
        # By Monte Carlo, the Taylor window and a parabola through three pixels add 1.3, and 0.01 cells without noise.
        place = np.hypot(1.3 * POSITION_FACTOR / np.sqrt(energy), 0.01)

        def listed(values: F64) -> F64:
            return np.asarray(values[here])[None]

        looks = replace(
            looks,
            covariance=looks.covariance[here][None],
            squint=np.zeros(len(row)),
            floor=listed(looks.floor),
            count=listed(looks.count),
            row=row[None],
            col=col[None],
            row_variance=(place / response.down.spacing)[None] ** 2,
            col_variance=(place / response.across.spacing)[None] ** 2,
            power=listed(looks.power),
            finite=looks.finite[here][None],
            level_spread=np.zeros(len(row)),
            unplaced=np.zeros(len(row)),
            dwells=len(row),
        )
        return cls(box, looks, power[here])

    def estimate(
        self, uncertainty: float, estimator: ElevationEstimator, settings: HeightSettings
    ) -> ElevationEstimate:
        """Elevations of the scatterers in each peak, or the reason without one; sidelobes of others count as noise."""
        beams = self.box.steering.beams(uncertainty)
        found = estimator.estimate(self.looks, beams, settings)
        found = with_foreign_power(found, found.sigma**2 * (self.looks.floor - 1))
        return without_imprecise(found, settings.max_sigma_beamwidths * beams.beamwidth)

    def placed(self, estimate: ElevationEstimate, tie: Tie, lattice: Lattice) -> PointHeights:
        """The peaks with one scatterer, within the box or 5 % of its size across.

        Of several in a cell, one look of a sparse array yields wrong heights too often: they get no height.
        """
        array, grid, steering = lattice.array, self.box.grid, self.box.steering
        field = height_field(estimate, self.looks, grid, grid, array.reference, array.look_side)
        off = np.abs(estimate.scatterers[0].elevation[0] - steering.elevation)
        inside = off <= 0.55 * lattice.size[2] / steering.metres
        some = np.flatnonzero((field.validity[0] == Validity.OK) & inside)
        surface = field.first
        positions, common = surface.positions[0, some], np.zeros((len(some), 3, 3))
        for number, position in enumerate(positions):
            offset = (array.seen(position)[2] - steering.elevation) / steering.beamwidth
            variance = tie.variance(position, steering.slope(offset), array)
            sight, _, across = array.axes_at(position)
            upwards = across * steering.beamwidth * steering.metres
            common[number] = variance * np.outer(upwards, upwards) + tie.range_sigma**2 * np.outer(sight, sight)
        return PointHeights(
            positions,
            surface.height[0, some],
            surface.own_covariance[0, some],
            common,
            surface.cnr_db[0, some],
            self.power[some],
        )


def _once(points: PointHeights, lattice: Lattice) -> PointHeights:
    """The points without those that another box has with more power, within half a cell and beamwidth."""
    if not len(points.height):
        return points
    cells = np.array([*(2 * np.array(lattice.spacing)), resolution(lattice.steering(lattice.array.centre))])
    tree = cKDTree(points.positions @ lattice.array.axes.T / cells)
    dropped = np.zeros(len(points.height), np.bool_)
    for first, second in tree.query_pairs(0.5):
        weaker = first if points.power[first] < points.power[second] else second
        dropped[weaker] = True
    return points.of(np.flatnonzero(~dropped))
