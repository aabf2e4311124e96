"""Height images as their messages state them: fields of heights in single precision, and back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np

from sal_height.doubts import Doubt, FitTest
from sal_height.elevation import ORDERS, USABLE, Validity, scatterer_count
from sal_height.engine.geometry_items import FARTHEST, Aperture, check_geometry
from sal_height.engine.provenance import Provenance
from sal_height.engine.results import DwellKey, Notice
from sal_height.engine.stage import Port
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid, above_place
from sal_height.numeric import F32, F64, U8, by_fields
from sal_height.relief import HeightField, Surface, covariances_from_sigma, unfolded

LAYERS = ("height", "sigma", "cnr_db", "east", "north")
"""Layers that have a number per pixel, always."""

OPTIONAL = {"spread": 1, "covariance": 6, "common_covariance": 6}
"""The other layers, with their numbers per pixel; they may be empty."""

_USABLE = np.zeros(256, np.bool_)
_USABLE[list(USABLE)] = True

_HELD = scatterer_count(np.arange(256, dtype=np.uint8))
_HELD[Validity.INTERPOLATED] = 1
"""Number of scatterers that have a height, by validity."""


def empty() -> F32:
    """The value of a layer that is not stated."""
    return np.zeros(0, np.float32)


@dataclass(frozen=True, eq=False)
class PackedSurface:
    """One scatterer per pixel; arrays of float32, row-major, with one number per pixel or six.

    Attributes:
        height: height above the sphere, m.
        sigma: standard deviation of the height, m.
        cnr_db: carrier-to-noise ratio, dB.
        east: eastward position relative to the origin of the grid, m.
        north: northward position relative to the origin of the grid, m.
        spread: standard deviation of the surface's own heights within the pixel, m; empty: not stated.
        covariance: covariance of the position without the pose error, six numbers per pixel, m^2; empty: not stated.
        common_covariance: part of the covariance that follows from the pose, m^2; empty: not known.
    """

    height: F32
    sigma: F32
    cnr_db: F32
    east: F32
    north: F32
    spread: F32 = field(default_factory=empty)
    covariance: F32 = field(default_factory=empty)
    common_covariance: F32 = field(default_factory=empty)

    @classmethod
    def of(cls, surface: Surface, grid: Grid) -> PackedSurface:
        """The layers of a surface."""
        (height, sigma, cnr_db, east, north, spread), own, common = surface.singles(grid.origin)
        return cls(height, sigma, cnr_db, east, north, spread, own.reshape(-1), common.reshape(-1))

    def __reduce__(self) -> tuple[Any, ...]:
        """To be sent to another process, with all layers as one array."""
        layers = by_fields(self)[1]
        return _surface_of, (np.concatenate(layers), tuple(map(len, layers)))

    @property
    def size(self) -> int:
        """Bytes of the arrays."""
        return sum(layer.nbytes for layer in by_fields(self)[1])


def _surface_of(numbers: F32, sizes: Sequence[int]) -> PackedSurface:
    return PackedSurface(*(numbers[end - size : end] for size, end in zip(sizes, accumulate(sizes), strict=True)))


@dataclass(frozen=True, eq=False)
class Heights:
    """Heights of a dwell.

    Attributes:
        key: sensor, number and stamp of the dwell.
        frame_id: name of the frame of the map.
        estimator: name of the estimator that made them, or "tracked" or "adjusted".
        grid: pixels.
        aperture: aperture that they are seen from.
        looks: numbers of pixels averaged in range and in azimuth.
        validity: value of `Validity` per pixel, uint8, shape (rows * cols,).
        surfaces: scatterers of each pixel, the strongest first.
        order_probability: probabilities of 0, 1, 2 or 3 scatterers or an extended surface, five numbers per pixel;
            empty: not estimated.
        provenance: record of how they were made.
        order: place of the dwell in the order of processing.
        doubts: reasons to distrust them.
        fit: tests of the data.
    """

    key: DwellKey
    frame_id: str
    estimator: str
    grid: Grid
    aperture: Aperture
    looks: tuple[int, int]
    validity: U8
    surfaces: tuple[PackedSurface, ...]
    order_probability: F32
    provenance: Provenance
    order: int = 0
    doubts: tuple[Doubt, ...] = ()
    fit: tuple[FitTest, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        """To be sent to another process, without the fields of float64."""
        return by_fields(self)

    @property
    def size(self) -> int:
        """Bytes of the arrays."""
        return self.validity.nbytes + self.order_probability.nbytes + sum(one.size for one in self.surfaces)

    @property
    def where(self) -> str:
        """Name of the message, as the start of a warning."""
        return f"HeightImage of dwell {self.key.number}"

    @cached_property
    def field(self) -> HeightField:
        """The surfaces as arrays of float64.

        A pixel that is usable by its validity but one of whose scatterers has no finite height, sigma, east or north, a
        sigma that is not greater than 0, or a matrix that is no covariance, gets the validity MISSING_DATA;
        `bad_pixels` counts them. Where no covariance is stated it follows from sigma and the pose.

        Raises:
            Rejected: the heights cannot be used; the error names the field, its value and what is allowed.
        """
        if not self.surfaces:
            raise Rejected("wrong size", f"{self.where} has no surface; it must have at least one.")
        grid = self.grid
        _check_sizes(self)
        check_geometry(grid, self.aperture, self.where)
        validity = np.array(self.validity, dtype=np.uint8).reshape(grid.shape)
        held = _HELD[validity]
        surfaces = _joined(self.surfaces, grid, self.aperture.state)
        absent = held <= np.arange(len(self.surfaces))[:, None, None]
        sound = (surfaces.is_possible(FARTHEST) | absent).all(axis=0) & (held <= len(self.surfaces))
        if not sound.all():
            validity[~sound] = Validity.MISSING_DATA
            absent |= ~sound
        probability = self.order_probability.reshape(*grid.shape, ORDERS) if self.order_probability.size else None
        return HeightField(
            grid,
            validity,
            surfaces.where(~absent).each(),
            None if probability is None else probability.astype(np.float64),
        )

    @property
    def bad_pixels(self) -> int:
        """Number of pixels that are usable by their validity but masked in `field`."""
        return int(np.count_nonzero(_USABLE[self.validity] & ~_USABLE[self.field.validity.ravel()]))

    def notices(self) -> Iterator[Notice]:
        """A warning that says how many pixels were masked, if there are any."""
        if not (count := self.bad_pixels):
            return
        sentence = (
            f"{self.where}: {count} of {len(self.validity)} pixels are usable by their validity, "
            f"but their height, sigma, spread, east, north or covariance is not finite or beyond {FARTHEST:g} m, sigma "
            "is not greater than 0, or a covariance is not positive semidefinite; they are left out."
        )
        yield Notice("bad pixels", sentence, self.key)

    def check_frame(self, map_frame: str) -> None:
        """Check the frame of coordinates.

        Raises:
            Rejected: it is not `map_frame`.
        """
        if self.frame_id != map_frame:
            raise Rejected(
                "wrong frames",
                f"{self.where} is in {self.frame_id!r}; it must be in {map_frame!r} (parameter map_frame).",
            )


def heights_port(estimator: str) -> Port:
    """The port of a stage that works on the heights of an estimator."""
    return Port(f"{estimator}/height", Heights, "heights of the estimator that the parameter names", counted=True)


def packed(heights: HeightField) -> dict[str, Any]:
    """The attributes of `Heights` that follow from a field of heights, rounded as its message is."""
    probability = heights.order_probability
    return {
        "grid": heights.grid,
        "validity": np.ascontiguousarray(heights.validity).reshape(-1),
        "surfaces": tuple(PackedSurface.of(surface, heights.grid) for surface in heights.surfaces),
        "order_probability": empty() if probability is None else _single(probability),
    }


def _single(numbers: F64 | F32) -> F32:
    return np.ascontiguousarray(numbers, dtype=np.float32).reshape(-1)


def _check_sizes(heights: Heights) -> None:
    """Every array has as many entries as the grid needs.

    Raises:
        Rejected: one has not.
    """
    grid = heights.grid
    count = grid.rows * grid.cols
    sizes = {"validity": (len(heights.validity), count)}
    if heights.order_probability.size:
        sizes["order_probability"] = len(heights.order_probability), ORDERS * count
    for number, surface in enumerate(heights.surfaces):
        for name in LAYERS:
            sizes[f"surfaces[{number}].{name}"] = len(getattr(surface, name)), count
        for name, each in OPTIONAL.items():
            if size := len(getattr(surface, name)):
                sizes[f"surfaces[{number}].{name}"] = size, each * count
    for name, (size, needed) in sizes.items():
        if size != needed or count == 0:
            raise Rejected(
                "wrong size",
                f"{heights.where}: {name} has {size} entries, {grid.rows} x {grid.cols} pixels need {needed} (at least "
                "1).",
            )


def _joined(layers: Sequence[PackedSurface], grid: Grid, aperture: ApertureState) -> Surface:
    """Surfaces seen from `aperture`, arrays of shape (surfaces, rows, cols, ...).

    Spread that is not stated is 0, covariance that is not stated follows from sigma.
    """
    none, names = np.zeros(grid.rows * grid.cols, np.float32), (*LAYERS, "spread")
    stacked = np.concatenate([_or(getattr(one, name), none) for name in names for one in layers])
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        numbers = stacked.astype(np.float64)
    height, sigma, cnr_db, east, north, spread = numbers.reshape(len(names), len(layers), *grid.shape)
    positions = above_place(grid.origin[0] + east, grid.origin[1] + north, height)
    own = _covariances([one.covariance for one in layers], grid)
    stated = [one.common_covariance for one in layers]
    common = _covariances(stated, grid) if any(one.size for one in stated) else None
    for number, one in enumerate(layers):
        if not one.covariance.size and np.isfinite(sigma[number]).any():
            own[number], by_pose = covariances_from_sigma(sigma[number], positions[number], aperture)
            if by_pose is not None:
                common = np.zeros_like(own) if common is None else common
                common[number] = by_pose
    return Surface(height, sigma, cnr_db, positions, spread, own, common)


def _covariances(triangles: Sequence[F32], grid: Grid) -> F64:
    """Symmetric matrices, shape (surfaces, rows, cols, 3, 3), from their upper triangles; 0 where none is stated."""
    each = OPTIONAL["covariance"]
    none = np.zeros(grid.rows * grid.cols * each, np.float32)
    numbers = np.concatenate([_or(triangle, none) for triangle in triangles])
    return unfolded(numbers.reshape(len(triangles), *grid.shape, each))


def _or(layer: F32, none: F32) -> F32:
    """A layer, or `none` if it is not stated."""
    return layer if layer.size else none
