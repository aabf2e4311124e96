"""The trial of a calibration refuses those of other instruments, and none that is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration_trials import AS_DESCRIBED, DEPARTING, ERROR, FOREIGN, Instrument, calibrated, tried
from benchmarks.goodness_of_fit import images_of, parts_of
from sal_height.calibration import Calibration
from sal_height.doubts import FitTest
from sal_height.elevation.fit.channel_gains import CHANNEL_GAIN, common_gain_test
from sal_height.imaging import Slc
from sal_height.pipeline import CalibrationTrial, can_be_tried
from sal_height.pipeline.calibration_trial import MOST_UNTESTED, _departs, _tests_of
from sal_height.sensor import Sensor
from sal_height.simulation import load_preset

DWELLS = 3


@pytest.mark.parametrize("instrument", [AS_DESCRIBED, DEPARTING])
@pytest.mark.parametrize("scene", ["level", "street", "canopy", "step +1.0"])
@pytest.mark.parametrize("cnr_db", [5, 20, 40])
def test_one_that_is_right_is_adopted(instrument: Instrument, scene: str, cnr_db: float) -> None:
    for slc, sensor in instrument.dwells(scene, cnr_db, DWELLS):
        trial = tried(slc, sensor, instrument.calibration(sensor, ERROR))
        assert trial.adopted is not False
        assert trial.refusal == ""


REFUSALS = {
    "gains 2 dB rms": "the gains of the channels depart from those of the beams by 1",
    "phases of any value": "the gains of the channels depart from those of the beams by ",
    "beams 5 % wider": "the width of the beams over the distance between them departs by -",
}


@pytest.mark.parametrize("name", REFUSALS)
@pytest.mark.parametrize("scene", ["level", "street"])
def test_one_of_another_instrument_is_refused(name: str, scene: str) -> None:
    for slc, sensor in AS_DESCRIBED.dwells(scene, 30, DWELLS):
        calibration = FOREIGN[name].instrument.calibration(sensor)
        trial = tried(slc, sensor, calibration)
        assert trial.adopted is False
        assert f"Calibration {calibration.id} is refused: with it {REFUSALS[name]}" in trial.refusal
        assert "with the description of the sensor alone by " in trial.refusal
        assert trial.chosen is None


def first_dwell(instrument: Instrument = AS_DESCRIBED, cnr_db: float = 20) -> tuple[Slc, Sensor]:
    return next(instrument.dwells("level", cnr_db, 1))


def test_it_is_compared_with_the_one_in_use() -> None:
    """Which fits, where the description does not: so it stays."""
    slc, sensor = first_dwell(DEPARTING)
    own, other = DEPARTING.calibration(sensor), FOREIGN["gains 2 dB rms"].instrument.calibration(sensor)
    trial = tried(slc, sensor, other, own)
    assert trial.chosen is own
    assert f"with calibration {own.id} by " in trial.refusal
    assert tried(slc, sensor, other).adopted, "nothing fits, and the doubts of the heights name it"


def test_what_is_wrong_in_the_dwell_itself_does_not_refuse_one_that_is_right() -> None:
    """Interference in a fraction of the ranges, at which gains depart in about every second dwell, with or without."""
    outcomes, departing = set(), 0
    for scene in ("level", "street"):
        images = images_of(scene, 16, 8)
        noise = images.noise.copy()
        noise[:, 40:90] += 10 ** (8 / 20) * np.roll(images.noise[0], (37, 6), axis=(0, 1))[40:90]
        sensor = images.sensor
        for slc in (part for cnr_db in (0, 3) for part in parts_of(replace(images, noise=noise).slc(cnr_db))):
            trial = tried(slc, sensor, AS_DESCRIBED.calibration(sensor, ERROR))
            outcomes.add(trial.adopted)
            departing += any(map(_departs, _tests_of(slc, sensor, None)))
    assert False not in outcomes
    assert departing > 4, "the test has lost its meaning"


def test_images_are_those_of_the_calibration_that_is_chosen() -> None:
    slc, sensor = first_dwell()
    formed: list[Calibration | None] = []

    def form(one: Calibration | None) -> Slc:
        formed.append(one)
        return calibrated(slc, one)

    wrong, right = FOREIGN["gains 2 dB rms"].instrument.calibration(sensor), AS_DESCRIBED.calibration(sensor, ERROR)
    trial = CalibrationTrial(wrong, None)
    for _ in range(3):
        assert trial.images(form, sensor) is slc
    assert formed == [wrong, None, None, None]
    formed.clear()
    trial = CalibrationTrial(right, None)
    for _ in range(2):
        made = trial.images(form, sensor)
        assert made is not None
        np.testing.assert_array_equal(made.images, calibrated(slc, right).images)
    assert formed == [right, right], "one that fits costs no images without it"


def test_dwells_of_noise_leave_it_on_trial_for_a_while() -> None:
    slc, sensor = first_dwell()
    rng = np.random.default_rng(2)
    noise = rng.standard_normal((2, *slc.images.shape)) @ np.eye(slc.images.shape[-1]) / np.sqrt(2)
    dark = replace(slc, images=(1e-3 * (noise[0] + 1j * noise[1])).astype(np.complex64))
    wrong = FOREIGN["gains 2 dB rms"].instrument.calibration(sensor)
    trial = CalibrationTrial(wrong, None)
    for number in range(MOST_UNTESTED):
        assert trial.adopted is None, number
        assert trial.images(lambda one: calibrated(dark, one), sensor) is not None
    assert trial.adopted is True
    trial = CalibrationTrial(wrong, None)
    trial.images(lambda one: calibrated(dark, one), sensor)
    trial.images(lambda one: calibrated(slc, one), sensor)
    assert trial.adopted is False, "the first dwell that tests it decides"


def test_a_block_without_images_decides_nothing() -> None:
    _, sensor = first_dwell()
    trial = CalibrationTrial(AS_DESCRIBED.calibration(sensor), None)
    for _ in range(2 * MOST_UNTESTED):
        assert trial.images(lambda _: None, sensor) is None
        assert trial.adopted is None


def test_images_that_no_heights_can_be_made_of_decide_nothing() -> None:
    slc, sensor = first_dwell()
    trial = CalibrationTrial(AS_DESCRIBED.calibration(sensor), None)
    trial.images(lambda one: replace(calibrated(slc, one), images=np.zeros_like(slc.images)), sensor)
    assert trial.adopted is None


def test_mixtures_and_few_channels_cannot_be_tried() -> None:
    sensor = load_preset("small").make_sensor()
    assert can_be_tried(sensor)
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((8, 8)))[0]
    assert not can_be_tried(replace(sensor, channel_matrix=tuple(map(tuple, turned.tolist())), config_hash=""))


def test_gains_together_are_as_improbable_as_their_deviates() -> None:
    """Sixteen gains of three standard deviations each; with few pixels, these are as likely as one deviation."""
    three, one = (
        common_gain_test([FitTest(CHANNEL_GAIN, m, z, p, 1 + 0.1 * z, 0.1) for m in range(16)])
        for z, p in ((3.0, 0.0027), (3.0, 0.3173))
    )
    assert three.p_value < 1e-20
    assert one.p_value == pytest.approx(0.45, abs=0.01)
    assert one.statistic == pytest.approx(16, rel=1e-3)
    assert three.size == pytest.approx(0.3)
    few = [FitTest(CHANNEL_GAIN, m, 3.0, 0.0027 if m < 8 else np.nan, 1.3, 0.1) for m in range(16)]
    assert np.isnan(common_gain_test(few).p_value)
