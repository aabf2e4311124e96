"""Pixels of one, two, three scatterers and of extended surfaces: found as often as promised, each within its sigma."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, elevation_at, few, make_beams, multilook, offset_of

from sal_height.beams.array import Beams
from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.layover import models
from sal_height.elevation.looks.looks import Looks

COLUMNS = 20

PATTERN_NAMES = pytest.mark.parametrize("pattern", ["sinc", "jinc"])


def points(beams: Beams, offsets: np.ndarray, cnrs: tuple[float, ...], looks: int, rng: np.random.Generator) -> Looks:
    """Image of pixels with fluctuating scatterers at `offsets` (pixels, scatterers) in unit noise, COLUMNS in a row."""
    slc = circular(rng, (len(offsets), looks, beams.count))
    for offset, cnr in zip(offsets.T, cnrs, strict=True):
        response = beams.response(elevation_at(offset), 0.0)[:, None]
        slc += response * np.sqrt(cnr) * circular(rng, (len(offset), looks, 1))
    image = np.moveaxis(slc, -1, 0).reshape(beams.count, -1, COLUMNS * looks)
    return multilook(image, 1, looks, hermitian=beams.is_complex)


def around(spacing: float, count: int, pixels: int, rng: np.random.Generator) -> np.ndarray:
    """Offsets (pixels, count) of scatterers `spacing` beamwidths apart, anywhere in the array."""
    half = 3.7 - spacing * (count - 1) / 2
    return rng.uniform(-half, half, (pixels, 1)) + spacing * (np.arange(count) - (count - 1) / 2)


def scores(result: ElevationEstimate, truth: np.ndarray, validity: Validity) -> np.ndarray:
    """Distance of every scatterer of the pixels with that validity to the nearest true one, over its sigma."""
    here = result.validity == validity
    found = np.stack([offset_of(s.elevation[here]) for s in result.scatterers])
    sigma = np.stack([s.sigma[here] for s in result.scatterers]) / BEAMWIDTH
    score = np.abs(found[..., None] - truth[here.ravel()]).min(axis=-1) / sigma
    return score[np.isfinite(score)]


def share(result: ElevationEstimate, *validities: Validity) -> float:
    return float(np.mean(np.isin(result.validity, validities)))


@PATTERN_NAMES
@pytest.mark.parametrize(("cnr_db", "looks"), few(1, [(10, 4), (20, 1), (25, 16)]))
def test_one_scatterer_is_taken_for_more_as_rarely_as_stated(pattern: str, cnr_db: int, looks: int) -> None:
    """Of 8000 pixels a standard error of 0.03 % for pairs, of 0.11 % for extended surfaces; 3.5 of them are allowed.

    Where it is taken for one, sigma is right.
    """
    beams, rng = make_beams(pattern), np.random.default_rng([52, looks])
    truth = rng.uniform(-3.7, 3.7, (8000, 1))
    result = ml_elevation(points(beams, truth, (10 ** (cnr_db / 10),), looks, rng), beams, MlSettings())
    several = share(result, Validity.TWO_SCATTERERS, Validity.THREE_SCATTERERS)
    assert several < 1e-3 + 3.5 * np.sqrt(1e-3 / 8000)
    assert share(result, Validity.EXTENDED) < 0.01 + 3.5 * np.sqrt(0.01 / 8000)
    score = scores(result, truth, Validity.OK)
    assert np.mean(score < 1) == pytest.approx(0.70, abs=0.03)
    assert np.mean(score > 5) < 2e-3


@pytest.mark.parametrize(
    ("cnr_db", "looks", "separation", "least"),
    few(2, [(10, 4, 1.0, 0.88), (20, 16, 0.7, 0.98), (15, 4, 1.0, 0.97), (5, 16, 1.0, 0.92), (20, 4, 2.0, 0.98)]),
)
def test_two_scatterers_are_found_and_each_is_within_its_sigma(
    cnr_db: int, looks: int, separation: float, least: float
) -> None:
    """2000 pixels: standard error of the share 0.7 % at most, of the coverage 0.8 %; doubt makes sigma greater."""
    beams, rng = make_beams("jinc"), np.random.default_rng([54, cnr_db, looks])
    truth, cnr = around(separation, 2, 2000, rng), 10 ** (cnr_db / 10)
    result = ml_elevation(points(beams, truth, (cnr, cnr), looks, rng), beams, MlSettings())
    assert share(result, Validity.TWO_SCATTERERS) > least
    score = scores(result, truth, Validity.TWO_SCATTERERS)
    assert 0.65 < np.mean(score < 1) < 0.85
    assert np.mean(score > 5) < 2e-3
    strong, weak = (s.cnr[result.validity == Validity.TWO_SCATTERERS] for s in result.scatterers[:2])
    assert np.all(strong >= weak)


@pytest.mark.parametrize(
    ("cnr_db", "looks", "spacing", "least"), few(2, [(20, 4, 1.0, 0.96), (20, 4, 0.75, 0.0), (20, 16, 0.75, 0.96)])
)
def test_three_scatterers_are_found_or_rejected_and_not_taken_for_two(
    cnr_db: int, looks: int, spacing: float, least: float
) -> None:
    """1500 pixels: standard error of the share 0.7 %, of the coverage 0.7 %; doubt makes sigma greater.

    At 20 dB, four looks of three that are 0.75 beamwidths apart are much as those of a wide surface: most are refused.
    """
    beams, rng = make_beams("jinc"), np.random.default_rng([55, cnr_db, looks])
    truth, cnr = around(spacing, 3, 1500, rng), 10 ** (cnr_db / 10)
    result = ml_elevation(points(beams, truth, (cnr,) * 3, looks, rng), beams, MlSettings())
    assert share(result, Validity.THREE_SCATTERERS) > least
    assert share(result, Validity.OK, Validity.TWO_SCATTERERS) < 0.012
    score = scores(result, truth, Validity.THREE_SCATTERERS)
    assert 0.65 < np.mean(score < 1) < 0.9
    assert np.mean(score > 5) < 2e-3


@pytest.mark.parametrize(
    ("cnr_db", "looks", "width", "least"), few(1, [(20, 4, 0.4, 0.8), (20, 16, 0.4, 0.95), (30, 16, 0.3, 0.97)])
)
def test_extended_surfaces_are_known_by_their_spread(cnr_db: int, looks: int, width: float, least: float) -> None:
    """Uniform over `width` beamwidths, 1500 pixels; doubt about pairs makes sigma rather too great than too small."""
    beams, rng = make_beams("jinc"), np.random.default_rng([66, cnr_db, looks])
    middle = rng.uniform(-3, 3, (1500, 1))
    pieces = middle + width * (np.arange(24) - 11.5) / 24
    result = ml_elevation(points(beams, pieces, (10 ** (cnr_db / 10) / 24,) * 24, looks, rng), beams, MlSettings())
    assert share(result, Validity.EXTENDED) > least
    here = result.validity == Validity.EXTENDED
    assert np.median(result.first.spread[here]) / BEAMWIDTH == pytest.approx(width / np.sqrt(12), rel=0.15)
    score = scores(result, middle, Validity.EXTENDED)
    assert 0.64 < np.mean(score < 1) < 0.92
    assert np.mean(score > 5) < 2e-3
    # Whatever is published, its middle is right.
    usable = (Validity.OK, Validity.EXTENDED)
    wrong = sum(np.count_nonzero(scores(result, middle, v) > 5) for v in usable if share(result, v))
    assert wrong / len(middle) < 6e-3


@pytest.mark.parametrize(("cnr_db", "looks"), few(1, [(20, 4), (20, 16), (30, 4)]))
def test_volumes_have_no_height(cnr_db: int, looks: int) -> None:
    """2.5 beamwidths deep, in the middle of the array, 1000 pixels: a standard error of 0.5 % at most."""
    beams, rng = make_beams("jinc"), np.random.default_rng([68, cnr_db, looks])
    middle = rng.uniform(-1.5, 1.5, (1000, 1))
    pieces = middle + 2.5 * (np.arange(40) - 19.5) / 40
    result = ml_elevation(points(beams, pieces, (10 ** (cnr_db / 10) / 40,) * 40, looks, rng), beams, MlSettings())
    assert share(result, Validity.OK, Validity.TWO_SCATTERERS, Validity.THREE_SCATTERERS) < 0.02
    assert share(result, Validity.NOT_ONE_SCATTERER) > 0.9


@pytest.mark.parametrize(
    ("cnr_db", "looks", "spread"), few(2, [(20, 4, 0.3), (10, 16, 0.3), (20, 16, 0.3), (30, 4, 0.4)])
)
def test_steep_surfaces_are_fitted(cnr_db: int, looks: int, spread: float) -> None:
    """1500 pixels of a uniform surface: its middle within its sigma, greater by doubt, and its spread within 10 %."""
    beams, rng = make_beams("jinc"), np.random.default_rng([69, cnr_db, looks])
    middle = rng.uniform(-2.5, 2.5, (1500, 1))
    pieces = middle + spread * np.sqrt(12) * (np.arange(40) - 19.5) / 40
    result = ml_elevation(points(beams, pieces, (10 ** (cnr_db / 10) / 40,) * 40, looks, rng), beams, MlSettings())
    assert share(result, Validity.EXTENDED) > 0.8
    here = result.validity == Validity.EXTENDED
    assert np.median(result.first.spread[here]) / BEAMWIDTH == pytest.approx(spread, rel=0.1)
    score = scores(result, middle, Validity.EXTENDED)
    assert 0.63 < np.mean(score < 1) < 0.8
    assert np.mean(score > 5) < 3e-3


@pytest.mark.parametrize(("cnr_db", "looks"), [(10, 4), (20, 4)])
def test_improbable_models_have_no_height(cnr_db: int, looks: int) -> None:
    """Of three scatterers 0.75 beamwidths apart, which look much like a wide surface and, if weak, like two."""
    beams, rng = make_beams("jinc"), np.random.default_rng([75, cnr_db])
    truth, cnr = rng.uniform(-1.5, 1.5, (1500, 1)) + np.array([-0.75, 0.0, 0.75]), 10 ** (cnr_db / 10)
    result = ml_elevation(points(beams, truth, (cnr,) * 3, looks, rng), beams, MlSettings())
    assert result.order_probability is not None
    for validity, own in {
        Validity.TWO_SCATTERERS: [2],
        Validity.THREE_SCATTERERS: [3],
        Validity.EXTENDED: [1, 4],
    }.items():
        chance = result.order_probability[result.validity == validity][:, own].sum(axis=1)
        assert np.all(chance >= 0.5)
    assert share(result, Validity.NOT_ONE_SCATTERER) > 0.02


def test_sigma_counts_a_spread_that_only_the_pixels_around_show() -> None:
    """A spread of 0.05 beamwidths at 20 dB, 3000 pixels, most of them taken for points: coverage within 1 %.

    Without it sigma would cover 53 %.
    """
    beams, rng, looks = make_beams("jinc"), np.random.default_rng(74), 4
    middle = rng.uniform(-3, 3, (3000, 1))
    pieces = middle + 0.05 * np.sqrt(12) * (np.arange(24) - 11.5) / 24
    result = ml_elevation(points(beams, pieces, (100 / 24,) * 24, looks, rng), beams, MlSettings())
    assert share(result, Validity.OK) > 0.4
    score = scores(result, middle, Validity.OK)
    assert np.mean(score < 1) == pytest.approx(0.68, abs=0.05)


def test_sigma_of_two_surfaces_counts_the_spread_of_those_around() -> None:
    """Two surfaces 1.5 beamwidths apart, each spread by 0.05 beamwidths, at 20 dB in 4 looks, 2000 pixels.

    A standard error of 1 %. Without any spread sigma would cover 50 %, with that of the others alone 66 %; the own one
    is for surfaces whose parts have different ranges.
    """
    beams, rng, looks = make_beams("jinc"), np.random.default_rng(75), 4
    middles = around(1.5, 2, 2000, rng)
    width = 0.05 * np.sqrt(12) * (np.arange(12) - 5.5) / 12
    pieces = (middles[..., None] + width).reshape(len(middles), -1)
    result = ml_elevation(points(beams, pieces, (100 / 12,) * 24, looks, rng), beams, MlSettings())
    score = scores(result, middles, Validity.TWO_SCATTERERS)
    assert len(score) > 3000
    assert np.mean(score < 1) == pytest.approx(0.72, abs=0.04)
    assert np.mean(score > 5) < 1e-3


def test_ranges_of_level_ground_are_neither_a_surface_nor_an_error() -> None:
    """Looks of four rows, 0.03 beamwidths from one to the next, at 30 dB: 1500 pixels; doubt makes sigma greater.

    Elevation belongs to the middle of the looks weighted by their power, as do range and height.
    """
    beams, rng, cnr = make_beams("jinc"), np.random.default_rng(67), 1e3
    steps = 0.03 * np.repeat(np.arange(4) - 1.5, 4)
    middle, amplitude = rng.uniform(-3, 3, (1500, 1)), np.sqrt(cnr) * circular(rng, (1500, 16))
    response = beams.response(elevation_at((middle + steps).ravel()), 0.0).reshape(1500, 16, -1)
    slc = amplitude[..., None] * response + circular(rng, response.shape)
    looks = multilook(np.moveaxis(slc, -1, 0).reshape(beams.count, -1, 16 * COLUMNS), 1, 16)
    weight = np.abs(amplitude) ** 2
    truth = middle + (weight @ steps / weight.sum(axis=1))[:, None]
    level = replace(looks, level_spread=steps.std() * BEAMWIDTH, unplaced=0.0)
    found = ml_elevation(level, beams, MlSettings())
    assert share(found, Validity.OK) > 0.97
    score = scores(found, truth, Validity.OK)
    assert 0.65 < np.mean(score < 1) < 0.82
    # At one range they would be extended surfaces, whose middle is uncertain.
    unaware = ml_elevation(looks, beams, MlSettings())
    assert found.order_probability is not None
    assert unaware.order_probability is not None
    assert np.median(found.order_probability[..., 4]) < 0.3
    assert np.median(unaware.order_probability[..., 4]) > 0.9
    assert np.median(unaware.sigma) > 1.5 * np.median(found.sigma)


def test_scatterer_outside_the_array_does_not_displace_the_one_inside() -> None:
    """Anywhere up to 1.75 beamwidths beyond the end, as strong: 3000 pixels of 20 dB and 4 looks, or 10 dB and 16."""
    for cnr, looks in ((100.0, 4), (10.0, 16)):
        beams, rng = make_beams("jinc"), np.random.default_rng([57, looks])
        truth = np.stack([rng.uniform(-3.5, 3.5, 3000), rng.uniform(3.8, 5.5, 3000)], axis=1)
        result = ml_elevation(points(beams, truth, (cnr, cnr), looks, rng), beams, MlSettings())
        assert share(result, Validity.OK) > 0.92
        score = scores(result, truth[:, :1], Validity.OK)
        assert np.mean(score < 1) == pytest.approx(0.69, abs=0.04)
        assert np.mean(score > 5) < 3e-3


def test_missing_data_are_no_pair() -> None:
    result = ml_elevation(Looks.of(np.zeros((2, 3, 16, 16), np.float32), 4), make_beams("jinc"), MlSettings())
    assert (result.validity == Validity.NO_SIGNAL).all()
    assert np.isnan(result.scatterers[1].elevation).all()


def test_blocks_and_units_of_power_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    beams, rng = make_beams("jinc"), np.random.default_rng(58)
    covariance = points(beams, rng.uniform(-3, 3, (60, 2)), (20.0, 20.0), 4, rng).covariance[:, :]
    covariance = np.asarray(covariance).reshape(10, 6, 16, 16)
    squint = np.array([0.0, 0.1, 0.0, 0.2, 0.1, 0.0]) * BEAMWIDTH
    whole = ml_elevation(Looks.of(covariance, 4, squint), beams, MlSettings())
    monkeypatch.setattr(models, "PIXELS_AT_ONCE", 3)
    parts = ml_elevation(Looks.of(2**-30 * covariance, 4, squint, 2**-30), beams, MlSettings())
    assert 10 < np.count_nonzero(whole.validity == Validity.TWO_SCATTERERS) < 60
    np.testing.assert_array_equal(parts.validity, whole.validity)
    np.testing.assert_allclose(parts.order_probability, whole.order_probability, atol=1e-4)
    for one, other in zip(parts.scatterers, whole.scatterers, strict=True):
        for name in ("elevation", "sigma", "cnr", "spread"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-3)


def test_a_dwell_is_the_same_whatever_came_before() -> None:
    """Tables are held between dwells: those made by one at other squints change no bit of the next."""
    rng, beams = np.random.default_rng(47), make_beams("jinc")
    looks = points(beams, around(1.0, 2, 200, rng), (100.0, 50.0), 4, rng)
    here, elsewhere = (
        replace(looks, squint=(np.linspace(-0.3, 0.3, COLUMNS) + shift) * BEAMWIDTH) for shift in (0.0, 0.0123)
    )
    alone = ml_elevation(here, make_beams("jinc"), MlSettings())
    ml_elevation(elsewhere, beams, MlSettings())
    after = ml_elevation(here, beams, MlSettings())
    np.testing.assert_array_equal(after.validity, alone.validity)
    for one, other in zip(after.scatterers, alone.scatterers, strict=True):
        np.testing.assert_array_equal(one.elevation, other.elevation)
        np.testing.assert_array_equal(one.sigma, other.sigma)
