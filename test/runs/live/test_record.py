"""The command that records what is published."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import assert_one_sentence
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.nodes.transport.graph import Graph

TIMEOUT_S = 600.0


def start(domain_id: int, out: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "sal_height", "record", "--domain", str(domain_id), "--out", str(out), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)  # noqa: S603


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    try:
        out, err = process.communicate(timeout=TIMEOUT_S)
    finally:
        process.kill()
    return process.returncode, out, err


def test_what_is_published_is_recorded_until_ctrl_c(graph: Graph, domain_id: int, tmp_path: Path) -> None:
    node = graph.add(Node("source", context=graph.context))
    node.declare_parameter("gain", 2.0)
    publishers = [node.create_publisher(String, name, 10) for name in ("/a/one", "/a/two", "/b/one")]
    process = start(domain_id, tmp_path / "bag", "/b/one", "--match", "/a/.*", "--exclude", ".*two")
    wanted = publishers[0], publishers[2]
    assert graph.spin_until(lambda: all(p.get_subscription_count() == 1 for p in wanted), TIMEOUT_S)
    for number in range(5):
        for publisher in publishers:
            publisher.publish(String(data=f"{publisher.topic_name} {number}"))
    (file,) = (tmp_path / "bag").glob("*.mcap")
    for text in (b"/b/one 4", b"gain"):
        assert graph.spin_until(lambda text=text: text in file.read_bytes(), TIMEOUT_S), text
    process.send_signal(signal.SIGINT)
    status, out, err = ended(process)
    assert (status, err) == (0, "")
    texts = [
        deserialize_message(m.cdr, String).data for m in BagReader(tmp_path / "bag").messages(["/a/one", "/b/one"])
    ]
    assert sorted(texts) == sorted(f"{topic} {number}" for topic in ("/a/one", "/b/one") for number in range(5))
    lines = [line.split() for line in out.splitlines()]
    assert ["/a/one", "5"] in lines
    assert ["/b/one", "5"] in lines
    assert "/a/two" not in out


def test_if_nothing_comes_that_is_said(domain_id: int, tmp_path: Path) -> None:
    status, _, err = ended(start(domain_id, tmp_path / "bag", "/nowhere", "--seconds", "0.5"))
    assert status == 1
    assert_one_sentence(err.strip().removeprefix("sal-height: "), "No message was received", "domain")
    assert BagReader(tmp_path / "bag").message_count == 0


@pytest.mark.parametrize(
    ("options", "word"),
    [(("--match", "*"), "regular expression"), (("--split-mb", "0"), "--split-mb"), (("--compression", "zip"), "zstd")],
)
def test_what_cannot_be_used_is_refused(
    options: tuple[str, ...], word: str, domain_id: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", "--domain", str(domain_id), "--out", str(tmp_path / "bag"), *options]) == 2
    assert_one_sentence(capsys.readouterr().err.strip().removeprefix("sal-height: "), word)
    assert not (tmp_path / "bag").exists()
