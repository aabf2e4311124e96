"""Stripmap: the antenna is fixed to the body, and every point of the ground has the aperture in which beams pass it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams
from sal_height.geometry import look_direction
from sal_height.numeric import C64, F32, F64, Complex, Index, unit_phasors
from sal_height.sensor import Sensor, lit_angle
from sal_height.simulation._kernels import angles_in
from sal_height.simulation.echoes import for_each_group, response_of, sum_of_echoes
from sal_height.simulation.pulse_groups import PulseGroup, outermost, pulse_groups, single_pulse, smooth_group
from sal_height.simulation.scene import VisibleSurface


def mean_square_gain(beams: Beams) -> float:
    """Mean square over the processed angle of the first detector's pattern, for a target at the boresight's elevation.

    A focused pixel is the mean of its pulses. Noise has the power of a sample over their number; the cells of level
    ground have, by Parseval, that of a beam that is even over the aperture, times this gain. (A point has at its peak
    the square of the mean of the pattern instead: for the square aperture 0.07 dB less.)
    """
    nodes = (np.arange(1000) + 0.5) / 1000 - 0.5
    along = math.sin(beams.rotation) * (beams.track_beamwidth / beams.beamwidth)
    across = math.cos(beams.rotation) * (beams.track_beamwidth / beams.beamwidth_beside)
    return float(np.mean(np.abs(beams.patterns[0].amplitude(nodes * along, nodes * across)) ** 2))


def simulate_block(
    sensor: Sensor,
    surface: VisibleSurface,
    amplitudes: Complex,
    antenna: F64,
    rotation: F64,
    reference_range: F64,
    seconds: npt.ArrayLike = 0.0,
    quartic_phase: float = 0.0,
) -> C64:
    """Noise-free phase history of every detector with the antenna fixed to the body.

    A scatterer has in each pulse the weight of the direction in which the body sees it then, and weight 0 in the pulses
    of a group (`pulse_groups`) in whose middle it is more than `lit_angle`, along the flight, from where the beams meet
    the ground at the reference range (by the given positions). As in `simulate_dwell` that is the
    weight of the receiving beam, and the samples are within 1e-4 of their rms of the sum over scatterers.

    Args:
        sensor: sensor with wavelength, frequencies and beams.
        surface: scatterers, of which only the positions are used.
        amplitudes: amplitudes of the scatterers, shape (scatterers,).
        antenna: position at each pulse on a flight eastwards, m, shape (pulses, 3).
        rotation: matrix that turns body into map axes at each pulse, shape (pulses, 3, 3).
        reference_range: reference range, m, shape (pulses,).
        seconds: times of the pulses after that of the surface's positions, s; broadcasts with (pulses,).
        quartic_phase: phase of a scatterer half a beamwidth off the beams' middle along the flight, growing with the
            fourth power of that angle, rad.

    Returns:
        Complex64 samples, shape (detectors, pulses, frequencies).
    """
    seconds = np.broadcast_to(seconds, len(antenna))
    view = _View(sensor, antenna, rotation, reference_range)
    samples = np.zeros((sensor.detector_count, len(antenna), sensor.sample_count), dtype=np.complex64)
    for chosen in surface.at_rest_and_moving():
        numbers = np.arange(len(amplitudes))[chosen]
        eastwards = numbers[np.argsort(surface.positions[numbers, 0], kind="stable")]
        strengths = amplitudes.astype(np.complex64)[eastwards]
        _add_echoes(view, surface, eastwards, strengths, seconds, quartic_phase, samples)
    return samples


def _add_echoes(
    view: _View,
    surface: VisibleSurface,
    chosen: Index,
    strengths: C64,
    seconds: F64,
    quartic_phase: float,
    samples: C64,
) -> None:
    """Add the echoes of some scatterers, from west to east, that are all at rest or all move (`simulate_block`)."""
    sensor, antenna, count = view.sensor, view.antenna, len(view.antenna)
    positions, velocity = (np.take(values.T, chosen, axis=1) for values in (surface.positions, surface.velocity))
    east, at_rest = positions[0], not np.any(velocity)
    probes = outermost(positions)

    def smooth(pulses: slice) -> PulseGroup | None:
        limits = view.lit((pulses.start + pulses.stop) // 2)
        lit = np.column_stack([np.clip(probes[:, 0], *limits), probes[:, 1:]])
        return smooth_group(sensor, lit, antenna, view.beam_angles(np.mean(lit, axis=0), pulses), pulses)

    groups = pulse_groups(count, smooth) if at_rest and not quartic_phase else []

    def fill(group: PulseGroup) -> None:
        lit = slice(*np.searchsorted(east, view.lit((group.pulses.start + group.pulses.stop) // 2)))
        if lit.stop == lit.start:
            return
        there = positions[:, lit].copy()
        if not at_rest:
            there += seconds[group.pulses.start] * velocity[:, lit]

        def response(pulses: list[int]) -> F32 | C64:
            offset, squint = view.angles(there, pulses)
            seen = response_of(view.beams, offset, squint)
            if not quartic_phase:
                return seen
            phase = quartic_phase * np.square(np.square(squint[0] * (2 / sensor.beams.track_beamwidth)))
            return np.asarray(seen * unit_phasors(phase)[:, None])

        reference = view.reference_range[group.pulses]
        samples[:, group.pulses] += sum_of_echoes(sensor, there, strengths[lit], response, group, reference)

    for_each_group(fill, groups or [single_pulse(probes, antenna, pulse) for pulse in range(count)], east.size)


class _View:
    """View of the ground from a block of pulses: arguments of `simulate_block`."""

    def __init__(self, sensor: Sensor, antenna: F64, rotation: F64, reference_range: F64) -> None:
        self.sensor, self.antenna, self.reference_range = sensor, np.ascontiguousarray(antenna), reference_range
        self.beams = sensor.beams
        middle = self.beams.axis_middle
        self._boresight = rotation @ look_direction(middle, 0.0, sensor.look_side)
        outwards = rotation @ look_direction(middle + np.pi / 2, 0.0, sensor.look_side)
        self._axes = np.stack([rotation[..., 0], outwards, self._boresight], axis=1).astype(np.float64)

    def lit(self, pulse: int) -> tuple[float, float]:
        """Least and greatest x in map, m, that the pulse lights up."""
        reference = float(self.reference_range[pulse])
        reach = lit_angle(self.beams) * reference
        aim = float(self.antenna[pulse, 0] + reference * self._boresight[pulse, 0])
        return aim - reach, aim + reach

    def angles(self, positions: F64, pulses: list[int]) -> tuple[F64, F64]:
        """Elevation from the middle of the beams and squint, rad, of positions (3, n) in pulses, shape (pulses, n)."""
        elevation, squint = np.empty((2, len(pulses), positions.shape[1]))
        for number, pulse in enumerate(pulses):
            angles_in(positions, self.antenna[pulse], self._axes[pulse], elevation[number], squint[number])
        return elevation, squint

    def beam_angles(self, point: F64, pulses: slice) -> F64:
        """The same angles of one point, m, (3,), in some pulses, in beamwidths, shape (pulses, 2)."""
        sight = point - self.antenna[pulses]
        ahead, outwards, down = np.einsum("pai,pi->ap", self._axes[pulses], sight)
        angles = np.stack([np.arctan2(outwards, down), np.arctan2(ahead, np.hypot(outwards, down))], axis=-1)
        return np.asarray(angles / min(self.beams.beamwidth, self.beams.beamwidth_beside))
