"""Coherence of even ground between pulses: that of waves from where the beam sends its power."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import make_sensor
from phase_errors import lower_band

from sal_height.imaging.autofocus.coherence import azimuth_waves, beam_coherence, half_turns

WAY = 1.295e-3
"""From pulse to pulse, m."""


def positions(way: float, pulses: int = 48) -> np.ndarray:
    """On a line towards the north-east, m."""
    return np.arange(pulses)[:, None] * way * np.array([0.6, 0.8, 0.0]) + [10.0, 20.0, 3000.0]


def test_waves_are_those_of_points_on_the_ground() -> None:
    """Of ranges that are worked out, 5 km away; all azimuths, over one dwell."""
    sensor, antenna = make_sensor(), positions(WAY)
    middle = antenna.mean(axis=0) + 5000 * np.array([0.8, -0.6, 0.0])
    angle = half_turns(48) * sensor.wavelength / (4 * WAY)
    points = middle + 5000 * angle[:, None] * np.array([0.6, 0.8, 0.0])
    away, to_middle = (np.linalg.norm(where - antenna[:, None], axis=-1) for where in (points, middle))
    waves = np.exp(-1j * sensor.centre_wavenumber * (away - to_middle))
    np.testing.assert_allclose(waves * waves[0].conj(), azimuth_waves(48), atol=1e-3)


def test_the_profile_is_the_power_of_the_beam() -> None:
    coherence = beam_coherence(sensor := make_sensor(), positions(WAY))
    assert coherence.profile.sum() == pytest.approx(1.0)
    assert np.argmax(coherence.profile) == 48
    np.testing.assert_allclose(np.diag(coherence.matrix), 1.0)
    beamwidth = sensor.beams.track_beamwidth * 4 * WAY / sensor.wavelength  # in half turns
    at_half = np.interp(beamwidth / 2, half_turns(48)[48:], coherence.profile[48:]) / coherence.profile.max()
    pattern = np.abs(sensor.beams.patterns[0].amplitude(np.zeros(1), np.full(1, 0.5)))[0] ** 2
    assert at_half == pytest.approx(pattern, rel=0.02)


@pytest.mark.parametrize("snr", [0.3, 20.0, 1e4])
def test_inverse_and_information_are_those_of_the_covariance(snr: float) -> None:
    coherence = beam_coherence(make_sensor(), positions(WAY))
    covariance = snr * coherence.matrix + np.eye(48)
    inverse = np.linalg.inv(covariance)
    np.testing.assert_allclose(coherence.inverse_band(snr), lower_band(inverse, 47), atol=1e-9)
    expected = 2 * ((covariance * inverse.T).real - np.eye(48))
    np.testing.assert_allclose(coherence.information(snr), lower_band(expected, 47), atol=1e-6 * snr)


@pytest.mark.parametrize("snr", [0.3, 20.0])
def test_filters_are_those_of_the_inverse_covariance(snr: float) -> None:
    """The power of what a filter passes is w^H R^-1 S R^-1 w; its gain is that of R itself, w^H R^-1 w."""
    coherence = beam_coherence(make_sensor(), positions(WAY))
    filters, gain = coherence.filters(snr)
    weights = np.linalg.inv(coherence.covariance(snr)) @ coherence.waves
    np.testing.assert_allclose(filters, weights.conj(), atol=1e-6 * np.abs(weights).max())
    np.testing.assert_allclose(gain, np.einsum("ta,ta->a", weights.conj(), coherence.waves).real, rtol=1e-9)


def test_pulses_are_compared_over_many_times_what_their_speckle_has_in_common() -> None:
    """An antenna of 1 cm that has moved by half of it, 4 pulses, sees other speckle: 16 times as many are compared."""
    coherence = beam_coherence(sensor := make_sensor(), positions(WAY, 256))
    assert coherence.lags == 64
    inverse = np.abs(np.linalg.inv(coherence.covariance(100.0)))[128]
    assert inverse[:64].max() < 1e-3 * inverse.max()
    assert beam_coherence(sensor, positions(WAY, 8)).lags == 7


def test_dwells_of_a_flight_share_it_and_others_do_not() -> None:
    sensor = make_sensor()
    coherence = beam_coherence(sensor, positions(WAY))
    assert beam_coherence(sensor, positions(1.001 * WAY) + 100.0) is coherence
    assert beam_coherence(sensor, positions(1.02 * WAY)) is not coherence
    assert beam_coherence(sensor, positions(WAY, 40)).matrix.shape == (40, 40)
