"""The command view: what it writes is read by others, what it cannot show is counted, and it needs the viewer."""

from __future__ import annotations

import os
import re
import runpy
import signal
import socket
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence, publisher_of
from rclpy.node import Node

from benchmarks.hostile_messages import hostile
from sal_height.bag import qos
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import BagWriter
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.messages import field_from_message, to_ns
from sal_height.messages.types import HeightImage, Odometry
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.qos import FRAMES_QOS
from sal_height.view.drawings import Picture, ReceivedMessage, Sheet
from sal_height.view.listener import Listener
from sal_height.view.painter import HEIGHT_IMAGE
from sal_height.view.show import show_live

rr = pytest.importorskip("rerun", reason="the extra 'view' is not installed: pip install rerun-sdk")

from sal_height.view.screen import file_screen, page_screen  # noqa: E402
from sal_height.view.viewer import open_window  # noqa: E402

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags" / "version_3"
TOOL = ROOT / "tools" / "view_picture.py"
TIMEOUT_S = 120.0


@pytest.fixture(autouse=True)
def own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The viewer keeps its settings in a folder of the test, and tells nobody of its use."""
    monkeypatch.setenv("HOME", str(tmp_path))
    words = [sys.executable, "-m", "rerun_cli", "analytics", "disable"]
    subprocess.run(words, check=True, capture_output=True, timeout=TIMEOUT_S)  # noqa: S603 (the viewer's own)


def rows_of(file: Path) -> dict[str, list[dict[str, Any]]]:
    """Rows of a recording by entity: columns by name, as Rerun's own reader gives them."""
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for chunk in rr.chunk.RrdReader(file).stream():
        batch = chunk.to_record_batch()
        for number in range(batch.num_rows):
            rows[chunk.entity_path].append({name: batch.column(name)[number] for name in batch.schema.names})
    return rows


@pytest.mark.parametrize("version", ["version_0", "version_1", "version_2", "version_3"])
def test_a_bag_becomes_a_file_that_the_viewers_own_reader_reads(version: str, tmp_path: Path) -> None:
    bag, file = ROOT / "bags" / version, tmp_path / "new" / "flight.rrd"
    assert main(["view", str(bag), "--save", str(file)]) == 0
    assert [path.name for path in file.parent.iterdir()] == ["flight.rrd"]
    words = [sys.executable, "-m", "rerun_cli", "rrd", "verify", str(file)]
    subprocess.run(words, check=True, capture_output=True, timeout=TIMEOUT_S)  # noqa: S603 (the viewer's own)
    rows, reader = rows_of(file), BagReader(bag)
    for estimator, surfaces in {"ml": 3, "monopulse": 1, "tracked": 3}.items():
        images = [reader.decode(m.type_name, m.cdr) for m in reader.messages([f"/{estimator}/height"])]
        number = min(surfaces, len(images[0].surfaces))
        names = [f"/{estimator}/{name}" for name in ("height", "sigma", "validity")]
        names += [f"/map/{estimator}/surface_{i + 1}" for i in range(number)]
        assert {name: len(rows[name]) for name in names} == dict.fromkeys(names, len(images))
        assert f"/map/{estimator}/surface_{number + 1}" not in rows
        for row, image in zip(rows[f"/map/{estimator}/surface_1"], images, strict=True):
            first = field_from_message(image).first
            there = first.is_determined
            assert row["stamp"].value == to_ns(image.header.stamp)
            assert len(row["Points3D:positions"].as_py()) == there.sum() > 0
            assert np.allclose(row["height_m"].as_py(), first.height[there], atol=1e-6)
            assert np.allclose(row["sigma_m"].as_py(), first.sigma[there], rtol=1e-5)
    assert len(rows["/map/platform/track"]) >= 1
    assert bool(rows["/rates/ml_height/offered"]) == (
        version in {"version_2", "version_3"}
    )  # nodes did not tell it before
    assert rows["/latency/ml_height/p95"]
    assert rows["/drops/ml_height"][-1]["Scalars:scalars"].as_py() == [0.0]
    assert len(rr.chunk.RrdReader(file).blueprints()) >= 1


