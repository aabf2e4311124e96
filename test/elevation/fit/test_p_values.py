"""Probabilities of the tests of a dwell, from its statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import make_beams
from scipy import stats

from sal_height.elevation.fit.channel_gains import gain_tests, stretch_test
from sal_height.elevation.fit.channel_noise import channel_noise_tests
from sal_height.elevation.fit.noise_level import level_test, range_test
from sal_height.elevation.fit.noise_pattern import correlation_test, interference_test
from sal_height.elevation.fit.statistics import BLOCKS, FitStatistics

CHANNELS, PIXELS = 8, 400
GAINS = [[gain, 0.05, 60.0] for gain in (1.0, 1.1, 0.9, 1.0, 1.3, 0.7, 1.0, 1.0)]
NOISES = [[amplitude, 0.03, 60.0] for amplitude in (1.0, 1.02, 0.98, 1.0, 1.3, 1.0, 1.0, 0.9)]
LEVELS = [[1.0 + 0.05 * block, PIXELS / BLOCKS] for block in range(BLOCKS)]
FOUND = FitStatistics(
    make_beams("jinc", CHANNELS),
    1.0,
    PIXELS,
    4.0,
    [*LEVELS, [1.1, PIXELS]],
    GAINS,
    NOISES,
    [1.2, 0.05, 80.0],
    [[[9.0, 60.0]] * 2] * 2,
)


def test_gains_and_stretch_have_the_tails_of_student_by_their_number_of_pixels() -> None:
    for test, (*_, number) in zip(gain_tests(FOUND, np.arange(CHANNELS)), GAINS, strict=True):
        assert test.p_value == pytest.approx(2 * stats.t.sf(test.statistic, 0.37 * number))
    stretch = stretch_test(FOUND)
    assert stretch.p_value == pytest.approx(2 * stats.t.sf(stretch.statistic, 0.37 * 80))


def test_noise_of_a_channel_is_relative_to_the_median_of_all_and_has_the_tails_of_student() -> None:
    for test, (amplitude, sigma, number) in zip(channel_noise_tests(FOUND, np.arange(CHANNELS)), NOISES, strict=True):
        assert test.size == pytest.approx(20 * np.log10(amplitude))
        assert test.sigma == pytest.approx(20 / np.log(10) * np.hypot(sigma / amplitude, 0.04))
        assert test.statistic == pytest.approx(abs(test.size) / test.sigma)
        assert test.p_value == pytest.approx(2 * stats.t.sf(test.statistic, 0.37 * number))


SCATTERERS, FEW, QUIET = [1.5, 0.2, 60.0], [1.5, 0.03, 20.0], [0.1, 0.003, 60.0]


@pytest.mark.parametrize(
    ("noises", "tested"),
    [
        ([SCATTERERS, *NOISES[1:]], CHANNELS - 1),
        ([FEW, *NOISES[1:]], CHANNELS - 1),
        ([SCATTERERS] * 3 + NOISES[3:], 0),
        ([QUIET] * CHANNELS, 0),
    ],
)
def test_what_is_not_spread_as_noise_is_not_tested(noises: list[list[float]], tested: int) -> None:
    """Nor are all channels if many of them are not, or below what the bins resolve."""
    tests = channel_noise_tests(replace(FOUND, noises=noises), np.arange(CHANNELS))
    assert [test.channel for test in tests if np.isfinite(test.p_value)] == list(range(CHANNELS))[CHANNELS - tested :]


def test_noise_has_the_tails_of_a_normal_deviate_of_as_many_as_were_searched() -> None:
    for test, searched in (
        (level_test(FOUND), 1),
        (range_test(FOUND), BLOCKS),
        (correlation_test(FOUND), 1),
        (interference_test(FOUND), 1),
    ):
        assert 0 < test.p_value < 1, test.name
        assert test.p_value == pytest.approx(min(1.0, searched * 2 * stats.norm.sf(test.statistic))), test.name
