"""The messages of a collection are the bytes that their serializer makes, though they are put together in bulk."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.geometry import PlatformState
from sal_height.imports import Collection, write_collection
from sal_height.messages import serialize
from sal_height.sensor import PhaseHistory
from sal_height.simulation import flight_of, load_preset


def test_messages_of_a_bag_are_those_of_the_serializer(tmp_path: Path) -> None:
    """Odometry of any attitude and covariance, and frames of several channels."""
    rng = np.random.default_rng(1)
    preset = flight_of(load_preset("small"), seed=1).sensor
    sensor = dataclasses.replace(preset, pulse_count=6, sample_count=5, config_hash="")
    shape = sensor.detector_count, 6, 5
    samples = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
    dwell = PhaseHistory(5_123_456_789, 1e-3 * np.arange(6), rng.uniform(1e3, 2e3, 6), samples)
    attitudes = Rotation.random(8, random_state=2).as_quat()
    states = [
        PlatformState(
            5_000_000_001 + 50_000_000 * k,
            *rng.normal(size=(1, 3)),
            attitudes[k],
            *rng.normal(size=(1, 3)),
            c,
            rng.normal(size=(3, 3)),
        )
        for k, c in enumerate(rng.normal(size=(8, 6, 6)))
    ]
    write_collection(Collection(sensor, [dwell], states), tmp_path / "bag")
    reader = BagReader(tmp_path / "bag")
    expected = [serialize(messages.state_to_message(one, messages.to_stamp(one.stamp_ns))) for one in states]
    assert [bytes(one.cdr) for one in reader.messages(["/platform/odometry"])] == expected
    frames = messages.history_to_messages(dwell, sensor, 0, messages.to_stamp(dwell.stamp_ns))
    assert [bytes(one.cdr) for one in reader.messages(["/phase_history"])] == [serialize(one) for one in frames]
