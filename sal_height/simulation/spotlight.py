"""Echoes of a spotlight dwell: scene, sensor and trajectory become the phase history of every detector."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from sal_height.numeric import C64, F32, F64, Complex, Index
from sal_height.sensor import Sensor
from sal_height.simulation.echoes import for_each_group, response_of, sum_of_echoes
from sal_height.simulation.pulse_groups import PulseGroup, outermost, pulse_groups, single_pulse, smooth_group
from sal_height.simulation.scene import VisibleSurface


def cell_power(cnr: float, sensor: Sensor, pulses: float, gain: float = 1.0) -> float:
    """Power of a resolution cell of brightness 1 so that it has the carrier-to-noise power ratio `cnr` in the image.

    That is in the unweighted image of a detector that looks straight at the cell, with a receiver right behind it: the
    gain of a channel matrix is additional. Focusing divides the noise power by the number of samples.

    Args:
        cnr: power ratio.
        sensor: sensor with frequencies and noise.
        pulses: number of pulses in the aperture.
        gain: power gain of the beam over the aperture, which is compensated (`stripmap.mean_square_gain`).
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
    ahead: npt.ArrayLike = 0.0,
    off_nadir: npt.ArrayLike = 0.0,
) -> C64:
    """Noise-free phase history of every detector.

    The beam follows the scene, so that a scatterer keeps its weight in each detector's beam as long as `ahead` and
    `off_nadir` stay the same. The samples are within 1e-4 of their rms of the sum over scatterers (`echoes`).

    Args:
        sensor: sensor with wavelength, frequencies and beams.
        surface: scatterers.
        amplitudes: amplitudes of the scatterers, shape (scatterers,).
        antenna: position at each pulse, m, shape (pulses, 3).
        reference_range: reference range, m, shape (pulses,).
        seconds: times of the pulses after that of the surface's positions, s; broadcasts with (pulses,).
        ahead: angle by which the beams point ahead in each pulse, rad; broadcasts with (pulses,).
        off_nadir: angle by which they point farther off nadir, rad; broadcasts with (pulses,).

    Returns:
        Complex64 samples, shape (detectors, pulses, frequencies).
    """
    seconds, *angles = (np.broadcast_to(values, len(antenna)) for values in (seconds, ahead, off_nadir))
    pointing = np.stack(angles, axis=-1)
    samples = np.zeros((sensor.detector_count, len(antenna), sensor.sample_count), dtype=np.complex64)
    turned = (pointing - pointing[0]) / (sensor.beams.track_beamwidth, sensor.beams.beamwidth)

    def beams_in(pulses: Index | list[int] | slice) -> tuple[tuple[float, float], ...]:
        """Angles of the beams in some pulses, as a key."""
        return tuple(map(tuple, pointing[pulses].tolist()))

    def add(chosen: Index | slice) -> None:
        """Add the echoes of scatterers that are all at rest, or all move: these are located again in every pulse."""
        offset, squint = surface.elevation[chosen] - sensor.beams.axis_middle, surface.squint[chosen]
        positions, velocity = (np.ascontiguousarray(v[chosen].T) for v in (surface.positions, surface.velocity))
        strengths, at_rest = amplitudes[chosen].astype(np.complex64), not np.any(velocity)

        @lru_cache(maxsize=1)
        def at(angles: tuple[tuple[float, float], ...]) -> F32 | C64:
            ahead, off_nadir = np.array(angles).T[..., None]
            return response_of(sensor.beams, offset - off_nadir, squint - ahead)

        probes, count = outermost(positions), len(antenna)

        def smooth(pulses: slice) -> PulseGroup | None:
            return smooth_group(sensor, probes, antenna, turned[pulses], pulses)

        groups = pulse_groups(count, smooth) if at_rest else []
        at(beams_in(slice(1)))  # once, not in every thread

        def fill(group: PulseGroup) -> None:
            there = positions if at_rest else positions + seconds[group.pulses.start] * velocity
            reference = reference_range[group.pulses]
            samples[:, group.pulses] += sum_of_echoes(
                sensor, there, strengths, lambda pulses: at(beams_in(pulses)), group, reference
            )

        for_each_group(fill, groups or [single_pulse(probes, antenna, pulse) for pulse in range(count)], offset.size)

    for chosen in surface.at_rest_and_moving():
        add(chosen)
    return samples
