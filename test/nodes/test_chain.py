"""The chain on good input: what comes out, with what stamp, provenance and diagnostics."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chain_fixture import DETECTORS, START_NS, Chain, StageChain, next_dwell_is_exact
from helpers import RAW_WAVEFORMS, assert_one_sentence, publisher_of, with_waveform
from instrument_messages import in_aviation_axes
from programs import Program
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.elevation.array.estimate import MEASURED
from sal_height.errors import UserError
from sal_height.geometry.earth import height_of
from sal_height.messages.types import (
    ChannelFrame,
    DiagnosticArray,
    HeightImage,
    Image,
    PointCloud2,
    TFMessage,
    TransformStamped,
)
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.lit_surfaces import truth_image


@pytest.fixture
def fed(flight: SimulatedFlight) -> StageChain:
    """Stages that have made the heights of dwell 0."""
    chain = StageChain(flight)
    chain.fly()
    return chain


@pytest.fixture
def nodes(chain: Chain) -> Chain:
    """Nodes that have made the heights of dwell 0."""
    chain.fly()
    return chain


def assert_heights_agree(fed: StageChain) -> None:
    image = fed.heights["ml", 0]
    grid, aperture = messages.grid_from_message(image.grid), messages.aperture_from_message(image.aperture)
    sensor = fed.flight.sensor
    cell = sensor.range_resolution * sensor.wavelength * 5000.0 / (2 * aperture.length)
    truth = truth_image(fed.flight.surface(0), aperture, grid, cell, sensor.beams)
    height = messages.float_view(image.surfaces[0].height, grid.shape)
    sigma = messages.float_view(image.surfaces[0].sigma, grid.shape)
    usable = np.isfinite(height) & truth.single
    scaled = ((height - truth.height) / sigma)[usable]
    assert usable.sum() > 50
    # The median of n standardised errors has a standard error of 1.25 / sqrt(n).
    assert abs(np.median(scaled)) < 4 * 1.25 / np.sqrt(usable.sum())
    assert np.mean(np.abs(scaled) < 2) > 0.8


def test_heights_agree_with_the_terrain(fed: StageChain) -> None:
    assert_heights_agree(fed)


@pytest.mark.parametrize("waveform", RAW_WAVEFORMS)
def test_heights_from_raw_echoes_agree_with_the_terrain_too(flight: SimulatedFlight, waveform: str) -> None:
    preset = with_waveform(flight.preset, waveform)
    chain = StageChain(replace(flight, preset=preset, sensor=preset.make_sensor()))
    chain.fly()
    assert_heights_agree(chain)


def test_odometry_in_axes_of_aviation_gives_the_same_heights(
    flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage]
) -> None:
    """With parameters map_axes and body_axes; the attitude is rounded once more, by 1e-16, in a phase of 1e4 rad."""
    image = {"rows": 46, "cols": 12, "map_axes": "ned", "body_axes": "frd"}
    chain = StageChain(flight, image=image)
    states = [in_aviation_axes(state) for state in flight.platform_states(0)]
    odometry = [messages.state_to_message(state, messages.to_stamp(START_NS + state.stamp_ns)) for state in states]
    chain.publish(chain.sensor_info(), *odometry, *chain.frames(0))
    chain.await_heights(0)
    for key, ours in chain.heights.items():
        assert np.array_equal(ours.validity, reference[key].validity)
        for name in ("height", "sigma", "east", "north"):
            mine, theirs = (np.array(getattr(one.surfaces[0], name)) for one in (ours, reference[key]))
            np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-4)


def test_stamp_dwell_and_frame_are_those_of_the_input(fed: StageChain) -> None:
    frame = fed.frames(0)[0]
    for image in fed.heights.values():
        assert image.header.stamp == frame.header.stamp
        assert image.header.frame_id == "map"
        assert image.dwell == frame.dwell


def test_provenance_names_every_stage_with_its_parameters(fed: StageChain) -> None:
    provenance = fed.heights["ml", 0].provenance
    assert provenance.config_hash == fed.flight.sensor.config_hash
    parameters = messages.stages_of(provenance.parameters)
    assert parameters["sar_compression"]["range_window"] == "taylor"
    assert parameters["ml_height"]["objective"] == "normalised"


def test_invalid_pixels_are_nan_and_valid_ones_are_not(fed: StageChain) -> None:
    for image in fed.heights.values():
        valid = np.isin(image.validity, MEASURED)
        for field in ("height", "sigma", "east", "north"):
            assert np.array_equal(np.isfinite(np.array(getattr(image.surfaces[0], field))), valid)
        assert np.all(np.array(image.surfaces[0].sigma)[valid] > 0)


def test_position_of_a_pixel_has_its_height(nodes: Chain, graph: Graph) -> None:
    clouds: list[PointCloud2] = []
    pictures: list[Image] = []
    frames: list[TransformStamped] = []
    listener = graph.add(Node("viewer", context=graph.context))
    subscribe(listener, TransformStamped, "ml/frame", frames.append, 10)
    subscribe(listener, PointCloud2, "ml/points", clouds.append, 10)
    subscribe(listener, Image, "ml/image", pictures.append, 10)
    nodes.wait(lambda: listener.count_publishers("ml/points") and listener.count_publishers("ml/image"), "discovery")
    shown = [p for p in nodes.stages["ml_height"]._offered if p.topic in {"/ml/points", "/ml/frame", "/ml/image"}]
    nodes.wait(lambda: len(shown) == 3 and all(p.subscribers for p in shown), "the viewer")
    nodes.publish(*nodes.odometry(1), *nodes.frames(1))
    nodes.await_heights(1)
    nodes.wait(lambda: clouds and pictures and frames, "points, their frame and picture")
    image = nodes.heights["ml", 1]
    assert frames[0].header == image.header
    assert frames[0].child_frame_id == clouds[0].header.frame_id == "ml_origin"
    shift = frames[0].transform.translation
    assert (shift.x, shift.y, shift.z) == (image.grid.origin.x, image.grid.origin.y, image.grid.origin.z)
    points = np.frombuffer(clouds[0].data, np.float32).reshape(-1, len(clouds[0].fields)).astype(np.float64)
    height, east = (
        np.concatenate([np.array(getattr(surface, name)) for surface in image.surfaces]) for name in ("height", "east")
    )
    seen = np.isfinite(height)
    assert len(points) == np.count_nonzero(seen)
    assert np.allclose(height_of(points[:, :3] + np.array([shift.x, shift.y, shift.z])), height[seen], atol=1e-5)
    assert np.allclose(points[:, 0], east[seen], atol=1e-6)
    picture = np.frombuffer(pictures[0].data, np.float32)
    assert np.array_equal(picture, np.array(image.surfaces[0].height, dtype=np.float32), equal_nan=True)
    assert (pictures[0].encoding, pictures[0].height, pictures[0].width) == ("32FC1", image.grid.rows, image.grid.cols)


def test_the_frame_of_the_points_is_on_tf(nodes: Chain, graph: Graph) -> None:
    """With the namespace in its name, for /tf is common to all."""
    transforms: list[Any] = []
    listener = graph.add(Node("viewer", context=graph.context))
    subscribe(listener, TFMessage, "/tf", transforms.append, 100)
    subscribe(listener, PointCloud2, "ml/points", lambda _: None, 10)
    heard = [p for p in nodes.stages["ml_height"]._offered if p.topic in {"/tf", "/ml/points"}]
    nodes.wait(lambda: len(heard) == 2 and all(p.subscribers for p in heard), "the viewer")
    nodes.publish(*nodes.odometry(1), *nodes.frames(1))
    nodes.wait(lambda: transforms, "a transform")
    (transform,) = transforms[0].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "ml_origin")
    assert transform.transform.rotation.w == 1.0


def test_every_message_is_accounted_for_in_the_diagnostics(nodes: Chain, graph: Graph) -> None:
    accounts: dict[str, dict[str, str]] = {}

    def keep(message: DiagnosticArray) -> None:
        accounts.update({s.name: {v.key: v.value for v in s.values} for s in message.status})

    subscribe(graph.add(Node("watcher", context=graph.context)), DiagnosticArray, "/diagnostics", keep, 10)
    nodes.wait(lambda: {"sar_compression", "ml_height", "monopulse"} <= set(accounts), "diagnostics")
    for stage, out in (("sar_compression", 8), ("ml_height", 1), ("monopulse", 1)):
        nodes.wait(lambda s=stage: accounts[s]["waiting"] == "0", "the work to end")
        assert accounts[stage]["in"] == accounts[stage]["processed"] == "8"
        assert accounts[stage]["out"] == str(out)
        assert float(accounts[stage]["latency_p95_ms"]) >= float(accounts[stage]["latency_p50_ms"]) > 0


def test_more_looks_than_pixels_cost_the_dwell_and_no_more(fed: StageChain) -> None:
    node = fed.stages["ml_height"]
    node.set(range_looks=47)
    fed.publish(*fed.odometry(1), *fed.frames(1))
    fed.await_drops("ml_height", "cannot be processed", DETECTORS)
    assert "Looks are 47 x 2 in an image of 46 x 12 pixels" in node.last_rejection
    node.set(range_looks=46)
    fed.publish(*fed.odometry(2), *fed.frames(2))
    fed.await_heights(2)
    assert fed.heights["ml", 2].grid.rows == 1


def test_looks_that_slide_give_a_height_to_every_pixel(fed: StageChain) -> None:
    before = fed.heights["ml", 0]
    changes = {"range_step": 1, "azimuth_step": 1, "look_window": "triangular", "range_looks": 4, "azimuth_looks": 3}
    fed.stages["ml_height"].set(**changes)
    fed.publish(*fed.odometry(1), *fed.frames(1))
    fed.await_heights(1)
    after = fed.heights["ml", 1]
    assert (after.grid.rows, after.grid.cols) == (46, 12)
    assert after.grid.row_spacing == pytest.approx(before.grid.row_spacing / 2)
    assert messages.stages_of(after.provenance.parameters)["ml_height"]["look_window"] == "triangular"
    assert np.isfinite(np.array(after.surfaces[0].height)).mean() > 0.3


def test_a_parameter_set_at_run_time_takes_effect_at_the_next_dwell(nodes: Chain) -> None:
    before = nodes.heights["ml", 0]
    result = nodes.stages["ml_height"].set_parameters([Parameter("range_looks", value=4)])
    assert result[0].successful
    nodes.publish(*nodes.odometry(1), *nodes.frames(1))
    nodes.await_heights(1)
    after = nodes.heights["ml", 1]
    assert (before.range_looks, after.range_looks) == (2, 4)
    assert (before.grid.rows, after.grid.rows) == (23, 12)
    assert messages.stages_of(after.provenance.parameters)["ml_height"]["range_looks"] == 4


@pytest.mark.parametrize(
    ("node", "name", "value", "said"),
    [
        ("ml_height", "objective", "best", "normalised, numerator"),
        ("ml_height", "range_looks", 0, "from 1 to 4096"),
        ("ml_height", "range_looks", "many", "whole number"),
        ("monopulse", "discriminant", "mean", "tls, ratio, noise_subtraction"),
        ("sar_compression", "range_window", "square", "hamming, rectangular, taylor"),
        ("sar_compression", "timeout_s", -1.0, "from 0.01 to 3600"),
    ],
)
def test_a_wrong_parameter_is_refused_in_one_sentence(node: str, name: str, value: Any, said: str) -> None:
    with pytest.raises(UserError) as error:
        PROCESSING[node].parameters(**{name: value})
    assert_one_sentence(str(error.value), name, said)


def test_every_node_is_a_program(tmp_path: Path, domain_id: int) -> None:
    """Processing nodes by `python -m`, the others by what their console scripts call."""
    wrong = ["--ros-args", "-p", "no_such_thing:=1", "-p", "preset:=no_such_preset", "-p", "timeout_s:=-1.0"]
    wrong += ["-p", f"bag:={tmp_path}"]
    module = subprocess.Popen(  # noqa: S603 (our own module)
        [sys.executable, "-m", "sal_height.nodes.processing", "ml_height", *wrong],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    forked = [
        Program(f"sal_height.nodes.{name}", "program", *wrong, domain_id=domain_id)
        for name in ("simulator", "playing.player")
    ]
    for program in (module, *forked):  # which start side by side
        _, errors = program.communicate(timeout=600)
        assert program.returncode == 2, errors
        assert "Traceback" not in errors


def test_two_sources_of_one_channel_are_named(chain: Chain, graph: Graph, reference: Any) -> None:
    other = graph.add(Node("other_driver", context=graph.context))
    publisher = publisher_of(other, ChannelFrame, "phase_history", FRAMES_QOS)
    chain.wait(lambda: publisher.get_subscription_count() == 1, "the other driver")
    frames = chain.frames(0)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames[:4])
    chain.wait(lambda: chain.accounts()["sar_compression"]["in"] == 4, "the frames")
    publisher.publish(frames[2])
    chain.await_drops("sar_compression", "duplicate", 1)
    said = chain.stages["sar_compression"].last_drop
    assert "Dwell 0, channel 2: the same message was received twice." in said
    assert "2 nodes publish phase_history: each must have channels of its own." in said
    chain.publish(*frames[4:])
    next_dwell_is_exact(chain, reference)


def test_a_clock_that_stands_still_or_is_not_there_changes_nothing(
    graph: Graph, flight: SimulatedFlight, reference: Any
) -> None:
    """Nodes take simulated time and nobody publishes /clock: dwells and timeouts go by stamps and a steady clock."""
    simulated = {"use_sim_time": True}
    chain = Chain(graph, flight, 0.5, image={"rows": 46, "cols": 12, **simulated}, heights=simulated)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0)[:3])
    chain.await_drops("sar_compression", "incomplete dwell", 3)
    next_dwell_is_exact(chain, reference)
    assert chain.stages["sar_compression"].get_clock().now().nanoseconds == 0
