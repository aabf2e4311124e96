"""A node that is offered more than it can do: whole dwells go, the oldest first, and each is counted."""

from __future__ import annotations

import itertools
import threading
from typing import Any

import pytest
from helpers import publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.engine import heights as height_stage
from sal_height.engine.heights import AT_ONCE
from sal_height.imaging import ImageSettings, Slc
from sal_height.messages import deserialize, serialize
from sal_height.messages.types import (
    ComplexImage,
    DiagnosticArray,
    DiagnosticStatus,
    HeightImage,
    Provenance,
    SensorInfo,
)
from sal_height.nodes import worker
from sal_height.nodes.accounts.account import DIAGNOSTICS, Account
from sal_height.nodes.playing.playlist import restamped
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS
from sal_height.pipeline import Compressor, heights_of_dwells
from sal_height.relief import HeightField
from sal_height.simulation.flight import SimulatedFlight

TIMEOUT_S = 120.0
START_NS = 1_000_000_000_000
INTERVAL_NS = 10_000_000

QUEUED = 3
BURST, BURSTS = 24, 6
"""Dwells published at once, fewer than wait in the middleware, and how often."""


def images_of(flight: SimulatedFlight, dwell: int = 0) -> list[bytes]:
    """The serialized images of a dwell."""
    history, settings = flight.phase_history(dwell), ImageSettings(air="none", rows=46, cols=12)
    slc = Compressor().add(history, flight.track(dwell), flight.sensor, settings)
    assert slc
    stamp = messages.to_stamp(START_NS + dwell * INTERVAL_NS)
    frame = messages.history_to_messages(history, flight.sensor, dwell, stamp)[0]
    made = messages.slc_to_messages(slc, frame, Provenance(config_hash=flight.sensor.config_hash))
    return [messages.serialize(image) for image in made]


def test_of_a_flood_whole_dwells_go_the_oldest_first_and_each_is_counted(
    graph: Graph, flight: SimulatedFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "DIAGNOSTICS_PERIOD_S", 0.05)
    monkeypatch.setattr(worker, "RECENT_S", 3600.0)
    overrides = [Parameter("max_queued_dwells", value=QUEUED)]
    node = graph.add(PROCESSING["monopulse"](context=graph.context, parameter_overrides=overrides))
    source, heights, states = graph.add(Node("source", context=graph.context)), [], []
    subscribe(source, HeightImage, "monopulse/height", heights.append, FRAMES_QOS)
    subscribe(source, DiagnosticArray, DIAGNOSTICS, lambda message: states.extend(message.status), 100)
    publisher = publisher_of(source, ComplexImage, "slc", FRAMES_QOS)
    publisher_of(source, SensorInfo, "sensor_info", LATCHED_QOS).publish(
        messages.sensor_to_message(flight.sensor, messages.to_stamp(0))
    )
    images, channels = images_of(flight), flight.sensor.detector_count
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1 and node.is_ready, TIMEOUT_S)
    assert graph.spin_until(lambda: source.count_publishers("monopulse/height") == 1, TIMEOUT_S)
    assert graph.spin_until(lambda: bool(states), TIMEOUT_S)

    def publish(dwell: int) -> None:
        for image in images:
            publisher.publish(restamped(image, dwell * INTERVAL_NS))

    def now() -> dict[str, Any]:
        """The counts; the state is kept, of which the middleware may lose some while messages flood in."""
        states.extend(node.diagnostics().status)
        return node.tally.summary()

    for burst in range(BURSTS):
        for dwell in range(BURST * burst, BURST * (burst + 1)):
            publish(dwell)
        sent = BURST * (burst + 1) * channels
        assert graph.spin_until(lambda sent=sent: now()["in"] == sent, TIMEOUT_S), node.tally.summary()
    assert graph.spin_until(lambda: now()["waiting"] == 0, TIMEOUT_S), node.tally.summary()
    summary = node.tally.summary()
    lost = {name: count for name, count in summary.items() if name.startswith("dropped.")}
    assert list(lost) == ["dropped.queue full"]
    assert summary["processed"] + lost["dropped.queue full"] == BURSTS * BURST * channels
    assert lost["dropped.queue full"] % channels == 0
    assert graph.spin_until(lambda: len(heights) == summary["processed"] // channels, TIMEOUT_S), len(heights)
    stamps = [messages.to_ns(height.header.stamp) for height in heights]
    newest = [START_NS + dwell * INTERVAL_NS for dwell in range(BURSTS * BURST - QUEUED, BURSTS * BURST)]
    assert stamps[-QUEUED:] == newest
    assert stamps == sorted(set(stamps))

    def has_told() -> bool:
        """Whether diagnostics have said that more dwells come than are processed."""
        told = [Account.of_status(status).numbers for status in states]
        return any(one.get("offered_hz", 0.0) > one.get("achieved_hz", 0.0) > 0 for one in told)

    assert graph.spin_until(has_told, TIMEOUT_S), states[-1]
    assert states[-1].level == DiagnosticStatus.WARN
    monkeypatch.setattr(worker, "RECENT_S", 0.3)
    later = itertools.count(BURSTS * BURST)
    sent = BURSTS * BURST * channels

    def is_well() -> bool:
        """Whether the node says so while dwells come that it can process: the next one when the last is done."""
        nonlocal sent
        counts = node.tally.summary()
        if counts["waiting"] == 0 and counts["in"] == sent:
            sent += channels
            publish(next(later))
        return bool(states[-1].level == DiagnosticStatus.OK)

    assert graph.spin_until(is_well, TIMEOUT_S), states[-1]
    assert node.tally.summary()["dropped.queue full"] == lost["dropped.queue full"]


def test_after_more_messages_than_wait_in_the_middleware_the_next_dwell_is_whole(
    graph: Graph, flight: SimulatedFlight
) -> None:
    """Those that waited are left out: what is left of their dwells is torn, and would push out what follows."""
    node = graph.add(PROCESSING["monopulse"](context=graph.context))
    source, heights = graph.add(Node("source", context=graph.context)), list[HeightImage]()
    subscribe(source, HeightImage, "monopulse/height", heights.append, FRAMES_QOS)
    publisher = publisher_of(source, ComplexImage, "slc", FRAMES_QOS)
    publisher_of(source, SensorInfo, "sensor_info", LATCHED_QOS).publish(
        messages.sensor_to_message(flight.sensor, messages.to_stamp(0))
    )
    images = images_of(flight)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1 and node.is_ready, TIMEOUT_S)
    for image in images:
        publisher.publish(image)
    assert graph.spin_until(lambda: len(heights) == 1, TIMEOUT_S)
    dwells = 2 * FRAMES_QOS.depth // len(images)
    for dwell in range(1, dwells):
        for image in images:
            publisher.publish(restamped(image, dwell * INTERVAL_NS))
    assert graph.spin_until(lambda: bool(node.tally.summary().get("dropped.overload")), TIMEOUT_S)
    for image in images:
        publisher.publish(restamped(image, dwells * INTERVAL_NS))
    assert graph.spin_until(lambda: len(heights) == 2, TIMEOUT_S), node.tally.summary()
    assert messages.to_ns(heights[-1].header.stamp) == START_NS + dwells * INTERVAL_NS
    assert graph.spin_until(lambda: node.tally.summary()["waiting"] in (0, 1), TIMEOUT_S)
    counts = node.tally.summary()
    assert counts["in"] == 2 * len(images) + counts["dropped.overload"] + counts["waiting"]
    assert counts["in"] <= FRAMES_QOS.depth + 2 * len(images)


