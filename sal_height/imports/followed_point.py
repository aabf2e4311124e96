"""One dwell of a single receiver whose beam follows a point, read from files that state no antenna."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.errors import UserError
from sal_height.geometry import Origin, PlatformState
from sal_height.imports.collection import Collection
from sal_height.numeric import C64, F64, I64
from sal_height.sensor import PhaseHistory, Sensor, spectrum_sensor

WIDEST_BEAM = 0.1
"""Greatest beamwidth in the sensor info, rad. Files need not state the antenna; it is as wide as pulses sample."""

MOST_PIXELS = 4095
"""Greatest number of rows and columns of an image."""


@dataclass(frozen=True, eq=False)
class Pulses:
    """Times and antenna positions of pulses, in the axes of the map.

    Attributes:
        stamps_ns: times at which the echo from the reference point was half-way, ns since 1970, shape (pulses,).
        antenna: positions half-way between transmitter and receiver, m, shape (pulses, 3).
        velocity: velocities of these positions, m/s, shape (pulses, 3).
        reference: points that the beam follows, m, shape (pulses, 3).
        reference_range: range to which the phase of the samples refers, m, shape (pulses,).
    """

    stamps_ns: I64
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
        name: name of the sensor.
        pulses: pulses of the sensor.
        fast_time: fields of `Sensor` that describe the samples of a pulse: wavelength, bandwidth, sample_count and, if
            they are no frequencies, those of the waveform.
        window: slant range that the samples of a pulse cover, m.

    Raises:
        UserError: the pulses have one time or position.
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
    # Length of the antenna over the distance between pulses, along the track; below 2, they do not sample its
    # beam.
    steps_in_antenna = 2.1
    # Slant range that the beam meets on level ground, in beamwidths, over that which the samples cover.
    share_of_window = 0.2
    return Sensor(
        name=name,
        look_side=side_of(antenna, pulses.velocity[pulses.middle], reference),
        pulse_count=len(pulses.antenna),
        pulse_repetition_frequency=steps / float(pulses.seconds[-1]),
        elevation_diameter=wavelength / min(share_of_window * window / (range_ * math.tan(elevation)), WIDEST_BEAM),
        azimuth_diameter=wavelength / min(wavelength / (steps_in_antenna * pulse_step), WIDEST_BEAM),
        pattern="sinc",
        elevation_boresights=(elevation,),
        noise_power=(0.0,),
        **fast_time,
    )


def collection_of(pulses: Pulses, samples: C64, sensor: Sensor, origin: Origin, window: float, air: str) -> Collection:
    """The collection of one dwell, with parameters that focus the swath that the samples cover.

    Args:
        pulses: pulses of the dwell.
        samples: samples of the dwell, complex64, shape (channels, pulses, samples).
        sensor: sensor of the dwell.
        origin: origin of the map.
        window: slant range around the reference point that the samples of a pulse cover, m.
        air: air in the ranges, as the parameter of the compression.
    """
    states = states_towards(pulses.stamps_ns, pulses.antenna, pulses.velocity, pulses.reference, sensor.look_side)
    history = PhaseHistory(int(pulses.stamps_ns[0]), pulses.seconds, pulses.reference_range, samples)
    antenna, reference = pulses.antenna[pulses.middle], pulses.reference[pulses.middle]
    slope = math.sin(boresight_to(antenna, reference))
    resolution = spectrum_sensor(sensor).range_resolution / slope
    range_ = float(np.linalg.norm(reference - antenna))
    oversampled = 1.2  # resolution of the image over the spacing of its pixels
    largest_side = 2000.0  # greatest side of the square that is imaged, m
    image = focusing(
        sensor, pulses.antenna, range_, min(window / slope / 2, largest_side), resolution / oversampled, air
    )
    return Collection(sensor, [history], states, origin, image)


def side_of(antenna: F64, velocity: F64, point: F64) -> int:
    """The side of a point: +1 right of the flight, -1 left; all of shape (3,), in map."""
    return -1 if np.cross(velocity, point - antenna)[2] > 0 else 1


def boresight_to(antenna: F64, point: F64) -> float:
    """Angle of a point from the nadir of an antenna, rad; both in map, m, shape (3,)."""
    east, north, up = point - antenna
    return float(np.arctan2(np.hypot(east, north), -up))


def states_towards(stamps_ns: I64, antenna: F64, velocity: F64, points: F64, look_side: int) -> list[PlatformState]:
    """Level states whose side is turned to a point.

    Args:
        stamps_ns: times, ns since 1970, shape (n,).
        antenna: positions in map, m, shape (n, 3).
        velocity: velocities in map, m/s, shape (n, 3).
        points: points that the beam follows, in map, m, shape (n, 3) or (3,).
        look_side: side of the points, +1 right, -1 left.
    """
    east, north, _ = np.moveaxis(points - antenna, -1, 0)
    yaw = np.arctan2(north, east) + look_side * np.pi / 2
    orientation = Rotation.from_euler("z", yaw[:, None]).as_quat()
    return [
        PlatformState(int(stamp), position, attitude, speed, np.zeros((6, 6)))
        for stamp, position, attitude, speed in zip(stamps_ns, antenna, orientation, velocity, strict=True)
    ]


def focusing(
    sensor: Sensor, antenna: F64, range_: float, side_m: float, widest_m: float, air: str
) -> dict[str, dict[str, Any]]:
    """Parameters that focus a square of level ground on pixels no farther apart than the aperture resolves.

    The resolution along the flight is wavelength * range / (2 * aperture length).

    Args:
        sensor: sensor, of which the wavelength is used.
        antenna: positions at the pulses, m, shape (pulses, 3).
        range_: slant range of the middle, m.
        side_m: side of the square, m; reduced where it needs more than MOST_PIXELS pixels.
        widest_m: greatest spacing of pixels, m.
        air: air in the ranges, as the parameter of the compression; those to a point that pulses are referred to may
            contain its delay or not.
    """
    length = float(np.linalg.norm(np.diff(antenna, axis=0), axis=-1).sum())
    spacing = min(widest_m, sensor.wavelength * range_ / (2 * length))
    pixels = min(2 * round(side_m / 2 / spacing) + 1, MOST_PIXELS)
    image = {"air": air, "image_plane": "ground", "rows": pixels, "cols": pixels, "ground_spacing_m": spacing}
    return {"sar_compression": image | {"range_window": "rectangular", "azimuth_window": "rectangular"}}
