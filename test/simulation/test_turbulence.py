"""Turbulent air: the usual model, the structure function of a way through it, and phases that have it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.impairments import Impairments, Turbulence


def test_hufnagel_valley_5_7_is_what_its_name_says() -> None:
    """At 0.5 um from the zenith: a coherence length of 5 cm and an isoplanatic angle of 7 urad, within 5 %."""
    air, k = Turbulence(ground_cn2=1.7e-14), 2 * np.pi / 0.5e-6

    def moment(power: float) -> float:
        return float(
            quad(lambda h: h**power * float(air.cn2(np.array(h))), 0, 30_000, limit=400, points=[100, 1500])[0]
        )

    assert (0.423 * k**2 * moment(0)) ** (-3 / 5) == pytest.approx(0.05, rel=0.05)
    assert (2.914 * k**2 * moment(5 / 3)) ** (-3 / 5) == pytest.approx(7e-6, rel=0.05)


def test_structure_of_a_way_is_the_integral_with_its_weight() -> None:
    """From an antenna 1000 m up, 2000 m away: by adaptive integration from the ground on."""
    air = Turbulence(ground_cn2=3e-14, wind_mps=10.0)
    expected = quad(lambda s: float(air.cn2(np.array(1000 * (1 - s)))) * (1 - s) ** (5 / 3), 0, 1)[0]
    expected *= 4 * 2.914 * (2 * np.pi / 1.55e-6) ** 2 * 2000
    assert air.structure(1.55e-6, 2000.0, 1000.0) == pytest.approx(expected, rel=1e-6)


def test_phases_have_the_structure_function() -> None:
    """Over distances from 1 cm to 10 m, as the mean of 3000 flights: within 4 standard errors, 10 %."""
    rng, distances = np.random.default_rng(4), np.array([0.0, 0.01, 0.1, 1.0, 10.0])
    drawn = [Turbulence(1e-14).drawn(0.3, 50.0, rng).displacement(distances / 50.0)[:, 0] for _ in range(3000)]
    found = np.mean((np.array(drawn) - np.array(drawn)[:, :1]) ** 2, axis=0)
    np.testing.assert_allclose(found[1:], 0.3 * distances[1:] ** (5 / 3), rtol=0.1)


def test_all_dwells_fly_through_the_same_air() -> None:
    preset = replace(load_preset("small"), impairments=Impairments(turbulence=Turbulence(ground_cn2=1.7e-14)))
    flight = flight_of(preset, seed=3)
    np.testing.assert_array_equal(flight.pulse_phase(1), flight_of(preset, seed=3).pulse_phase(1))
    assert np.any(flight.pulse_phase(0) != flight_of(preset, seed=4).pulse_phase(0))
