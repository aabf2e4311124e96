"""Elevations that neighbours agree on: fewer outliers, edges where they were, and nothing but single pixels' peaks."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from helpers import BEAMWIDTH, make_beams, multilook, offset_of, phased, target_slc

from sal_height.beams.array import Beams
from sal_height.elevation.array import spatial_prior
from sal_height.elevation.array._kernels import FREE_NODES
from sal_height.elevation.array.estimate import explained_power
from sal_height.elevation.array.likelihood import GUARD, OBJECTIVES, estimate_of, peak_elevation, peaks_at, search_guard
from sal_height.elevation.array.search import PeakSearches
from sal_height.elevation.array.spatial_prior import RECOMMENDED_STRENGTH, smoothed_peaks
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.looks.looks import DwellColumns, Looks
from sal_height.errors import UserError

NORMALISED = OBJECTIVES["normalised"]
SIZE = 160
"""Rows and columns of most images: 25 600 pixels."""

ROW, COL = np.indices((SIZE, SIZE))


def image(
    beams: Beams, offset: np.ndarray, looks: int, cnr_db: float, seed: int, squint: float | np.ndarray = 0.0
) -> Looks:
    """Looks at targets at `offset` (beamwidths, shape (rows, cols)) in unit noise."""
    rows, cols = offset.shape
    slc = target_slc(
        beams,
        offset.reshape(-1, 1),
        rows * cols,
        looks,
        10 ** (cnr_db / 10),
        np.random.default_rng(seed),
        np.broadcast_to(squint, (rows, cols)).reshape(-1, 1),
    )
    seen = multilook(slc.reshape(-1, rows, cols * looks), 1, looks, hermitian=beams.is_complex)
    return Looks.of(seen.covariance[:, :], looks, squint)


def alone(looks: Looks, beams: Beams) -> np.ndarray:
    """Elevations without the prior, rad."""
    return peak_elevation(looks, beams, NORMALISED, search_guard(beams))


def together(looks: Looks, beams: Beams, strength: float = RECOMMENDED_STRENGTH) -> np.ndarray:
    """Elevations with the prior, rad."""
    return smoothed_peaks(looks, beams, strength)


def outliers(elevation: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Pixels more than a beamwidth off."""
    return np.abs(offset_of(elevation) - offset) > 1


SURFACES = {
    "level": np.full((SIZE, SIZE), 1.75),
    "slope": -3.4 + (0.2 * ROW) % 6.8,
    "foreslope": 3.4 - (0.3 * ROW) % 6.8,
    "roof": np.where((np.abs(ROW - 80) < 30) & (np.abs(COL - 80) < 40), 2.0, -1.0),
}
"""Offsets in beamwidths; the slopes start anew every 34 and 23 rows."""


@pytest.mark.parametrize("pattern", ["sinc", "jinc"])
@pytest.mark.parametrize("surface", SURFACES)
def test_ten_times_fewer_outliers_at_5_db_with_four_looks(surface: str, pattern: str) -> None:
    beams, offset = make_beams(pattern), SURFACES[surface]
    seen = image(beams, offset, 4, 5.0, seed=1)
    before, after = alone(seen, beams), together(seen, beams)
    # 500 to 800 of 25 600 pixels, standard error 4 %; after, at most 50 with an error of 14 % or more.
    assert 500 < np.count_nonzero(outliers(before, offset)) < 1000
    assert np.count_nonzero(outliers(after, offset)) <= np.count_nonzero(outliers(before, offset)) / 10


def test_pixels_that_were_right_are_as_before() -> None:
    """Bit by bit, but for those a sidelobe away; so the local accuracy is that of maximum likelihood."""
    beams, offset = make_beams(), SURFACES["level"]
    seen = image(beams, offset, 4, 5.0, seed=2)
    before, after = alone(seen, beams), together(seen, beams)
    right = np.abs(offset_of(before) - offset) < 0.5
    assert np.mean(before[right] == after[right]) > 0.999


