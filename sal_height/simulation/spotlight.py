"""Echoes of a spotlight dwell: scene, sensor and trajectory become the phase history of every detector."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import finufft
import numpy as np
import numpy.typing as npt

from sal_height.numeric import F64, WORKERS, Complex, Index
from sal_height.sensor import NUFFT_TOLERANCE, Sensor
from sal_height.simulation.scene import VisibleSurface


def cell_power(cnr: float, sensor: Sensor, pulses: float, gain: float = 1.0) -> float:
    """Power of a resolution cell of brightness 1 so that it has the carrier-to-noise power ratio `cnr` in the image.

    That is in the unweighted image of a detector that looks straight at the cell, with a receiver right behind it: what
    a channel matrix takes or gives comes on top. Focusing divides the noise power by the number of samples.

    Args:
        cnr: power ratio.
        sensor: frequencies and noise.
        pulses: in the aperture.
        gain: of the beam over the aperture, as a power, which is made good (`stripmap.mean_square_gain`).
    """
    noise = float(np.mean(sensor.noise_power)) / (pulses * sensor.sample_count)
    return cnr * noise / gain


def draw_amplitudes(surface: VisibleSurface, cell_power: float, rng: np.random.Generator) -> Complex:
    """Complex amplitude of every scatterer: circular Gaussian (speckle), but constant for point targets."""
    speckle = (rng.standard_normal(len(surface.power)) + 1j * rng.standard_normal(len(surface.power))) / np.sqrt(2)
    return np.sqrt(surface.power * cell_power) * np.where(surface.deterministic, 1.0, speckle)


def simulate_dwell(
    sensor: Sensor,
    surface: VisibleSurface,
    amplitudes: Complex,
    antenna: F64,
    reference_range: F64,
    seconds: npt.ArrayLike = 0.0,
    pointing: npt.ArrayLike = 0.0,
) -> Complex:
    """Noise-free phase history of every detector.

    The beam is held on the scene, so that a scatterer keeps its weight in each detector's beam as long as `pointing`
    stays the same. The sum over scatterers at every frequency is a type-1 non-uniform FFT in range, one per pulse.

    Args:
        sensor: wavelength, frequencies and beams.
        surface: scatterers.
        amplitudes: of the scatterers, shape (scatterers,).
        antenna: position at each pulse, m, shape (pulses, 3).
        reference_range: m, shape (pulses,).
        seconds: times of the pulses after that of the surface's positions; broadcasts with (pulses,).
        pointing: angle by which the beams point ahead in each pulse, rad; broadcasts with (pulses,).

    Returns:
        Complex128 samples, shape (detectors, pulses, frequencies).
    """
    seconds, pointing = (np.broadcast_to(values, len(antenna)) for values in (seconds, pointing))

    samples = np.empty((sensor.detector_count, len(antenna), sensor.sample_count), dtype=np.complex128)

    def fill(part: tuple[float, Index]) -> None:
        """Simulate some pulses in which the beams point alike."""
        angle, pulses = part
        weighted = np.ascontiguousarray(sensor.beams.response(surface.elevation, surface.squint - angle).T) * amplitudes
        for pulse in pulses:
            distance = np.linalg.norm(surface.after(seconds[pulse]).positions - antenna[pulse], axis=-1)
            delay = distance - reference_range[pulse]
            strengths = weighted * np.exp(-1j * sensor.centre_wavenumber * delay)
            phase = sensor.wavenumber_step * delay
            samples[:, pulse] = finufft.nufft1d1(
                phase, strengths, sensor.sample_count, isign=-1, eps=NUFFT_TOLERANCE, nthreads=1
            )

    parts = [
        (float(angle), pulses)
        for angle in np.unique(pointing)
        for pulses in np.array_split(np.flatnonzero(pointing == angle), WORKERS)
        if pulses.size
    ]
    with ThreadPoolExecutor(WORKERS) as pool:
        list(pool.map(fill, parts))
    return samples
