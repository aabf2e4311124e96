"""Tomographic profiles: one, two and many scatterers in a pixel, with exact covariances and with looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, elevation_at, make_beams, offset_of

from sal_height.beams.array import Beams
from sal_height.elevation.looks.looks import Looks
from sal_height.elevation.vegetation.profile import PROFILES, ElevationProfile, capon, invert, music

BEAMS = make_beams("jinc")
CANOPY = np.linspace(-0.5, 1.5, 41)
"""Elevations of a canopy, beamwidths, 1 above the ground at -1.5."""

ALL = pytest.mark.parametrize("title", PROFILES)


def covariance_of(offsets: np.ndarray, powers: np.ndarray, beams: Beams = BEAMS) -> np.ndarray:
    """C of unit noise and scatterers at offsets (beamwidths) from the middle, of those CNRs."""
    response = beams.response(elevation_at(offsets), 0.0)
    return np.einsum("n,ni,nj->ij", powers, response, response.conj()) + np.eye(beams.count)


def exact_looks(mean: np.ndarray, count: float) -> Looks:
    """One pixel whose mean covariance is the expected one."""
    return Looks.of(count * mean[None, None], count)


def drawn_looks(mean: np.ndarray, count: int, pixels: int, seed: int) -> Looks:
    """Pixels of Gaussian looks with that covariance."""
    rng = np.random.default_rng(seed)
    shape = (pixels, count, len(mean))
    white = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
    samples = white @ np.linalg.cholesky(mean).T
    return Looks.of(np.einsum("pki,pkj->pij", samples, samples.conj()).real[:, None], count)


def shares(profile: ElevationProfile) -> np.ndarray:
    """Cumulative distribution of the reflectivity over the nodes, (pixels, nodes)."""
    values = profile.values.reshape(-1, len(profile.elevation))
    return np.cumsum(values, axis=1) / values.sum(axis=1, keepdims=True)


def distance(profile: ElevationProfile, offsets: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Earth mover's distance from the truth in every pixel, beamwidths."""
    nodes = offset_of(profile.elevation)
    true = np.array([powers[offsets <= node].sum() for node in nodes]) / powers.sum()
    return np.abs(shares(profile) - true).sum(axis=1) * (nodes[1] - nodes[0])


@ALL
@pytest.mark.parametrize("offset", [-3.4, 0.03, 2.6])
def test_single_scatterer_is_the_peak(title: str, offset: float) -> None:
    mean = covariance_of(np.array([offset]), np.array([100.0]))
    profile = PROFILES[title](exact_looks(mean, 16), BEAMS)
    assert offset_of(profile.elevation)[np.argmax(profile.values[0, 0])] == pytest.approx(offset, abs=0.06)


def test_inversion_keeps_the_power_of_surface_and_canopy() -> None:
    """CNRs of 50 and 100, 1 beamwidth apart: the sieve blunts the point, which loses an eighth, and the whole 5 %."""
    offsets, powers = np.append(CANOPY, -1.5), np.append(np.full(41, 100 / 41), 50.0)
    profile = invert(exact_looks(covariance_of(offsets, powers), 64), BEAMS)
    nodes = offset_of(profile.elevation)
    spacing = nodes[1] - nodes[0]
    low, high = profile.values[0, 0][nodes < -1].sum() * spacing, profile.values[0, 0][nodes > -1].sum() * spacing
    assert low + high == pytest.approx(150, rel=0.06)
    assert low == pytest.approx(50, rel=0.13)
    assert distance(profile, offsets, powers)[0] < 0.1


@ALL
def test_two_scatterers_closer_than_a_beamwidth_are_two_peaks(title: str) -> None:
    """0.8 beamwidths apart, at 20 dB: the mean power over elevation (beamforming) has one peak."""
    offsets = np.array([-0.4, 0.4])
    looks = exact_looks(covariance_of(offsets, np.array([100.0, 100.0])), 200)
    profile = PROFILES[title](looks, BEAMS)
    near = np.abs(offset_of(profile.elevation)) < 1
    values, nodes = profile.values[0, 0][near], offset_of(profile.elevation)[near]
    peaks = nodes[1:-1][(values[1:-1] > values[:-2]) & (values[1:-1] > values[2:])]
    np.testing.assert_allclose(peaks, offsets, atol=0.11)
    response = BEAMS.response(elevation_at(nodes), 0.0)
    blurred = np.einsum("ni,ij,nj->n", response, looks.covariance[0, 0], response)
    assert np.sum((blurred[1:-1] > blurred[:-2]) & (blurred[1:-1] > blurred[2:])) == 1


