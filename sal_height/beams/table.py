"""Measured beams: tables of complex amplitudes over angles, and their patterns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline, RectBivariateSpline

from sal_height.beams.apertures import PatternFunction
from sal_height.beams.pattern import Pattern, first_null
from sal_height.errors import UserError
from sal_height.numeric import C128, F64

Values = npt.NDArray[Any]
"""Float64 or complex128."""

Derivatives = Callable[[F64, F64, tuple[int, int]], Values]
"""Derivative of the given orders of an interpolated table, at elevations and azimuths of one shape, in that shape."""


@dataclass(frozen=True)
class BeamTable:
    """The measured beam of one detector; the same content as sal_height_msgs/BeamTable.

    Attributes:
        elevation: offsets from the detector's boresight along the detector axis, increasing, rad.
        azimuth: offsets across that axis, increasing, rad; a single one: the beam depends on elevation only.
        real: real part of the amplitude at every elevation and, within it, every azimuth. All detectors of a sensor
            have one unit, because they are compared with each other; CNRs keep their meaning if the greatest modulus
            is near 1.
        imaginary: imaginary part, in the order and unit of `real`.

    Raises:
        UserError: the angles are too few or do not increase, or the values are not finite, not as many as directions,
            or all zero.
    """

    elevation: tuple[float, ...]
    azimuth: tuple[float, ...]
    real: tuple[float, ...]
    imaginary: tuple[float, ...]

    def __post_init__(self) -> None:
        least = 4  # offsets along one axis of a table, for a cubic spline
        for name in ("elevation", "azimuth"):
            angles = np.array(getattr(self, name), dtype=np.float64)
            few = angles.size < least and not (name == "azimuth" and angles.size == 1)
            if few or not (np.all(np.isfinite(angles)) and np.all(np.diff(angles) > 0)):
                raise UserError(
                    f"A beam table has {angles.size} offsets in {name}; they must be {least} or more"
                    f"{' (or one in azimuth)' if name == 'azimuth' else ''}, finite and increasing."
                )
        size = len(self.elevation) * len(self.azimuth)
        if not len(self.real) == len(self.imaginary) == size:
            raise UserError(
                f"A beam table has {len(self.real)} real and {len(self.imaginary)} imaginary parts; its "
                f"{len(self.elevation)} x {len(self.azimuth)} angles need {size} each."
            )
        values = self.values
        if not np.all(np.isfinite(values)) or not np.any(values):
            raise UserError("A beam table has amplitudes that are not finite, or all zero; all must be finite.")

    @property
    def values(self) -> C128:
        """Amplitudes, shape (elevations, azimuths)."""
        flat = np.array(self.real, dtype=np.float64) + 1j * np.array(self.imaginary, dtype=np.float64)
        return flat.reshape(len(self.elevation), len(self.azimuth))


def tabulated_pattern(table: BeamTable, beamwidth: float, azimuth_beamwidth: float | None = None) -> Pattern:
    """Return the pattern of a table: the cubic spline through its amplitudes, and the spline's derivatives.

    With a single azimuth the pattern is the same at all azimuths. Beyond the table nothing is received: 0.

    Args:
        table: table of one detector's beam.
        beamwidth: wavelength / antenna diameter along the detector axis, rad.
        azimuth_beamwidth: beamwidth across the detector axis, rad; None: `beamwidth`.

    Returns:
        Pattern: named "table", known within the table; float64 where all amplitudes are real, otherwise complex128.
    """
    elevation = np.array(table.elevation) / beamwidth
    azimuth = np.array(table.azimuth) / (azimuth_beamwidth or beamwidth)
    values = table.values if any(table.imaginary) else table.values.real
    if azimuth.size == 1:
        derivatives, azimuths = _interpolate_line(elevation, values[:, 0]), (-np.inf, np.inf)
    else:
        derivatives, azimuths = (
            _interpolate_surface(elevation, azimuth, values),
            (float(azimuth[0]), float(azimuth[-1])),
        )
    elevations = (float(elevation[0]), float(elevation[-1]))
    amplitude, slope, azimuth_slope = (
        _within(elevations, azimuths, derivatives, orders) for orders in ((0, 0), (1, 0), (0, 1))
    )
    # A single azimuth does not show the main lobe: it is assumed to be that of a square aperture, 1 beamwidth.
    main_lobe = 1.0 if azimuth.size == 1 else first_null(amplitude, max(map(abs, azimuths)))
    return Pattern("table", amplitude, slope, azimuth_slope, main_lobe, elevations)


def _interpolate_line(elevation: F64, values: Values) -> Derivatives:
    """Interpolate values, shape (n,), by a cubic spline over elevation alone."""
    spline = CubicSpline(elevation, values)
    return lambda e, _, orders: np.zeros_like(e, dtype=values.dtype) if orders[1] else spline(e, orders[0])


def _interpolate_surface(elevation: F64, azimuth: F64, values: Values) -> Derivatives:
    """Interpolate values, shape (n, m), by a tensor product of cubic splines."""
    if np.iscomplexobj(values):
        real, imaginary = (_interpolate_surface(elevation, azimuth, part) for part in (values.real, values.imag))
        return lambda e, a, orders: real(e, a, orders) + 1j * imaginary(e, a, orders)
    spline = RectBivariateSpline(elevation, azimuth, values)
    return lambda e, a, orders: spline.ev(e, a, *orders)


def _within(
    elevations: tuple[float, float], azimuths: tuple[float, float], derivatives: Derivatives, orders: tuple[int, int]
) -> PatternFunction:
    """Return a derivative of the spline as a function of all offsets (beamwidths): 0 beyond the table."""
    edge = 1e-9  # beamwidths beyond a table that still belong to it: elevations in rad are rounded to about 1e-12

    def values(e: npt.ArrayLike, a: npt.ArrayLike) -> F64:
        e, a = np.broadcast_arrays(np.asarray(e, dtype=np.float64), np.asarray(a, dtype=np.float64))
        scale = np.where(np.isnan(e + a), np.nan, 1.0)
        for offset, (low, high) in ((e, elevations), (a, azimuths)):
            scale[(offset < low - edge) | (offset > high + edge)] = 0.0
        nearest_e, nearest_a = np.clip(np.nan_to_num(e), *elevations), np.clip(np.nan_to_num(a), *azimuths)
        return scale * derivatives(nearest_e, nearest_a, orders)

    return values
