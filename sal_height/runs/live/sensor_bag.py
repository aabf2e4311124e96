"""Dwells of a simulated sensor, as a bag: to be played live, without a simulator in the graph."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from sal_height import messages
from sal_height.bag import qos
from sal_height.bag.described import FRAMES
from sal_height.bag.qos import Qos
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import FIX_TYPE, FRAME_TYPE, ODOMETRY_TYPE, SENSOR_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.graph.catalogue import HEIGHTS, TRACKER, suited
from sal_height.graph.reporting import PARAMETERS, PRESET, SEED, merged
from sal_height.messages.flight import FlightMessage, dwell_messages, first_messages
from sal_height.nodes.playing.playlist import Playlist
from sal_height.progress import Bar
from sal_height.runs.chain.entry import contents
from sal_height.runs.chain.recorded_parameters import recorded_parameters
from sal_height.runs.truth.simulate import parameters_of_flight
from sal_height.sensor import Sensor
from sal_height.simulation import Preset, SimulatedFlight, flight_of
from sal_height.topics import MAP_ORIGIN, ODOMETRY, SENSOR_INFO
from sal_height.workers.processes import Forked, run_in_copy


@dataclass(frozen=True)
class Feed:
    """A sensor that will be played from a bag.

    Attributes:
        bag: folder or file.
        sensor: sensor whose dwells are played.
        nodes: the height nodes that process them.
        parameters: parameters of nodes that the bag was made with.
        custom_data: custom data of the bag: texts by name.
        simulation: process that still writes the bag; None: it is complete.
    """

    bag: Path
    sensor: Sensor
    nodes: list[str]
    parameters: dict[str, dict[str, Any]]
    custom_data: Mapping[str, str]
    simulation: Forked | None = None

    @classmethod
    def of_bag(cls, bag: Path, estimators: Collection[str] = ()) -> Self:
        """Sensor and estimators of a bag.

        Args:
            bag: folder or file.
            estimators: names of those that make heights; empty: those whose heights the bag has, or the standard ones.

        Raises:
            UserError: it has no phase history or no sensor info, or an estimator does not suit the sensor.
        """
        reader = BagReader(bag)
        sensor, _ = contents(reader)
        made = [name for name in HEIGHTS.values() if f"/{name}/height" in reader.topics and name != HEIGHTS[TRACKER]]
        makers = suited(sensor, estimators or made)
        return cls(bag, sensor, makers, recorded_parameters(reader, makers), reader.custom_data)

    @classmethod
    def simulated(cls, preset: Preset, seed: int, folder: Path) -> Self:
        """Have the flight of a preset written to a bag, by a process of its own if this one can fork.

        Raises:
            UserError: the flight leaves its scene, or the bag cannot be written.
        """
        flight = flight_of(preset, seed)
        flight.surface(0)  # refuses a flight outside the scene before anything is started

        def simulate() -> int:
            record_sensor(preset, seed, folder)
            return 0

        simulation = run_in_copy(simulate, "simulation")
        custom_data = _custom_data(flight)
        values = json.loads(custom_data[PARAMETERS])
        return cls(folder, flight.sensor, suited(flight.sensor, preset.estimators), values, custom_data, simulation)

    def playlist(self) -> Playlist:
        """The dwells of the bag, once it is complete.

        Raises:
            UserError: they could not be simulated, or none is complete.
        """
        if self.simulation is not None and (status := self.simulation.wait(math.inf)):
            raise UserError(f"The simulation of the sensor ended with status {status}; its message is above.")
        return Playlist.of_bag(BagReader(self.bag), math.inf)


def record_sensor(preset: Preset, seed: int, folder: Path) -> Path:
    """Simulate the flight of a preset and write what its sensor delivers to a bag; returns the bag.

    Raises:
        UserError: the flight leaves its scene, or the bag cannot be written.
    """
    flight = flight_of(preset, seed)
    start_ns = time.time_ns()
    with BagWriter(folder, _custom_data(flight)) as bag:
        for name, (kind, offered) in _topics_of(flight).items():
            bag.add_topic(f"/{name}", kind, [offered])

        def write(published: Iterable[FlightMessage]) -> None:
            for topic, message, stamp_ns in published:
                bag.write(f"/{topic}", messages.serialize(message), stamp_ns, stamp_ns)

        write(first_messages(flight, start_ns))
        for dwell in Bar(range(preset.dwells), unit="dwell", desc="simulating"):
            write(dwell_messages(flight, dwell, start_ns))
    return folder


def _topics_of(flight: SimulatedFlight) -> dict[str, tuple[str, Qos]]:
    """Type and quality of service of the topics of a simulated sensor."""
    topics = {
        SENSOR_INFO: (SENSOR_TYPE, qos.LATCHED),
        ODOMETRY: (ODOMETRY_TYPE, qos.ODOMETRY),
        FRAMES: (FRAME_TYPE, qos.FRAMES),
    }
    if flight.scene.origin:
        topics[MAP_ORIGIN] = FIX_TYPE, qos.LATCHED
    if flight.preset.impairments.air:
        topics |= {topic: (one.type_name, qos.ODOMETRY) for topic, one in messages.AIR.items()}
    return topics


def _custom_data(flight: SimulatedFlight) -> dict[str, str]:
    """Custom data of the bag of a simulated sensor: preset, seed and the like."""
    preset = flight.preset
    values = merged(parameters_of_flight(flight, suited(flight.sensor, preset.estimators)), preset.processing)
    return {PARAMETERS: json.dumps(values), PRESET: json.dumps(dataclasses.asdict(preset)), SEED: str(flight.seed)}
