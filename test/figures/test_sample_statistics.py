"""Statistics and their standard errors: of samples whose statistics are known, drawn again and again."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from sal_height.figures.sample_statistics import Measured, mean, median, s68, share, std
from sal_height.theory.discriminator_noise import s68_of

LAW = stats.t(12, 0.3, 0.5)

EXPECTED: dict[Callable[[np.ndarray], Measured], float] = {mean: 0.3, median: 0.3, std: LAW.std(), s68: s68_of(LAW)}


@pytest.mark.parametrize("statistic", EXPECTED)
def test_standard_errors_are_those_of_repetition(statistic: Callable[[np.ndarray], Measured]) -> None:
    """z has mean 0 within 3.5 / sqrt(600) = 0.14 and variance 1 within 3.5 sqrt(2 / 600) = 0.2 beside 5 % of bias."""
    rng = np.random.default_rng(71)
    measured = [statistic(0.3 + 0.5 * rng.standard_t(12, 2000)) for _ in range(600)]
    z = np.array([(value - EXPECTED[statistic]) / error for value, error in measured])
    assert abs(np.mean(z)) < 0.15
    assert np.var(z) == pytest.approx(1.0, abs=0.25)


def test_share_of_none_and_of_all_has_an_error_too() -> None:
    assert share(np.zeros(99, dtype=bool)) == pytest.approx((0.0, np.sqrt(1 / 101 * 100 / 101 / 99)))
    assert share(np.ones(99, dtype=bool)) == pytest.approx((1.0, np.sqrt(1 / 101 * 100 / 101 / 99)))
    assert share(np.arange(400) < 100).value == 0.25
    assert share(np.arange(400) < 100).standard_error == pytest.approx(np.sqrt(0.25 * 0.75 / 400), rel=0.01)


@pytest.mark.parametrize("statistic", [mean, median, s68])
def test_one_value_has_no_width(statistic: Callable[[np.ndarray], Measured]) -> None:
    assert statistic(np.array([0.7])).standard_error == 0.0


def test_one_value_has_no_error_of_its_standard_deviation() -> None:
    assert np.isnan(std(np.array([0.7])).standard_error)