@pytest.mark.parametrize(("looks", "cnr_db", "step"), [(4, 5.0, 3.0), (4, 10.0, 1.0), (1, 10.0, 3.0)])
def test_edge_stays_within_a_pixel(looks: int, cnr_db: float, step: float) -> None:
    """Of every row the edge is where the fewest pixels are on the wrong side."""
    beams, half = make_beams(), SIZE // 2
    seen = image(beams, np.where(half > COL, -step / 2, step / 2), looks, cnr_db, seed=3)
    high = offset_of(together(seen, beams)) > 0
    wrong = np.array([high[:, :c].sum(axis=1) + (~high[:, c:]).sum(axis=1) for c in range(half - 5, half + 6)])
    nearest_first = np.argsort(np.abs(np.arange(-5, 6)), kind="stable")
    displacement = np.abs(np.arange(-5, 6))[nearest_first][np.argmin(wrong[nearest_first], axis=0)]
    assert displacement.max() <= 1
    # 5 % of 160 rows have a standard error of 1.7 %.
    assert np.mean(displacement) < 0.1


@pytest.mark.parametrize("size", [2, 3, 4])
def test_thin_bars_are_found_more_often_than_without(size: int) -> None:
    """3 beamwidths above the ground, at 5 dB with four looks: 0.97 without, 0.998 with; 3200 pixels or more."""
    beams = make_beams()
    bar = np.isin(COL % 16, np.arange(size))
    offset = np.where(bar, 2.0, -1.0)
    seen = image(beams, offset, 4, 5.0, seed=4)
    before = np.mean(outliers(alone(seen, beams), offset)[bar])
    after = np.mean(outliers(together(seen, beams), offset)[bar])
    # Standard errors .003 and .001.
    assert before > 0.02
    assert after < before / 3


def test_lone_pixels_are_lost_in_a_fifth_of_the_cases() -> None:
    """The price, at 5 dB with four looks; 1600 pixels in 280 x 280 have a standard error of 0.010."""
    beams = make_beams()
    row, col = np.indices((280, 280))
    lone = (row % 7 == 3) & (col % 7 == 3)
    offset = np.where(lone, 2.0, -1.0)
    lost = np.mean(outliers(together(image(beams, offset, 4, 5.0, seed=5), beams), offset)[lone])
    assert lost == pytest.approx(0.2, abs=0.04)


@pytest.mark.parametrize("looks", [1, 4])
@pytest.mark.parametrize("squint", [0.0, np.linspace(-0.4, 0.4, SIZE) * BEAMWIDTH], ids=["one squint", "many"])
def test_strength_0_is_plain_maximum_likelihood(looks: int, squint: float | np.ndarray) -> None:
    beams = make_beams("jinc")
    seen = image(beams, SURFACES["roof"], looks, 0.0, 6, squint)
    np.testing.assert_array_equal(together(seen, beams, 0.0), alone(seen, beams), strict=True)


@pytest.mark.parametrize("surface", SURFACES)
def test_nothing_changes_at_20_db(surface: str) -> None:
    """With four looks, whose outliers are 1 in 10 000; 25 600 pixels have a standard error of 0.006 %."""
    beams = make_beams()
    seen = image(beams, SURFACES[surface], 4, 20.0, seed=7)
    assert np.mean(together(seen, beams) == alone(seen, beams)) >= 0.999


def test_every_elevation_is_a_peak_of_its_pixel() -> None:
    """Or an end of the domain: 0.02 beamwidths to either side less power is explained."""
    beams = make_beams()
    seen = image(beams, SURFACES["roof"], 1, 0.0, seed=8)
    elevation = together(seen, beams)
    moved = elevation != alone(seen, beams)
    assert np.mean(moved) > 0.1
    first, last = beams.domain(GUARD * BEAMWIDTH)
    inside = (elevation > first + 0.02 * BEAMWIDTH) & (elevation < last - 0.02 * BEAMWIDTH)
    there = explained_power(seen.covariance, beams.response(elevation, 0.0))
    for side in (-0.02, 0.02):
        beside = explained_power(seen.covariance, beams.response(elevation + side * BEAMWIDTH, 0.0))
        assert np.all((beside < there)[inside])


