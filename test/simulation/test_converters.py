"""Converters: noise of rounding as theory has it, and the levels that there are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import make_sensor, refused

from sal_height.errors import UserError
from sal_height.simulation import load_preset, parse_preset
from sal_height.simulation.receiver_noise import received


@pytest.mark.parametrize("bits", [4, 8])
def test_rounding_adds_a_sixth_of_the_square_of_a_step(bits: int) -> None:
    """Of noise that takes many steps, within 4 standard errors of 200 000 samples; no value is between the levels."""
    sensor = make_sensor(pulse_count=100, sample_count=1000, full_scale=4.0)
    nothing = np.zeros((3, 100, 1000), np.complex64)
    exact = received(nothing, sensor, np.random.default_rng(1))
    rounded = received(nothing, sensor, np.random.default_rng(1), bits)
    step = 8.0 / (2**bits - 1)
    assert np.mean(np.abs(rounded - exact) ** 2) == pytest.approx(step**2 / 6, rel=0.01)
    levels = np.unique(rounded.view(np.float32))
    assert len(levels) <= 2**bits
    assert np.abs(levels).max() <= np.float32(4.0)
    np.testing.assert_allclose(np.diff(levels), np.round(np.diff(levels) / step) * step, rtol=1e-4)


def test_strong_samples_are_clipped_at_the_outermost_level() -> None:
    sensor = make_sensor(pulse_count=3, sample_count=4, full_scale=2.0)
    samples = np.full((3, 3, 4), 100 - 100j, np.complex64)
    np.testing.assert_array_equal(received(samples, sensor, np.random.default_rng(1), 6), np.complex64(2 - 2j))


def test_converters_without_a_full_scale_are_said_in_one_sentence() -> None:
    given = dataclasses.asdict(load_preset("small"))
    given["impairments"]["adc_bits"] = 8
    with refused(UserError, "adc_bits", "full_scale_over_noise_db"):
        parse_preset(given, "small")
