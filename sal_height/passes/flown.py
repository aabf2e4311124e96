"""The phase history of one pass, flown or simulated, and the choice of passes that can be processed together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.constants import speed_of_light

from sal_height.errors import UserError
from sal_height.numeric import C128, F64, ShortRepr
from sal_height.sensor import PhaseHistory, Sensor

LEAST_PASSES = 3
"""Least number of passes: two determine amplitude, phase and height of a point, and cannot show a wrong phase."""


@dataclass(frozen=True, eq=False)
class Pass(ShortRepr):
    """Data of one receiver on one pass.

    Attributes:
        name: name for users.
        sensor: sensor with waveform "spectrum" and one channel.
        history: phase history of the pulses, shape (1, pulses, frequencies).
        antenna: position at each pulse in map, shape (pulses, 3), m.
    """

    name: str
    sensor: Sensor
    history: PhaseHistory
    antenna: F64

    @property
    def wavenumber(self) -> float:
        """Two-way wavenumber of the middle of the band, rad/m."""
        return 4 * np.pi / self.sensor.wavelength

    @property
    def flight(self) -> F64:
        """Vector from the first pulse to the last, m, shape (3,)."""
        return np.asarray(self.antenna[-1] - self.antenna[0])

    def azimuths(self, centre: F64) -> F64:
        """Azimuth of the antenna seen from a point, rad from the middle pulse of the pass, shape (pulses,)."""
        angle = self.bearing(centre, self.antenna)
        return np.asarray((angle - angle[len(angle) // 2] + np.pi) % (2 * np.pi) - np.pi)

    @staticmethod
    def bearing(centre: F64, antenna: F64) -> F64:
        """Angle of antennas from east about a point, rad, shape of `antenna` without its last axis."""
        return np.asarray(np.arctan2(antenna[..., 1] - centre[1], antenna[..., 0] - centre[0]))

    def moved(self, offset: F64) -> Self:
        """The pass with its antenna moved by `offset` (m, shape (3,))."""
        return replace(self, antenna=self.antenna + offset)

    def of_pulses(self, which: slice) -> Self:
        """The pass with some of its pulses."""
        return replace(self, history=self.history.pulses(which), antenna=self.antenna[which])


def together(passes: Sequence[Pass], centre: F64) -> tuple[tuple[Pass, ...], tuple[str, ...]]:
    """Choose the passes that see the same ground in the same band and from the same azimuths, and cut them alike.

    Bands are compared with their median, azimuths with the medians of both ends.

    Args:
        passes: passes in any order.
        centre: centre of the scene in map, shape (3,), m.

    Returns:
        The passes, cut to the azimuths that all have; and a warning about each pass that was left out.

    Raises:
        UserError: fewer than LEAST_PASSES are left.
    """
    if len(passes) < LEAST_PASSES:
        given = "1 pass was" if len(passes) == 1 else f"{len(passes)} passes were"
        raise UserError(
            f"{given} given; heights need {LEAST_PASSES} or more, as two leave nothing that could show a wrong phase "
            "between them."
        )
    refused: list[str] = []
    kept: Sequence[Pass] = passes
    for check in (_check_receiver, _check_band, _check_ground, _check_azimuths):
        reasons = check(kept, centre)
        refused += [f"Pass {one.name} is left out: {why}" for one, why in zip(kept, reasons, strict=True) if why]
        kept = [one for one, why in zip(kept, reasons, strict=True) if not why]
        if len(kept) < LEAST_PASSES:
            raise UserError(f"Of {len(passes)} passes {len(kept)} can be used; {LEAST_PASSES} are needed. {refused[0]}")
    first, last = _common_azimuths(kept, centre)
    return tuple(_cut(one, centre, first, last) for one in kept), tuple(refused)


def _check_receiver(passes: Sequence[Pass], _centre: F64) -> list[str]:
    reasons = []
    for one in passes:
        why = ""
        if one.sensor.mode != "spotlight" or one.sensor.waveform != "spectrum":
            why = f"mode {one.sensor.mode} and waveform {one.sensor.waveform} are not spotlight and spectrum."
        elif one.sensor.detector_count > 1:
            why = f"it has {one.sensor.detector_count} channels; a pass must have one."
        reasons.append(why)
    return reasons


def _check_band(passes: Sequence[Pass], _centre: F64) -> list[str]:
    middle = np.array([one.wavenumber for one in passes])
    width = np.array([one.sensor.wavenumber_step * one.sensor.sample_count for one in passes])
    usual, wide = float(np.median(middle)), float(np.median(width))
    band_share = 0.1  # largest difference of middle frequency and of bandwidth between passes, over the bandwidth
    other = (np.abs(middle - usual) > band_share * wide) | (np.abs(width - wide) > band_share * wide)
    return [
        f"its wavelength is {one.sensor.wavelength:.6g} m and its bandwidth {one.sensor.bandwidth:.4g} Hz; those of "
        f"most passes are {4 * np.pi / usual:.6g} m and {one.sensor.bandwidth * wide / own:.4g} Hz."
        if differs
        else ""
        for one, own, differs in zip(passes, width, other, strict=True)
    ]


def _check_ground(passes: Sequence[Pass], centre: F64) -> list[str]:
    off = [
        float(np.abs(np.linalg.norm(one.antenna - centre, axis=-1) - one.history.reference_range).max())
        for one in passes
    ]
    return [
        f"the middle of the scene is {by:.4g} m off the range that it has recorded; its range window reaches over "
        f"{one.sensor.range_window / 2:.4g} m."
        if by > one.sensor.range_window / 2
        else ""
        for one, by in zip(passes, off, strict=True)
    ]


def _intervals(passes: Sequence[Pass], centre: F64) -> F64:
    """First and last azimuth of each pass, rad from that of the middle of the first pass, shape (passes, 2)."""
    start = Pass.bearing(centre, passes[0].antenna[len(passes[0].antenna) // 2])
    ends = []
    for one in passes:
        own = one.azimuths(centre)
        middle = Pass.bearing(centre, one.antenna[len(own) // 2]) - start
        middle = (middle + np.pi) % (2 * np.pi) - np.pi
        ends.append([middle + own.min(), middle + own.max()])
    return np.array(ends)


def _check_azimuths(passes: Sequence[Pass], centre: F64) -> list[str]:
    ends = _intervals(passes, centre)
    first, last = np.median(ends, axis=0)
    common = np.minimum(ends[:, 1], last) - np.maximum(ends[:, 0], first)
    least_overlap = 0.5  # least fraction of the azimuths of a pass that all passes must have
    apart = common < least_overlap * np.maximum(ends[:, 1] - ends[:, 0], last - first)
    # All must have half of them in common: those whose ends differ most from the median are left out until they have.
    short = np.maximum(ends[:, 0] - first, last - ends[:, 1])
    while not apart.all() and ends[~apart, 1].min() - ends[~apart, 0].max() < least_overlap * (last - first):
        apart[np.argmax(np.where(apart, -np.inf, short))] = True
    return [
        f"it sees the scene from azimuths of {np.degrees(low):.3g} to {np.degrees(high):.3g} degrees from the first "
        f"pass, most passes from {np.degrees(first):.3g} to {np.degrees(last):.3g}; all must have half of these in "
        "common."
        if alone
        else ""
        for (low, high), alone in zip(ends, apart, strict=True)
    ]


def _common_azimuths(passes: Sequence[Pass], centre: F64) -> tuple[float, float]:
    """The azimuths that all passes have, as bearings from the first pass's middle."""
    ends = _intervals(passes, centre)
    start = float(Pass.bearing(centre, passes[0].antenna[len(passes[0].antenna) // 2]))
    return start + float(ends[:, 0].max()), start + float(ends[:, 1].min())


def _cut(one: Pass, centre: F64, first: float, last: float) -> Pass:
    middle = (first + last) / 2
    angle = (Pass.bearing(centre, one.antenna) - middle + np.pi) % (2 * np.pi) - np.pi
    inside = np.flatnonzero(np.abs(angle) <= (last - first) / 2 + 1e-9)
    return one.of_pulses(slice(int(inside[0]), int(inside[-1]) + 1))


GOTCHA_ELEVATIONS = tuple(np.radians([45.66, 44.01, 43.92, 44.18, 44.14, 43.53, 43.01, 43.06]).tolist())
"""Elevation angles of the eight passes of AFRL's Gotcha set over the horizon, rad, as published with it."""


@dataclass(frozen=True)
class Circle:
    """Passes on arcs of circles around the middle of the scene, which is the origin of map.

    Attributes:
        elevations: elevations over the horizon under which each pass is seen from there, rad.
        distance: distance from there, m.
        arc: azimuths of a pass, rad.
        pulses: number of pulses of a pass.
        frequencies: number of frequencies of a pulse.
        frequency: middle of the band, Hz.
        bandwidth: bandwidth, Hz.
        speed: speed of flight, m/s.
    """

    elevations: Sequence[float] = GOTCHA_ELEVATIONS
    distance: float = 10e3
    arc: float = np.radians(3.0)
    pulses: int = 100
    frequencies: int = 192
    frequency: float = 9.6e9
    bandwidth: float = 640e6
    speed: float = 100.0

    def antenna(self, number: int) -> F64:
        """Positions of the antenna on a pass, m, shape (pulses, 3)."""
        azimuth = self.arc * np.linspace(-0.5, 0.5, self.pulses)
        elevation = self.elevations[number]
        level = self.distance * np.cos(elevation)
        height = np.full(self.pulses, self.distance * np.sin(elevation))
        return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], axis=-1)

    def seconds(self, number: int) -> F64:
        """Times of the pulses of a pass after the first one, s."""
        reach = self.arc * self.distance * np.cos(self.elevations[number])
        return np.linspace(0.0, reach / self.speed, self.pulses)

    def sensor(self, number: int, noise_power: float) -> Sensor:
        """The sensor of a pass: one receiver, whose beam is so wide that pulses sample it."""
        wavelength = speed_of_light / self.frequency
        step = self.arc * self.distance * np.cos(self.elevations[number]) / (self.pulses - 1)
        return Sensor(
            name=f"pass_{number + 1}",
            look_side=-1,
            wavelength=wavelength,
            bandwidth=self.bandwidth,
            sample_count=self.frequencies,
            pulse_count=self.pulses,
            pulse_repetition_frequency=self.speed / step,
            elevation_diameter=2.1 * step,
            azimuth_diameter=2.1 * step,
            pattern="sinc",
            elevation_boresights=(np.pi / 2 - self.elevations[number],),
            noise_power=(noise_power,),
        )


def simulated_passes(
    circle: Circle,
    points: F64,
    amplitudes: C128,
    noise_power: float,
    rng: np.random.Generator,
    phases: F64 | None = None,
    offsets: F64 | None = None,
) -> list[Pass]:
    """Passes over point reflectors in noise.

    Args:
        circle: arcs of the passes.
        points: positions of the reflectors in map, shape (points, 3), m.
        amplitudes: amplitudes of the points in a sample, shape (points,), or (passes, points).
        noise_power: power of the noise of a sample, E|n|^2.
        rng: generator of the noise.
        phases: phases of the passes, (passes,), None: 0, rad.
        offsets: offsets of the antennas from their stated positions, shape (passes, 3), None: 0, m.
    """
    count = len(circle.elevations)
    each = np.broadcast_to(amplitudes, (count, len(points)))
    turns = np.zeros(count) if phases is None else phases
    off = np.zeros((count, 3)) if offsets is None else offsets
    passes = []
    for number in range(count):
        stated = circle.antenna(number)
        sensor = circle.sensor(number, noise_power)
        reference = np.linalg.norm(stated, axis=-1)
        samples = _echoes(sensor, stated + off[number], reference, points, each[number] * np.exp(1j * turns[number]))
        noise = rng.standard_normal((*samples.shape, 2)) @ np.array([1.0, 1j])
        samples = samples + np.sqrt(noise_power / 2) * noise
        history = PhaseHistory(0, circle.seconds(number), reference, samples[None].astype(np.complex64))
        passes.append(Pass(sensor.name, sensor, history, stated))
    return passes


def _echoes(sensor: Sensor, antenna: F64, reference: F64, points: F64, amplitudes: C128) -> C128:
    """Echoes of points, shape (pulses, frequencies)."""
    number = np.arange(sensor.sample_count) - (sensor.sample_count - 1) / 2
    echoes = np.zeros((len(antenna), sensor.sample_count), np.complex128)
    middle, step = 4 * np.pi / sensor.wavelength, sensor.wavenumber_step
    for point, amplitude in zip(points, amplitudes, strict=True):
        longer = np.linalg.norm(antenna - point, axis=-1) - reference
        first = np.exp(-1j * (middle + number[0] * step) * longer)
        # The phase grows evenly from frequency to frequency.
        turned = np.exp(-1j * step * np.multiply.outer(longer, np.arange(sensor.sample_count)))
        echoes += amplitude * first[:, None] * turned
    return echoes
