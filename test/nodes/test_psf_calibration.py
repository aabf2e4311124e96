"""A sensor that is not as described, calibrated in the graph, and what calibrations do to images and heights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chain_fixture import DETECTORS, START_NS, TIMEOUT_S, Chain
from helpers import assert_one_sentence, publisher_of
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.calibration.calibration import Calibration, load_calibration, save_calibration
from sal_height.engine.stage import DwellKey
from sal_height.errors import UserError
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.messages.types import ComplexImage, HeightImage
from sal_height.nodes.host import StageNode
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS, LATCHED_QOS
from sal_height.sensor.sensor import PhaseHistory
from sal_height.simulation.flight import SimulatedFlight

COUNT = 64


def fault() -> np.ndarray:
    """Gains that spread by 1 dB and 20 degrees, and a ripple of 2 dB in channel 3: (channels, frequencies)."""
    rng = np.random.default_rng(3)
    gains = 10 ** (rng.normal(0, 1, DETECTORS) / 20) * np.exp(1j * np.radians(rng.normal(0, 20, DETECTORS)))
    response = np.repeat(gains[:, None], COUNT, axis=1)
    response[3] *= np.exp(0.25 * np.cos(2 * np.pi * 6 * np.arange(COUNT) / COUNT))
    return response


class FaultyFlight(SimulatedFlight):
    """A flight whose receivers have `fault`, noise included; the description knows how strong the noise is."""

    def phase_history(self, dwell: int) -> PhaseHistory:
        plain = SimulatedFlight(self.preset, self.preset.make_sensor(), self.scene, self.dwells, self.seed)
        history = plain.phase_history(dwell)
        return replace(history, samples=(history.samples * fault()[:, None]).astype(np.complex64))


def faulty(flight: SimulatedFlight, dwells: int = 3) -> FaultyFlight:
    noise = tuple(np.mean(np.abs(fault()) ** 2, axis=1).tolist())
    sensor = replace(flight.sensor, noise_power=noise, config_hash="")
    return FaultyFlight(flight.preset, sensor, flight.scene, dwells, flight.seed)


def calibration_of(flight: SimulatedFlight, **values: Any) -> Calibration:
    sigmas = {f"{what}_sigma": np.zeros(DETECTORS) for what in ("response", "gain", "phase")}
    given = {"response": fault(), "dwells": 1} | sigmas | values
    return Calibration(flight.sensor.config_hash, **given)


def saved(folder: Path, calibration: Calibration) -> str:
    save_calibration(folder / "calibration.npz", calibration)
    return str(folder / "calibration.npz")


def flown(graph: Graph, flight: SimulatedFlight, calibration: str, missing_after_s: float = 30.0) -> Chain:
    chain = Chain(graph, flight, missing_after_s, {"rows": 46, "cols": 12, "calibration": calibration})
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    return chain


def differences(chain: Chain, reference: Any, estimator: str) -> np.ndarray:
    """Heights less those of the reference (m), where both have one."""
    heights, expected = (np.array(one[estimator, 0].surfaces[0].height) for one in (chain.heights, reference))
    difference = heights - expected
    return difference[np.isfinite(difference)]


def test_a_calibration_that_is_right_gives_the_heights_of_a_perfect_sensor(
    graph: Graph, flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage], tmp_path: Path
) -> None:
    calibration = calibration_of(faulty(flight))
    chain = flown(graph, faulty(flight), saved(tmp_path, calibration))
    chain.await_heights(0)
    for estimator in ("ml", "monopulse"):
        # Equalised noise differs between channels by its last percent: a pixel at a threshold may change sides.
        ours, theirs = (np.array(images[estimator, 0].validity) for images in (chain.heights, reference))
        assert np.count_nonzero(ours != theirs) <= 3
        # Which of two scatterers is the stronger may change with the last digits.
        assert np.quantile(np.abs(differences(chain, reference, estimator)), 0.95) < 2e-3
        assert chain.heights[estimator, 0].provenance.calibration_id == calibration.id


def test_without_it_heights_are_spoilt(
    graph: Graph, flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage]
) -> None:
    chain = flown(graph, faulty(flight), "")
    chain.await_heights(0)
    for estimator in ("ml", "monopulse"):
        assert (
            np.sqrt(np.mean(differences(chain, reference, estimator) ** 2)) > 0.015
        )  # pixels that are spoilt more are not valid
        assert not chain.heights[estimator, 0].provenance.calibration_id


def test_height_nodes_take_the_width_of_the_beams_that_a_calibration_has_found(
    graph: Graph, flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage], tmp_path: Path
) -> None:
    """Wider beams stretch a pair's elevations about its middle: by 5 % and a little, as sinc's slope is not even."""
    wide = calibration_of(flight, response=np.ones((DETECTORS, COUNT)), width_factor=1.05, width_sigma=0.01)
    chain = flown(graph, flight, saved(tmp_path, wide))
    chain.await_heights(0)
    beam_m = flight.sensor.beamwidth * flight.preset.flight.slant_range_m * np.sin(flight.preset.flight.look_angle_rad)
    spread = np.abs(differences(chain, reference, "monopulse"))
    assert 0.05 * 0.1 * beam_m < np.median(spread) < 0.05 * 0.5 * beam_m


@pytest.fixture
def heard(graph: Graph) -> Iterator[list[CalibrationMessage]]:
    """Calibrations that come on the topic."""
    messages: list[CalibrationMessage] = []
    listener = graph.add(_node(graph, "listener"))
    subscribe(listener, CalibrationMessage, "calibration", messages.append, LATCHED_QOS)
    return messages


def _node(graph: Graph, name: str) -> Any:
    from rclpy.node import Node

    return Node(name, context=graph.context)


def calibrator(graph: Graph, **parameters: Any) -> StageNode:
    values = {"dwell_step": 1, "timeout_s": 30.0, **parameters}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    return graph.add(PROCESSING["psf_calibration"](context=graph.context, parameter_overrides=overrides))


def test_the_graph_calibrates_itself(
    graph: Graph, flight: SimulatedFlight, heard: list[CalibrationMessage], tmp_path: Path
) -> None:
    """Eight dwells tell gains of 1 dB and 20 degrees to a fifth; the ninth dwell has them taken off."""
    node = calibrator(graph, dwells=8, file=str(tmp_path / "found.npz"))
    image = {"range_window": "rectangular", "cols": 12, "calibration": "topic"}
    chain = Chain(graph, faulty(flight, dwells=9), 30.0, image)
    for dwell in range(8):
        chain.publish(chain.sensor_info(), *chain.odometry(dwell), *chain.frames(dwell))
        chain.await_heights(dwell)
    chain.wait(lambda: heard and (tmp_path / "found.npz").is_file(), "a calibration")
    found = messages.calibration_from_message(heard[0])
    assert found.id == load_calibration(tmp_path / "found.npz").id == heard[0].id
    assert any("in common: No point target" in sentence for sentence in heard[0].undetermined)
    gains, true = (response.mean(axis=1) for response in (found.response, fault()))
    ratio = np.log(gains / true)
    ratio -= ratio.mean()
    assert 8.686 * np.std(ratio.real) < 0.2
    assert np.degrees(np.std(ratio.imag)) < 4
    chain.wait(lambda: len(chain.stages["sar_compression"].stage._received) > 0, "the calibration to be heard")
    chain.publish(*chain.odometry(8), *chain.frames(8))
    chain.await_heights(8)
    assert chain.heights["ml", 7].provenance.calibration_id == ""
    assert chain.heights["ml", 8].provenance.calibration_id == found.id
    assert graph.spin_until(lambda: "dropped.calibrated already" in node.tally.summary(), TIMEOUT_S)


def test_one_dwell_of_so_many_is_taken_in(
    graph: Graph, flight: SimulatedFlight, heard: list[CalibrationMessage]
) -> None:
    node = calibrator(graph, dwells=2, dwell_step=2)
    chain = Chain(graph, flight, 30.0, {"range_window": "rectangular", "cols": 12})
    chain.publish(chain.sensor_info())
    for dwell in range(3):
        assert not heard
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
        chain.await_heights(dwell)
    chain.wait(lambda: heard, "a calibration")
    assert heard[0].dwells == 2
    assert messages.to_ns(heard[0].header.stamp) == START_NS + flight.dwell_start_ns(2)
    assert node.tally.summary()["in"] == 3 * DETECTORS


def test_weighted_images_do_not_calibrate(graph: Graph, flight: SimulatedFlight) -> None:
    node = calibrator(graph)
    chain = flown(graph, flight, "")
    chain.await_heights(0)
    assert graph.spin_until(lambda: node.tally.summary().get("dropped.cannot be processed") == DETECTORS, TIMEOUT_S)
    assert "range_window rectangular" in node.last_rejection
    assert_one_sentence(node.last_rejection.partition(": ")[2])


def test_images_wait_for_their_calibration_and_go_without_it(
    graph: Graph, flight: SimulatedFlight, tmp_path: Path
) -> None:
    """A height node that has not heard what beams the calibration found makes no heights."""
    images: list[Any] = []
    with_file = flown(graph, faulty(flight), saved(tmp_path, calibration_of(faulty(flight))))
    _listen(graph, ComplexImage, images)
    with_file.publish(*with_file.odometry(1), *with_file.frames(1))
    with_file.wait(lambda: len(images) == DETECTORS, "images")
    deaf = [Parameter("timeout_s", value=0.5)]
    late = graph.add(
        PROCESSING["ml_height"](
            context=graph.context,
            parameter_overrides=deaf,
            cli_args=["--ros-args", "-r", "slc:=other", "-r", "calibration:=unheard", "-r", "__node:=late"],
        )
    )
    feeder = _node(graph, "other_feeder")
    graph.add(feeder)
    publisher = publisher_of(feeder, ComplexImage, "other", FRAMES_QOS)
    assert graph.spin_until(lambda: publisher.get_subscription_count() == 1, TIMEOUT_S)
    with_file.publish(with_file.sensor_info())
    for image in images:
        publisher.publish(image)
    assert graph.spin_until(lambda: late.tally.summary().get("dropped.no calibration") == DETECTORS, TIMEOUT_S)
    assert "was not received on topic calibration" in late.last_rejection


def _listen(graph: Graph, kind: type, into: list[Any]) -> None:
    node = graph.add(_node(graph, "images"))
    subscribe(node, kind, "slc", into.append, FRAMES_QOS)
    assert graph.spin_until(lambda: node.count_publishers("slc") == 1, TIMEOUT_S)


def test_calibrations_that_are_none_are_counted_and_ignored(
    graph: Graph, flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage]
) -> None:
    chain = Chain(graph, flight, 30.0, {"rows": 46, "cols": 12, "calibration": "topic"})
    feeder = graph.add(_node(graph, "calibration_feeder"))
    publisher = publisher_of(feeder, CalibrationMessage, "calibration", LATCHED_QOS)
    chain.wait(lambda: publisher.get_subscription_count() == 3, "the nodes to connect")
    stages = ["sar_compression", "ml_height", "monopulse"]
    good = messages.calibration_to_message(calibration_of(flight), messages.to_stamp(START_NS))
    for number, (field, value, sentence) in enumerate(
        [("id", "", "has no id"), ("response", [1.0, 0.0], "need 512"), ("width_factor", 9.0, "allowed are")], 1
    ):
        bad = messages.calibration_to_message(calibration_of(flight), messages.to_stamp(START_NS))
        setattr(bad, field, value)
        publisher.publish(bad)
        chain.wait(
            lambda number=number: all(
                chain.stages[name].tally.summary().get("ignored.calibration") == number for name in stages
            ),
            "the calibration to be ignored",
        )
        assert sentence in chain.stages["ml_height"].last_rejection
    other = messages.calibration_from_message(good)
    publisher.publish(messages.calibration_to_message(replace(other, config_hash="other"), good.header.stamp))
    chain.wait(lambda: len(chain.stages["sar_compression"].stage._received) > 0, "the calibration of another sensor")
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    assert np.array_equal(
        np.array(chain.heights["ml", 0].surfaces[0].height),
        np.array(reference["ml", 0].surfaces[0].height),
        equal_nan=True,
    )


def test_a_calibration_is_applied_from_the_dwells_on_that_a_replay_states(
    graph: Graph, flight: SimulatedFlight
) -> None:
    """However early it arrives."""
    chain = Chain(graph, flight, 30.0, {"rows": 46, "cols": 12, "calibration": "topic"})
    found = calibration_of(flight, response=np.ones((DETECTORS, COUNT)))
    node = chain.stages["sar_compression"]
    node.state_calibrations({found.id: [DwellKey(flight.sensor.config_hash, 1, START_NS + flight.dwell_start_ns(1))]})
    publisher = publisher_of(graph.add(_node(graph, "feeding")), CalibrationMessage, "calibration", LATCHED_QOS)
    publisher.publish(messages.calibration_to_message(found, messages.to_stamp(START_NS)))
    inlets = [chain.stages[name]._inlets_of["calibration"] for name in ("sar_compression", "ml_height", "monopulse")]
    chain.wait(lambda: all(inlet.received == 1 for inlet in inlets), "the calibration to arrive")
    chain.publish(chain.sensor_info())
    for dwell in range(3):
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
        chain.await_heights(dwell)
    applied = [chain.heights["ml", dwell].provenance.calibration_id for dwell in range(3)]
    assert applied == ["", found.id, found.id]


def test_a_file_for_another_sensor_stops_every_frame_with_a_sentence(
    graph: Graph, flight: SimulatedFlight, tmp_path: Path
) -> None:
    other = replace(calibration_of(flight), config_hash="other")
    chain = flown(graph, flight, saved(tmp_path, other), missing_after_s=0.5)
    chain.await_drops("sar_compression", "cannot be processed", DETECTORS)
    assert "is of sensor 'other'" in chain.stages["sar_compression"].last_rejection


def test_what_there_is_at_the_end_makes_a_calibration_if_there_was_none(
    graph: Graph, flight: SimulatedFlight, heard: list[CalibrationMessage], tmp_path: Path
) -> None:
    node = calibrator(graph, dwells=100, file=str(tmp_path / "found.npz"))
    chain = Chain(graph, flight, 30.0, {"range_window": "rectangular", "cols": 12})
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.wait(lambda: node.tally.summary()["in"] == DETECTORS and not node.tally.summary()["waiting"], "the images")
    node.conclude()
    node.conclude()
    chain.wait(lambda: heard, "a calibration")
    assert load_calibration(tmp_path / "found.npz").id == heard[0].id
    assert heard[0].dwells == 1


def test_a_file_that_cannot_be_written_costs_nothing_else(
    graph: Graph, flight: SimulatedFlight, heard: list[CalibrationMessage], tmp_path: Path
) -> None:
    node = calibrator(graph, dwells=1, file=str(tmp_path / "nowhere" / "found.npz"))
    chain = Chain(graph, flight, 30.0, {"range_window": "rectangular", "cols": 12})
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.wait(lambda: heard, "a calibration")
    chain.wait(lambda: node.tally.summary().get("ignored.file") == 1, "the file to be missed")
    assert "nowhere" in node.last_rejection
    chain.wait(lambda: not node.tally.summary()["waiting"], "the images to be accounted for")


def test_clipped_dwells_are_left_out(graph: Graph, flight: SimulatedFlight, heard: list[CalibrationMessage]) -> None:
    node = calibrator(graph, dwells=1)
    clipped = replace(flight.sensor, full_scale=0.5, config_hash="")
    chain = Chain(
        graph,
        SimulatedFlight(flight.preset, clipped, flight.scene, 1, flight.seed),
        30.0,
        {"range_window": "rectangular", "cols": 12},
    )
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    assert graph.spin_until(lambda: node.tally.summary().get("dropped.saturated") == DETECTORS, TIMEOUT_S)
    assert_one_sentence(node.last_rejection.partition(": ")[2])
    assert not heard


@pytest.mark.parametrize("text", ["1,2", "a,b,c", "1;2;3"])
def test_a_target_that_is_no_place_is_refused(graph: Graph, text: str) -> None:
    with pytest.raises(UserError, match="must be three numbers, E,N,H in m") as refusal:
        calibrator(graph, target=text)
    assert_one_sentence(str(refusal.value))
