"""Odometry and sensors that are stated to be other than they are, and what becomes of images by these errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height.adjustment.drift import STATE, Stated
from sal_height.adjustment.equations import Form
from sal_height.adjustment.observed import COMMON, DELAY, OWN, ObservedDwell, Unknowns, displacement, pose
from sal_height.geometry import Mounting, PlatformState
from sal_height.numeric import F64
from sal_height.sensor import Sensor


@dataclass(frozen=True)
class Error:
    """What is stated beyond what is true."""

    unknowns: tuple[tuple[int, float], ...]
    states: Callable[[list[PlatformState]], list[PlatformState]]
    sensor: Callable[[Sensor], Sensor] = lambda sensor: sensor


def turned(states: list[PlatformState], turn: F64) -> list[PlatformState]:
    by = Rotation.from_rotvec(turn)
    return [replace(s, orientation=(by * Rotation.from_quat(s.orientation)).as_quat()) for s in states]


def mounted(sensor: Sensor, arm: F64, turn: F64) -> Sensor:
    mounting = sensor.mounting
    x, y, z, w = (mounting.axes * Rotation.from_rotvec(turn)).as_quat().tolist()
    lever_arm = tuple((np.array(mounting.lever_arm) + arm).tolist())
    return replace(sensor, mounting=Mounting("sensor", lever_arm, (x, y, z, w)), config_hash=sensor.config_hash)


def squeezed(sensor: Sensor, share: float) -> Sensor:
    boresights = np.array(sensor.elevation_boresights)
    wider = boresights.mean() + (1 + share) * (boresights - boresights.mean())
    return replace(sensor, elevation_boresights=tuple(wider.tolist()))


def drifted(states: list[PlatformState], velocity: F64) -> list[PlatformState]:
    """As navigation has it whose velocity is off, and whose position is right in the middle."""
    middle = (states[0].stamp_ns + states[-1].stamp_ns) / 2
    return [
        replace(s, velocity=s.velocity + velocity, position=s.position + (s.stamp_ns - middle) * 1e-9 * velocity)
        for s in states
    ]


def axis(number: int, size: float) -> F64:
    return size * np.eye(3)[number]


S = STATE


def layout_of(*times: float) -> Unknowns:
    """Of dwells at these times, s."""
    layout = Unknowns(100.0)
    for number, seconds in enumerate(times):
        layout.add(number, Stated(seconds, np.eye(6), np.eye(3)))
    return layout


def displaced(number: int, dwell: ObservedDwell, mounting: Mounting, layout: Unknowns) -> Form:
    return displacement(pose(number, dwell, layout, mounting), dwell)


ERRORS = {
    **{
        f"position {name}": Error(
            ((n, 0.3),), lambda states, n=n: [replace(s, position=s.position + axis(n, 0.3)) for s in states]
        )
        for n, name in enumerate("xyz")
    },
    **{
        f"velocity {name}": Error(((3 + n, 0.002),), lambda states, n=n: drifted(states, axis(n, 0.002)))
        for n, name in enumerate("xyz")
    },
    **{
        f"attitude {name}": Error(((6 + n, 5e-5),), lambda states, n=n: turned(states, axis(n, 5e-5)))
        for n, name in enumerate("xyz")
    },
    **{
        f"boresight {name}": Error(
            ((S + n, 5e-5),), lambda states: states, lambda sensor, n=n: mounted(sensor, np.zeros(3), axis(n, 5e-5))
        )
        for n, name in enumerate("xyz")
    },
    **{
        f"lever arm {name}": Error(
            ((S + 3 + n, 0.2),), lambda states: states, lambda sensor, n=n: mounted(sensor, axis(n, 0.2), np.zeros(3))
        )
        for n, name in enumerate("xyz")
    },
    "delay": Error(
        ((S + DELAY, 0.004),), lambda states: [replace(s, position=s.position - 0.004 * s.velocity) for s in states]
    ),
}


def foretold(form: Form, unknowns: tuple[tuple[int, float], ...]) -> F64:
    values = np.zeros(S + COMMON + OWN)
    for number, size in unknowns:
        values[number] = size
    return form.values @ values + form.constant
