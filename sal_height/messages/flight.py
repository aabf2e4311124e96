"""Messages of the sensor and the platform of a simulated flight, in the order in which they are published."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from sal_height.engine.frames import MAP_FRAME
from sal_height.messages.basics import to_stamp
from sal_height.messages.frames import history_to_messages, state_to_message
from sal_height.messages.navigation import air_to_messages, origin_to_message
from sal_height.messages.sensors import sensor_to_message
from sal_height.simulation import SimulatedFlight
from sal_height.topics import MAP_ORIGIN, ODOMETRY, PHASE_HISTORY, SENSOR_INFO


class FlightMessage(NamedTuple):
    """A message of the sensor or of the platform.

    Attributes:
        topic: name of its topic.
        message: message.
        stamp_ns: time that it is about, ns.
    """

    topic: str
    message: Any
    stamp_ns: int


def first_messages(flight: SimulatedFlight, start_ns: int) -> Iterator[FlightMessage]:
    """The description of the sensor, and the origin of the map if the scene has one.

    Args:
        flight: flight.
        start_ns: stamp of its start, ns.
    """
    stamp = to_stamp(start_ns)
    yield FlightMessage(SENSOR_INFO, sensor_to_message(flight.sensor, stamp), start_ns)
    if origin := flight.scene.origin:
        yield FlightMessage(MAP_ORIGIN, origin_to_message(origin, stamp, MAP_FRAME), start_ns)


def dwell_messages(flight: SimulatedFlight, dwell: int, start_ns: int) -> Iterator[FlightMessage]:
    """The air, the odometry and the frames of all channels of a dwell.

    Args:
        flight: flight.
        dwell: number of the dwell.
        start_ns: stamp of the start of the flight, ns.
    """
    for air in flight.probed_air(dwell):
        at_ns = start_ns + air.stamp_ns
        for topic, message in air_to_messages(air.values, to_stamp(at_ns)).items():
            yield FlightMessage(topic, message, at_ns)
    for state in flight.platform_states(dwell):
        at_ns = start_ns + state.stamp_ns
        yield FlightMessage(ODOMETRY, state_to_message(state, to_stamp(at_ns)), at_ns)
    history = flight.phase_history(dwell)
    at_ns = start_ns + history.stamp_ns
    for frame in history_to_messages(history, flight.sensor, dwell, to_stamp(at_ns)):
        yield FlightMessage(PHASE_HISTORY, frame, at_ns)
