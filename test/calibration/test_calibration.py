"""Calibrations: what they do to phase histories, and how they are kept."""

from __future__ import annotations

import pickle
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from helpers import make_sensor

from sal_height.calibration.calibration import Calibration
from sal_height.calibration.files import load_calibration, save_calibration
from sal_height.errors import UserError
from sal_height.numeric.windows import window
from sal_height.sensor import BeamErrors
from sal_height.sensor.sensor import PhaseHistory

SENSOR = make_sensor()
SHAPE = SENSOR.detector_count, SENSOR.sample_count


def made(response: np.ndarray, **changes: object) -> Calibration:
    sigmas = {f"{what}_sigma": np.zeros(len(response)) for what in ("response", "gain", "phase")}
    values = {"config_hash": SENSOR.config_hash, "dwells": 3} | sigmas | changes
    return Calibration(response=response.astype(complex), **values)


def any_response(seed: int = 1) -> np.ndarray:
    parts = np.random.default_rng(seed).standard_normal((2, *SHAPE))
    return 1 + 0.2 * (parts[0] + 1j * parts[1])


def test_standard_errors_are_an_uncertainty_of_the_beams() -> None:
    """Gains and phases count as they are, an error of the width by x h'(x); what was not measured adds nothing."""
    beams, response = SENSOR.beams, np.ones(SHAPE)
    gains = made(response, gain_sigma=np.array([0.03, np.nan, 0.0]), phase_sigma=np.array([0.04, np.nan, 0.05]))
    assert gains.beam_uncertainty(beams) == pytest.approx(np.sqrt(0.05**2 * 2 / 3))
    width = made(response, width_sigma=0.01).beam_uncertainty(beams)
    directions = np.linspace(*beams.span, 1001)
    offsets = directions[:, None] - np.array(SENSOR.elevation_boresights)
    expected = 0.01 * np.sqrt(np.mean((offsets * beams.slope(directions, 0.0)) ** 2))
    assert width == pytest.approx(expected, rel=0.05)
    assert made(response).beam_uncertainty(beams) == 0


def test_what_a_calibration_measured_replaces_what_is_assumed_of_it() -> None:
    beams, response = SENSOR.beams, np.ones(SHAPE)
    assumed, unknown = BeamErrors(width=0.02, gain=0.06), np.full(SHAPE[0], np.nan)
    nothing = made(response, gain_sigma=unknown, phase_sigma=unknown)
    by_gains = nothing.beam_uncertainty(beams, assumed._replace(width=0.0))
    by_width = nothing.beam_uncertainty(beams, assumed._replace(gain=0.0))
    assert by_gains == pytest.approx(0.06)
    assert nothing.beam_uncertainty(beams, assumed) == pytest.approx(np.hypot(by_gains, by_width))
    gains = made(response, gain_sigma=np.full(SHAPE[0], 0.001)).beam_uncertainty(beams, assumed)
    assert gains == pytest.approx(np.hypot(0.001, by_width))
    width = made(response, gain_sigma=unknown, width_sigma=1e-9).beam_uncertainty(beams, assumed)
    assert width == pytest.approx(0.06)
    one = made(response, gain_sigma=np.array([0.0, np.nan, 0.0])).beam_uncertainty(beams, BeamErrors(gain=0.06))
    assert one == pytest.approx(0.06 / np.sqrt(3))


PUPIL = {
    "pupil": np.array([0.0, 0.01, 0.0, 0.05, 0.0, -0.02]),
    "pupil_sigma": np.full(6, 0.002),
    "pupil_misfit": 1.01,
    "pupil_p_value": 0.2,
}


def test_beams_are_those_behind_the_pupil() -> None:
    beams, measured = SENSOR.beams, made(np.ones(SHAPE), width_factor=1.1, **PUPIL)
    expected = beams.aberrated(tuple(PUPIL["pupil"])).widened(1.1).response(beams.span[0], 0.0)
    np.testing.assert_array_equal(measured.beams(beams).response(beams.span[0], 0.0), expected)
    assert made(np.ones(SHAPE)).beams(beams).response(beams.span[0], 0.0).dtype == np.float64


def test_a_pupil_is_kept(tmp_path: Path) -> None:
    save_calibration(tmp_path / "c.npz", made(np.ones(SHAPE), **PUPIL))
    found = load_calibration(tmp_path / "c.npz")
    for name, value in PUPIL.items():
        np.testing.assert_array_equal(getattr(found, name), value)


@pytest.mark.parametrize(
    ("changes", "part"),
    [({"pupil": np.zeros(3)}, "must have 6"), ({"pupil": np.full(6, np.nan), "pupil_sigma": np.ones(6)}, "between")],
)
def test_a_pupil_that_makes_no_sense_is_refused(changes: dict[str, np.ndarray], part: str) -> None:
    with pytest.raises(UserError, match=part):
        made(np.ones(SHAPE), **changes)


