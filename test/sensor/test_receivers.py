"""Saturated receivers: how much is clipped, what that adds to the rest, and where it is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import circular, make_sensor
from scipy.stats import norm

from sal_height.elevation.array.estimate import MEASURED, ElevationEstimate, Scatterer, Validity, without_saturated
from sal_height.sensor.sensor import MAX_SHARE, clipped, saturated_shares
from sal_height.simulation.receiver_noise import received

MIXTURE = ((0.6, 0.8, 0.0), (-0.8, 0.6, 0.0), (0.0, 0.0, 1j))
"""Two mixtures of the first two detectors; the third by itself."""


def gaussian(seed: int, *shape: int) -> np.ndarray:
    return circular(np.random.default_rng(seed), shape).astype(np.complex64)


def test_clipping_stops_real_and_imaginary_parts_at_full_scale() -> None:
    samples = np.array([[0.5 - 3j, 2 + 0.1j], [-2 - 2j, 1j]], np.complex64)
    expected = np.array([[0.5 - 1j, 1 + 0.1j], [-1 - 1j, 1j]], np.complex64)
    np.testing.assert_array_equal(clipped(samples, 1.0), expected)
    assert clipped(samples, 0.0) is samples


def distortion(share: float) -> float:
    """Power that clipping adds to Gaussian samples over that of what is left of them, where `share` is clipped.

    Of a circular Gaussian sample x a multiple alpha x is left, and the rest does not correlate with it (Bussgang 1952).
    In standard deviations of a part, with the limit c, Q(c) = share / 2 and the density phi, Price's theorem gives
    alpha = 1 - 2 Q(c), and the clipped part has the power 1 - 2 Q(c) - 2 c phi(c) + 2 c^2 Q(c).
    """
    limit, left = norm.isf(share / 2), 1 - share
    return float((left - 2 * limit * norm.pdf(limit) + limit**2 * share) / left**2 - 1)


@pytest.mark.parametrize("share", [0.3, 0.05, 8e-3])
def test_distortion_is_what_a_gain_does_not_explain(share: float) -> None:
    """Of 2 10^6 Gaussian numbers; the standard error of the sums of squares is that of their 100 parts."""
    samples = np.random.default_rng(1).standard_normal((100, 20_000))
    limit = norm.isf(share / 2)
    seen = clipped((samples + 1j * samples).astype(np.complex64), limit).real
    gain = np.sum(seen * samples) / np.sum(samples**2)
    parts = np.mean((seen - gain * samples) ** 2, axis=1) / gain**2
    assert gain == pytest.approx(1 - share, abs=3.5 * np.sqrt(2 / samples.size))
    assert np.mean(parts) == pytest.approx(distortion(share), abs=3.5 * np.std(parts) / np.sqrt(len(parts)))


def test_the_greatest_share_keeps_distortion_40_db_below_the_signal() -> None:
    assert 10 * np.log10(distortion(MAX_SHARE)) == pytest.approx(-40, abs=0.1)


def test_shares_are_of_parts_at_or_beyond_full_scale() -> None:
    """1 %, 10 % and none of the parts of Gaussian samples; standard error of a share p of N parts: sqrt(p / N)."""
    sensor = make_sensor(full_scale=2.0)
    limits = np.array([norm.isf(0.005), norm.isf(0.05), 10.0])
    samples = gaussian(2, 3, 500, 200) * (2.0 * np.sqrt(2) / limits[:, None, None]).astype(np.float32)
    shares = saturated_shares(clipped(samples, 2.0), sensor)
    np.testing.assert_allclose(shares, [0.01, 0.1, 0.0], atol=3.5 * np.sqrt(0.1 / 2e5))
    np.testing.assert_array_equal(saturated_shares(samples, sensor), shares)
    assert np.isnan(saturated_shares(samples, replace(sensor, full_scale=0.0))).all()


@pytest.mark.parametrize("in_antenna", [True, False])
def test_the_simulators_receivers_clip_where_they_are(in_antenna: bool) -> None:
    """Behind the matrix they clip channels; before it detectors, whose share all channels made of them have."""
    sensor = make_sensor(channel_matrix=MIXTURE, matrix_in_antenna=in_antenna, noise_power=(1e-6,) * 3, full_scale=0.7)
    frames = gaussian(3, 3, sensor.pulse_count, sensor.sample_count)
    frames[1] *= 0.5
    channels = received(frames, sensor, np.random.default_rng(4))
    mixed = np.tensordot(np.array(MIXTURE), frames, axes=1).astype(np.complex64)
    expected = [np.mean(np.abs(f.view(np.float32)) >= 0.7) for f in (mixed if in_antenna else frames)]
    shares = saturated_shares(channels, sensor)
    if in_antenna:
        assert np.abs(channels.view(np.float32)).max() == np.float32(0.7)
    else:
        assert np.abs(channels.view(np.float32)).max() > 0.7
        expected[1] = expected[0]
    np.testing.assert_allclose(shares, expected, atol=0.002)  # noise carries a few parts over the edge
    assert min(shares) > 0.1


def test_only_what_was_usable_becomes_saturated() -> None:
    validity = np.array([[v for v in Validity if v is not Validity.SATURATED]], np.uint8)
    values = np.ones(validity.shape)
    one = Scatterer(values, values, values, values)
    result = without_saturated(ElevationEstimate((one, one), validity))
    usable = np.isin(validity, MEASURED)
    assert np.all(result.validity[usable] == Validity.SATURATED)
    np.testing.assert_array_equal(result.validity[~usable], validity[~usable])
    assert len(result.scatterers) == 1
