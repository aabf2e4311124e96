"""Point targets found in an image: where they are, what their chips hold, and why the others are none."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from helpers import circular, few, refused
from numpy.testing import assert_allclose

from sal_height.errors import NotDetermined, UserError
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, TapeTarget, make_tape
from sal_height.response import point_targets
from sal_height.response.point_targets import BLOCK, PointTargetSettings, Verdict, chip_at, find_targets

SIDE = 256
PLACES = ((70.3, 60.8), (80.0, 190.45), (190.75, 100.1))


def tape(*targets: TapeTarget, seed: int = 1, shape: tuple[int, int] = (SIDE, SIDE)) -> np.ndarray:
    """A Taylor-weighted range band, a cosine beam."""
    fault = RangeFault(sawtooth=0.0)
    return make_tape(shape, np.random.default_rng(seed), targets, fault, AzimuthFault())


def verdicts(image: np.ndarray, chip: tuple[int, int] = (64, 64)) -> list[Verdict]:
    """Of all candidates, the brightest first."""
    return [candidate.verdict for candidate in find_targets(image, chip).candidates]


@pytest.mark.parametrize("carrier", [(0.0, 0.0), (0.45, -0.2)])
def test_targets_are_found_where_they_are(carrier: tuple[float, float]) -> None:
    # The standard error of a place in clutter is about 0.01 pixels in range here, and less in azimuth.
    image = tape(*(TapeTarget(*place, 40.0 + i) for i, place in enumerate(PLACES)))
    rows, cols = np.ogrid[:SIDE, :SIDE]
    image = (image * np.exp(2j * np.pi * (carrier[0] * rows + carrier[1] * cols))).astype(np.complex64)
    survey = find_targets(image)
    assert [candidate.verdict for candidate in survey.candidates] == [Verdict.ACCEPTED] * 3
    found = sorted((target.row, target.col, 10 * np.log10(target.over_clutter)) for target in survey.targets)
    assert_allclose([place for *place, _ in found], PLACES, atol=0.03)
    assert_allclose([level for *_, level in found], [40, 41, 42], atol=0.6)


@pytest.mark.parametrize("scale", [1e-15, 1e15])
def test_the_scale_of_an_image_does_not_matter(scale: float) -> None:
    image = tape(TapeTarget(*PLACES[0], 40.0))
    (plain,), (scaled,) = (find_targets((image * factor).astype(np.complex64)).targets for factor in (1, scale))
    assert_allclose(scaled.spectrum, plain.spectrum, rtol=1e-3, atol=1e-3)
    assert scaled.over_clutter == pytest.approx(plain.over_clutter, rel=1e-4)


def test_a_chip_holds_the_response_between_the_pixels() -> None:
    # Noise free: what is left is that a window of 128 pixels is not cyclic.
    offsets = np.arange(-32, 32)
    place = (120.37, 131.81)

    def response(rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
        return np.sinc(rows / 2.6)[:, None] ** 2 * np.sinc(cols / 2.3) ** 2 * np.exp(0.3j)

    image = response(np.arange(SIDE) - place[0], np.arange(SIDE) - place[1])
    target = chip_at(5 * image, 120, 132, clutter=1e-4)
    assert_allclose((target.row, target.col), place, atol=1e-4)
    assert target.over_clutter == pytest.approx(25e4, rel=1e-3)
    expected = response(offsets, offsets) * np.exp(-0.3j)
    assert_allclose(np.fft.fftshift(target.chip), expected, atol=1e-3)
    assert_allclose(target.spectrum, np.fft.fftshift(np.fft.fft2(target.chip)), atol=1e-9)


def test_a_chip_as_wide_as_the_image_is_cyclic() -> None:
    """A narrow image has no columns to spare beside a chip."""
    image = tape(TapeTarget(128.2, 9.7, 45.0), shape=(SIDE, 12))
    survey = find_targets(image, (64, 12))
    (target,) = survey.require()
    assert target.spectrum.shape == (64, 12)
    assert_allclose((target.row, target.col), (128.2, 9.7), atol=0.03)


def test_speckle_has_no_targets() -> None:
    survey = find_targets(tape())
    assert not survey.candidates
    with refused(NotDetermined, "No pixel", "point_over_clutter_db", "needed"):
        survey.require()


def with_gap(value: float, size: int) -> np.ndarray:
    image = tape(TapeTarget(120, 130, 40.0))
    image[100 : 100 + size, 140 : 140 + size] = value
    return image


def pair(rows: float, cols: float, over: float = 40.0) -> np.ndarray:
    """Two targets, one of 40 dB."""
    return tape(TapeTarget(120.0, 130.0, 40.0), TapeTarget(120.0 + rows, 130.0 + cols, over))


def limited(level: float, *, part: bool) -> np.ndarray:
    image = tape(TapeTarget(120, 130, 40.0))
    if part:
        return np.clip(image.view(np.float32), -level, level).view(np.complex64)
    amplitude = np.abs(image)
    return (image * np.minimum(1, level / np.maximum(amplitude, level))).astype(np.complex64)


@pytest.mark.parametrize(
    ("image", "verdict"),
    [
        (tape(TapeTarget(20, 130, 40.0)), Verdict.EDGE),
        (tape(TapeTarget(120, 230, 40.0)), Verdict.EDGE),
        (with_gap(np.nan, 1), Verdict.NOT_FINITE),
        (with_gap(np.inf, 1), Verdict.NOT_FINITE),
        (with_gap(0.0, 8), Verdict.GAPS),
        (pair(30, 28), Verdict.CROWDED),
        (pair(30, 28, 35), Verdict.CROWDED),
        (pair(9, 5, 30), Verdict.COMPLICATED),
        (pair(4, 2), Verdict.COMPLICATED),
        (pair(8, 0, 36), Verdict.COMPLICATED),
        (pair(0, 4, 36), Verdict.COMPLICATED),
        (limited(20.0, part=True), Verdict.CLIPPED),
        (limited(50.0, part=False), Verdict.CLIPPED),
    ],
)
def test_what_is_no_point_alone_is_not_taken(image: np.ndarray, verdict: Verdict) -> None:
    survey = find_targets(image)
    assert set(survey.verdicts) == {verdict}
    with refused(NotDetermined, f"{survey.verdicts[verdict]} {verdict}"):
        survey.require()


def test_what_is_much_fainter_does_not_crowd() -> None:
    assert verdicts(pair(30, 28, 18)) == [Verdict.ACCEPTED]
    assert verdicts(tape(TapeTarget(120, 130, 60), TapeTarget(150, 105, 35))) == [Verdict.ACCEPTED, Verdict.CROWDED]
    assert verdicts(with_gap(0.0, 4)) == [Verdict.ACCEPTED]


@pytest.mark.parametrize("seed", few(1, [0, 1, 2, 3, 4]))
def test_speckle_does_not_make_a_faint_target_complicated(seed: int) -> None:
    assert verdicts(tape(TapeTarget(120, 130, 24.0), seed=seed)) == [Verdict.ACCEPTED]


def test_two_that_are_not_resolved_are_wider_than_the_others() -> None:
    # In one row the pair is the product of its cuts: alone it would pass.
    others = (TapeTarget(190, 60, 40), TapeTarget(60, 190, 40))
    image = tape(*others, TapeTarget(70.0, 60.0, 42), TapeTarget(71.9, 60.0, 42), seed=2)
    found = {candidate.row: candidate.verdict for candidate in find_targets(image).candidates}
    assert sorted(found.values()) == [Verdict.ACCEPTED, Verdict.ACCEPTED, Verdict.COMPLICATED]
    assert found[190] is found[60] is Verdict.ACCEPTED


def crowded_pairwise(places: np.ndarray, power: np.ndarray, chip: tuple[int, int]) -> list[bool]:
    """Each candidate against every other."""
    near = np.all(np.abs(places[:, None] - places) <= np.array(chip) // 2, axis=-1)
    np.fill_diagonal(near, val=False)
    return np.any(near & (power > 0.01 * power[:, None]), axis=1).tolist()


def draw_candidates(count: int, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Places far from the edges of an image of 10 000 x 10 000, and powers."""
    rng = np.random.default_rng(7)
    return rng.integers(500, 500 + side, (count, 2)), 10 ** rng.uniform(2, 5, count) * rng.uniform(1, 2, count)


