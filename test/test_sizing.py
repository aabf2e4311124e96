"""What benchmarks conclude from what they measure, and the tables of docs/size_your_computer.md."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from helpers import publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter

from benchmarks import growth, live_runs, sizing
from benchmarks.idle_nodes import IDLE
from benchmarks.processes import OWN, Usage, memory_bytes
from benchmarks.sizes import lidar, made_up_images
from sal_height import messages
from sal_height.messages.types import ChannelFrame, ComplexImage, Header, HeightImage, Provenance, SensorInfo
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS

OFFERED_HZ, SECONDS = 80.0, 20.0


def graph_that_sustains(limit: float, rate: float) -> live_runs.Seen:
    """What would be seen of a graph that processes so much of a sensor: the rest is dropped."""
    offered = OFFERED_HZ * rate * SECONDS
    done = min(offered, OFFERED_HZ * limit * SECONDS)
    latencies = {"ml/height": [0.0] * int(done)}
    return live_runs.Seen(OFFERED_HZ * rate, SECONDS, math.ceil(offered - done), 0, latencies, Usage(), 0.0, 0, 0)


@pytest.mark.parametrize("limit", [0.02, 0.17, 0.3, 1.0, 2.7])
def test_the_highest_rate_is_found_from_any_guess_near_it(limit: float) -> None:
    for guess in (0.3 * limit, 0.8 * limit, limit, 1.5 * limit, 3.0 * limit):
        rate, seen = live_runs.highest_rate(lambda rate: graph_that_sustains(limit, rate), guess)
        assert seen.left_out == 0
        assert (0.89 if guess > 0.5 * limit else 0.8) * limit <= rate <= 1.001 * limit


def test_a_graph_that_sustains_nothing_has_the_rate_0() -> None:
    rate, seen = live_runs.highest_rate(lambda rate: graph_that_sustains(0.0, rate), 1.0)
    assert rate == 0
    assert seen.left_out


def test_processor_time_and_memory_of_processes_are_those_they_use() -> None:
    """A process works for 0.5 s of processor time with 100 MB, and says so: it is seen while it waits."""
    work = (
        "import sys, time; held = bytearray(b'1') * 100_000_000\n"
        "while time.process_time() < 0.5: pass\n"
        "print('done', flush=True); sys.stdin.read()"
    )
    program = [sys.executable, "-c", "open('/proc/self/comm', 'w').write('busy')\n" + work]
    with subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:  # noqa: S603 (our own code)
        assert process.stdout
        assert process.stdin
        process.stdout.readline()
        usage = Usage()
        usage.take()
        together = memory_bytes()
        process.stdin.close()
    (sample,) = usage.samples
    assert sample.cpu_s["busy"] == pytest.approx(0.5, abs=0.1)
    assert 100e6 < sample.resident["busy"] < 130e6
    assert sample.resident[OWN] > 30e6
    assert 100e6 < together <= sum(sample.resident.values())


def test_costs_of_units_are_found_from_points() -> None:
    """Of curves over detectors, pixels and looks, with 3 % of error, within 10 %."""
    rng, costs = np.random.default_rng(1), {"dwell": 2e-3, "pixel": 1e-6, "pixel · look · detector²": 3e-9}
    points = [
        *({"detectors": n, "pixels": 552, "looks": 4} for n in (2, 4, 8, 16, 32, 64, 128)),
        *({"detectors": 16, "pixels": n, "looks": 4} for n in (10**4, 10**5, 10**6)),
        *({"detectors": 16, "pixels": 552, "looks": n} for n in (1, 4, 16, 64)),
    ]
    units = sizing.MODEL["monopulse"]
    for point in points:
        true = sum(cost * units[unit](point) for unit, cost in costs.items())
        point["seconds"] = true * (1 + rng.uniform(-0.03, 0.03))
    found = sizing.constants({"monopulse": points})["monopulse"]
    assert found == {unit: pytest.approx(cost, rel=0.1) for unit, cost in costs.items()}


def test_the_exponent_is_that_of_the_upper_half() -> None:
    sizes = [2, 4, 8, 16, 32, 64, 128]
    assert growth._exponent(sizes, [1e-6 * n**2.5 for n in sizes]) == pytest.approx(2.5)
    assert growth._exponent(sizes, [1e-3 if n < 16 else 1e-3 * n / 16 for n in sizes]) == pytest.approx(1.0)
    assert np.isnan(growth._exponent([1], [1.0]))


def test_tables_go_to_their_places_and_the_text_stays() -> None:
    text = "before\n<!-- measured: cores -->\nold\n<!-- end -->\nafter\n<!-- measured: constants -->\n<!-- end -->\n"
    once = sizing.filled(text, {"cores": "| new |"})
    assert once == text.replace("old\n", "\n| new |\n\n")
    assert sizing.filled(once, {"cores": "| new |"}) == once
    with pytest.raises(ValueError, match="no place for the table 'other'"):
        sizing.filled(text, {"other": ""})


def test_the_document_has_a_place_for_every_table() -> None:
    text = sizing.DOCUMENT.read_text(encoding="utf-8")
    sizing.filled(text, dict.fromkeys(("cores", "processes", "constants", "transport"), ""))
    assert f"({sizing.PICTURE.name})" in text
    assert sizing.PICTURE.exists()


def test_idle_nodes_publish_the_same_products_again_with_the_stamp_of_the_dwell(graph: Graph) -> None:
    sensor, received = lidar(4), []
    slc = made_up_images(sensor, 46, 12)
    listener = graph.add(Node("listener", context=graph.context))
    subscribe(listener, HeightImage, "monopulse/height", received.append, FRAMES_QOS)
    looks = [Parameter("range_looks", value=2), Parameter("azimuth_looks", value=2)]
    node = graph.add(IDLE["monopulse"](context=graph.context, parameter_overrides=looks))
    info = publisher_of(listener, SensorInfo, "sensor_info", LATCHED_QOS)
    frames = publisher_of(listener, ComplexImage, "slc", FRAMES_QOS)
    info.publish(messages.sensor_to_message(sensor, messages.to_stamp(0)))
    assert graph.spin_until(lambda: node.is_ready and node.count_subscribers("monopulse/height") == 1, 60.0)
    stamps = [messages.to_stamp(second * 10**9) for second in (1, 2, 3)]
    for number, stamp in enumerate(stamps):
        frame = ChannelFrame(header=Header(stamp=stamp), dwell=number)
        images = messages.slc_to_messages(slc, frame, Provenance(config_hash=sensor.config_hash))
        for image in images:
            frames.publish(image)
        assert graph.spin_until(lambda number=number: len(received) == number + 1, 20.0)
    assert [image.header.stamp for image in received] == stamps
    assert {image.dwell for image in received} == {0}  # of the first dwell, the only one that was processed
    assert len({image.surfaces[0].height.tobytes() for image in received}) == 1
