"""Range response of a point, and along-track spectra of pieces of a strip by the aspect of each bin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams
from sal_height.geometry import aperture_at
from sal_height.imaging import Processing, Slc
from sal_height.numeric import C64, C128, F64, Index, window
from sal_height.sensor import Sensor, processed_angle

PLACES = np.linspace(-24, 24, 1921)
"""Distances from a target for which its response is tabulated, rows."""


def point_response(name: str, spacing: float, rows: F64) -> F64:
    """Amplitude of a point at distances from it, 1 in the middle.

    Args:
        name: name of the window over the band, of `windows.WINDOWS`.
        spacing: spacing of rows, range resolutions.
        rows: distances from the point, any shape, rows.
    """
    return np.interp(rows, PLACES, _tabulated(name, round(spacing, 3)))


@lru_cache(maxsize=8)
def _tabulated(name: str, spacing: float) -> F64:
    """The response at PLACES."""
    samples = 256  # of the band
    weights = window(name, samples)
    turns = (np.arange(samples) - (samples - 1) / 2) / samples * spacing
    return np.asarray(np.cos(2 * np.pi * PLACES[:, None] * turns) @ weights / np.sum(weights))


@dataclass(frozen=True, eq=False)
class Bins:
    """The bins of the spectra of some pixels along the flight.

    Attributes:
        pixels: number of pixels.
        numbers: numbers of the bins in the order of `numpy.fft.fft`, increasing with the aspect, shape (bins,).
        aspects: squints under which the antenna saw targets at rest that are in these bins, same shape, rad.
        weights: weights of the azimuth window, rms 1, same shape.
        angle: processed angle, rad.
    """

    pixels: int
    numbers: Index
    aspects: F64
    weights: F64
    angle: float

    @classmethod
    def of(cls, slc: Slc, sensor: Sensor, pixels: int, least: float = 0.35) -> Self:
        """The bins of a number of pixels of a row of an image: those with 0.35 of the largest weight, at least."""
        angle = processed_angle(sensor)
        off = column_aspects(slc, sensor, pixels)
        taper = Processing(azimuth_window=slc.azimuth_window, angle=angle)
        weights = taper.angle_weights(off, np.full(pixels, sensor.wavelength / (2 * slc.grid.col_spacing * pixels)))
        used = np.flatnonzero((weights > least * weights.max()) & (np.abs(off) <= angle / 2))
        used = used[np.argsort(off[used])]
        weights = weights[used] / np.sqrt(np.mean(weights[used] ** 2))
        return cls(pixels, used, off[used], weights, angle)

    @property
    def frequencies(self) -> F64:
        """Frequencies from -1/2 to 1/2, shape (bins,), cycles per resolution cell."""
        return self.aspects / self.angle

    @property
    def cell(self) -> float:
        """Pixels in a resolution cell."""
        spacing = (self.aspects[-1] - self.aspects[0]) / (len(self.aspects) - 1)
        return float(self.pixels * spacing / self.angle)

    @property
    def middle(self) -> int:
        """Number of the bin whose aspect is nearest to 0."""
        return int(np.abs(self.aspects).argmin())

    def nominal(self) -> Self:
        """As many bins, of the nearest of spacings 0.5 % apart, with the aspect 0 in the middle one."""
        spacing = (self.aspects[-1] - self.aspects[0]) / (len(self.aspects) - 1)
        step = 0.005
        rounded = self.angle * np.exp(step * np.rint(np.log(spacing / self.angle) / step))
        return replace(self, aspects=rounded * (np.arange(len(self.aspects)) - self.middle))

    def slowed(self, share: float) -> Self:
        """The bins of targets that pass the antenna at a fraction of its speed: their aspects are greater."""
        return replace(self, aspects=self.aspects / share, angle=self.angle / share)

    def spectra(self, pixels: C64 | C128) -> C128:
        """Spectra of pixels about the middle one without the window; noise has in each bin the power that pixels have.

        Args:
            pixels: pixels of images, shape (..., pixels).

        Returns:
            Complex128 of shape (..., bins).
        """
        turned = np.fft.fft(np.fft.ifftshift(pixels, axes=-1), axis=-1)[..., self.numbers]
        return np.asarray(turned * np.sqrt(len(self.numbers)) / (self.weights * self.pixels))

    def image(self, spectra: C128) -> C128:
        """Pixels that have these spectra, shape (..., bins), and nothing in other bins, shape (..., pixels)."""
        whole = np.zeros((*spectra.shape[:-1], self.pixels), np.complex128)
        whole[..., self.numbers] = spectra * (self.weights * self.pixels / np.sqrt(len(self.numbers)))
        return np.asarray(np.fft.fftshift(np.fft.ifft(whole, axis=-1), axes=-1))

    def amplitudes(self, beams: Beams, elevation: npt.ArrayLike, lags: F64) -> C128:
        """Amplitudes of all channels for a target with each of the lags (rad), shape (..., lags, bins, channels).

        The elevation (rad) is a number, or an array that broadcasts with (..., lags, bins).
        """
        return np.asarray(beams.response(elevation, self.aspects + lags[:, None]))


def column_aspects(slc: Slc, sensor: Sensor, pixels: int) -> F64:
    """Aspects of all bins of a number of pixels of a row in the order of `numpy.fft.fft`, as squints, rad."""
    grid = slc.grid
    middle = grid.middle
    sight = middle - aperture_at(middle, slc.aperture).position
    abeam = float(sight @ grid.col_direction / np.linalg.norm(sight))
    # A pixel's phase turns by 4 pi / wavelength per metre of range, so that its frequency is that of the line of
    # sight; around that of the body's abeam, bins are the aspects, for small angles.
    whole = sensor.wavelength / (2 * grid.col_spacing)
    off: F64 = np.asarray(np.fft.fftfreq(pixels) * whole - abeam, np.float64)
    return off - whole * np.rint(off / whole)