def test_a_bad_message_is_skipped_and_counted_and_the_others_are_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reader, rng = BagReader(BAG), np.random.default_rng(2)
    good = list(reader.messages(["/ml/height"]))
    decoded = reader.decode(HEIGHT_IMAGE, good[0].cdr)
    spoilt = [good[0].cdr[:100], *hostile(decoded, 40, rng)]
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/ml/height", HEIGHT_IMAGE, [qos.FRAMES])
        for time_ns, cdr in enumerate([good[0].cdr, *spoilt, good[1].cdr]):
            bag.write("/ml/height", cdr, time_ns + 1, time_ns + 1)
    assert main(["view", str(tmp_path / "bag"), "--save", str(tmp_path / "a.rrd")]) == 0
    said = capsys.readouterr()
    counts = [int(line.split()[1]) for line in said.err.splitlines() if " not shown (" in line]
    assert sum(counts) + int(said.out.split()[0]) == len(spoilt) + 2
    assert "(unreadable): A message of type sal_height_msgs/msg/HeightImage in bag" in said.err
    assert "unexpected" not in said.err
    rows = rows_of(tmp_path / "a.rrd")
    assert len(rows["/ml/height"]) == int(said.out.split()[0])
    stamps = [row["stamp"].value for row in rows["/ml/height"]]
    assert {to_ns(reader.decode(HEIGHT_IMAGE, m.cdr).header.stamp) for m in good} <= set(stamps)
    assert rows["/messages/view"]


def test_a_live_graph_is_shown_until_it_is_over(
    graph: Graph, domain_id: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = BagReader(BAG)
    heights = [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/ml/height"])]
    states = [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/platform/odometry"])]
    source = graph.add(Node("source", context=graph.context))
    publishers = {
        HeightImage: publisher_of(source, HeightImage, "ml/height", FRAMES_QOS),
        Odometry: publisher_of(source, Odometry, "platform/odometry", FRAMES_QOS),
    }
    taken: Counter[str] = Counter()
    expected = {"/ml/height": len(heights), "/platform/odometry": len(states)}
    deadline = time.monotonic() + TIMEOUT_S
    with file_screen(tmp_path / "live.rrd", "live", 10.0) as screen, Listener("", 10**7, domain_id) as listener:
        hear, published = listener.received, []

        def received() -> ReceivedMessage | None:
            one = hear()
            taken.update([one.topic] if one else [])
            return one

        def is_over() -> bool:
            """Whether all has come that is published once both topics are listened to."""
            if not published and all(p.get_subscription_count() == 1 for p in publishers.values()):
                published.extend([*heights, *states])
                for message in published:
                    publishers[type(message)].publish(message)
            graph.spin_until(lambda: True)
            return taken == expected or time.monotonic() > deadline

        monkeypatch.setattr(listener, "received", received)
        shown = show_live(listener, screen, is_over)
    assert shown.drawn == expected
    assert not shown.skipped
    rows = rows_of(tmp_path / "live.rrd")
    assert len(rows["/ml/height"]) == len(heights)
    assert rows["/map/platform/track"]


def test_a_live_view_ends_at_an_interrupt_with_a_complete_file(graph: Graph, domain_id: int, tmp_path: Path) -> None:
    image = next(iter(BagReader(BAG).messages(["/ml/height"])))
    source = graph.add(Node("source", context=graph.context))
    publisher = publisher_of(source, HeightImage, "ml/height", FRAMES_QOS)
    words = ["view", "--domain", str(domain_id), "--save", str(tmp_path / "a.rrd")]
    with subprocess.Popen([sys.executable, "-m", "sal_height", *words], stdout=subprocess.PIPE, text=True) as view:  # noqa: S603
        assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, TIMEOUT_S)
        publisher.publish(image.cdr)
        file = tmp_path / ".a.rrd.part"
        size = file.stat().st_size
        assert graph.spin_until(lambda: file.stat().st_size > size + len(image.cdr), TIMEOUT_S)
        view.send_signal(signal.SIGINT)
        said, _ = view.communicate(timeout=TIMEOUT_S)
    assert view.returncode == 0
    assert said.startswith("1 message shown on /ml/height\n")
    assert len(rows_of(tmp_path / "a.rrd")["/ml/height"]) == 1


def test_a_live_view_without_messages_ends_with_status_1(
    domain_id: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "nice", lambda _: 0)  # other tests run in this process
    words = ["--domain", str(domain_id), "--seconds", "0.5", "--save", str(tmp_path / "a.rrd")]
    assert main(["view", *words]) == 1
    assert capsys.readouterr().out.startswith("0 messages shown on no topic\n")


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ([str(BAG), "--save", "{}/a.rrd", "--web"], ["--save", "--web", "exclude"]),
        ([str(BAG), "--port", "9090", "--save", "{}/a.rrd"], ["--port", "--web"]),
        ([str(BAG), "--save", "{}/there.rrd"], ["there.rrd", "exists"]),
        ([str(BAG), "--namespace", "uav7", "--save", "{}/a.rrd"], ["uav7", "/ml/height"]),
        (["{}/nothing", "--save", "{}/a.rrd"], ["nothing"]),
    ],
)
def test_wrong_use_is_told_in_a_sentence_and_leaves_no_file(
    words: list[str], parts: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "there.rrd").write_text("mine")
    assert main(["view", *(word.format(tmp_path) for word in words)]) == 2
    assert_one_sentence(capsys.readouterr().err.strip().removeprefix("sal-height: "), *parts)
    assert not [path for path in tmp_path.glob("*.rrd*") if path.name != "there.rrd"]
    assert (tmp_path / "there.rrd").read_text() == "mine"


