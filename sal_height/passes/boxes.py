"""The volume of the search, in boxes along range, flight and across both, and the images of the passes in them.

A scatterer at the distance s from the plane of an image is seen by passes of different elevation at ranges that differ
by s times the difference of the elevations. So images are formed in one plane per box, and the size of a box across it
keeps this below SHIFT of a range cell; a scatterer of any height is in register in its own box. In each box,
scatterers are searched at all heights, and those within the box are kept. In range and along the flight the size of a
box keeps errors of the phases of its middle below `PHASE_ERROR`.

An antenna with an error of position d along the flight or towards the scene sees it shifted by d. Images of bright
points are compared with the median of those of all passes; a common shift is not observable, and does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sal_height.elevation import AxisResponse, CellResponse
from sal_height.errors import UserError
from sal_height.geometry import Grid
from sal_height.imaging import Processing, backproject_points
from sal_height.numeric import C64, F64, Bool, ShortRepr, vertex
from sal_height.passes.array import PassArray, Steering, resolution
from sal_height.passes.settings import PassSettings

SHIFT = 0.15
"""Largest shift between the outermost passes at the edge of a box, at a loss of a tenth of their power, range cells."""

PHASE_ERROR = 0.02
"""Largest error at the edges of a box of phases that are computed for its middle, rad."""

MARGIN = 3
"""Margin around a box for the response of a point within, pixels."""


@dataclass(frozen=True, eq=False)
class Box(ShortRepr):
    """A part of the volume.

    Attributes:
        centre: centre in map, shape (3,), m.
        grid: grid of the images, in the plane of range and flight through the centre, MARGIN pixels around the box.
        steering: phases of the passes about the centre.
    """

    centre: F64
    grid: Grid
    steering: Steering

    @property
    def inner(self) -> tuple[slice, slice]:
        """Rows and columns of the box itself."""
        return slice(MARGIN, self.grid.rows - MARGIN), slice(MARGIN, self.grid.cols - MARGIN)


@dataclass(frozen=True, eq=False)
class Lattice(ShortRepr):
    """Boxes of one size around the middle of the scene.

    Attributes:
        array: passes.
        side: side of the square of ground that is searched, m.
        heights: lowest and greatest height of the search, m.
        size: size of a box in range, along the flight and across both, m.
        spacing: spacing of pixels in range and along the flight, m.
        response: response of the images.
        processing: windows of the images.
    """

    array: PassArray
    side: float
    heights: tuple[float, float]
    size: tuple[float, float, float]
    spacing: tuple[float, float]
    response: CellResponse
    processing: Processing

    @classmethod
    def of(cls, array: PassArray, settings: PassSettings) -> Lattice:
        """The lattice whose boxes keep to SHIFT and PHASE_ERROR."""
        sensor = array.passes[0].sensor
        cell = max(one.sensor.range_resolution for one in array.passes)
        distance = float(np.linalg.norm(array.centre - array.reference.position))
        lengths = [float(np.linalg.norm(one.flight)) for one in array.passes]
        azimuth_cell = sensor.wavelength * distance / (2 * min(lengths))
        across = 2 * SHIFT * cell / float(np.ptp(array.elevations))
        # Over a length w the differences of the phases change by about w / distance of themselves.
        steering = array.steering(array.centre, -across / 2, across / 2)
        turned = float(np.abs(steering.slope(0.0)).max()) * across / 2 / resolution(steering)
        way = 2 * distance * PHASE_ERROR / turned
        # Spacing of pixels: brightest pixels are half of that from a point at most, cells of the unweighted resolution.
        sampling = 0.5
        spacing = sampling * cell, sampling * azimuth_cell
        rows = float(np.clip(way, 8 * spacing[0], max(2 * across, 8 * spacing[0])))
        cols = float(np.clip(way, 8 * spacing[1], max(8 * spacing[1], min(200 * spacing[1], settings.side_m))))
        windows = settings.range_window, settings.azimuth_window
        response = CellResponse(AxisResponse(windows[0], sampling), AxisResponse(windows[1], sampling))
        heights = settings.lowest_m, settings.highest_m
        size = rows, cols, across
        return cls(array, settings.side_m, heights, size, spacing, response, Processing(*windows))

    def box(self, number: tuple[int, int, int]) -> Box:
        """The box of three numbers, 0, 0, 0 in the middle of the scene."""
        centre = self.array.centre + np.array(number) * self.size @ self.array.axes
        sight, along, _ = self.array.axes_at(centre)
        counts = [
            int(np.ceil(size / step)) + 1 + 2 * MARGIN for size, step in zip(self.size, self.spacing, strict=False)
        ]
        half = (np.array(counts) - 1) / 2 * self.spacing
        origin = centre - half[0] * sight - half[1] * along
        grid = Grid(origin, sight, along, *self.spacing, *counts)
        return Box(centre, grid, self.steering(centre))

    def steering(self, point: F64) -> Steering:
        """The phases about a point (m, shape (3,)), for all heights that are searched."""
        climb, half = self.array.axes_at(point)[2, 2], self.size[2] / 2
        low, high = ((height - float(point[2])) / climb for height in self.heights)
        return self.array.steering(point, min(low, -half), max(high, half))

    def numbers(self, half: float, low: float, high: float) -> list[tuple[int, int, int]]:
        """Numbers of the boxes that meet a square of ground of twice `half` (m) between two heights (m)."""
        corners = np.array(np.meshgrid([-half, half], [-half, half], [low, high])).reshape(3, -1).T
        corners[:, :2] += self.array.centre[:2]
        seen = (corners - self.array.centre) @ self.array.axes.T / self.size
        first, last = np.floor(seen.min(axis=0)).astype(int), np.ceil(seen.max(axis=0)).astype(int)
        every = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True))), -1).reshape(
            -1, 3
        )
        centres = self.array.centre + every * self.size @ self.array.axes
        reach = np.abs(np.array(self.size)[:, None] * self.array.axes).sum(axis=0) / 2
        off = np.abs(centres[:, :2] - self.array.centre[:2]) <= half + reach[:2]
        level = (centres[:, 2] >= low - reach[2]) & (centres[:, 2] <= high + reach[2])
        return [(int(a), int(b), int(c)) for a, b, c in every[off.all(axis=1) & level]]

    def on_ground(self, settings: PassSettings) -> list[Box]:
        """The box that intersects the ground, at each range and position along the flight.

        They reach farther by `tie_reach_m`: points above the ground are displaced in range.
        """
        half = self.side / 2 + settings.tie_reach_m
        found: dict[tuple[int, int], tuple[float, tuple[int, int, int]]] = {}
        for number in self.numbers(half, settings.ground_m, settings.ground_m):
            centre = self.array.centre + np.array(number) * self.size @ self.array.axes
            off = abs(float(centre[2]) - settings.ground_m)
            if off < found.get(number[:2], (np.inf, number))[0]:
                found[number[:2]] = off, number
        return [self.box(number) for _, number in found.values()]

    def check_size(self) -> None:
        """Refuse a volume that has too many pixels.

        Raises:
            UserError: it has more than 2^26, though images are formed around bright points only.
        """
        (low, high), grid = self.heights, self.box((0, 0, 0)).grid
        if not low < high:
            raise UserError(f"Settings lowest_m and highest_m are {low:g} and {high:g} m; the first must be less.")
        pixels = self.side**2 * (high - low) / float(np.prod(self.size)) * grid.rows * grid.cols
        most = 2**26
        if pixels > most:
            raise UserError(
                f"The volume of {self.side:g} m x {self.side:g} m from {low:g} to {high:g} m has {pixels:.3g} pixels; "
                f"at most {most} are allowed: choose a smaller side_m, or nearer lowest_m and highest_m."
            )

    def columns(self) -> list[list[tuple[int, int, int]]]:
        """Numbers of all boxes that meet the volume, grouped by range and position along the flight."""
        found: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
        for number in sorted(self.numbers(self.side / 2, *self.heights)):
            found.setdefault(number[:2], []).append(number)
        return list(found.values())

    def covers(self, points: F64, margin: float = 0.0) -> Bool:
        """True where points (m in map, (n, 3)) are over the searched ground, or within `margin` (m) of it, (n,)."""
        return np.asarray(np.all(np.abs(points[:, :2] - self.array.centre[:2]) <= self.side / 2 + margin, axis=1))

    def images(self, boxes: Sequence[Box], where: Sequence[Bool] | None = None) -> list[C64]:
        """Images of all passes in boxes, each of shape (passes, rows, cols).

        Args:
            boxes: boxes of the images.
            where: True for the wanted pixels of each, (rows, cols); the others are NaN. None: all.
        """
        masks = [np.ones(box.grid.shape, np.bool_) for box in boxes] if where is None else where
        points = np.concatenate([box.grid.pixels()[mask] for box, mask in zip(boxes, masks, strict=True)])
        ends = np.cumsum([int(mask.sum()) for mask in masks])[:-1]
        images = [np.full((len(self.array.passes), *mask.shape), np.nan, np.complex64) for mask in masks]
        for number, one in enumerate(self.array.passes):
            values = backproject_points(
                one.history, one.antenna, one.sensor, self.processing, points, self.array.axes[1]
            )[0]
            for image, mask, part in zip(images, masks, np.split(values, ends), strict=True):
                image[number, mask] = part
        return images


def background(images: Sequence[C64]) -> F64:
    """Power of the background of each pass, (passes,): the median of its pixels, as if they were speckle or noise.

    The median of exponentially distributed powers is ln 2 of their mean; few bright points do not move it.

    Raises:
        UserError: a pass has no power anywhere.
    """
    powers = np.concatenate([np.abs(image.reshape(len(image), -1)) ** 2 for image in images], axis=1)
    with np.errstate(all="ignore"):
        level = np.nanmedian(powers.astype(np.float64), axis=1) / np.log(2)
    if not np.all(level > 0):
        raise UserError("A pass has no signal in the scene; all passes must have seen it.")
    return np.asarray(level)


def brightest(power: F64, box: Box, least: float) -> tuple[F64, F64]:
    """Rows and columns, with fractions, of the peaks of power in a box above a level; arrays of shape (peaks,).

    A parabola through the logarithms of three pixels gives the position in its pixel.
    """
    rows, cols = box.inner
    around = [
        power[rows.start + down : rows.stop + down, cols.start + across : cols.stop + across]
        for down in (-1, 0, 1)
        for across in (-1, 0, 1)
    ]
    middle = around.pop(4)
    is_peak = (middle >= least) & np.all([middle > other for other in around[:4]], axis=0)
    is_peak &= np.all([middle >= other for other in around[4:]], axis=0)
    row, col = np.nonzero(is_peak)
    row, col = row + MARGIN, col + MARGIN
    with np.errstate(divide="ignore"):
        level = np.log(np.maximum(power, np.finfo(np.float32).tiny))
    down, _ = vertex(level[row - 1, col], level[row, col], level[row + 1, col])
    across, _ = vertex(level[row, col - 1], level[row, col], level[row, col + 1])
    return np.clip(down, -0.5, 0.5) + row, np.clip(across, -0.5, 0.5) + col


@dataclass(frozen=True, eq=False)
class Registered:
    """Passes with aligned images.

    Attributes:
        lattice: lattice with the antennas of the passes moved.
        boxes: boxes on the ground.
        images: images of all passes in these, with the background's power 1.
        background: power of the background in each pass, shape (passes,).
        shifts: shifts that were removed, in range and along the flight, shape (passes, 2), m.
    """

    lattice: Lattice
    boxes: Sequence[Box]
    images: Sequence[C64]
    background: F64
    shifts: F64


def registered(array: PassArray, settings: PassSettings) -> Registered:
    """Estimate and remove the shifts between the images of the passes, twice, and those above a quarter of a pixel.

    Smaller ones are estimated better from phases.

    Raises:
        UserError: a pass has no signal, or the volume is too large.
    """
    shifts = np.zeros((len(array.passes), 2))
    lattice = Lattice.of(array, settings)
    lattice.check_size()
    boxes = lattice.on_ground(settings)
    for last in (False, False, True):
        images = lattice.images(boxes)
        level = background(images)
        images = [(image / np.sqrt(level)[:, None, None]).astype(np.complex64) for image in images]
        if last:
            break
        found = measured_shifts(images, lattice, settings.largest_shift_m)
        found = np.where(np.abs(found) > 0.25 * np.array(lattice.spacing), found, 0.0)
        if not found.any():
            break
        shifts += found
        # A scene that appears too far was seen from farther back, and one that appears ahead from farther behind.
        lattice = Lattice.of(array.moved(-shifts @ array.axes[:2]), settings)
        boxes = lattice.on_ground(settings)
    return Registered(lattice, boxes, images, level, shifts)


def measured_shifts(images: Sequence[C64], lattice: Lattice, largest: float) -> F64:
    """Shift of each pass against the median of all, in range and along the flight, m, shape (passes, 2).

    The peak of the sum over boxes of the correlation of amplitudes; 0 where the largest is 0.
    """
    spacing = np.array(lattice.spacing)
    reach = np.minimum(np.floor(largest / spacing).astype(int), np.array(images[0].shape[1:]) // 2 - 1)
    total = np.zeros((len(images[0]), *(2 * reach + 1)))
    for image in images:
        amplitude = np.nan_to_num(np.abs(image))
        usual = np.median(amplitude, axis=0)
        spectra = np.fft.fft2(amplitude - amplitude.mean(axis=(1, 2), keepdims=True))
        against = np.fft.fft2(usual - usual.mean())
        correlation = np.fft.fftshift(np.fft.ifft2(spectra * against.conj()).real, axes=(1, 2))
        middle = np.array(image.shape[1:]) // 2
        low, high = middle - reach, middle + reach + 1
        total += correlation[:, low[0] : high[0], low[1] : high[1]]
    return np.array([_peak(one) - reach for one in total]) * spacing


def _peak(values: F64) -> F64:
    """Position of the greatest value, by parabolas; shape (2,)."""
    at = np.unravel_index(np.argmax(values), values.shape)
    place = np.array(at, np.float64)
    for axis in (0, 1):
        if 0 < at[axis] < values.shape[axis] - 1:
            line = np.take(values, at[1 - axis], axis=1 - axis)
            place[axis] += vertex(*line[at[axis] - 1 : at[axis] + 2])[0]
    return place
