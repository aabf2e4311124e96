"""Ground under a canopy: errors against sigma, and refusals where the ground cannot be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, elevation_at, few, make_beams, offset_of

from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.looks.looks import Looks
from sal_height.elevation.vegetation.canopy_ground import CanopyGroundSettings, canopy_ground_elevation

BEAMS = make_beams("jinc")
GROUND = -1.47
FROM_THE_GROUND, HANGING, THIN = (GROUND, 1.5), (-0.5, 1.5), (-0.6, 0.0)
"""Lower and upper end of canopies, beamwidths."""

SETTINGS = CanopyGroundSettings()


def drawn(
    ground: float, canopy: float, ends: tuple[float, float], count: int, pixels: int, extinction: float = 0.3
) -> Looks:
    """Gaussian looks of ground and canopy of these CNRs; the canopy's power falls by `extinction` per beamwidth."""
    rng = np.random.default_rng(4)
    heights = np.linspace(*ends, 41)
    profile = np.exp(-extinction * (ends[1] - heights))
    powers = np.append(ground, canopy * profile / profile.sum())
    response = BEAMS.response(elevation_at(np.append(GROUND, heights)), 0.0) * np.sqrt(powers)[:, None]

    def circular(*shape: int) -> np.ndarray:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

    samples = circular(pixels, count, len(powers)) @ response + circular(pixels, count, BEAMS.count)
    return Looks.of(np.einsum("pki,pkj->pij", samples, samples.conj()).real[:, None], count)


def estimate(looks: Looks) -> ElevationEstimate:
    return canopy_ground_elevation(looks, BEAMS, SETTINGS)


@pytest.mark.parametrize(
    ("ends", "ground", "least_valid"),
    few(1, [(FROM_THE_GROUND, 50.0, 0.9), (HANGING, 50.0, 0.9), (FROM_THE_GROUND, 25.0, 0.5)]),
)
def test_ground_is_within_two_sigma(ends: tuple[float, float], ground: float, least_valid: float) -> None:
    """60 pixels of 60 looks: 95 % of them or more, with a standard error of 3 %; sigma is a few hundredths."""
    result = estimate(drawn(ground, 50.0, ends, 60, 60))
    valid = result.validity == Validity.OK
    error, sigma = offset_of(result.elevation[valid]) - GROUND, result.sigma[valid] / BEAMWIDTH
    assert valid.mean() >= least_valid
    assert np.mean(np.abs(error) < 2 * sigma) > 0.95 - 0.03
    assert np.max(np.abs(error) / sigma) < 5
    assert np.median(sigma) < 0.05


@pytest.mark.parametrize(
    ("ground", "canopy", "ends", "extinction", "reason"),
    [
        (0.0, 50.0, FROM_THE_GROUND, 1.0, Validity.NO_GROUND),  # no echo of the ground
        (0.0, 50.0, HANGING, 0.0, Validity.NO_GROUND),
        (0.0, 100.0, FROM_THE_GROUND, 6.0, Validity.NO_GROUND),  # nothing but the top of the crowns
        (50.0, 0.0, HANGING, 0.0, Validity.NO_GROUND),  # bare ground: it might be the top of something dense
        (0.0, 50.0, THIN, 0.0, Validity.NO_GROUND),  # a layer thinner than what counts as a canopy
        (0.0, 1000.0, FROM_THE_GROUND, 1.0, Validity.NO_GROUND),  # so bright that its shape is not that of the model
        (0.0, 0.0, HANGING, 0.0, Validity.NO_SIGNAL),
    ],
)
def test_where_nothing_can_be_told_there_is_a_reason_and_no_ground(
    ground: float, canopy: float, ends: tuple[float, float], extinction: float, reason: Validity
) -> None:
    validity = estimate(drawn(ground, canopy, ends, 40, 20, extinction)).validity
    assert not np.any(validity == Validity.OK)
    assert np.mean(validity == reason) >= 0.75  # of dense crowns some may reach below the array


def test_ground_below_the_array_is_refused() -> None:
    """The lowest four of 16 detectors are 2 beamwidths of elevation; without them the ground is 0.3 below the first."""
    looks, chosen = drawn(50.0, 50.0, HANGING, 60, 10), np.arange(6, 16)
    upper = Looks.of(np.ascontiguousarray(looks.covariance[..., chosen[:, None], chosen]), 60)
    assert offset_of(BEAMS.detectors(chosen).span[0]) > GROUND + 0.5
    validity = canopy_ground_elevation(upper, BEAMS.detectors(chosen), SETTINGS).validity
    assert not np.any(validity == Validity.OK)
    assert np.any(validity == Validity.OUTSIDE_ARRAY)


def test_missing_samples_units_of_noise_and_phases_of_channels() -> None:
    looks = drawn(50.0, 50.0, HANGING, 60, 4)
    expected = estimate(looks)
    louder = replace(looks, covariance=9 * looks.covariance, noise_powers=9 * looks.noise_powers)
    louder = replace(louder, finite=np.array([[True], [True], [False], [True]]))
    result = estimate(louder)
    assert result.validity[:, 0].tolist() == [Validity.OK, Validity.OK, Validity.MISSING_DATA, Validity.OK]
    kept = [0, 1, 3]
    np.testing.assert_allclose(result.elevation[kept], expected.elevation[kept], rtol=1e-9)
    np.testing.assert_allclose(result.sigma[kept], expected.sigma[kept], rtol=1e-6)
    phases = np.exp(1j * np.arange(16))
    turned = Looks.of((phases[:, None] * looks.covariance * phases.conj())[:1], 60)
    by_phase = canopy_ground_elevation(turned, BEAMS.combined(np.diag(phases)), SETTINGS)
    np.testing.assert_allclose(by_phase.elevation, expected.elevation[:1], rtol=1e-9)
    np.testing.assert_allclose(by_phase.sigma, expected.sigma[:1], rtol=1e-6)


def test_sigma_above_the_limit_is_imprecise() -> None:
    looks = drawn(50.0, 50.0, HANGING, 60, 3)
    strict = canopy_ground_elevation(looks, BEAMS, CanopyGroundSettings(max_sigma_beamwidths=0.001))
    assert (strict.validity == Validity.IMPRECISE).all()


def test_bright_pixels_are_fitted_at_all_elevations() -> None:
    """At 30 dB each, elevations above all scatterers explain nothing, and powers must not grow without end."""
    result = estimate(drawn(1000.0, 1000.0, HANGING, 20, 10))
    assert np.mean(result.validity == Validity.OK) >= 0.8
    error = offset_of(result.elevation) - GROUND
    assert np.max(np.abs(error) / (result.sigma / BEAMWIDTH)) < 3
