"""Power and carrier-to-noise ratio, against other ways to count the same echo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import Boltzmann, Planck, speed_of_light

from sal_height.beams import GAUSSIAN_WIDTH, pattern_named
from sal_height.theory import Link, diffuse_backscatter, effective_area, noise_density

LIDAR = Link(
    slant_range=5000.0,
    lit_angle=1.3e-3 * 1.55e-4,
    cell_area=0.042 * 0.048,
    backscatter=0.5,
    effective_area=7.9e-5,
    coherent_time=1.6e-3,
    noise=noise_density(1.55e-6),
)


def test_noise_is_thermal_at_radio_frequencies_and_shot_noise_in_light() -> None:
    photon = Planck * speed_of_light / 0.03
    assert noise_density(0.03) == pytest.approx(Boltzmann * 290 + photon / 2, rel=1e-6)
    assert noise_density(1.55e-6) == pytest.approx(Planck * speed_of_light / 1.55e-6, rel=1e-9)
    assert noise_density(0.03, 2.0) == 2 * noise_density(0.03)


@pytest.mark.parametrize(("pattern", "share"), [("jinc", np.pi / 4), ("sinc", 1.0)])
def test_an_even_antenna_receives_with_its_whole_area(pattern: str, share: float) -> None:
    assert effective_area(pattern_named(pattern), 0.02, 0.03) == pytest.approx(share * 0.02 * 0.03, rel=0.01)


def test_a_gaussian_beam_has_the_area_of_its_solid_angle() -> None:
    """|h|^2 = exp(-(e^2 + a^2) / s^2) has the integral pi s^2."""
    area = effective_area(pattern_named("gaussian"), 0.02, 0.03)
    assert area == pytest.approx(0.02 * 0.03 / (np.pi * GAUSSIAN_WIDTH**2), rel=1e-6)


def test_a_gain_of_the_pattern_is_no_larger_antenna() -> None:
    pattern = pattern_named("sinc")
    assert effective_area(pattern.scaled(3.0), 0.02, 0.03) == pytest.approx(effective_area(pattern, 0.02, 0.03))


def test_lidar_counts_the_photons_of_a_diffuse_surface() -> None:
    """A perfect receiver has as many photons of an aperture as it has carrier-to-noise ratio.

    The ground of albedo rho, lit by the irradiance E, has the radiance rho E / pi.
    """
    albedo, incidence, power, wavelength = 0.3, np.pi / 4, 40.0, 1.55e-6
    irradiance = power * np.cos(incidence) / (LIDAR.lit_angle * LIDAR.slant_range**2)
    intensity = albedo * irradiance / np.pi * LIDAR.cell_area * np.cos(incidence)
    received = intensity * LIDAR.effective_area / LIDAR.slant_range**2
    photons = received * LIDAR.coherent_time / (Planck * speed_of_light / wavelength)
    link = replace(LIDAR, backscatter=diffuse_backscatter(albedo, incidence))
    assert power * link.cnr_per_watt == pytest.approx(photons, rel=1e-9)


def test_radar_equation_with_gain_and_pulses() -> None:
    """P G^2 lambda^2 sigma / ((4 pi)^3 R^4 k T F L) for one antenna that sends and receives, times the energy."""
    wavelength, slant_range, area = 0.03, 35e3, 3.6
    gain = 4 * np.pi * area / wavelength**2
    duration, pulses, rate, peak, figure, loss = 20e-6, 64, 240.0, 2000.0, 2.0, 4.0
    section = 0.1 * 28.0 * 19.7
    received = peak * gain**2 * wavelength**2 * section / ((4 * np.pi) ** 3 * slant_range**4 * loss)
    cnr = received * duration * pulses / noise_density(wavelength, figure)
    link = Link(
        slant_range, 4 * np.pi / gain, 28.0 * 19.7, 0.1, area, pulses / rate, noise_density(wavelength, figure), loss
    )
    assert peak * duration * rate * link.cnr_per_watt == pytest.approx(cnr, rel=1e-9)


@pytest.mark.parametrize(("name", "power"), [("slant_range", -4), ("lit_angle", -1), ("loss", -1), ("backscatter", 1)])
def test_laws_of_the_link(name: str, power: int) -> None:
    twice = replace(LIDAR, **{name: 2 * getattr(LIDAR, name)})
    assert twice.cnr_per_watt == pytest.approx(LIDAR.cnr_per_watt * 2.0**power)
