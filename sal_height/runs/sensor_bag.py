"""What a simulated sensor delivers, as a bag: to be played live, without a simulator beside the graph."""

from __future__ import annotations

import dataclasses
import json
import time
from pathlib import Path
from typing import Any

from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from tqdm import tqdm

from sal_height import messages
from sal_height.bag.writer import BagWriter
from sal_height.nodes.playlist import FRAMES, ODOMETRY, SENSOR_INFO
from sal_height.nodes.stage import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.runs.ensemble import suited
from sal_height.runs.reporting import PARAMETERS, PRESET, SEED, merged
from sal_height.runs.simulate import processing_of
from sal_height.simulation import Preset, flight_of

tqdm.monitor_interval = 0  # no thread that refreshes slow bars: it would be in the way of `runs.processes.Forked`


def record_sensor(preset: Preset, seed: int, folder: Path) -> Path:
    """Simulate the flight of a preset and write what its sensor delivers to a bag; returns the bag.

    Raises:
        UserError: the flight leaves its scene, or the bag cannot be written.
    """
    flight = flight_of(preset, seed)
    values = merged(processing_of(preset, suited(flight.sensor, preset.estimators)), preset.processing)
    custom_data = {
        PARAMETERS: json.dumps(values),
        PRESET: json.dumps(dataclasses.asdict(preset)),
        SEED: str(seed),
    }
    start_ns = time.time_ns()
    stamp = messages.to_stamp(start_ns)
    topics: dict[str, tuple[str, QoSProfile]] = {
        SENSOR_INFO: ("sal_height_msgs/msg/SensorInfo", LATCHED_QOS),
        ODOMETRY: ("nav_msgs/msg/Odometry", ODOMETRY_QOS),
        FRAMES: ("sal_height_msgs/msg/ChannelFrame", FRAMES_QOS),
    }
    with BagWriter(folder, custom_data) as bag:
        for name, (kind, qos) in topics.items():
            bag.add_topic(f"/{name}", kind, [qos])

        def write(topic: str, message: Any, stamp_ns: int) -> None:
            bag.write(f"/{topic}", serialize_message(message), stamp_ns, stamp_ns)

        write(SENSOR_INFO, messages.sensor_to_message(flight.sensor, stamp), start_ns)
        for dwell in tqdm(range(preset.dwells), unit="dwell", desc="simulating"):
            for state in flight.platform_states(dwell):
                at_ns = start_ns + state.stamp_ns
                write(ODOMETRY, messages.state_to_message(state, messages.to_stamp(at_ns)), at_ns)
            history = flight.phase_history(dwell)
            at_ns = start_ns + history.stamp_ns
            for frame in messages.history_to_messages(history, flight.sensor, dwell, messages.to_stamp(at_ns)):
                write(FRAMES, frame, at_ns)
    return folder