def test_every_column_has_its_own_squint() -> None:
    """Of beams turned by 15 degrees, whose response depends on it."""
    straight = make_beams("jinc")
    beams = Beams(straight.patterns, straight.boresights, straight.beamwidth, rotation=np.deg2rad(15))
    squint, offset = np.linspace(-0.4, 0.4, SIZE) * BEAMWIDTH, np.zeros((SIZE, SIZE))
    seen = image(beams, offset, 4, 5.0, 9, squint)
    before = np.count_nonzero(outliers(alone(seen, beams), offset))
    after = np.count_nonzero(outliers(together(seen, beams), offset))
    assert before > 500
    assert after <= before / 10


def test_likelihood_is_the_greatest_over_the_power_of_the_amplitudes() -> None:
    """Of Gaussian samples with covariance sigma^2 I + P a a^T: -K ln det - tr(inverse R), less that of P = 0."""
    beams, looks, noise_power = make_beams(count=8), 3, 2.5
    rng = np.random.default_rng(10)
    covariance = image(beams, np.array([[0.3, -1.0]]), looks, 3.0, 10).covariance * np.float32(noise_power)
    covariance[0, 1] *= np.float32(0.05)  # weaker than noise almost everywhere: P = 0 is best
    searches = PeakSearches.over(beams, NORMALISED, 0.0)
    seen = Looks.of(covariance, looks, noise_power=noise_power)
    own, has_data = spatial_prior._log_likelihood(seen, next(spatial_prior._tiles(1, DwellColumns(1, 2))), searches)
    assert has_data.all()
    powers = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 4001)])
    nodes = np.linspace(*beams.domain(0.0), own.shape[2])
    for pixel, g in product(range(2), rng.choice(own.shape[2], 5, replace=False)):
        a = beams.response(nodes[g], 0.0)
        models = noise_power * np.eye(8) + powers[:, None, None] * np.outer(a, a)
        traces = np.trace(np.linalg.solve(models, covariance[0, pixel].astype(float)[None]), axis1=1, axis2=2)
        values = -looks * np.linalg.slogdet(models)[1] - traces
        assert own[0, pixel, g] == pytest.approx(values.max() - values[0], abs=2e-4)
    assert np.count_nonzero(own[0, 1]) < own.shape[2] / 2


def test_on_a_line_the_sum_is_that_of_the_best_of_all_paths() -> None:
    """Through every node, by trying all: own log-likelihoods less the strength at each jump of 3 nodes or more."""
    pixels, count, strength = 5, 8, 0.7
    own = np.random.default_rng(11).exponential(size=(1, pixels, count)).astype(np.float32)
    paths = np.array(list(product(range(count), repeat=pixels)))
    jumps = np.count_nonzero(np.abs(np.diff(paths, axis=1)) > FREE_NODES, axis=1)
    value = own[0, np.arange(pixels), paths].sum(axis=1) - strength * jumps
    best = np.array([[value[paths[:, p] == g].max() for g in range(count)] for p in range(pixels)])
    total = (own + spatial_prior._messages(own, np.ones((1, pixels), dtype=bool), strength))[0]
    np.testing.assert_allclose(
        total - total.max(axis=1, keepdims=True), best - best.max(axis=1, keepdims=True), atol=1e-5
    )
    assert np.any(jumps[np.argmax(value)] > 0)


def test_all_eight_neighbours_say_the_same_of_a_cross() -> None:
    """A pixel that knows nothing hears of each of its eight neighbours once."""
    own = np.zeros((3, 3, 9), np.float32)
    own[..., 4] = 5.0
    own[1, 1] = 0.0
    heard = spatial_prior._messages(own, np.ones((3, 3), dtype=bool), 0.5)[1, 1]
    np.testing.assert_allclose(heard, np.where(np.abs(np.arange(9) - 4) <= FREE_NODES, 0.0, -8 * 0.5), atol=1e-6)