def test_without_a_display_the_window_is_refused_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)

    def open_until_it_ends() -> None:
        with open_window(500) as viewer:  # where it ends at once, this fails already
            deadline = time.monotonic() + TIMEOUT_S
            while viewer.is_open() and time.monotonic() < deadline:
                time.sleep(0.05)  # the end of another program tells nobody
            viewer.check()

    with pytest.raises(UserError) as refusal:
        open_until_it_ends()
    assert_one_sentence(str(refusal.value), "The Rerun viewer ended", "DISPLAY", "--web", "--save")


def test_a_viewer_that_hangs_is_ended_and_the_command_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sal_height.view.screen.STUCK_S", 1.0)
    monkeypatch.setattr("sal_height.view.screen.HAND_OVER_S", 1.0)
    started: list[int] = []
    popen = subprocess.Popen

    def start(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        process = popen(*arguments, **options)
        started.append(process.pid)
        return process

    monkeypatch.setattr("sal_height.view.viewer.subprocess.Popen", start)
    noise = np.random.default_rng(1).integers(0, 255, (1000, 1000, 3), dtype=np.uint8)

    def show_until_it_ends() -> None:
        with page_screen(None, 500, "hangs", 10.0) as screen:
            os.killpg(started[0], signal.SIGSTOP)
            deadline = time.monotonic() + TIMEOUT_S
            while screen.is_open() and time.monotonic() < deadline:
                screen.show(Sheet(0, 0, (Picture("noise", noise),)))

    with pytest.raises(UserError) as refusal:
        show_until_it_ends()
    assert_one_sentence(str(refusal.value), "took nothing")


@pytest.fixture
def page() -> Iterator[str]:
    """Address of the page of a bag, and the program that serves it."""
    with runpy.run_path(str(TOOL))["served"]([str(BAG)]) as address:
        yield address


def test_the_page_is_served_to_this_machine_only(page: str) -> None:
    ports = [int(port) for port in re.findall(r"(?::|%3A)(\d+)", page)]
    assert len(ports) == 2
    for port in ports:
        socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S).close()
        for address in own_addresses():
            with pytest.raises(OSError, match="refused"):
                socket.create_connection((address, port), timeout=TIMEOUT_S)


def own_addresses() -> list[str]:
    """Addresses of this machine other than the local one: 127.0.0.2 always is one."""
    found = {str(info[4][0]) for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    return sorted((found | {"127.0.0.2"}) - {"127.0.0.1"})


def test_a_browser_shows_the_page_of_a_bag(page: str, tmp_path: Path) -> None:
    tool = runpy.run_path(str(TOOL))
    if lacking := tool["missing"]():
        pytest.skip(f"not installed: {lacking}")
    image = tool["picture_of"](page)
    image.save(tmp_path / "page.png")
    assert tool["colours"](image) > tool["COLOURS"]
    pixels = np.asarray(image).astype(int)
    left = pixels[: pixels.shape[0] // 2, : pixels.shape[1] // 2]
    assert (np.ptp(left, axis=-1) > 100).mean() > 0.005  # points in saturated colours
