"""Doubts about dwells that are not as described, and none about those that are."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.goodness_of_fit import FAULTS, NONE, Fault, dwells_of, images_of
from sal_height.calibration import Calibration
from sal_height.elevation import ESTIMATORS
from sal_height.imaging import ImageSettings, Slc
from sal_height.pipeline import Compressor, heights
from sal_height.relief import HeightField
from sal_height.sensor import Sensor
from sal_height.simulation import flight_of, load_preset

DWELLS = 3
ML = ESTIMATORS["ml"]


@pytest.mark.parametrize("scene", ["level", "street", "canopy", "step +1.0"])
@pytest.mark.parametrize("cnr_db", [3, 10, 30, 40])
def test_a_dwell_as_described_is_not_in_doubt(scene: str, cnr_db: float) -> None:
    for field in dwells_of(scene, NONE, cnr_db, dwells=DWELLS):
        assert not field.doubts
        level, *gains = field.fit[:17]
        assert (level.name, level.channel, level.unit) == ("noise level", -1, "dB")
        assert [gain.channel for gain in gains] == list(range(16))
        assert np.isnan(level.size) == np.isnan(level.p_value) == np.isnan(level.sigma)
        assert not abs(level.size) > 0.6
        rest = ["noise over range", "interference", "correlated noise", "beam stretch"]
        assert [(test.name, test.channel) for test in field.fit[17:21]] == [(name, -1) for name in rest]
        assert [(test.name, test.channel) for test in field.fit[21:]] == [("noise of channel", m) for m in range(16)]
        assert np.isnan(level.size) or cnr_db < 40, "level ground fills range cells there"


@pytest.mark.parametrize("scene", ["level", "street"])
@pytest.mark.parametrize(("name", "noise_db"), [("noise +1 dB", 1), ("noise +3 dB", 3), ("noise -6 dB", -6)])
def test_noise_of_another_power_is_found(scene: str, name: str, noise_db: float) -> None:
    for field in dwells_of(scene, FAULTS[name], 10 + noise_db, dwells=DWELLS):
        (doubt,) = field.doubts
        assert doubt.name == "noise level"
        assert doubt.size == pytest.approx(noise_db, abs=0.35)
        assert doubt.p_value < 1e-5


def test_counts_of_a_converter_are_said_with_both_numbers() -> None:
    """Noise of 20 counts rms, whose power is left at 1."""
    for field in dwells_of("street", FAULTS["noise +26 dB"], 46, dwells=DWELLS):
        (doubt,) = field.doubts
        stated, found = re.search(r"samples is (\S+) and .* states (\S+) ", doubt.sentence).group(2, 1)  # type: ignore[union-attr]
        assert float(stated) == 1
        assert float(found) == pytest.approx(400, rel=0.06)
        assert f"state a noise_power of {found}" in doubt.sentence


@pytest.mark.parametrize("scene", ["level", "street"])
@pytest.mark.parametrize("cnr_db", [10, 20])
def test_a_channel_of_noise_alone_is_found_and_its_neighbours_are_not_blamed(scene: str, cnr_db: float) -> None:
    for field in dwells_of(scene, FAULTS["channel 5 noise only"], cnr_db, dwells=DWELLS):
        (doubt,) = field.doubts
        assert (doubt.name, doubt.channel) == ("channel gain", 5)
        assert abs(doubt.size) < 0.2
        assert "Channel 5 " in doubt.sentence
        assert "noise" in doubt.sentence


@pytest.mark.parametrize("scene", ["level", "street"])
@pytest.mark.parametrize(("cnr_db", "size_db"), [(5, 6), (5, 10), (10, 6), (20, 10), (30, 6)])
@pytest.mark.parametrize("channel", [0, 5])
def test_the_noise_of_one_channel_is_found(scene: str, cnr_db: float, size_db: float, channel: int) -> None:
    """Its neighbours would be said to have wrong gains, or the dwell another noise level."""
    fault = Fault(channel_noise_db=tuple(size_db if m == channel else 0.0 for m in range(16)))
    for field in dwells_of(scene, fault, cnr_db, dwells=DWELLS):
        (doubt,) = field.doubts
        assert (doubt.name, doubt.channel) == ("noise of channel", channel)
        assert doubt.size == pytest.approx(size_db, abs=1 if size_db < 10 and cnr_db > 5 else 3)
        assert f"channel {channel} is" in doubt.sentence


@pytest.mark.parametrize("cnr_db", [5, 20])
@pytest.mark.parametrize("noisy", [(5, 6), (2, 3, 9, 10)])
def test_the_noise_of_several_channels_is_found(noisy: tuple[int, ...], cnr_db: float) -> None:
    """And leaves no doubt where it is measured."""
    fault = Fault(channel_noise_db=tuple(6.0 if m in noisy else 0.0 for m in range(16)))
    for field in dwells_of("street", fault, cnr_db, dwells=2):
        assert [(doubt.name, doubt.channel) for doubt in field.doubts] == [("noise of channel", m) for m in noisy]
    for field in dwells_of("street", fault, cnr_db, settings=MEASURED, dwells=2):
        assert not field.doubts


def test_wrong_gains_are_one_doubt_about_the_worst_channel() -> None:
    gains = FAULTS["gains 2 dB rms"].gain_db
    for field in dwells_of("level", FAULTS["gains 2 dB rms"], 20, dwells=DWELLS):
        (doubt,) = field.doubts
        assert doubt.name == "channel gain"
        assert abs(gains[doubt.channel]) > 2
        assert 20 * np.log10(doubt.size) == pytest.approx(gains[doubt.channel], abs=1.5)
        assert re.search(r"So do \d+ others", doubt.sentence)


FOUND_BY = {
    "interference -10 dB": ("interference", 0.065, 0.03),
    "interference 0 dB": ("interference", 0.7, 0.4),
    "interference +10 dB": ("interference", 12, 6),
    "correlation .3": ("correlated noise", 0.24, 0.06),
}
"""Name of the doubt, and its size with a tolerance: of pixels that are left out some of the noise is."""


@pytest.mark.parametrize("scene", ["level", "street"])
@pytest.mark.parametrize("cnr_db", [5, 10])
@pytest.mark.parametrize("name", FOUND_BY)
def test_noise_that_channels_have_in_common_is_found(scene: str, cnr_db: float, name: str) -> None:
    test, size, tolerance = FOUND_BY[name]
    for field in dwells_of(scene, FAULTS[name], cnr_db, dwells=DWELLS):
        (doubt,) = field.doubts
        assert doubt.name == test
        assert doubt.size == pytest.approx(size, abs=tolerance)


@pytest.mark.parametrize("scene", ["level", "street"])
@pytest.mark.parametrize("cnr_db", [5, 20])
def test_a_gain_over_range_is_found_at_the_right_mean_noise(scene: str, cnr_db: float) -> None:
    for field in dwells_of(scene, FAULTS["gain over range 3 dB"], cnr_db, dwells=DWELLS):
        (doubt,) = field.doubts
        assert doubt.name == "noise over range"
        assert abs(doubt.size) == pytest.approx(2.3, abs=0.5), "the outer quarters are 2.3 dB off"


@pytest.mark.parametrize(("pitch", "word"), [(1.03, "narrower"), (0.97, "wider")])
def test_beams_that_are_farther_from_each_other_are_found(pitch: float, word: str) -> None:
    for field in dwells_of("level", Fault(pitch=pitch), 20, dwells=DWELLS):
        (doubt,) = field.doubts
        assert doubt.name == "beam stretch"
        assert doubt.size == pytest.approx(1 / pitch - 1, abs=0.008)
        assert word in doubt.sentence


MEASURED = ML.settings(noise_and_gains="measured")  # type: ignore[call-arg]


@pytest.mark.parametrize("name", ["noise +3 dB", "noise of channel 5 +6 dB", "gains 2 dB rms", "channel 5 noise only"])
def test_noise_and_gains_that_are_measured_leave_no_doubt(name: str) -> None:
    """The tests remain those of the description, and heights have more pixels than with wrong gains."""
    stated, measured = (
        dwells_of("level", FAULTS[name], 20, dwells=2, settings=settings) for settings in (ML.settings(), MEASURED)
    )
    for described, field in zip(stated, measured, strict=True):
        assert described.doubts
        assert not field.doubts
        assert repr(field.fit) == repr(described.fit)


@pytest.mark.parametrize("scene", ["level", "street"])
def test_a_silent_channel_is_left_out_and_gains_of_its_neighbours_stay(scene: str) -> None:
    """Heights are those without the channel, value for value; its neighbours would be found too strong or too weak."""
    silent = Fault(gain_db=(0.0, 0.0, -200.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    images = silent.of(images_of(scene, 8, 1))
    slc = images.slc(20.0)
    without = slc.images.copy()
    without[2] = 0
    measured = heights(slc, images.sensor, ML, MEASURED)
    expected = heights(replace(slc, images=without), images.sensor, ML, ML.settings())
    np.testing.assert_array_equal(measured.first.height, expected.first.height)
    np.testing.assert_array_equal(measured.first.sigma, expected.first.sigma)


@pytest.mark.parametrize("channel", [0, 8])
def test_heights_with_the_measured_noise_of_a_channel_keep_what_sigma_promises(channel: int) -> None:
    """On level ground; as described 19 % are beyond 5 sigma where channel 8 has the noise."""
    fault = Fault(channel_noise_db=tuple(10.0 if m == channel else 0.0 for m in range(16)))
    level = np.nanmedian([field.first.height for field in dwells_of("level", NONE, 20, dwells=DWELLS)])
    measured = [field.first for field in dwells_of("level", fault, 10, dwells=DWELLS, settings=MEASURED)]
    errors = np.concatenate([((one.height - level) / one.sigma).ravel() for one in measured])
    assert np.count_nonzero(np.isfinite(errors)) > 700
    assert np.nanmean(np.abs(errors) > 5) < 0.005


def test_nothing_is_measured_of_a_dwell_as_described() -> None:
    stated, measured = (dwells_of("street", NONE, 20, dwells=2, settings=one) for one in (ML.settings(), MEASURED))
    for described, field in zip(stated, measured, strict=True):
        assert np.array_equal(field.first.height, described.first.height, equal_nan=True)


@pytest.mark.parametrize(
    ("fault", "width_factor", "name"),
    [(FAULTS["gains 2 dB rms"], 1.0, "channel gain"), (NONE, 1.04, "beam stretch"), (NONE, 1.0, None)],
)
def test_a_calibration_of_another_instrument_is_named(fault: Fault, width_factor: float, name: str | None) -> None:
    """Images that it equalised have wrong gains, and beams that it describes a wrong width; one that fits is not."""
    images = fault.of(images_of("level", 16, 1))
    zeros, response = np.zeros(16), np.ones((16, images.sensor.sample_count), np.complex64)
    calibration = Calibration(images.sensor.config_hash, response, zeros, zeros, zeros, width_factor=width_factor)
    field = heights(images.slc(25.0), images.sensor, ML, ML.settings(), calibration)
    if name is None:
        assert not field.doubts
        return
    (doubt,) = field.doubts
    assert doubt.name == name
    assert f"calibration {calibration.id}, which may be of another instrument" in doubt.sentence


@pytest.mark.parametrize(("gains_db", "cnr_db"), [(1.0, 30), (2.0, 20), (2.0, 30)])
def test_heights_with_measured_gains_keep_what_sigma_promises(gains_db: float, cnr_db: float) -> None:
    """On level ground, with a standard error of .05; without the gains that are left it would be 1.6 to 2.5."""
    fault = Fault(gain_db=tuple(gains_db * np.random.default_rng(5).standard_normal(16)))
    described = dwells_of("level", NONE, cnr_db, dwells=DWELLS)
    level = np.nanmedian([field.first.height for field in described])
    measured = [field.first for field in dwells_of("level", fault, cnr_db, dwells=DWELLS, settings=MEASURED)]
    errors = np.concatenate([((one.height - level) / one.sigma).ravel() for one in measured])
    assert 0.6 < np.sqrt(np.nanmean(errors**2)) < 1.3
    assert not np.any(np.abs(errors) > 5)


def test_gains_that_are_left_count_behind_a_calibration_too() -> None:
    """One that knows gains and width exactly, as the description here."""
    images = FAULTS["gains 2 dB rms"].of(images_of("level", 16, 1))
    zeros, response = np.zeros(16), np.ones((16, images.sensor.sample_count), np.complex64)
    calibration = Calibration(images.sensor.config_hash, response, zeros, zeros, zeros, width_sigma=0.0)
    exact = MEASURED.model_copy(update={"channel_gain_sigma_db": 0.0, "beam_width_sigma": 0.0})
    behind, described = (heights(images.slc(30.0), images.sensor, ML, exact, one) for one in (calibration, None))
    np.testing.assert_allclose(behind.first.sigma, described.first.sigma, rtol=1e-3)


@cache
def small_slc(cnr_db: float = 20.0) -> tuple[Slc, Sensor]:
    """Images of the small preset, 8 channels."""
    preset = load_preset("small")
    flight = flight_of(replace(preset, cnr_db=cnr_db), 3)
    size = ImageSettings(rows=preset.image.rows, cols=preset.image.cols)
    slc = Compressor().add(flight.phase_history(0), flight.track(0), flight.sensor, size)
    assert slc is not None
    return slc, flight.sensor


def louder(slc: Slc, sensor: Sensor) -> HeightField:
    """Heights of images whose samples are ten times as large as described."""
    return heights(replace(slc, images=10 * slc.images), sensor, ML, ML.settings())


def test_channels_keep_their_numbers_where_one_is_dead() -> None:
    slc, sensor = small_slc()
    images = slc.images.copy()
    images[2] = 0
    field = heights(replace(slc, images=images), sensor, ML, ML.settings())
    assert [test.channel for test in field.fit] == [-1, 0, 1, 3, 4, 5, 6, 7]  # seven channels have no other tests


def test_where_ranges_are_blanked_most_rows_are_tested() -> None:
    slc, sensor = small_slc()
    blanked = replace(sensor, blanked_ranges=((2, 4999.0, 4999.4),), config_hash="")
    field = louder(slc, blanked)
    assert [test.channel for test in field.fit[:9]] == [-1, *range(8)], "few rows are without channel 2"
    (doubt,) = field.doubts
    assert doubt.size == pytest.approx(20, abs=1)


def mixed(sensor: Sensor) -> Sensor:
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((8, 8)))[0]
    return replace(sensor, channel_matrix=tuple(map(tuple, turned.tolist())), config_hash="")


def test_channels_that_are_mixtures_have_a_noise_level_only() -> None:
    slc, sensor = small_slc()
    turned = mixed(sensor)
    images = np.einsum("mn,nrc->mrc", np.array(turned.channel_matrix), slc.images).astype(np.complex64)
    field = louder(replace(slc, images=images), turned)
    assert [test.name for test in field.fit] == ["noise level"]
    assert field.doubts[0].size == pytest.approx(20, abs=1)


NOT_TESTED: dict[str, Callable[[Slc, Sensor], HeightField]] = {
    "clipped": lambda slc, sensor: louder(replace(slc, saturated_share=np.ones(8)), sensor),
    "monopulse": lambda slc, sensor: heights(slc, sensor, ESTIMATORS["monopulse"], ESTIMATORS["monopulse"].settings()),
    "without layover": lambda slc, sensor: heights(slc, sensor, ML, ML.settings(layover=False)),
}


@pytest.mark.parametrize("case", NOT_TESTED)
def test_nothing_is_tested_without_a_model_of_every_pixel(case: str) -> None:
    field = NOT_TESTED[case](*small_slc())
    assert field.fit == field.doubts == ()


def test_tests_are_those_of_the_exact_likelihood_whatever_is_maximised() -> None:
    slc, sensor = small_slc()
    exact, published = (
        heights(slc, sensor, ML, ML.settings(objective=objective)) for objective in ("normalised", "numerator")
    )
    assert len(exact.fit) > 1
    assert repr(published.fit) == repr(exact.fit)  # some of the numbers are NaN


@pytest.mark.parametrize(("detectors", "tests"), [(2, 0), (3, 1), (5, 1), (6, 7)])
def test_few_channels_have_fewer_tests(detectors: int, tests: int) -> None:
    """Two of none, as two scatterers explain all that they receive; gains need six."""
    field = dwells_of("level", Fault(20.0), 30, detectors=detectors, dwells=1)[0]
    assert len(field.fit) == tests
    assert [doubt.name for doubt in field.doubts] == (["noise level"] if tests else [])


@pytest.mark.parametrize("detectors", [3, 4, 8])
@pytest.mark.parametrize("scene", ["street", "slope +40 deg", "slope -40 deg"])
def test_few_channels_as_described_are_not_in_doubt(detectors: int, scene: str) -> None:
    """Scenes in which the noise level of few channels is found farthest off, without a doubt."""
    for cnr_db in (5, 20, 40):
        for field in dwells_of(scene, NONE, cnr_db, detectors=detectors, dwells=2):
            assert not field.doubts
            assert not field.fit[0].sigma < 1.7 / detectors, "what scatterers and the search add or take"