def test_pixels_without_data_say_nothing_and_pass_nothing_on() -> None:
    """Beyond a column without data an image is as if it were the only one."""
    beams = make_beams()
    seen = image(beams, SURFACES["level"], 1, 5.0, seed=12)
    seen.covariance[:, 60] = 0
    whole = together(seen, beams)
    np.testing.assert_array_equal(whole[:, :60], together(Looks.of(seen.covariance[:, :60], 1), beams))
    np.testing.assert_array_equal(whole[:, 61:], together(Looks.of(seen.covariance[:, 61:], 1), beams))
    np.testing.assert_array_equal(whole[:, 60], alone(seen, beams)[:, 60])


def test_tiles_agree_with_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even where neighbours count most, at 0 dB with one look; with margins of 2 one pixel in 700 differs."""
    beams, squint = make_beams(), np.linspace(-0.4, 0.4, SIZE) * BEAMWIDTH
    seen = Looks.of(image(beams, SURFACES["level"], 1, 0.0, 13, squint).covariance[:150], 1, squint)
    whole = together(seen, beams)
    monkeypatch.setattr(spatial_prior, "TILE", 50)
    np.testing.assert_array_equal(together(seen, beams), whole)


def test_phases_of_detectors_make_no_difference_to_complex_beams() -> None:
    """Each detector has its own; the covariance, too."""
    real, phases = make_beams("jinc"), np.random.default_rng(14).uniform(0, 2 * np.pi, 16)
    beams = replace(real, patterns=tuple(phased(real.patterns[0], np.exp(1j * phase)) for phase in phases))
    turned = image(beams, SURFACES["level"], 4, 5.0, seed=14)
    factors = np.exp(1j * (phases - phases[:, None])).astype(np.complex64)
    plain = Looks.of((turned.covariance * factors).real, 4)
    np.testing.assert_allclose(offset_of(together(turned, beams)), offset_of(together(plain, real)), rtol=0, atol=1e-3)
    with pytest.raises(UserError, match="must be complex"):
        together(plain, beams)


def test_uphill_of_the_right_node_is_the_highest_peak() -> None:
    """Climbed from the highest node of the grid or the next; from elsewhere, a lower peak."""
    beams = make_beams()
    pixels = image(beams, np.full((1, 200), 0.4), 4, 20.0, seed=15).covariance[0]
    search = PeakSearches.over(beams, NORMALISED, 0.0).at(0.0)
    highest = np.argmax(search.on_grid(pixels), axis=1)
    for shift in (-1, 0, 1):
        np.testing.assert_array_equal(search.peaks_uphill(pixels, highest + shift), search.peaks(pixels).elevation)
    far = search.peaks_uphill(pixels, np.zeros_like(highest))
    assert np.all(np.abs(offset_of(far) - 0.4) > 1)


@pytest.mark.parametrize("strength", [0.0, RECOMMENDED_STRENGTH])
def test_estimate_is_that_of_the_peaks_that_were_taken(strength: float) -> None:
    beams, squint = make_beams("sinc"), np.linspace(-0.2, 0.2, 6) * BEAMWIDTH
    slc = target_slc(beams, 0.7, 40, 24, 3.0, np.random.default_rng(5)).astype(np.complex64)
    looks = multilook(slc, 1, 4, squint=squint)
    settings = MlSettings(min_cnr_db=0.0, ambiguous_ratio=1.0, layover=False)
    plain = ml_elevation(looks, beams, settings)
    found = estimate_of(peaks_at(smoothed_peaks(looks, beams, strength), looks, beams), looks, beams, settings)
    if strength:
        np.testing.assert_array_equal(
            found.elevation, ml_elevation(looks, beams, settings.changed(prior_strength=strength)).elevation
        )
    same = found.elevation == plain.elevation
    assert same.all() == (strength == 0)
    for name in ("sigma", "cnr", "validity"):
        np.testing.assert_allclose(getattr(found, name)[same], getattr(plain, name)[same], rtol=1e-6)
