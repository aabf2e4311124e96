"""A synthetic tape: images of an imperfect SAR with known transfer functions, for tests of the calibration.

The image is speckle and point targets (PSF paper, eq. 2.9), filtered by a range and an azimuth response (eq. 2.10). All
frequencies are in cycles per pixel, from -1/2 up; responses over N frequencies begin with -1/2, as `numpy.fft.fftshift`
puts them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from sal_height.numeric import C64, C128, F64, frequencies
from sal_height.simulation import RangeSawtooth, RangeTaper


@dataclass(frozen=True)
class RangeFault:
    """A range response: a Taylor-weighted band with a sawtooth on it.

    Attributes:
        support: fraction of the frequencies in the band, in their middle.
        sidelobe_db: level of the Taylor weights' sidelobes, of which 4 on each side fall off little, dB.
        sawtooth: depth of the sawtooth, over the amplitude.
        teeth: number of teeth of the sawtooth in all frequencies, and distance of its echoes from the target, pixels.
    """

    support: float = 28 / 64
    sidelobe_db: float = 35.0
    sawtooth: float = 0.1
    teeth: float = 16.0

    def response(self, count: int) -> C128:
        """Response at `count` frequencies from -1/2 cycles per pixel, shape (count,)."""
        frequency = frequencies(count)
        taper = RangeTaper(self.sidelobe_db, self.support).response(frequency)
        return np.asarray(taper * RangeSawtooth(self.sawtooth, self.teeth).response(frequency), dtype=np.complex128)


@dataclass(frozen=True)
class AzimuthFault:
    """An azimuth response: the real beam over the full band, a quartic phase at its edges, and a swinging antenna.

    Attributes:
        taper: exponent of the beam's cosine over the band.
        quartic: phase at the edges of the band, rad.
        swing: greatest displacement of the beam by the swing of the antenna, over the band.
        swing_period: period of the swing, columns.
    """

    taper: float = 1.0
    quartic: float = 0.0
    swing: float = 0.0
    swing_period: float = 2048.0

    def pointing(self, columns: npt.ArrayLike) -> F64:
        """Displacement of the beam at columns, cycles per pixel."""
        return self.swing * np.sin(2 * np.pi * np.asarray(columns, dtype=np.float64) / self.swing_period)

    def response(self, count: int, pointing: float = 0.0) -> C128:
        """Response at `count` frequencies from -1/2 cycles per pixel, the beam displaced by `pointing`, (count,)."""
        frequency = frequencies(count)
        beam = np.abs(np.cos(np.pi * (frequency - pointing))) ** self.taper
        return beam * np.exp(1j * self.quartic * (2 * frequency) ** 4)


@dataclass(frozen=True)
class Saturation:
    """A limiter between pulse compression and the synthetic aperture, where a bright target is still short in range.

    Attributes:
        level: greatest amplitude, over the rms of the signal there.
        aperture: number of columns over which a target is spread before azimuth compression.
    """

    level: float
    aperture: float = 32.0


@dataclass(frozen=True)
class TapeTarget:
    """A point target: position in pixels, with fractions, and power at its peak over the mean of the speckle."""

    row: float
    col: float
    over_clutter_db: float


def make_tape(
    shape: tuple[int, int],
    rng: np.random.Generator,
    targets: tuple[TapeTarget, ...] = (),
    range_fault: RangeFault | None = None,
    azimuth_fault: AzimuthFault | None = None,
    noise: float = 0.0,
    nyquist_spur: float = 0.0,
    saturation: Saturation | None = None,
    noise_response: F64 | None = None,
) -> C64:
    """An image of range rows and azimuth columns; speckle has the mean power 1, and phases of targets are random.

    Args:
        shape: rows and columns.
        rng: random numbers of speckle, noise and the targets' phases.
        targets: point targets in the speckle.
        range_fault: range response; None: a flat band.
        azimuth_fault: azimuth response; None: a flat band.
        noise: rms of the noise, over that of the speckle.
        nyquist_spur: amplitude of a wave of half a cycle per row, over the rms of the speckle.
        saturation: saturation of the system; None: it is linear.
        noise_response: weights of the processor that the noise has passed, at `rows` frequencies from -1/2 cycles per
            pixel; None: it is white.

    Returns:
        complex64, shape `shape`.
    """
    rows, cols = shape
    range_response = range_fault.response(rows) if range_fault else np.ones(rows)
    beam = azimuth_fault or AzimuthFault(taper=0.0)
    spectrum = _scene_spectrum(shape, rng, targets, range_response, beam.response(cols))
    if saturation:
        spectrum = _limited(spectrum, saturation)
    image = _through_beam(spectrum, beam)
    image += noise * _noise(shape, rng, noise_response)
    if nyquist_spur:
        image += nyquist_spur * np.exp(1j * (np.pi * np.arange(rows) + rng.uniform(0, 2 * np.pi)))[:, None]
    return image.astype(np.complex64)


def _scene_spectrum(
    shape: tuple[int, int],
    rng: np.random.Generator,
    targets: tuple[TapeTarget, ...],
    range_response: C128 | F64,
    azimuth_response: C128,
) -> C128:
    """Two-dimensional spectrum of the scene behind the range response; scaled for a speckle power of 1 in the image."""
    rows, cols = shape
    gain = np.sqrt(np.mean(np.abs(range_response) ** 2) * np.mean(np.abs(azimuth_response) ** 2))
    peak = np.mean(np.abs(range_response)) * np.mean(np.abs(azimuth_response)) / gain
    spectrum = scipy.fft.fftshift(scipy.fft.fft2(_circular(shape, rng)))
    for target in targets:
        amplitude = 10 ** (target.over_clutter_db / 20) / peak * np.exp(2j * np.pi * rng.uniform())
        down = np.exp(-2j * np.pi * frequencies(rows) * target.row)
        across = np.exp(-2j * np.pi * frequencies(cols) * target.col)
        spectrum += amplitude * down[:, None] * across
    return spectrum * (range_response / gain)[:, None]


def _limited(spectrum: C128, saturation: Saturation) -> C128:
    """The spectrum of a scene whose amplitude is limited while targets are spread along the flight."""
    spread = np.exp(1j * np.pi * saturation.aperture * frequencies(spectrum.shape[1]) ** 2)
    signal = scipy.fft.ifft2(scipy.fft.ifftshift(spectrum * spread))
    amplitude = np.abs(signal)
    level = saturation.level * np.sqrt(np.mean(amplitude**2))
    signal *= np.minimum(1.0, level / np.maximum(amplitude, level))
    return scipy.fft.fftshift(scipy.fft.fft2(signal)) / spread


def _through_beam(spectrum: C128, beam: AzimuthFault) -> C128:
    """The image through the beam, with its pointing at each column."""
    rows, cols = spectrum.shape
    if not beam.swing:
        return scipy.fft.ifft2(scipy.fft.ifftshift(spectrum * beam.response(cols)))
    # The response is interpolated between 16 pointings per period of the swing.
    count = max(2, int(np.ceil(16 * cols / beam.swing_period)) + 1)
    knots = np.linspace(0, cols - 1, count)
    image = np.zeros((rows, cols), dtype=np.complex128)
    for knot in knots:
        weight = np.interp(np.arange(cols), knots, (knots == knot).astype(float))
        response = beam.response(cols, float(beam.pointing(knot)))
        image += weight * scipy.fft.ifft2(scipy.fft.ifftshift(spectrum * response))
    return image


def _noise(shape: tuple[int, int], rng: np.random.Generator, response: F64 | None) -> C128:
    """Noise of mean power 1 behind a range response, white along azimuth."""
    white = _circular(shape, rng)
    if response is None:
        return white
    weights = scipy.fft.ifftshift(response / np.sqrt(np.mean(response**2)))
    return np.asarray(scipy.fft.ifft(scipy.fft.fft(white, axis=0) * weights[:, None], axis=0))


def _circular(shape: tuple[int, int], rng: np.random.Generator) -> C128:
    """Circular Gaussian numbers of mean power 1."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
