"""One dwell of pulses whose beam follows a point, as a collection with the parameters that focus it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sal_height.errors import UserError
from sal_height.geometry import Origin
from sal_height.imports.collection import Collection
from sal_height.imports.receiver import boresight_to, focusing, side_of, states_towards
from sal_height.numeric import C64, F64
from sal_height.sensor import PhaseHistory, Sensor, spectrum_sensor

WIDEST_BEAM = 0.1
"""Greatest beamwidth in the sensor info, rad. Files need not state the antenna; it is as wide as pulses sample."""

STEPS_IN_ANTENNA = 2.1
"""Length of the antenna over the distance between pulses, along the track; below 2, they do not sample its beam."""

SHARE_OF_WINDOW = 0.2
"""Slant range that the beam meets on level ground, in beamwidths, over that which frequencies tell apart."""

OVERSAMPLED = 1.2
"""Resolution of the image over the spacing of its pixels."""

LARGEST_SIDE = 2000.0
"""Greatest side of the square that is imaged, m."""


@dataclass(frozen=True, eq=False)
class Pulses:
    """When and from where pulses were taken, in the axes of the map.

    Attributes:
        stamps_ns: times at which the echo from the reference point was half-way, ns since 1970, shape (pulses,).
        antenna: positions half-way between transmitter and receiver, m, shape (pulses, 3).
        velocity: the same, m/s.
        reference: points that the beam follows, m, shape (pulses, 3).
        reference_range: to which the phase of the samples refers, m, shape (pulses,).
    """

    stamps_ns: np.ndarray[Any, np.dtype[np.int64]]
    antenna: F64
    velocity: F64
    reference: F64
    reference_range: F64

    @property
    def middle(self) -> int:
        """Number of the pulse in the middle."""
        return len(self.stamps_ns) // 2

    @property
    def seconds(self) -> F64:
        """Times after the first pulse, s."""
        return np.asarray((self.stamps_ns - self.stamps_ns[0]) * 1e-9, dtype=np.float64)


def following_sensor(name: str, pulses: Pulses, fast_time: Mapping[str, Any], window: float) -> Sensor:
    """One receiver with its boresight on the reference point, seen from the middle of the track.

    Args:
        name: of the sensor.
        pulses: that it has taken.
        fast_time: fields of `Sensor` that describe the samples of a pulse: wavelength, bandwidth, sample_count and, if
            they are no frequencies, those of the waveform.
        window: slant range that the samples of a pulse tell apart, m.

    Raises:
        UserError: the pulses were taken at one time or place.
    """
    antenna, reference = pulses.antenna[pulses.middle], pulses.reference[pulses.middle]
    elevation, range_ = boresight_to(antenna, reference), float(np.linalg.norm(reference - antenna))
    steps, wavelength = len(pulses.antenna) - 1, float(fast_time["wavelength"])
    pulse_step = float(np.linalg.norm(pulses.antenna[-1] - pulses.antenna[0])) / steps
    if not (pulse_step > 0 and pulses.seconds[-1] > 0):
        raise UserError(
            f"The {steps + 1} pulses of {name} reach over {pulses.seconds[-1]:.6g} s and {steps * pulse_step:.6g} m; "
            "they must be taken one after the other on a flight."
        )
    return Sensor(
        name=name,
        look_side=side_of(antenna, pulses.velocity[pulses.middle], reference),
        pulse_count=len(pulses.antenna),
        pulse_repetition_frequency=steps / float(pulses.seconds[-1]),
        elevation_diameter=wavelength / min(SHARE_OF_WINDOW * window / (range_ * math.tan(elevation)), WIDEST_BEAM),
        azimuth_diameter=wavelength / min(wavelength / (STEPS_IN_ANTENNA * pulse_step), WIDEST_BEAM),
        pattern="sinc",
        elevation_boresights=(elevation,),
        noise_power=(0.0,),
        **fast_time,
    )


def collection_of(pulses: Pulses, samples: C64, sensor: Sensor, origin: Origin, window: float) -> Collection:
    """The collection of one dwell, with parameters that focus what the samples tell apart on the ground.

    Args:
        pulses: of the dwell.
        samples: complex64, shape (channels, pulses, samples).
        sensor: that took them.
        origin: of the map.
        window: slant range around the reference point that the samples of a pulse tell apart, m.
    """
    states = states_towards(pulses.stamps_ns, pulses.antenna, pulses.velocity, pulses.reference, sensor.look_side)
    history = PhaseHistory(int(pulses.stamps_ns[0]), pulses.seconds, pulses.reference_range, samples)
    antenna, reference = pulses.antenna[pulses.middle], pulses.reference[pulses.middle]
    slope = math.sin(boresight_to(antenna, reference))
    resolution = spectrum_sensor(sensor).range_resolution / slope
    range_ = float(np.linalg.norm(reference - antenna))
    image = focusing(sensor, pulses.antenna, range_, min(window / slope / 2, LARGEST_SIDE), resolution / OVERSAMPLED)
    return Collection(sensor, [history], states, origin, image)
