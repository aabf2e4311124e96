"""A source that is ahead of nodes in processes of their own, and what comes out: the same as step by step."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import separate_processes
from helpers import make_sensor
from rewritten_bag import rewritten

from sal_height.bag.compare import EQUAL, compare_bags
from sal_height.bag.reader import BagReader
from sal_height.nodes.account import Account
from sal_height.nodes.graph import Graph
from sal_height.nodes.stage import FRAMES_QOS
from sal_height.runs.conductor import Conductor, Plan
from sal_height.runs.lead import IN_STEP, MOST_AHEAD, Lead, lead_of
from sal_height.runs.replay import replay
from sal_height.runs.sensor_bag import record_sensor
from sal_height.simulation.preset import Preset

STAGES = ["sar_compression", "ml_height", "relief_tracker"]
HEIGHTS = ["/ml/height", "/monopulse/height", "/tracked/height"]
CHANNELS = 8


def test_the_source_is_ahead_as_far_as_all_nodes_can_hold() -> None:
    sensor = make_sensor()
    channels = sensor.detector_count

    def dwells(**parameters: dict[str, Any]) -> int:
        return lead_of(sensor, STAGES, parameters).dwells

    assert lead_of(sensor, STAGES, {}) == Lead(MOST_AHEAD, channels)
    assert dwells(ml_height={"max_queued_dwells": 1}) == 1
    assert dwells(sar_compression={"max_unfinished_dwells": 1}) == 0
    assert dwells(sar_compression={"max_memory_mb": 1}) == max(0, min(2, 1_000_000 // (2 * sensor.dwell_bytes) - 1))
    large = dataclasses.replace(sensor, pulse_count=2048, config_hash="")
    assert lead_of(large, STAGES, {"ml_height": {"max_memory_mb": 1}}).dwells == 0
    assert lead_of(sensor, STAGES, {"relief_tracker": {"latency_budget_s": 1.0}}) == IN_STEP
    assert lead_of(sensor, [*STAGES, "psf_calibration"], {}) == IN_STEP
    assert lead_of(dataclasses.replace(sensor, mode="stripmap", config_hash=""), STAGES, {}) == IN_STEP
    assert channels * (MOST_AHEAD + 1) <= FRAMES_QOS.depth


def test_the_next_dwell_is_asked_for_when_all_nodes_are_done_with_all_but_the_last_few(graph: Graph) -> None:
    plan = Plan("player", STAGES, ["phase_history"], Path("bag"), {}, 9)
    watching, lead = graph.add(Conductor(plan, context=graph.context)), Lead(2, CHANNELS)
    watching._steps = 3
    watching.accounts = before = {
        "recorder": Account.of_numbers({"unwritten": 0, "recorded./phase_history": 8}),
        "player": Account.of_numbers({"in": 3, "waiting": 0, "published./phase_history": 24}),
        "sar_compression": Account.of_numbers({"in": 24, "waiting": 16, "published./slc": 8}),
        "ml_height": Account.of_numbers({"in": 8, "waiting": 0, "published./ml/height": 1}),
        "relief_tracker": Account.of_numbers({"in": 1, "waiting": 0}),
    }
    assert watching.caught_up(lead)
    assert not watching.caught_up(IN_STEP)
    for name, changed in (
        ("recorder", {"unwritten": 0, "recorded./phase_history": 7}),
        ("player", {"in": 3, "waiting": 1, "published./phase_history": 24}),
        ("player", {"in": 2, "waiting": 0, "published./phase_history": 24}),
        ("player", {"in": 3, "waiting": 0, "published./phase_history": 23}),  # a dwell lacks a frame
        ("sar_compression", {"in": 24, "waiting": 17, "published./slc": 8}),
        ("ml_height", {"in": 8, "waiting": 1, "published./ml/height": 1}),
        ("relief_tracker", {"in": 0, "waiting": 0}),
    ):
        watching.accounts = {**before, name: Account.of_numbers(changed)}
        assert not watching.caught_up(lead), (name, changed)


def test_a_dwell_that_waits_for_a_frame_is_not_overtaken(two_dwells: Preset, tmp_path: Path) -> None:
    """Heights, tracked ones too, and their order are those of a replay step by step."""
    whole = record_sensor(dataclasses.replace(two_dwells, dwells=6), 3, tmp_path / "whole")
    bag = rewritten(
        whole,
        tmp_path / "lacking",
        lambda message, number: None if (message.topic, number) == ("/phase_history", 2 * CHANNELS + 3) else message,
    )
    proceed = {"missing_channels": "proceed", "timeout_s": 1.0}
    made = [tmp_path / name for name in ("in_step", "ahead")]
    assert not replay(bag, made[0], {"sar_compression": proceed}).outcome.losses
    separate_processes.replayed(bag, made[1], *(f"--param=sar_compression.{name}={proceed[name]}" for name in proceed))
    bags = [BagReader(folder / "bag") for folder in made]
    compared = compare_bags(*bags, topics=HEIGHTS)
    assert {topic: (one.verdict, one.matched) for topic, one in compared.items()} == dict.fromkeys(HEIGHTS, (EQUAL, 6))
    order = [
        [reader.decode(one.type_name, one.cdr).dwell for one in reader.messages(["/ml/height"])] for reader in bags
    ]
    assert order[0] == order[1]
