"""Heights from elevations: the position on the ground of the scatterer in each pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from sal_height.beams import Beams
from sal_height.doubts import Doubt, FitTest
from sal_height.elevation import (
    ElevationEstimate,
    Looks,
    Validity,
    common_deviation,
    scatterer_count,
)
from sal_height.extras import import_extra
from sal_height.geometry import ApertureState, Grid, aperture_at, height_of, locate_at_elevation
from sal_height.numeric import F32, F64, U8, Bool, ShortRepr, draw_array, in_parallel
from sal_height.relief import _surface_kernels as kernels
from sal_height.relief.labelled import labelled_heights
from sal_height.relief.position_error import (
    LEAST_POINTS,
    height_variance,
    measured_covariance,
    pitch_covariance,
    pose_covariance,
)


@dataclass(frozen=True)
class Surface(ShortRepr):
    """One scatterer of each pixel; arrays of the shape (rows, cols) of the height image, NaN where it is absent.

    Attributes:
        height: height above the sphere, m.
        sigma: standard deviation of height, m, including that from the platform's pose.
        cnr_db: carrier-to-noise ratio of one look, dB.
        positions: position in map, m, shape (rows, cols, 3).
        spread: standard deviation of the surface's own heights within the pixel, m; 0: a single point.
        own_covariance: covariance of the position without the errors that pixels share, m^2, shape (rows, cols, 3, 3).
        common_covariance: covariance from the platform's pose, whose error all pixels of a dwell share, and from beams
            that are not exactly known, whose error those of one elevation share, m^2; None: neither is known.
    """

    height: F64
    sigma: F64
    cnr_db: F64
    positions: F64
    spread: F64
    own_covariance: F64
    common_covariance: F64 | None = None

    @classmethod
    def at(cls, positions: F64, height: F64, sigma: F64, cnr_db: F64) -> Self:
        """A surface of single points, whose covariance is not known."""
        return cls(height, sigma, cnr_db, positions, np.zeros_like(height), np.full((*height.shape, 3, 3), np.nan))

    @classmethod
    def seen_from(
        cls,
        aperture: ApertureState,
        positions: F64,
        own_covariance: F64,
        cnr_db: F64,
        spread: F64 | None = None,
        beam_covariance: F64 | None = None,
    ) -> Self:
        """A surface with the covariance from the pose of the aperture added; arguments as the attributes.

        Spread None: a surface of single points. Beam covariance None: the beams are known.
        """
        common = pose_covariance(positions, aperture)
        if beam_covariance is not None:
            common = beam_covariance if common is None else common + beam_covariance
        variance = height_variance(own_covariance if common is None else own_covariance + common, positions)
        height = height_of(positions)
        spread = np.zeros_like(height) if spread is None else spread
        return cls(height, np.sqrt(variance), cnr_db, positions, spread, own_covariance, common)

    @property
    def covariance(self) -> F64:
        """Covariance of the position with that from the pose, as far as it is known, m^2, shape (rows, cols, 3, 3)."""
        return self.own_covariance if self.common_covariance is None else self.own_covariance + self.common_covariance

    @property
    def own_sigma(self) -> F64:
        """Standard deviation of height without the errors that pixels share, m; sigma where no covariance is known.

        What all pixels of a dwell share is not in the difference of two, and averaging over neighbours does not reduce
        it.
        """
        own = np.sqrt(height_variance(self.own_covariance, self.positions))
        return np.where(np.isnan(own), self.sigma, own)

    @property
    def is_determined(self) -> Bool:
        """Pixels with finite position, height and, in the single precision of messages, sigma, shape (rows, cols)."""
        with np.errstate(over="ignore"):
            sigma = self.sigma.astype(np.float32)
        east, north, up = np.moveaxis(self.positions, -1, 0)
        return np.isfinite(east + north + up) & np.isfinite(sigma) & (sigma > 0)

    def is_possible(self, farthest: float) -> Bool:
        """Scatterers with possible numbers: `is_determined`, and no height, spread or deviation beyond `farthest` (m).

        Covariances must be positive semidefinite but for rounding in float32: all principal minors are 0 or greater
        (Sylvester).
        """
        possible = np.empty(self.height.shape, np.bool_)
        # How far a determinant may be below 0, over that of the variances: float32 rounds each number by up to 1e-7.
        rounding = 1e-5
        numbers, found = self.numbers(), possible.reshape(-1)

        def mark(part: slice) -> None:
            kernels.mark_possible(found[part], farthest, rounding, *(array[part] for array in numbers))

        in_parallel(mark, len(found), LEAST_POINTS)
        return possible

    def each(self) -> tuple[Surface, ...]:
        """The surfaces of which all arrays of this one have one more axis, the first."""
        common = self.common_covariance
        return tuple(
            Surface(
                height=self.height[number],
                sigma=self.sigma[number],
                cnr_db=self.cnr_db[number],
                positions=self.positions[number],
                spread=self.spread[number],
                own_covariance=self.own_covariance[number],
                common_covariance=None if common is None else common[number],
            )
            for number in range(len(self.height))
        )

    def singles(self, origin: F64) -> tuple[F32, F32, F32]:
        """The numbers in single precision, as messages have them.

        Args:
            origin: place from which positions count, m, shape (3,).

        Returns:
            Height, sigma, CNR, eastward and northward position and spread of each pixel, shape (6, pixels); and the
            upper triangles of own and of common covariances, row by row, shape (pixels, 6), or (0, 6) if not known.
        """
        numbers, count = self.numbers(), self.height.size
        layers, own, common = (np.empty(shape, np.float32) for shape in ((6, count), (count, 6), (len(numbers[-1]), 6)))
        cnr_db = np.ascontiguousarray(self.cnr_db).reshape(-1)
        has_own = kernels.fill_singles(*numbers, cnr_db, origin, layers, own, common)
        return layers, own if has_own else own[:0], common

    def where(self, there: Bool) -> Surface:
        """The surface only `there`, and NaN elsewhere; the CNR stays."""
        if there.all():
            return self
        chosen = self._nowhere()
        chosen.take(self, there)
        return chosen

    def take(self, other: Surface, there: Bool) -> None:
        """Replace the numbers `there`, but the CNR, by those of another surface; the arrays must be contiguous."""
        kernels.copy_some(there.reshape(-1), *other.numbers(), *self.numbers())

    def _nowhere(self) -> Surface:
        """A surface of this shape and CNR, with common errors if this one has some; all other numbers are NaN."""
        shape, count = self.height.shape, self.height.size
        numbers = np.full((15 if self.common_covariance is None else 24) * count, np.nan)
        height, sigma, spread = numbers[: 3 * count].reshape(3, *shape)
        positions = numbers[3 * count : 6 * count].reshape(*shape, 3)
        own, *common = numbers[6 * count :].reshape(-1, *shape, 3, 3)
        return Surface(height, sigma, self.cnr_db, positions, spread, own, *common)

    def numbers(self) -> tuple[F64, F64, F64, F64, F64, F64]:
        """The arrays but the CNR for compiled loops, as of `_surface_kernels.mark_possible`."""
        common = np.empty((0, 3, 3)) if self.common_covariance is None else self.common_covariance
        return (
            np.ascontiguousarray(self.height).reshape(-1),
            np.ascontiguousarray(self.sigma).reshape(-1),
            np.ascontiguousarray(self.spread).reshape(-1),
            np.ascontiguousarray(self.positions).reshape(-1, 3),
            np.ascontiguousarray(self.own_covariance).reshape(-1, 3, 3),
            np.ascontiguousarray(common).reshape(-1, 3, 3),
        )


@dataclass(frozen=True)
class HeightField(ShortRepr):
    """Heights of one dwell.

    Attributes:
        grid: pixels of the height image.
        validity: `Validity` of each pixel, uint8, shape (rows, cols).
        surfaces: the strongest scatterer of the pixels that have a height, with the `cnr_db` of all pixels that have a
            signal; then as many weaker ones as were searched for.
        order_probability: probability of each order, as in `ElevationEstimate`; None: not estimated.
        fit: tests of the data that they were estimated from.
        doubts: reasons to distrust them.
    """

    grid: Grid
    validity: U8
    surfaces: tuple[Surface, ...]
    order_probability: F64 | None = None
    fit: tuple[FitTest, ...] = ()
    doubts: tuple[Doubt, ...] = ()

    @property
    def first(self) -> Surface:
        """The surface of the strongest scatterers."""
        return self.surfaces[0]

    def to_xarray(self) -> Any:
        """The heights as an xarray.Dataset with the dimensions surface, row and col.

        Names, units and attributes are those of `sal_height.open_heights`; x and y are distances along the sphere.

        Raises:
            UserError: xarray is not installed.
        """
        xarray = import_extra("xarray", "Making labelled arrays")
        return xarray.Dataset(*labelled_heights([self])).isel(dwell=0)

    def plot(self, axes: Any = None) -> Any:
        """Draw the heights of the strongest scatterers over the pixels; returns the axes.

        Args:
            axes: axes of Matplotlib; None: those of a new figure.
        """
        names = ("along-track distance (m)", "distance in range (m)", "height above the sphere (m)")
        return draw_array(self.first.height, self.grid.extent, names, axes=axes)


def height_field(
    estimate: ElevationEstimate,
    looks: Looks,
    slc_grid: Grid,
    grid: Grid,
    aperture: ApertureState,
    look_side: int,
    radial_velocity: float = 0.0,
    beams: Beams | None = None,
    radial_velocity_sigma: float = 0.0,
) -> HeightField:
    """Compute height, its standard deviation and the ground position of every pixel.

    Range and Doppler are those of the looks' power-weighted centre; the elevation selects the point on their circle.
    The errors of elevation, of range and of Doppler are independent (`position_error.measured_covariance`); those
    of range and Doppler are there because the centre of the speckle within its cell is unknown, which limits the
    height at high CNR. The error of the platform's pose (`position_error.pose_covariance`) is common to all pixels of
    the dwell, and that of uncertain beams (`beam_error.common_deviation`) to those of one elevation; so is that of the
    angles between the beams (`position_error.pitch_covariance`). The variance of height is that of both parts along the
    vertical.

    Args:
        estimate: elevations of the pixels.
        looks: position in the SLC of each pixel's power.
        slc_grid: pixels of the SLC.
        grid: pixels of the height image (`look_grid`).
        aperture: state of the platform.
        look_side: look side, +1 right, -1 left.
        radial_velocity: velocity v_r of the targets, positive if they recede, m/s. It displaces them in the image by
            -range v_r / speed along-track (SAL paper, section 4), which is corrected.
        beams: beams whose uncertainty is in the estimate's sigmas, and becomes common; None: they are known.
        radial_velocity_sigma: standard deviation of that velocity, m/s, another in each pixel.
    """
    points = slc_grid.points(looks.row, looks.col)
    aperture = aperture_at(points, aperture)
    sight = points - aperture.position
    slant_range = np.sqrt(np.einsum("...i,...i", sight, sight))
    displacement = slant_range / np.linalg.norm(aperture.velocity)  # m along the flight for 1 m/s along the sight
    along = sight @ aperture.direction + displacement * radial_velocity
    # The centre of the speckle is somewhere in its cell, in each look at another position.
    depth = slc_grid.row_spacing * np.abs(sight @ slc_grid.row_direction) / slant_range
    width = slc_grid.col_spacing * np.abs(slc_grid.col_direction @ aperture.direction)
    range_sigma = depth * np.sqrt(looks.row_variance)
    along_sigma = np.hypot(width * np.sqrt(looks.col_variance), displacement * radial_velocity_sigma)

    # All scatterers of the pixels at once, shape (scatterers, rows, cols).
    elevation, sigma, cnr, spread = (
        np.array([getattr(scatterer, name) for scatterer in estimate.scatterers])
        for name in ("elevation", "sigma", "cnr", "spread")
    )
    positions = locate_at_elevation(elevation, slant_range, along, aperture, look_side)
    by_beams = None
    if beams and beams.uncertainty:
        shared = np.minimum(common_deviation(beams, elevation, looks.squint), sigma)
        by_beams, _ = measured_covariance(positions, aperture, shared, 0.0, 0.0)
        with np.errstate(invalid="ignore"):
            sigma = np.where(np.isfinite(sigma), np.sqrt(sigma**2 - shared**2), sigma)
    if beams and beams.pitch_uncertainty:
        by_pitch = pitch_covariance(positions, aperture, elevation - beams.axis_middle, beams.pitch_uncertainty)
        by_beams = by_pitch if by_beams is None else by_beams + by_pitch
    own, climb = measured_covariance(positions, aperture, sigma, range_sigma, along_sigma)
    with np.errstate(divide="ignore", invalid="ignore"):
        cnr_db = 10 * np.log10(np.where(cnr > 0, cnr, np.nan))
    surfaces = Surface.seen_from(aperture, positions, own, cnr_db, spread * climb, by_beams)
    validity = _checked_validity(estimate.validity, surfaces)
    filled = _has_scatterers(validity, len(elevation))
    cnr_db[1:][~filled[1:]] = np.nan
    return HeightField(grid, validity, surfaces.where(filled).each(), estimate.order_probability)


def _has_scatterers(validity: U8, surfaces: int) -> Bool:
    """True for pixels with a scatterer in each of N surfaces, by their validity, shape (surfaces, rows, cols)."""
    return scatterer_count(validity) > np.arange(surfaces)[:, None, None]


def _checked_validity(validity: U8, surfaces: Surface) -> U8:
    """The validity with a reason where measurements could be used, but a height or its sigma is not determined.

    OUTSIDE_ARRAY: no position on the ground has that range, Doppler and elevation. LOW_CNR: sigma is infinite, as
    without a signal. NOT_ONE_SCATTERER: one or more of several scatterers are not determined.

    Args:
        validity: validity by the elevations, shape (rows, cols).
        surfaces: all surfaces, arrays of shape (surfaces, rows, cols, ...).
    """
    lacking = _has_scatterers(validity, len(surfaces.height)) & ~surfaces.is_determined
    if not lacking.any():
        return validity
    placed = np.isfinite(surfaces.positions[0]).all(axis=-1)
    several = scatterer_count(validity) > 1
    reason = np.select([several, placed], [Validity.NOT_ONE_SCATTERER, Validity.LOW_CNR], Validity.OUTSIDE_ARRAY)
    return np.where(lacking.any(axis=0), reason, validity).astype(np.uint8)
