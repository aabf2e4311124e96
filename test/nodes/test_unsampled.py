"""Dwells that cannot be imaged: one clear reason, a count, and the next good dwell exactly as if nothing happened."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from chain_fixture import DETECTORS, Chain, next_dwell_is_exact
from helpers import assert_one_sentence
from scipy.spatial.transform import Rotation

from sal_height import messages
from sal_height.sensor.sensor import Sensor


def sparse(sensor: Sensor) -> Sensor:
    """An antenna so small that the pulses do not sample its beams: 1.67 mm apart, allowed are .5 mm."""
    return dataclasses.replace(sensor, elevation_diameter=0.001, azimuth_diameter=0.001, config_hash="")


def short(sensor: Sensor) -> Sensor:
    """An antenna so large that the dwell resolves no more than its beam: 8 cm, needed are 50 cm."""
    return dataclasses.replace(sensor, elevation_diameter=1.0, azimuth_diameter=1.0, config_hash="")


def deep(sensor: Sensor) -> Sensor:
    """Beams over more ground than the frequencies tell apart: 8 beams over 5.4 m of range, the window is 4.8 m."""
    return dataclasses.replace(
        sensor, elevation_boresights=tuple(np.pi / 4 + (np.arange(8) - 3.5) * 1.55e-4), config_hash=""
    )


@pytest.mark.parametrize(
    ("spoil", "reason", "limit"),
    [
        (sparse, "aliased in azimuth", "a pulse repetition frequency of 1e+05 Hz"),
        (short, "too few pulses", "longer than half the antenna (0.5 m)"),
        (deep, "aliased in range", "must be spaced 2.763e+07 Hz or less"),
    ],
)
def test_a_dwell_that_does_not_sample_the_scene(
    chain: Chain, reference: Any, spoil: Any, reason: str, limit: str
) -> None:
    sensor = spoil(chain.flight.sensor)
    frames = chain.frames(0)
    for frame in frames:
        frame.config_hash = sensor.config_hash
    chain.publish(messages.sensor_to_message(sensor, frames[0].header.stamp), *chain.odometry(0), *frames)
    chain.await_drops("sar_compression", reason, DETECTORS)
    assert_one_sentence(chain.stages["sar_compression"].last_rejection.partition(": ")[2], limit)
    chain.publish(chain.sensor_info())
    next_dwell_is_exact(chain, reference)


def test_a_scene_outside_the_beams(chain: Chain, reference: Any) -> None:
    """Heading off by two beamwidths: what was lit is not what the image shows."""
    odometry = chain.odometry(0)
    for message in odometry:
        state = messages.state_from_message(message)
        turned = dataclasses.replace(state, orientation=Rotation.from_euler("z", 3.1e-4).as_quat())
        message.pose = messages.state_to_message(turned, message.header.stamp).pose
        message.twist = messages.state_to_message(turned, message.header.stamp).twist
    chain.publish(chain.sensor_info(), *odometry, *chain.frames(0))
    chain.await_drops("sar_compression", "Doppler centroid outside the band", DETECTORS)
    assert_one_sentence(chain.stages["sar_compression"].last_rejection.partition(": ")[2], "to each side; attitude")
    chain.publish(*chain.odometry(0))
    next_dwell_is_exact(chain, reference)


def test_a_track_that_jumps(chain: Chain, reference: Any) -> None:
    odometry = chain.odometry(0)
    start = chain.frames(0)[0].header.stamp
    for message in odometry:
        if messages.to_ns(message.header.stamp) > messages.to_ns(start):
            message.pose.pose.position.y += 1.0
    chain.publish(chain.sensor_info(), *odometry, *chain.frames(0))
    chain.await_drops("sar_compression", "cannot be processed", DETECTORS)
    assert_one_sentence(chain.stages["sar_compression"].last_rejection.partition(": ")[2], "twist must be the velocity")
    chain.publish(*chain.odometry(0))
    next_dwell_is_exact(chain, reference)
