"""The live host with a calibrator, an adjuster and a detector of movers: their products, and those of a replay."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node
from std_srvs.srv import Trigger

from sal_height.bag.compare import EQUAL
from sal_height.bag.reader import BagReader
from sal_height.graph.watch import AccountBook, Watcher
from sal_height.nodes.accounts.account import Account
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.runs.chain.entry import Part
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.runs.replay.bag_replay import replay
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.preset import TargetSettings, load_preset

DEADLINE_S = 300.0

CONFIGURATION = """
namespace: lidar
nodes:
  paced_player: {{parameters: {{bag: {folder}/sensor, rate: 0.03}}}}
  sar_compression: {{parameters: {{rows: 46, cols: 48, calibration: topic, max_queued_dwells: 1024}}}}
  plain:
    node: sar_compression
    parameters: {{rows: 46, cols: 12, range_window: rectangular, max_queued_dwells: 1024}}
    remap: {{slc: plain/slc}}
  psf_calibration: {{parameters: {{dwells: 4, dwell_step: 1, max_queued_dwells: 1024}}, remap: {{slc: plain/slc}}}}
  ml_height: {{parameters: {{range_looks: 2, azimuth_looks: 2, max_queued_dwells: 1024}}}}
  mover_detection: {{parameters: {{max_queued_dwells: 1024}}}}
  height_adjuster: {{parameters: {{max_queued_dwells: 1024}}}}
  relief_tracker: {{parameters: {{max_queued_dwells: 1024}}}}
  recorder:
    parameters:
      directory: {folder}/bag
      topics: [sensor_info, platform/odometry, phase_history, calibration, losses, /diagnostics, ml/height,
               tracked/height, adjusted/height, adjusted/odometry, movers]
"""

STAGES = ("sar_compression", "plain", "psf_calibration", "ml_height", "mover_detection", "height_adjuster")

LATE = 8
"""Dwells at the end of a flight whose movers depend on how it ends."""

WANTED = LATE + 4
"""Dwells of a flight."""


@dataclass
class Flight:
    """A flight that has ended: its bag, exit status and output of its program, and accounts of its nodes."""

    bag: Path
    status: int
    said: str
    accounts: dict[str, Account]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """A mover on a street, and a lidar with other gains than described, slow enough that no dwell is lost."""
    folder = tmp_path_factory.mktemp("flight")
    target = TargetSettings(0.1, 0.5, 0.8, 30.0, radial_velocity_mps=8.003)
    faults = Impairments(undescribed_gains_db=(0.8, -0.8, 1.2, -0.5, 0.3, -1.3, 0.6, -0.3))
    record_sensor(replace(load_preset("small"), targets=(target,), dwells=8, impairments=faults), 3, folder / "sensor")
    (folder / "flight.yaml").write_text(CONFIGURATION.format(folder=folder))
    book = AccountBook()
    with free_domain() as domain, Graph(domain) as graph:
        graph.add(Watcher(book, context=graph.context))
        client = graph.add(Node("pilot", context=graph.context)).create_client(Trigger, "/lidar/paced_player/start")
        with subprocess.Popen(  # noqa: S603 (our own program)
            [sys.executable, "-m", "sal_height", "live", str(folder / "flight.yaml")],
            env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as program:

            def until(condition: Callable[[], bool]) -> None:
                assert graph.spin_until(lambda: condition() or program.poll() is not None, DEADLINE_S)
                assert program.poll() is None

            def account(name: str) -> Account:
                return book.entries[f"lidar/{name}"].account

            try:
                until(lambda: all(f"lidar/{name}" in book.entries and account(name).ready for name in STAGES))
                until(client.service_is_ready)
                assert client.call_async(Trigger.Request()) is not None
                until(lambda: account("mover_detection").published_on.get("lidar/movers", 0) >= WANTED)
                until(lambda: account("height_adjuster").published_on.get("lidar/adjusted/height", 0) >= WANTED)
                program.send_signal(signal.SIGINT)
                said, _ = program.communicate(timeout=DEADLINE_S)
            finally:
                program.kill()
        return Flight(folder / "bag", program.returncode, said, {name: account(name) for name in STAGES})


def products(bag: Path, topic: str) -> dict[int, Any]:
    """The messages of a topic, without namespace, by their stamps, ns."""
    reader = BagReader(bag)
    found = [
        reader.decode(m.type_name, m.cdr) for m in reader.messages([n for n in reader.topics if n.endswith(topic)])
    ]
    return {one.header.stamp.sec * 10**9 + one.header.stamp.nanosec: one for one in found}


def test_every_dwell_is_accounted_for(flight: Flight) -> None:
    assert flight.status == 0, flight.said
    assert "Traceback" not in flight.said
    for name, account in flight.accounts.items():
        assert account.received == account.processed + sum(account.dropped.values()) + account.waiting, name
        assert account.processed > 0, name
        assert not account.dropped.keys() - {"ended"}, name


def test_movers_are_found_and_calibrations_are_applied(flight: Flight) -> None:
    clouds = list(products(flight.bag, "/movers").values())
    assert len(clouds) >= WANTED
    assert {cloud.width for cloud in clouds} == {0, 1}
    made = {one.id for one in products(flight.bag, "/calibration").values()}
    used = [image.provenance.calibration_id for image in products(flight.bag, "/ml/height").values()]
    assert used[0] == ""
    assert len(made) >= 2
    first = next(number for number, one in enumerate(used) if one)
    assert set(used[first:]) <= made


def test_a_replay_by_calls_makes_the_same(flight: Flight, tmp_path: Path) -> None:
    result = replay(flight.bag, tmp_path / "out", {}, part=Part(namespace="lidar"), jobs=1)
    assert {topic: one.verdict for topic, one in result.compared.items()} == dict.fromkeys(
        ("/ml/height", "/tracked/height", "/adjusted/height"), EQUAL
    )
    assert result.compared["/adjusted/height"].matched >= WANTED
    assert result.shortfalls(changed=False) == []
    again = tmp_path / "out" / "bag"
    for topic, late in (("/movers", LATE), ("/adjusted/odometry", 0)):
        flown, made = products(flight.bag, topic), products(again, topic)
        compared = list(flown)[: len(flown) - late]
        assert len(compared) >= WANTED - LATE, topic
        assert [repr(flown[stamp]) for stamp in compared] == [repr(made[stamp]) for stamp in compared], topic