@pytest.mark.parametrize("chip", [(64, 64), (30, 6)])
def test_crowds_are_those_of_all_pairs(chip: tuple[int, int]) -> None:
    places, power = draw_candidates(300, 600)
    marked = point_targets._position_verdicts(places, power, (10_000, 10_000), chip, 0.01)
    expected = crowded_pairwise(places, power, chip)
    assert 50 < sum(expected) < 290
    assert [verdict is Verdict.CROWDED for verdict in marked] == expected


def test_crowds_of_a_city_need_little_memory() -> None:
    """All pairs of as many candidates would take 3 GB."""
    places, power = draw_candidates(20_000, 8192)
    tracemalloc.start()
    point_targets._position_verdicts(places, power, (10_000, 10_000), (64, 64), 0.01)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


def test_settings_decide_what_is_taken() -> None:
    image = tape(*(TapeTarget(*place, 40.0 + i) for i, place in enumerate(PLACES)))
    survey = find_targets(image, settings=PointTargetSettings(points_per_image=2))
    assert [candidate.verdict for candidate in survey.candidates] == [Verdict.ACCEPTED, Verdict.ACCEPTED, Verdict.SPARE]
    assert len(survey.targets) == 2
    assert len(find_targets(image, settings=PointTargetSettings(point_over_clutter_db=41.5)).candidates) == 1
    assert not find_targets(image, settings=PointTargetSettings(point_sidelobes_db=45.0)).targets
    lone = pair(30, 28, 18)
    assert not find_targets(lone, settings=PointTargetSettings(point_isolation_db=26.0)).targets
    close = tape(
        TapeTarget(190, 60, 40), TapeTarget(60, 190, 40), TapeTarget(70.0, 60.0, 42), TapeTarget(71.9, 60.0, 42), seed=2
    )
    assert len(find_targets(close, settings=PointTargetSettings(point_energy_ratio=5.0)).targets) == 3


