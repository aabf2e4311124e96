"""The passes as an array in elevation: their response to a point of the same range and Doppler at any elevation.

Range, Doppler and elevation are those from a reference aperture in the middle of the passes. Images are formed on one
grid, so that a pixel x of pass p has a scatterer at q with the phase

    phi_p = -k (mean over the pulses of |a_t - q| - |a_t - x|),    k = 4 pi / wavelength

and what passes with the elevation e of q on its circle of range and Doppler is the response exp(j phi_p(e)) of a
channel. The ranges are exact; over the few metres of a box their differences are polynomials of e to better than
1e-6 rad. A phase that all passes share is arbitrary, so that of the middle is subtracted.

Passes confuse heights: with phases phi_p of a point at an offset x from the true one, the fraction of its power that a
point there explains is |sum_p exp(j (phi_p(x) - phi_p(0)))|^2 / M^2. Passes at even distances have grating lobes of 1;
uneven ones have sidelobes, which noise can raise above the peak.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams, Pattern
from sal_height.errors import UserError
from sal_height.geometry import ApertureState, angles_of, locate_at_elevation
from sal_height.numeric import F64, ShortRepr, window
from sal_height.passes.flown import Pass
from sal_height.passes.settings import PassSettings

DEGREE = 4
"""Degree of the polynomials of elevation."""


@dataclass(frozen=True, eq=False)
class Steering(ShortRepr):
    """The phases of the passes about one point.

    Attributes:
        elevation: elevation of the point, rad.
        searched: lowest and greatest elevation of the search, less that of the point, rad.
        beamwidth: elevation over which the phases of two passes farthest apart turn once against each other, rad.
        coefficients: coefficients of the phase in rising powers of (elevation - that of the point) in beamwidths, shape
            (passes, DEGREE + 1), rad.
        metres: distance across range and flight for a rad of elevation, the slant range, m.
    """

    elevation: float
    searched: tuple[float, float]
    beamwidth: float
    coefficients: F64
    metres: float

    def phase(self, offset: npt.ArrayLike) -> F64:
        """Phases at offsets from the point in beamwidths, rad, shape (..., passes)."""
        return np.asarray(np.polynomial.polynomial.polyval(np.asarray(offset, np.float64), self.coefficients.T).T)

    def slope(self, offset: npt.ArrayLike) -> F64:
        """Derivatives of `phase`, rad per beamwidth, shape (..., passes)."""
        rising = np.polynomial.polynomial.polyder(self.coefficients.T)
        return np.asarray(np.polynomial.polynomial.polyval(np.asarray(offset, np.float64), rising).T)

    def beams(self, uncertainty: float = 0.0) -> Beams:
        """The passes as beams of one receiver each, over the elevations that are searched."""
        offsets = np.linspace(*self.searched, len(self.coefficients))
        boresights, starts = self.elevation + offsets, offsets / self.beamwidth
        patterns = tuple(map(_pattern, self.coefficients, starts.tolist()))
        return Beams(patterns, boresights, self.beamwidth, uncertainty=uncertainty)


def _pattern(coefficients: F64, start: float) -> Pattern:
    """The pattern of a pass, whose boresight is `start` beamwidths from the point that the coefficients are about."""
    polynomial = np.polynomial.Polynomial(coefficients)
    rising = polynomial.deriv()

    def amplitude(e: npt.ArrayLike, _a: npt.ArrayLike) -> Any:
        return np.exp(1j * polynomial(np.asarray(e) + start))

    def slope(e: npt.ArrayLike, _a: npt.ArrayLike) -> Any:
        x = np.asarray(e) + start
        return 1j * rising(x) * np.exp(1j * polynomial(x))

    none: Callable[[npt.ArrayLike, npt.ArrayLike], Any] = lambda e, _a: np.zeros(np.shape(e))  # noqa: E731
    return Pattern("pass", amplitude, slope, none, main_lobe=1.0)


@dataclass(frozen=True, eq=False)
class PassArray(ShortRepr):
    """Passes, and the aperture in their middle to which range, Doppler and elevation refer.

    Attributes:
        passes: passes, cut to the same azimuths.
        centre: centre of the scene in map, shape (3,), m.
        reference: aperture in the middle; its body axes are level, with y across the line of sight.
        look_side: side of its flight, +1 right, -1 left.
        azimuth_window: window of the images, a name of `windows.WINDOWS`.
    """

    passes: tuple[Pass, ...]
    centre: F64
    reference: ApertureState
    look_side: int
    azimuth_window: str

    @classmethod
    def of(cls, passes: tuple[Pass, ...], centre: F64, settings: PassSettings) -> Self:
        """The array of some passes.

        Raises:
            UserError: they all see the scene from one elevation.
        """
        flights = np.array([one.flight for one in passes])
        flights *= np.sign(flights @ flights[0])[:, None]  # a pass in the opposite direction sees the same
        middles = np.array([one.antenna[len(one.antenna) // 2] for one in passes])
        position, flight = middles.mean(axis=0), flights.mean(axis=0)
        level = (centre - position) * np.array([1.0, 1.0, 0.0])
        forward = np.cross([0.0, 0.0, 1.0], level / np.linalg.norm(level))
        forward *= np.sign(forward @ flight) or 1.0
        rotation = np.column_stack([forward, np.cross([0.0, 0.0, 1.0], forward), [0.0, 0.0, 1.0]])
        side = -1 if rotation[:, 1] @ level > 0 else 1
        length = float(np.linalg.norm(flight))
        reference = ApertureState(position, flight, rotation, length, np.zeros((6, 6)))
        array = cls(passes, centre, reference, side, settings.azimuth_window)
        apart = float(np.ptp(array.elevations))
        least = 1e-4  # rad: a resolution of 150 m at X band and 10 km
        if not apart > least:
            raise UserError(
                f"The passes see the scene from elevations that differ by {np.degrees(apart):.3g} degrees; heights "
                f"need {np.degrees(least):.2g} or more."
            )
        return array

    @cached_property
    def middles(self) -> F64:
        """Position of each antenna in the middle of its pass, in map, shape (passes, 3), m."""
        return np.array([one.antenna[len(one.antenna) // 2] for one in self.passes])

    @property
    def wavenumbers(self) -> F64:
        """Two-way wavenumbers of the middles of the bands, rad/m, shape (passes,)."""
        return np.array([one.wavenumber for one in self.passes])

    @cached_property
    def elevations(self) -> F64:
        """Angles from nadir under which the passes see the middle of the scene, rad, shape (passes,)."""
        sight = self.middles - self.centre
        return np.asarray(np.arccos(sight[:, 2] / np.linalg.norm(sight, axis=-1)))

    @cached_property
    def axes(self) -> F64:
        """Unit vectors along the line of sight, along the flight and upwards across both, rows, shape (3, 3)."""
        return self.axes_at(self.centre)

    def axes_at(self, point: F64) -> F64:
        """`axes` at another point (m, shape (3,)): rows and columns of an image, and the direction of elevation."""
        sight = (point - self.reference.position) / np.linalg.norm(point - self.reference.position)
        along = self.reference.direction - (self.reference.direction @ sight) * sight
        along /= np.linalg.norm(along)
        across = np.cross(sight, along)
        return np.stack([sight, along, across * np.sign(across[2])])

    def moved(self, offsets: F64) -> Self:
        """The array with the antennas of its passes moved by offsets (m, shape (passes, 3)), but not its reference."""
        passes = (one.moved(offset) for one, offset in zip(self.passes, offsets, strict=True))
        return replace(self, passes=tuple(passes))

    def seen(self, points: F64) -> tuple[F64, F64, F64]:
        """Slant range (m), distance along the flight (m) and elevation (rad) of points, shape (..., 3)."""
        slant_range, elevation, _ = angles_of(points, self.reference, self.look_side)
        return slant_range, (points - self.reference.position) @ self.reference.direction, elevation

    def steering(self, point: F64, low_m: float, high_m: float) -> Steering:
        """The phases of the passes about a point (m, shape (3,)), for scatterers between two distances across (m).

        The polynomials are valid for 5 beamwidths more, which estimators search.
        """
        slant_range, along, elevation = (float(value) for value in self.seen(point))
        searched = low_m / slant_range, high_m / slant_range
        reach = 1.5 * max(np.abs(searched))
        for _ in range(2):  # the reach needs the beamwidth
            coefficients, beamwidth = self._fitted(point, (slant_range, along, elevation), reach)
            reach = 1.5 * max(np.abs(searched)) + 5 * beamwidth
        return Steering(elevation, searched, beamwidth, coefficients, slant_range)

    def _fitted(self, point: F64, seen: tuple[float, float, float], reach: float) -> tuple[F64, float]:
        """Coefficients of `Steering`, valid over `reach` (rad), and its beamwidth (rad); `seen` as by `seen`."""
        slant_range, along, elevation = seen
        nodes = 12
        offsets = reach * np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes)
        places = locate_at_elevation(elevation + offsets, slant_range, along, self.reference, self.look_side)
        phases = np.array([self._phases(one, point, places) for one in self.passes])
        fitted = np.polynomial.polynomial.polyfit(offsets / reach, phases.T, DEGREE)
        slopes = fitted[1] / reach
        fastest, slowest = np.argmax(slopes), np.argmin(slopes)
        # A phase that all passes share is arbitrary: that half way between the outermost is subtracted.
        fitted -= (fitted[:, [fastest]] + fitted[:, [slowest]]) / 2
        beamwidth = float(2 * np.pi / (slopes[fastest] - slopes[slowest]))
        scale = (beamwidth / reach) ** np.arange(DEGREE + 1)
        return (fitted * scale[:, None]).T, beamwidth

    def _phases(self, one: Pass, point: F64, places: F64) -> F64:
        """Phases (rad) in a pass of scatterers at positions (m, (n, 3)) in the pixel at a point, shape (n,)."""
        count = len(one.antenna)
        # Between 17 pulses ranges change as a parabola of time.
        chosen = np.unique(np.linspace(0, count - 1, min(count, 17)).astype(np.intp))
        weights = window(self.azimuth_window, count)[chosen]
        antenna = one.antenna[chosen]
        sight = point - antenna
        near = np.linalg.norm(sight, axis=-1)
        offset = places - point
        # |s + d| - |s| = (2 s d + d^2) / (|s + d| + |s|) without the difference of two large numbers.
        far = np.linalg.norm(sight[:, None] + offset, axis=-1)
        longer = (2 * sight @ offset.T + np.sum(offset**2, axis=-1)) / (far + near[:, None])
        return np.asarray(-one.wavenumber * (weights @ longer) / weights.sum())


def resolution(steering: Steering) -> float:
    """Resolution of the passes across range and flight, a beamwidth, m."""
    return steering.beamwidth * steering.metres


FALSE_PEAK = 0.5
"""Least fraction of the power of a sidelobe that may be mistaken for the height of a point."""


@dataclass(frozen=True, eq=False)
class Ambiguity(ShortRepr):
    """Properties of the array response of the passes.

    Attributes:
        resolution: height over which the phases of the outermost passes turn once against each other, m.
        width: width of the main lobe at half its power, m of height.
        sidelobe: largest fraction of the power of a point at another height within `reach`.
        at: height of that sidelobe over the point, m.
        first_false: nearest height with a sidelobe of FALSE_PEAK or more, infinite without one within `reach`, m.
        reach: largest height to each side, m.
        offsets: heights of the response, shape (n,), m.
        response: fraction of the power there, shape (n,).
    """

    resolution: float
    width: float
    sidelobe: float
    at: float
    first_false: float
    reach: float
    offsets: F64
    response: F64


def ambiguity_of(steering: Steering, climb: float, reach: float) -> Ambiguity:
    """The array response over heights.

    Args:
        steering: phases of the passes.
        climb: height for a rad of elevation, m.
        reach: largest height to each side, m.
    """
    beamwidth = steering.beamwidth * climb
    step = 0.02  # beamwidths
    offsets = np.arange(0.0, reach / beamwidth + step, step)
    slopes = steering.slope(0.0)
    response = np.abs(np.exp(1j * np.multiply.outer(offsets, slopes)).mean(axis=-1)) ** 2
    half = float(np.interp(-0.5, -response[: _first_rise(response)], offsets[: _first_rise(response)]))
    beyond = _first_rise(response)
    peaks = beyond + np.flatnonzero(
        (response[beyond:-1] >= response[beyond - 1 : -2]) & (response[beyond:-1] > response[beyond + 1 :])
    )
    greatest = peaks[np.argmax(response[peaks])] if len(peaks) else len(response) - 1
    false = peaks[response[peaks] >= FALSE_PEAK]
    both = np.concatenate([-offsets[:0:-1], offsets]) * beamwidth
    return Ambiguity(
        resolution=beamwidth,
        width=2 * half * beamwidth,
        sidelobe=float(response[greatest]),
        at=float(offsets[greatest] * beamwidth),
        first_false=float(offsets[false[0]] * beamwidth) if len(false) else np.inf,
        reach=reach,
        offsets=both,
        response=np.concatenate([response[:0:-1], response]),
    )


def _first_rise(response: F64) -> int:
    """Number of the node behind which the response rises for the first time."""
    rises = np.flatnonzero(np.diff(response) > 0)
    return int(rises[0]) + 1 if len(rises) else len(response) - 1