def test_equalised_channels_have_one_response() -> None:
    response = any_response()
    samples = np.repeat(response[:, None], 4, axis=1).astype(np.complex64)
    history = PhaseHistory(0, np.zeros(4), np.zeros(4), samples)
    after = made(response).equalised(history).samples
    np.testing.assert_allclose(after, np.broadcast_to(after[:1], after.shape), atol=3e-7)
    strong = np.abs(response).min(axis=0) > 0.8
    np.testing.assert_allclose(after[0, 0, strong], 1, atol=5e-4)


def test_ratios_are_right_even_where_a_channel_hears_next_to_nothing() -> None:
    response = np.ones(SHAPE, dtype=complex)
    response[1, 10:20] = 1e-3
    response[2, 30] = 0
    equaliser = made(response).equaliser
    assert np.abs(equaliser).max() < 27**0.25 / 4 / 0.1 * 1.01
    np.testing.assert_allclose((equaliser * response)[1, 10:20], (equaliser * response)[0, 10:20], rtol=1e-5)
    np.testing.assert_array_equal(equaliser[:, 30], 0)


def test_noise_grows_by_the_equaliser() -> None:
    response = any_response()
    rng = np.random.default_rng(2)
    noise = (rng.standard_normal((2, SHAPE[0], 4000, SHAPE[1]))).astype(np.float32)
    history = PhaseHistory(0, np.zeros(4000), np.zeros(4000), (noise[0] + 1j * noise[1]) / np.float32(np.sqrt(2)))
    weights = window("hamming", SHAPE[1])
    calibration = made(response)
    after = np.mean(np.abs(calibration.equalised(history).samples @ weights) ** 2, axis=1) / np.sum(weights**2)
    np.testing.assert_allclose(calibration.noise_gains("hamming"), after, rtol=5 / np.sqrt(4000))


def test_nothing_to_correct_changes_nothing() -> None:
    np.testing.assert_allclose(made(np.ones(SHAPE)).equaliser, 1, rtol=2e-4)


def test_a_file_gives_back_what_was_written(tmp_path: Path) -> None:
    calibration = made(any_response(), width_factor=1.03, width_sigma=0.01)
    save_calibration(tmp_path / "c.npz", calibration)
    again = load_calibration(tmp_path / "c.npz")
    assert again.id == calibration.id
    np.testing.assert_array_equal(again.response, calibration.response)
    assert [path.name for path in tmp_path.iterdir()] == ["c.npz"]


@pytest.mark.parametrize(
    "change",
    [
        {"response": any_response(2).astype(complex)},
        {"width_factor": 1.01},
        {"dwells": 4},
        {"config_hash": "x"},
        {"response_sigma": np.ones(SHAPE[0])},
        {"gain_sigma": np.ones(SHAPE[0])},
        {"phase_sigma": np.ones(SHAPE[0])},
    ],
    ids=str,
)
def test_any_value_changes_the_id(change: dict[str, object]) -> None:
    calibration = made(any_response())
    assert replace(calibration, id="", **change).id != calibration.id


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"config_hash": ""}, "has no config_hash"),
        ({"response": np.ones(4)}, r"responses of shape \(4,\)"),
        ({"response": np.zeros(SHAPE)}, "a channel without any"),
        ({"response": np.full(SHAPE, np.nan)}, "not finite"),
        ({"width_factor": 3.0}, "width factor of the beams is 3.0; allowed are 0.5 to 2.0"),
        ({"width_sigma": np.inf}, "standard errors that are negative or infinite"),
    ],
    ids=str,
)
def test_values_that_cannot_be_are_refused(change: dict[str, object], sentence: str) -> None:
    with pytest.raises(UserError, match=sentence):
        replace(made(np.ones(SHAPE)), **change)


def test_another_sensor_is_refused() -> None:
    with pytest.raises(UserError, match="the frames are of"):
        made(np.ones(SHAPE), config_hash="other").check(SENSOR)
    with pytest.raises(UserError, match="the sensor has"):
        made(np.ones((SHAPE[0], 7))).check(SENSOR)


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot be read: No such file"):
        load_calibration(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("text")
    np.savez(tmp_path / "other.npz", a=1)
    numbers = ("response", "response_sigma", "gain_sigma", "phase_sigma", "width_factor", "width_sigma", "dwells")
    np.savez(tmp_path / "bad.npz", config_hash="", **dict.fromkeys(numbers, 1))
    for name, sentence in (
        ("text", "is no calibration"),
        ("other", "is no calibration"),
        ("bad", "has no config_hash"),
    ):
        with pytest.raises(UserError, match=sentence):
            load_calibration(tmp_path / f"{name}.npz")


def test_copies_in_another_process_are_one_object_with_all_values() -> None:
    """Also where values are NaN: tables that are made for a calibration are looked up by its identity."""
    calibration = made(any_response(), width_factor=1.1, **PUPIL)
    first, second = (pickle.loads(pickle.dumps(calibration)) for _ in range(2))  # noqa: S301 (our own)
    assert first is second
    for one in fields(Calibration):
        np.testing.assert_array_equal(getattr(first, one.name), getattr(calibration, one.name))
    assert pickle.loads(pickle.dumps(replace(calibration, dwells=7))) is not first  # noqa: S301
