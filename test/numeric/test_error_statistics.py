"""Statistics of errors, of samples whose numbers are known."""

from __future__ import annotations

import numpy as np
import pytest

from sal_height.numeric import ErrorStatistics, error_statistics

NONE = np.zeros(0)


def test_numbers_of_five_errors() -> None:
    found = error_statistics(np.array([-1.0, 0.0, 1.0, 2.0, 8.0]), np.array([2.0, 1.0, 1.0, 1.0, 1.5]))
    # Quantiles 0.16 and 0.84 of five numbers lie 0.64 steps from the ends.
    assert found == ErrorStatistics(
        count=5,
        bias=2.0,
        rms=pytest.approx(np.sqrt(14)),
        deviation=pytest.approx(np.sqrt(10)),
        median=1.0,
        s68=pytest.approx((8 - 0.64 * 6 - (-1 + 0.64)) / 2),
        sigma=pytest.approx(1.3),
        within_1_sigma=0.4,
        within_2_sigma=0.6,
        beyond_5_sigma=0.2,
    )


def test_normal_errors_keep_what_their_sigmas_promise() -> None:
    """100 000 errors: the standard error of the fractions is 0.0015, that of s68 0.4 %."""
    rng = np.random.default_rng(1)
    sigmas = rng.uniform(0.5, 2.0, 100_000)
    found = error_statistics(rng.normal(0.0, sigmas), sigmas)
    assert found.within_1_sigma == pytest.approx(0.6827, abs=0.006)
    assert found.within_2_sigma == pytest.approx(0.9545, abs=0.003)
    assert found.beyond_5_sigma < 1e-4
    alike = error_statistics(rng.normal(0.3, 0.1, 100_000), np.full(100_000, 0.1))
    assert alike.s68 == pytest.approx(0.0994, rel=0.015)
    assert alike.median == pytest.approx(0.3, abs=0.002)


def test_an_empty_sample_has_no_numbers() -> None:
    keys = ("bias_m", "rms_m", "deviation_m", "median_m", "s68_m", "sigma_m", "within_1_sigma", "beyond_5_sigma")
    found = error_statistics(NONE, NONE)
    assert found.count == 0
    assert found.in_metres(keys) == dict.fromkeys(keys)
