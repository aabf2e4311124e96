"""A sensor that is not as described, calibrated among stages, and the effect of calibrations on images and heights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from chain_fixture import DETECTORS, START_NS, StageChain, same_heights
from chained import Hosted
from helpers import assert_one_sentence
from stage_graph import StageGraph

from sal_height import messages
from sal_height.calibration.calibration import Calibration
from sal_height.calibration.files import load_calibration, save_calibration
from sal_height.engine.results import DwellKey
from sal_height.errors import UserError
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.messages.types import HeightImage
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


UNWEIGHTED = {"range_window": "rectangular", "cols": 12}
"""Images that calibrate."""


def flown(flight: SimulatedFlight, calibration: str, missing_after_s: float = 30.0) -> StageChain:
    chain = StageChain(flight, missing_after_s, {"rows": 46, "cols": 12, "calibration": calibration})
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    return chain


def differences(chain: StageChain, reference: Any, estimator: str) -> np.ndarray:
    """Heights less those of the reference (m), where both have one."""
    heights, expected = (np.array(one[estimator, 0].surfaces[0].height) for one in (chain.heights, reference))
    difference = heights - expected
    return difference[np.isfinite(difference)]


def test_a_calibration_that_is_right_gives_the_heights_of_a_perfect_sensor(
    flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage], tmp_path: Path
) -> None:
    calibration = calibration_of(faulty(flight))
    chain = flown(faulty(flight), saved(tmp_path, calibration))
    for estimator in ("ml", "monopulse"):
        # Equalised noise differs between channels by its last percent: a pixel at a threshold may change sides.
        ours, theirs = (np.array(images[estimator, 0].validity) for images in (chain.heights, reference))
        assert np.count_nonzero(ours != theirs) <= 3
        # Which of two scatterers is the stronger may change with the last digits.
        assert np.quantile(np.abs(differences(chain, reference, estimator)), 0.95) < 2e-3
        assert chain.heights[estimator, 0].provenance.calibration_id == calibration.id


def test_without_it_heights_are_spoilt(flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage]) -> None:
    chain = flown(faulty(flight), "")
    for estimator in ("ml", "monopulse"):
        assert (
            np.sqrt(np.mean(differences(chain, reference, estimator) ** 2)) > 0.015
        )  # pixels that are spoilt more are not valid
        assert not chain.heights[estimator, 0].provenance.calibration_id


def test_height_nodes_take_the_width_of_the_beams_that_a_calibration_has_found(
    flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage], tmp_path: Path
) -> None:
    """Wider beams stretch a pair's elevations about its middle: by 5 % and a little, as sinc's slope is not even."""
    wide = calibration_of(flight, response=np.ones((DETECTORS, COUNT)), width_factor=1.05, width_sigma=0.01)
    chain = flown(flight, saved(tmp_path, wide))
    beam_m = flight.sensor.beamwidth * flight.preset.flight.slant_range_m * np.sin(flight.preset.flight.look_angle_rad)
    spread = np.abs(differences(chain, reference, "monopulse"))
    assert 0.05 * 0.1 * beam_m < np.median(spread) < 0.05 * 0.5 * beam_m


class Calibrating:
    """A chain with a calibrator, and the calibrations that it publishes."""

    def __init__(
        self, flight: SimulatedFlight, image: Mapping[str, Any] = MappingProxyType(UNWEIGHTED), **parameters: Any
    ) -> None:
        self.chain = StageChain(flight, 30.0, image)
        self.stage: Hosted = self.chain.graph.add("psf_calibration", **{"dwell_step": 1, **parameters})
        self.heard: list[CalibrationMessage] = self.chain.graph.heard["calibration"]
        self.chain.publish(self.chain.sensor_info())

    def fly(self, *dwells: int) -> None:
        for dwell in dwells:
            self.chain.publish(*self.chain.odometry(dwell), *self.chain.frames(dwell))
            self.chain.await_heights(dwell)


def test_stages_calibrate_themselves(flight: SimulatedFlight, tmp_path: Path) -> None:
    """Eight dwells tell gains of 1 dB and 20 degrees to a fifth; the ninth dwell has them taken off."""
    image = {**UNWEIGHTED, "calibration": "topic"}
    calibrating = Calibrating(faulty(flight, dwells=9), image, dwells=8, file=str(tmp_path / "found.npz"))
    calibrating.fly(*range(8))
    (heard,) = calibrating.heard
    found = messages.calibration_from_message(heard)
    assert found.id == load_calibration(tmp_path / "found.npz").id == heard.id
    assert any("in common: No point target" in sentence for sentence in heard.undetermined)
    gains, true = (response.mean(axis=1) for response in (found.response, fault()))
    ratio = np.log(gains / true)
    ratio -= ratio.mean()
    assert 8.686 * np.std(ratio.real) < 0.2
    assert np.degrees(np.std(ratio.imag)) < 4
    calibrating.fly(8)
    assert calibrating.chain.heights["ml", 7].provenance.calibration_id == ""
    assert calibrating.chain.heights["ml", 8].provenance.calibration_id == found.id
    assert calibrating.stage.counted("dropped.") == {"calibrated already": DETECTORS}


def test_one_dwell_of_several_is_used(flight: SimulatedFlight) -> None:
    calibrating = Calibrating(flight, dwells=2, dwell_step=2)
    calibrating.fly(0, 1)
    assert not calibrating.heard
    calibrating.fly(2)
    (heard,) = calibrating.heard
    assert heard.dwells == 2
    assert messages.to_ns(heard.header.stamp) == START_NS + flight.dwell_start_ns(2)
    assert calibrating.stage.counts["in"] == 3 * DETECTORS


def test_weighted_images_do_not_calibrate(flight: SimulatedFlight) -> None:
    calibrating = Calibrating(flight, {"rows": 46, "cols": 12})
    calibrating.fly(0)
    assert calibrating.stage.counted("dropped.") == {"cannot be processed": DETECTORS}
    assert "range_window rectangular" in calibrating.stage.last_rejection
    assert_one_sentence(calibrating.stage.last_drop)


def test_images_wait_for_their_calibration_and_go_without_it(flight: SimulatedFlight, tmp_path: Path) -> None:
    """A height stage that has not received what beams the calibration found makes no heights."""
    chain = flown(faulty(flight), saved(tmp_path, calibration_of(faulty(flight))))
    other = StageGraph()
    late = other.add("ml_height", timeout_s=0.5)
    other.publish("sensor_info", chain.sensor_info())
    other.publish("slc", *chain.graph.heard["slc"])
    other.wait(lambda: late.counted("dropped.") == {"no calibration": DETECTORS}, "the drops")
    assert "was not received on topic calibration" in late.last_rejection


def test_calibrations_that_cannot_be_used_are_counted_and_ignored(
    flight: SimulatedFlight, reference: dict[tuple[str, int], HeightImage]
) -> None:
    chain = StageChain(flight, 30.0, {"rows": 46, "cols": 12, "calibration": "topic"})
    stamp = messages.to_stamp(START_NS)
    for number, (field, value, sentence) in enumerate(
        [("id", "", "has no id"), ("response", [1.0, 0.0], "need 512"), ("width_factor", 9.0, "allowed are")], 1
    ):
        bad = messages.calibration_to_message(calibration_of(flight), stamp)
        setattr(bad, field, value)
        chain.publish(bad)
        assert all(stage.counted("ignored.") == {"calibration": number} for stage in chain.stages.values())
        assert sentence in chain.stages["ml_height"].last_rejection
    chain.publish(messages.calibration_to_message(replace(calibration_of(flight), config_hash="other"), stamp))
    chain.fly()
    assert same_heights(chain.heights["ml", 0], reference["ml", 0])


def test_a_calibration_is_applied_from_the_dwells_on_that_a_replay_states(flight: SimulatedFlight) -> None:
    """However early it arrives."""
    chain = StageChain(flight, 30.0, {"rows": 46, "cols": 12, "calibration": "topic"})
    found = calibration_of(flight, response=np.ones((DETECTORS, COUNT)))
    dwell_1 = DwellKey(flight.sensor.config_hash, 1, START_NS + flight.dwell_start_ns(1))
    chain.stages["sar_compression"].stage.state_calibrations({found.id: [dwell_1]})
    chain.publish(messages.calibration_to_message(found, messages.to_stamp(START_NS)), chain.sensor_info())
    for dwell in range(3):
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
        chain.await_heights(dwell)
    applied = [chain.heights["ml", dwell].provenance.calibration_id for dwell in range(3)]
    assert applied == ["", found.id, found.id]


def test_a_file_for_another_sensor_stops_every_frame_with_a_sentence(flight: SimulatedFlight, tmp_path: Path) -> None:
    other = replace(calibration_of(flight), config_hash="other")
    chain = flown(flight, saved(tmp_path, other), missing_after_s=0.5)
    chain.await_drops("sar_compression", "cannot be processed", DETECTORS)
    assert "is of sensor 'other'" in chain.stages["sar_compression"].last_rejection


def test_what_there_is_at_the_end_makes_a_calibration_if_there_was_none(
    flight: SimulatedFlight, tmp_path: Path
) -> None:
    calibrating = Calibrating(flight, dwells=100, file=str(tmp_path / "found.npz"))
    calibrating.fly(0)
    calibrating.stage.conclude()
    (heard,) = calibrating.heard
    assert load_calibration(tmp_path / "found.npz").id == heard.id
    assert heard.dwells == 1


def test_a_calibration_is_made_when_it_is_asked_for(flight: SimulatedFlight) -> None:
    calibrating = Calibrating(flight, dwells=100)
    stage, answers = calibrating.stage, calibrating.chain.graph.answers
    stage.ask(lambda: stage.stage.command("save"))
    calibrating.fly(0)
    assert stage.summary()["processed"] == DETECTORS
    for _ in range(2):
        stage.ask(lambda: stage.stage.command("save"))
    assert [one.success for one in answers] == [False, True, False]
    assert [one.sentence for one in answers[:2]] == ["no dwell was used yet", "published"]
    assert len(calibrating.heard) == 1


def test_a_file_that_cannot_be_written_costs_nothing_else(flight: SimulatedFlight, tmp_path: Path) -> None:
    calibrating = Calibrating(flight, dwells=1, file=str(tmp_path / "nowhere" / "found.npz"))
    calibrating.fly(0)
    assert len(calibrating.heard) == 1
    assert calibrating.stage.counted("ignored.") == {"file": 1}
    assert "nowhere" in calibrating.stage.last_rejection
    assert calibrating.stage.summary()["processed"] == DETECTORS


def test_clipped_dwells_are_left_out(flight: SimulatedFlight) -> None:
    clipped = replace(flight.sensor, full_scale=0.5, config_hash="")
    calibrating = Calibrating(SimulatedFlight(flight.preset, clipped, flight.scene, 1, flight.seed), dwells=1)
    calibrating.fly(0)
    assert calibrating.stage.counted("dropped.") == {"saturated": DETECTORS}
    assert_one_sentence(calibrating.stage.last_drop)
    assert not calibrating.heard


@pytest.mark.parametrize("text", ["1,2", "a,b,c", "1;2;3"])
def test_a_target_that_is_no_place_is_refused(text: str) -> None:
    with pytest.raises(UserError, match="must be three numbers, E,N,H in m") as refusal:
        StageGraph().add("psf_calibration", target=text)
    assert_one_sentence(str(refusal.value))
