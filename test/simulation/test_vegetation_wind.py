"""Vegetation in the wind: its echoes lose coherence with the time between pulses as its velocities say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sal_height.configuration import validated
from sal_height.errors import UserError
from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.impairments import Impairments, VegetationWind
from sal_height.simulation.preset import TargetSettings
from sal_height.simulation.scene import Scene

HALF_WIDTH = 0.03
"""Of the strip of ground along the flight, m: less than a resolution cell, so that pulses see the same."""

FLIGHTS = 10


def flown(scene_extent: float, wind: VegetationWind | None, seed: int = 3) -> SimulatedFlight:
    """The small lidar over a strip of level ground whose scatterers are spread in height."""
    preset = replace(load_preset("small"), cnr_db=40.0, impairments=Impairments(vegetation_wind=wind))
    flight = flight_of(preset, seed)
    east = np.array([-30.0, -HALF_WIDTH, -0.99 * HALF_WIDTH, 0.99 * HALF_WIDTH, HALF_WIDTH, 30.0])
    north = np.linspace(-30.0, 30.0, 61)
    bright = np.tile(np.abs(east) < HALF_WIDTH, (61, 1)).astype(np.float64)
    scene = Scene("a strip across the flight", east, north, np.zeros((61, 6)), bright, extent=scene_extent)
    return replace(flight, scene=scene)


def coherences(wind: VegetationWind | None) -> np.ndarray:
    """Coherence of pulses by the lag between them, over the dwells above the strip of some flights."""
    total: np.ndarray | float = 0.0
    for seed in range(FLIGHTS):
        samples = flown(0.2, wind, seed).phase_history(1).samples
        pulses = samples.shape[1]
        products = [np.vdot(samples[:, : pulses - lag], samples[:, lag:]) / (pulses - lag) for lag in range(pulses)]
        total = total + np.array(products)
    return np.asarray(total / np.abs(np.asarray(total)[0]))


def test_velocities_have_the_exponential_spectrum() -> None:
    """Mean square, and the share beyond 2 rms, exp(-2 sqrt 2), of 1e5: to 4 standard errors."""
    speed = VegetationWind(0.2, still_share=0.3).drawn(100_000, np.random.default_rng(1))
    moving = speed[speed != 0]
    assert len(moving) / len(speed) == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / 1e5))
    assert np.mean(moving**2) == pytest.approx(0.04, rel=4 * np.sqrt(5 / 7e4))
    share = np.exp(-2 * np.sqrt(2))
    assert np.mean(np.abs(moving) > 0.4) == pytest.approx(share, abs=4 * np.sqrt(share / 7e4))


def test_coherence_falls_as_the_transform_of_the_spectrum() -> None:
    """1 / (1 + (4 pi v t / wavelength)^2 / 2) for three quarters of the layers above the ground, 1 for the rest.

    Some 1000 range cells and beams, in 10 flights: within .1, 4 standard errors.
    """
    wind = VegetationWind(rms_velocity_mps=0.004, still_share=0.25)
    found, windy = coherences(wind) / coherences(None), flown(0.2, wind)
    time = windy.pulse_times
    moved = 1 / (1 + (4 * np.pi / windy.sensor.wavelength * wind.rms_velocity_mps * time) ** 2 / 2)
    velocity = windy.surface(1).velocity
    moving = np.average(np.any(velocity, axis=1), weights=windy.surface(1).power)
    assert moving == pytest.approx(0.75 * 7 / 15, abs=0.02)
    expected = 1 - moving + moving * moved
    assert expected[-1] < 0.75
    np.testing.assert_allclose(found[: len(time) // 2].real, expected[: len(time) // 2], atol=0.1)


def test_ground_and_targets_stand_still() -> None:
    """A target 1 m above the street: the same echoes, whatever the wind."""
    calm = replace(load_preset("small"), targets=(TargetSettings(0.0, 0.0, 1.0, power_db=30.0),))
    windy = replace(calm, impairments=Impairments(vegetation_wind=VegetationWind(0.2)))
    assert np.any(flight_of(windy, 3).surface(1).deterministic)
    echoes = [flight_of(preset, 3).phase_history(1).samples for preset in (calm, windy)]
    np.testing.assert_array_equal(*echoes)


def test_leaves_of_woods_move_along_the_sight_and_the_ground_beneath_does_not() -> None:
    preset = replace(load_preset("woods"), impairments=Impairments(vegetation_wind=VegetationWind(0.2)))
    flight = flight_of(preset, 2)
    surface, aperture = flight.surface(0), flight.aperture(0)
    moves = np.any(surface.velocity, axis=1)
    assert 0.2 < np.mean(moves) < 1
    assert surface.heights[moves].min() > surface.heights[~moves].min()
    sight = surface.positions - aperture.position
    along = np.einsum("nk,nk->n", sight, surface.velocity)[moves] / np.linalg.norm(sight[moves], axis=1)
    np.testing.assert_allclose(np.abs(along), np.linalg.norm(surface.velocity[moves], axis=1), rtol=1e-3)
    again = flight_of(preset, 2).surface(0).velocity
    np.testing.assert_array_equal(again, surface.velocity)


def test_a_wind_that_is_none_is_refused() -> None:
    with pytest.raises(UserError, match="rms_velocity_mps"):
        validated(VegetationWind, {"rms_velocity_mps": 0.0}, "a preset")
