"""Stripmap: the antenna is fixed to the body, and every point of the ground has the aperture in which beams pass it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import finufft
import numpy as np
import numpy.typing as npt

from sal_height.geometry import look_direction
from sal_height.optics import Pattern
from sal_height.scene import VisibleSurface
from sal_height.sensor import Sensor

Array = npt.NDArray[np.float64]
FloatArray = npt.NDArray[np.float32]
ComplexArray = npt.NDArray[np.complex64]

NUFFT_TOLERANCE = 1e-6
"""Relative error of the non-uniform FFT in single precision: less is its rounding."""

LIT_BEAMWIDTHS = 1.0
"""Ground to each side of the beam's middle, along the flight, that a pulse lights up; in beamwidths.

That is the main lobe of the square aperture. A pulse repetition frequency of 4 speed / aperture, which presets demand,
samples its Doppler; what lies beyond would appear as ambiguities.
"""


def processed_angle(sensor: Sensor) -> float:
    """Angle over which a target is processed, rad: one beamwidth, which gives a resolution of half the aperture."""
    return sensor.beamwidth


def aperture_length(sensor: Sensor, slant_range: float) -> float:
    """Length of the synthetic aperture of a target at `slant_range` (m), m."""
    return processed_angle(sensor) * slant_range


def mean_square_gain(pattern: Pattern) -> float:
    """Mean square over the processed angle of the pattern in azimuth, for a target at the boresight's elevation.

    A focused pixel is the mean of its pulses. Noise has the power of a sample over their number; the cells of level
    ground have, by Parseval, that of a beam that is even over the aperture, times this gain. (A point has at its peak
    the square of the mean of the pattern instead: for the square aperture 0.07 dB less.)
    """
    nodes = (np.arange(1000) + 0.5) / 1000 - 0.5
    return float(np.mean(pattern.amplitude(0.0, nodes) ** 2))


def cell_power(cnr: float, sensor: Sensor, slant_range: float, speed: float) -> float:
    """Power of a resolution cell of brightness 1 so that it has the carrier-to-noise ratio `cnr` in the image.

    In the image of a detector that looks straight at its elevation, processed over one beamwidth without weights. The
    pulses of the aperture, as many as are sent on its length, share the noise; the beam's gain over them is made good.

    Args:
        cnr: power ratio.
        sensor: beams, noise and pulse repetition frequency.
        slant_range: m.
        speed: of the platform, m/s.
    """
    pulses = aperture_length(sensor, slant_range) * sensor.pulse_repetition_frequency / speed
    noise = float(np.mean(sensor.noise_power)) / (pulses * sensor.sample_count)
    return cnr * noise / mean_square_gain(sensor.beams.pattern)


def simulate_block(
    sensor: Sensor,
    surface: VisibleSurface,
    amplitudes: npt.NDArray[np.complexfloating],
    antenna: Array,
    rotation: Array,
    reference_range: Array,
) -> ComplexArray:
    """Noise-free phase history of every detector with the antenna fixed to the body.

    A scatterer has in each pulse the weight of the direction in which the body sees it then, and none when it is more
    than LIT_BEAMWIDTHS, along the flight, from where the beams meet the ground at the reference range. As in
    `simulate_dwell` that is the weight of the receiving beam, and the sum a non-uniform FFT in range, one per pulse.

    Angles are measured from the middle of the beams, and phases reduced to a turn, in float64; what follows is float32,
    which has as many digits as the samples need, and is several times faster.

    Args:
        sensor: wavelength, frequencies and beams.
        surface: scatterers; where they are, not how they were seen.
        amplitudes: of the scatterers, shape (scatterers,).
        antenna: position at each pulse on a flight eastwards, m, shape (pulses, 3).
        rotation: matrix that turns body into map axes at each pulse, shape (pulses, 3, 3).
        reference_range: m, shape (pulses,).

    Returns:
        Complex64 samples, shape (detectors, pulses, frequencies).
    """
    order = np.argsort(surface.positions[:, 0], kind="stable")
    positions, strengths = surface.positions[order], amplitudes[order].astype(np.complex64)
    east = positions[:, 0].copy()
    middle = float(np.mean(sensor.beams.span))
    boresights = (sensor.beams.boresights - middle).astype(np.float32)
    boresight = look_direction(middle, 0.0, sensor.look_side)
    outwards = look_direction(middle + np.pi / 2, 0.0, sensor.look_side)
    axes = np.stack([np.array([1.0, 0.0, 0.0]), outwards, boresight], axis=-1)

    def pulse_samples(position: Array, rotation: Array, reference: float) -> ComplexArray:
        reach = LIT_BEAMWIDTHS * sensor.beamwidth * reference
        aim = position[0] + reference * (rotation @ boresight)[0]
        lit = slice(*np.searchsorted(east, (aim - reach, aim + reach)))
        if lit.start == lit.stop:
            return np.zeros((sensor.detector_count, sensor.sample_count), dtype=np.complex64)
        sight = (positions[lit] - position) @ (rotation @ axes)
        distance = np.sqrt(np.einsum("si,si->s", sight, sight))
        delay = distance - reference
        elevation = np.arctan2(sight[:, 1].astype(np.float32), sight[:, 2].astype(np.float32))
        squint = np.arcsin((sight[:, 0] / distance).astype(np.float32))
        response = _response(sensor, elevation - boresights[:, None], squint)
        weighted = response * (strengths[lit] * _phasors(delay * (sensor.centre_wavenumber / (2 * np.pi))))
        phase = (sensor.wavenumber_step * delay).astype(np.float32)
        return np.asarray(
            finufft.nufft1d1(phase, weighted, sensor.sample_count, isign=-1, eps=NUFFT_TOLERANCE, nthreads=1)
        )

    with ThreadPoolExecutor() as pool:
        pulses = list(pool.map(pulse_samples, antenna, rotation, reference_range))
    return np.stack(pulses, axis=1)


def _response(sensor: Sensor, elevation: FloatArray, squint: FloatArray) -> FloatArray:
    """Amplitude pattern at angles (rad) from each boresight, in float32."""
    beamwidth = np.float32(sensor.beamwidth)
    return sensor.beams.pattern.amplitude(elevation / beamwidth, squint / beamwidth).astype(np.float32)


def _phasors(turns: Array) -> ComplexArray:
    """exp(-2 pi j turns)."""
    angle = (-2 * np.pi * (turns - np.rint(turns))).astype(np.float32)
    result = np.empty(len(turns), dtype=np.complex64)
    result.real, result.imag = np.cos(angle), np.sin(angle)
    return result