def test_dwells_that_wait_are_processed_at_once_and_one_that_cannot_be_fails_alone(
    graph: Graph, flight: SimulatedFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The heights are those of dwells that come one by one."""
    images = [images_of(flight, dwell) for dwell in range(3)]
    bad = deserialize(images[1][2], ComplexImage)
    bad.grid.row_spacing *= 1.01  # another grid than that of the other channels
    numbers: list[int] = []

    def counted(slcs: list[Slc], *others: Any) -> list[HeightField]:
        numbers.append(len(slcs))
        return heights_of_dwells(slcs, *others)

    monkeypatch.setattr(height_stage, "heights_of_dwells", counted)
    overrides = [Parameter("max_queued_dwells", value=2 * AT_ONCE)]
    node = graph.add(PROCESSING["monopulse"](context=graph.context, parameter_overrides=overrides))
    source, made = graph.add(Node("source", context=graph.context)), []
    subscribe(source, HeightImage, "monopulse/height", made.append, FRAMES_QOS)
    publisher = publisher_of(source, ComplexImage, "slc", FRAMES_QOS)
    publisher_of(source, SensorInfo, "sensor_info", LATCHED_QOS).publish(
        messages.sensor_to_message(flight.sensor, messages.to_stamp(0))
    )
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1 and node.is_ready, TIMEOUT_S)
    assert graph.spin_until(lambda: source.count_publishers("monopulse/height") == 1, TIMEOUT_S)

    def publish(dwells: list[list[bytes]]) -> None:
        for image in itertools.chain(*dwells):
            publisher.publish(image)

    for dwell in range(3):
        publish(images[dwell : dwell + 1])
        assert graph.spin_until(lambda count=dwell + 1: len(made) == count, TIMEOUT_S)
    assert numbers == [1, 1, 1]
    held = threading.Event()
    node.submit(0, lambda: int(held.wait(TIMEOUT_S)))
    later = [[restamped(one, shift * INTERVAL_NS) for one in dwell] for shift in (10, 20, 30) for dwell in images]
    broken = [*images[1][:2], serialize(bad), *images[1][3:]]
    publish([*later, [restamped(image, 40 * INTERVAL_NS) for image in broken]])
    assert graph.spin_until(lambda: node.jobs == 11, TIMEOUT_S)
    held.set()
    assert graph.spin_until(lambda: len(made) == 12 and node.jobs == 0, TIMEOUT_S), node.tally.summary()
    assert numbers == [1, 1, 1, AT_ONCE, 1]
    surfaces = [repr(one.surfaces) for one in made]
    assert surfaces[3:] == 3 * surfaces[:3]
    assert node.tally.summary()["dropped.channels disagree"] == flight.sensor.detector_count