def test_capon_of_one_scatterer_is_its_closed_form() -> None:
    """L^-1 by Sherman and Morrison: |b|^2 - c |a^T b|^2 / (1 + M / K + c |a|^2), over 1 + M / K, is b^T L^-1 b."""
    power, count = 20.0, 8
    profile = capon(exact_looks(covariance_of(np.array([0.2]), np.array([power])), count), BEAMS)
    a, b = BEAMS.response(elevation_at(0.2), 0.0), BEAMS.response(profile.elevation, 0.0)
    loaded = 1 + 16 / count
    inverse = (np.sum(b**2, axis=1) - power * (b @ a) ** 2 / (loaded + power * a @ a)) / loaded
    np.testing.assert_allclose(profile.values[0, 0], 1 / inverse - loaded / np.sum(b**2, axis=1), rtol=1e-9, atol=1e-12)


def test_inversion_comes_nearer_to_the_canopy_than_capon() -> None:
    """Ground and canopy of CNR 10 and 10 in 16 looks: median of 200 pixels, in beamwidths, 0.01 of standard error."""
    offsets, powers = np.append(CANOPY, -1.5), np.append(np.full(41, 10 / 41), 10.0)
    looks = drawn_looks(covariance_of(offsets, powers), 16, 200, seed=1)
    inverted, by_capon = (np.median(distance(f(looks, BEAMS), offsets, powers)) for f in (invert, capon))
    assert inverted < 0.24
    assert by_capon > inverted + 0.05


@pytest.mark.parametrize("count", [1, 4, 64])
def test_noise_alone_has_little_reflectivity_and_no_signal_subspace(count: int) -> None:
    """The mean power of noise is 1; per beamwidth, with some 2 detectors in it, less is left with more looks."""
    looks = drawn_looks(np.eye(16), count, 300, seed=2)
    assert np.mean(invert(looks, BEAMS).values) < 0.6 / np.sqrt(count)
    assert np.mean(capon(looks, BEAMS).values) < 0.6 / np.sqrt(count)
    assert np.mean(music(looks, BEAMS).values > 1 + 1e-6) < 0.25


@ALL
def test_profiles_follow_units_and_squint(title: str) -> None:
    """Noise of any power; columns of another squint; fewer looks than channels; samples that were missing."""
    mean = covariance_of(np.array([0.5]), np.array([30.0]))
    looks = drawn_looks(mean, 5, 6, seed=3)
    louder = replace(looks, covariance=9 * looks.covariance, noise_powers=9 * looks.noise_powers)
    expected = PROFILES[title](looks, BEAMS).values
    np.testing.assert_allclose(PROFILES[title](louder, BEAMS).values, expected, rtol=1e-6)
    wide = Looks.of(np.swapaxes(looks.covariance, 0, 1), 5, np.linspace(0, 0.4, 6) * BEAMWIDTH)
    wide = replace(wide, finite=np.arange(6)[None] != 2)
    values = PROFILES[title](wide, BEAMS).values
    np.testing.assert_allclose(values[0, 0], expected[0, 0], rtol=1e-6)
    assert np.isnan(values[0, 2]).all()
    assert np.isfinite(values[0, [0, 1, 3, 4, 5]]).all()
    assert np.max(np.abs(values[0, 5] - expected[5, 0])) > 1e-3 * expected[5].max()


@ALL
def test_complex_beams_give_the_same_profile(title: str) -> None:
    """Phases that vary from channel to channel but not over elevation change nothing but the number of looks."""
    phases = np.exp(1j * np.arange(16))
    turned = BEAMS.combined(np.diag(phases))
    mean = covariance_of(np.array([-1.0, 0.6]), np.array([30.0, 60.0]))
    values = PROFILES[title](exact_looks(mean, 1000), BEAMS).values
    complex_looks = exact_looks(phases[:, None] * mean * phases.conj(), 1000)
    np.testing.assert_allclose(PROFILES[title](complex_looks, turned).values, values, rtol=1e-6, atol=1e-9)