def test_the_survey_is_a_mean_and_a_maximum_of_blocks() -> None:
    image = circular(np.random.default_rng(3), (3 * BLOCK + 5, 2 * BLOCK + 1)).astype(np.complex64)
    image[5, 7], image[40, 20], image[48:, 32:] = np.nan, np.inf, np.nan
    mean, peak = point_targets._blocks(image)
    power = np.where(np.isfinite(image), np.abs(image) ** 2, np.nan)
    for i, j in np.ndindex(mean.shape):
        block = power[BLOCK * i : BLOCK * (i + 1), BLOCK * j : BLOCK * (j + 1)]
        expected = (np.nanmean(block), np.nanmax(block)) if np.any(np.isfinite(block)) else (0, 0)
        assert_allclose((mean[i, j], peak[i, j]), expected, rtol=1e-5)
    assert mean.shape == (4, 3)


@pytest.mark.parametrize("value", [0.0, np.nan, 7 + 7j, 1e300])
def test_images_of_one_value_have_no_targets(value: complex) -> None:
    with pytest.raises(NotDetermined):
        find_targets(np.full((128, 128), value, dtype=np.complex128)).require()


@pytest.mark.parametrize(
    ("image", "chip", "part"),
    [
        (np.ones((128, 128)), (64, 64), "float64"),
        (np.ones((2, 128, 128), dtype=np.complex64), (64, 64), "(2, 128, 128)"),
        (np.ones((50, 128), dtype=np.complex64), (64, 64), "50 x 128"),
        (np.ones((128, 128), dtype=np.complex64), (64, 2), "64 x 2"),
    ],
)
def test_what_cannot_be_surveyed_is_refused(image: np.ndarray, chip: tuple[int, int], part: str) -> None:
    with refused(UserError, part, "must be"):
        find_targets(image, chip)
