"""`sal-height import-gotcha`: AFRL Gotcha phase history (MATLAB files) becomes a bag of one dwell."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from scipy.constants import speed_of_light
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from sal_height import messages
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.geometry import PlatformState
from sal_height.nodes.stage import FRAMES_QOS, LATCHED_QOS, ODOMETRY_QOS
from sal_height.numeric import F64, I64
from sal_height.runs.reporting import PARAMETERS
from sal_height.sensor import PhaseHistory, Sensor

FIELDS = ("fp", "freq", "x", "y", "z", "r0")

SPEED = 100.0
"""Speed of flight (m/s) from which pulse times are made; the files have positions only."""

BEAM = 0.0145
"""Beamwidth (rad) put into the sensor info; the files do not state the antenna. As wide as the pulses sample: 147 m."""

FOCUSING = {
    "sar_compression": {
        "image_plane": "ground",
        "rows": 501,
        "cols": 501,
        "ground_spacing_m": 0.2,
        "range_window": "rectangular",
    }
}
"""Parameters that focus the 100 m scene; they are put beside the bag."""


def import_gotcha(files: list[Path], out: Path) -> int:
    """Write sensor info, odometry and phase history of consecutive files as one dwell of a bag; the number of pulses.

    Pulse times follow from the recorded antenna positions at constant SPEED; base_link is level and looks at the
    scene's centre, which is the map's origin.

    Raises:
        UserError: a file is not Gotcha phase history, the files differ in frequency, or the bag cannot be written.
    """
    parts = [_load(path) for path in files]
    frequency = parts[0]["freq"].ravel()
    for path, part in zip(files, parts, strict=True):
        if part["freq"].size != frequency.size or not np.allclose(part["freq"].ravel(), frequency, rtol=1e-9):
            raise UserError(f"File {path} has other frequencies than {files[0]}; all must share them.")
    antenna: F64 = np.concatenate([np.stack([p[axis].ravel() for axis in "xyz"], axis=-1) for p in parts])
    samples = np.concatenate([p["fp"].T for p in parts]).astype(np.complex64)[None]
    steps = np.linalg.norm(np.diff(antenna, axis=0), axis=-1)
    times_ns = np.rint(np.concatenate([[0.0], np.cumsum(steps)]) / SPEED * 1e9).astype(np.int64)
    if not np.all(np.diff(times_ns) > 0):
        raise UserError("Two pulses were taken at the same antenna position; name each file once.")
    times: F64 = times_ns * np.float64(1e-9)
    velocity = np.asarray(np.gradient(antenna, times, axis=0), dtype=np.float64)
    reference = np.concatenate([p["r0"].ravel() for p in parts])
    sensor = _sensor(frequency, antenna, velocity, times)
    history = PhaseHistory(0, times, reference, samples)
    states = _states(times_ns, antenna, velocity, sensor.look_side)
    _write(out, sensor, history, states)
    return len(times)


def _load(path: Path) -> dict[str, Any]:
    """The FIELDS of a file.

    Raises:
        UserError: it does not have them, or their sizes or values cannot be those of phase history.
    """
    try:
        data = loadmat(path)["data"][0][0]
        part = {name: np.asarray(data[name], dtype="c8" if name == "fp" else "f8") for name in FIELDS}
    except Exception as error:  # scipy, zlib and numpy each have their own for a damaged file
        raise UserError(
            f"File {path} is not AFRL Gotcha phase history; expected is a MATLAB file with data.{', .'.join(FIELDS)}."
        ) from error
    frequencies, pulses = part["freq"].size, part["x"].size
    if frequencies < 2 or pulses < 2:
        raise UserError(
            f"File {path} has {frequencies} frequencies and {pulses} antenna positions; 2 or more of each are needed."
        )
    if part["fp"].shape != (frequencies, pulses):
        raise UserError(f"File {path} has .fp of shape {part['fp'].shape}; it must be {(frequencies, pulses)}.")
    for name in ("y", "z", "r0"):
        if part[name].size != pulses:
            raise UserError(f"File {path} has {part[name].size} values of .{name}; they must be {pulses}, as of .x.")
    for name, values in part.items():
        if not np.all(np.isfinite(values)):
            raise UserError(f"File {path} has values of .{name} that are not finite; all must be finite numbers.")
    frequency = part["freq"].ravel()
    even, step = np.linspace(frequency[0], frequency[-1], frequencies, retstep=True)
    if not (frequency[0] > 0 and step > 0 and np.abs(frequency - even).max() <= 0.01 * step):
        raise UserError(f"File {path} has uneven .freq; it must rise from above 0 in equal steps, to 1 % of a step.")
    return part


def _sensor(frequency: F64, antenna: F64, velocity: F64, times: F64) -> Sensor:
    """One receiver with its boresight on the map's origin, seen from the middle of the track."""
    middle = len(antenna) // 2
    level = float(np.hypot(*antenna[middle, :2]))
    turn = np.cross(velocity[middle], -antenna[middle])[2]
    wavelength = speed_of_light / float(np.mean(frequency))
    return Sensor(
        name="afrl_gotcha",
        look_side=-1 if turn > 0 else 1,
        wavelength=wavelength,
        bandwidth=float(frequency[-1] - frequency[0]) * len(frequency) / (len(frequency) - 1),
        sample_count=len(frequency),
        pulse_count=len(antenna),
        pulse_repetition_frequency=(len(times) - 1) / float(times[-1]),
        aperture=wavelength / BEAM,
        pattern="sinc",
        elevation_boresights=(float(np.arctan2(level, antenna[middle, 2])),),
        noise_power=(0.0,),
    )


def _states(times_ns: I64, antenna: F64, velocity: F64, look_side: int) -> list[PlatformState]:
    """One level state per pulse, its side turned to the map's origin."""
    towards = np.arctan2(-antenna[:, 1], -antenna[:, 0])
    orientation = Rotation.from_euler("z", (towards + look_side * np.pi / 2)[:, None]).as_quat()
    return [
        PlatformState(int(ns), position, attitude, speed, np.zeros((6, 6)))
        for ns, position, attitude, speed in zip(times_ns, antenna, orientation, velocity, strict=True)
    ]


def _write(out: Path, sensor: Sensor, history: PhaseHistory, states: list[PlatformState]) -> None:
    """The bag: each message logged at the time it would have been received."""
    topics: dict[str, tuple[str, QoSProfile]] = {
        "/sensor_info": ("sal_height_msgs/msg/SensorInfo", LATCHED_QOS),
        "/platform/odometry": ("nav_msgs/msg/Odometry", ODOMETRY_QOS),
        "/phase_history": ("sal_height_msgs/msg/DetectorFrame", FRAMES_QOS),
    }
    end_ns = states[-1].stamp_ns
    recorded: list[tuple[str, Any, int]] = [
        ("/sensor_info", messages.sensor_to_message(sensor, messages.to_stamp(0)), 0)
    ]
    recorded += [
        ("/platform/odometry", messages.state_to_message(s, messages.to_stamp(s.stamp_ns)), s.stamp_ns) for s in states
    ]
    frames = messages.history_to_messages(history, sensor, 0, messages.to_stamp(history.stamp_ns))
    recorded += [("/phase_history", frame, end_ns + 1) for frame in frames]
    with BagWriter(out, {PARAMETERS: json.dumps(FOCUSING)}) as bag:
        for topic, (type_name, qos) in topics.items():
            bag.add_topic(topic, type_name, [qos])
        for topic, message, time_ns in recorded:
            bag.write(topic, serialize_message(message), time_ns, time_ns)
