"""The error of elevation by sidelobes: against estimates of drawn pixels with a weak wave from elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, elevation_at, make_beams, offset_of

from sal_height.elevation import AxisResponse, CellResponse, Looks, Window, covariance, ml_elevation, sidelobe_variance
from sal_height.elevation.array.response_spread import PULL_SPAN, PULL_STEPS, squared_pull
from sal_height.elevation.estimators.maximum_likelihood import MlSettings

ONE = Window.named("boxcar", 1), Window.named("boxcar", 1)
RECTANGULAR = CellResponse(AxisResponse("rectangular", 1.0), AxisResponse("rectangular", 1.0))


@pytest.mark.parametrize("distance", [0.125, 0.3125, 0.8125, 1.5])
def test_a_wave_from_elsewhere_moves_the_estimate_as_its_pull_says(distance: float) -> None:
    """At -40 dB in each of 4 looks of 4000 pixels: standard error of the variance 2 %, higher orders of 1 %."""
    beams, rng = make_beams("jinc", 16), np.random.default_rng(12)
    here, there = (beams.response(elevation_at(np.array([x])), 0.0)[0] for x in (0.0, distance))
    ratio = 1e-4 * np.sum(here**2) / np.sum(there**2)
    amplitude, wave = 1e4 * circular(rng, (4000, 4)), 1e4 * np.sqrt(ratio) * circular(rng, (4000, 4))
    samples = amplitude[..., None] * here + wave[..., None] * there
    looks = Looks.of(covariance(samples.astype(np.complex64), hermitian=False)[:, None], 4)
    found = offset_of(ml_elevation(looks, beams, MlSettings(layover=False)).elevation[:, 0])
    energy = np.sum(np.abs(amplitude) ** 2, axis=1)
    node = round((PULL_SPAN + distance) * PULL_STEPS)
    expected = 1e-4 * 1e8 * squared_pull(beams)[node] / BEAMWIDTH**2 / (2 * energy)
    assert np.mean(found**2 / expected) == pytest.approx(1, abs=0.12)


def test_variance_is_the_sum_over_pixels_of_share_power_and_squared_pull() -> None:
    """A weak pixel of a column 5 rows from a bright one a beamwidth away, and 15 rows from its mirror image."""
    beams = make_beams("jinc", 16)
    power = np.zeros((21, 1))
    power[5], power[10] = 1e6, 1e2
    noise = 1.0
    matrices = (power[..., None, None] / 16 + noise) * np.eye(16, dtype=np.float32)
    looks = Looks.of(matrices.astype(np.float32), 1.0)
    elevation = elevation_at(np.where(np.arange(21)[:, None] < 8, 1.0, 0.0))
    variance = sidelobe_variance(elevation, looks, beams, ONE, RECTANGULAR)
    whole, near = RECTANGULAR.down.fractions()
    pull = squared_pull(beams)[round((PULL_SPAN + 1) * PULL_STEPS)]
    share = (whole - near)[len(whole) // 2 + np.array([5, 15])].sum()
    assert variance[10, 0] == pytest.approx(share * 1e6 * pull / (2 * 1e2), rel=1e-3)


def test_a_pedestal_reaches_all_pixels_of_a_row_and_none_of_a_column() -> None:
    """By as much in every sample of a look, wherever the bright pixel is."""
    beams = make_beams("jinc", 16)
    blurred = replace(RECTANGULAR, pedestal=1e-3)
    pull = squared_pull(beams)[round((PULL_SPAN + 1) * PULL_STEPS)]
    added = []
    for shape, bright in (((1, 9), (0, 2)), ((9, 1), (2, 0))):
        power = np.full(shape, 1e2)
        power[bright] = 1e6
        elevation = elevation_at((power > 1e3).astype(float))
        looks = Looks.of(((power[..., None, None] / 16 + 1.0) * np.eye(16, dtype=np.float32)).astype(np.float32), 1.0)
        sharp, blur = (sidelobe_variance(elevation, looks, beams, ONE, one) for one in (RECTANGULAR, blurred))
        added.append((blur - sharp).ravel()[[5, 7]])
    # The pixel itself, and its mirror image about the nearer edge.
    np.testing.assert_allclose(added[0], 2 * 1e-3 * 1e6 * pull / (2 * 1e2), rtol=1e-2)
    np.testing.assert_allclose(added[1], 0.0, atol=1e-12)


def test_pixels_of_one_elevation_do_not_move_each_other() -> None:
    beams = make_beams("jinc", 16)
    looks = Looks.of(np.broadcast_to(100 * np.eye(16, dtype=np.float32), (9, 7, 16, 16)), 4.0)
    variance = sidelobe_variance(np.full((9, 7), float(elevation_at(0.3))), looks, beams, ONE, RECTANGULAR)
    np.testing.assert_allclose(variance, 0.0, atol=1e-30)


def test_pixels_without_elevation_move_no_other() -> None:
    beams = make_beams("jinc", 16)
    looks = Looks.of(np.broadcast_to(100 * np.eye(16, dtype=np.float32), (9, 1, 16, 16)), 4.0)
    elevation = np.full((9, 1), np.nan)
    elevation[[0, 4, 8]] = elevation_at(0.3)
    variance = sidelobe_variance(elevation, looks, beams, ONE, RECTANGULAR)
    np.testing.assert_allclose(variance[[0, 4, 8]], 0.0, atol=1e-30)
    assert np.all(np.isfinite(variance))
