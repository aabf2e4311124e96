"""The boresight of passes to and fro: its errors, what is stated of them, and what no adjustment can do better than."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.row import Row
from sal_height.numeric import F64, root_mean_square
from sal_height.simulation import Preset


def with_drawn_mounting(preset: Preset, seed: int) -> Preset:
    """A preset whose boresight, lever arm and delay of the odometry are off by chance, as is stated of them.

    With the same errors in every flight these and the shift of edges may cancel, or add up, in all of them.
    """
    rng, given = np.random.default_rng(seed), preset.processing["sar_compression"]
    arm = given["lever_arm_sigma_m"] * rng.standard_normal(3)
    turn = given["boresight_sigma_rad"] * rng.standard_normal(3)
    odometry = replace(
        preset.impairments.odometry,
        undescribed_lever_arm_m=tuple(arm.tolist()),
        undescribed_boresight_rad=tuple(turn.tolist()),
        delay_s=given["odometry_delay_sigma_s"] * float(rng.standard_normal()),
    )
    return replace(preset, impairments=replace(preset.impairments, odometry=odometry))


def of_boresight(preset: Preset, errors: F64, covariances: F64, edges_m: float, text: str) -> Iterator[Row]:
    """Rows on the boresight: its errors, what is stated of them, and that over the least that is possible.

    Args:
        preset: preset of the flights.
        errors: errors about the axes of the sensor, rad, shape (flights, 3).
        covariances: covariances that are stated of them, rad^2, shape (flights, 3, 3).
        edges_m: standard deviation of the apparent shift of edges, m.
        text: conditions.
    """
    look, alone = preset.flight.look_angle_rad, attitude_bounds(preset)
    axes = {"about the flight": [1.0, 0.0, 0.0], "along the flight": [0.0, -np.cos(look), np.sin(look)]}
    bounds = bound_about_flight(preset, edges_m), alone[1]
    for (name, axis), bound, by_attitude in zip(axes.items(), bounds, alone, strict=True):
        error, sigma = errors @ axis, np.sqrt(np.einsum("i,fij,j->f", axis, covariances, axis))
        stated = f"stated {1e6 * sigma.mean():.1f}, bound {1e6 * bound:.1f}, attitude alone {1e6 * by_attitude:.1f}"
        # The bound of twenty passes is 11 urad about the flight; 16 is what six flights may show of it by chance.
        yield Row(f"boresight {name}", 1e6 * float(root_mean_square(error)), "urad", "<= 16", f"{text}; {stated}")
        z = float(root_mean_square(error / sigma))
        yield Row(f"boresight {name}, over what is stated", z, "1", "<= 1.5", text)
        yield Row(f"boresight {name}, stated over the bound", float(sigma.mean()) / bound, "1", "<= 1.2", text)


def attitude_bounds(preset: Preset) -> tuple[float, float]:
    """Standard deviations of the boresight about and along the flight that errors of the attitude leave, rad.

    Passes to and fro turn a boresight about the horizontal axes of map with them, and the errors of the attitude not,
    so that errors which last from pass to pass cancel: of n passes with the correlation r and the rms A remain
    A^2 (1 - r) / (n + (n - 2) r), and about the vertical A^2 (1 + r) / (n - (n - 2) r). The prior is added.
    """
    odometry, passes = preset.impairments.odometry, preset.flight.passes
    r, n, look = np.exp(-passes.interval_s / odometry.correlation_s), passes.count, preset.flight.look_angle_rad
    level = odometry.attitude_rad**2 * (1 - r) / (n + (n - 2) * r)
    heading = odometry.heading_rad**2 * (1 + r) / (n - (n - 2) * r)
    along = level * np.cos(look) ** 2 + heading * np.sin(look) ** 2
    about_flight, along_flight = (_with_prior(preset, variance) for variance in (level, along))
    return about_flight, along_flight


def bound_about_flight(preset: Preset, edges_m: float) -> float:
    """Standard deviation of the boresight about the flight where positions drift and edges seem to lie farther out.

    The best linear estimate from exact differences between passes. Pass k, which looks to the side s = (-1)^k, sees the
    ground off by

        across: p + R cos(look) (e + s b) + s (l + d),    up: q + R sin(look) (s e + b)

    with errors p and q of the position, which are integrals of Gauss-Markov velocities, e of the attitude, l of the
    lever arm across, d of edges, and b of the boresight.

    Args:
        preset: preset of the flights.
        edges_m: standard deviation of the apparent shift of edges, m.
    """
    odometry, flight = preset.impairments.odometry, preset.flight
    count, look, correlation = flight.passes.count, flight.look_angle_rad, odometry.correlation_s
    times = flight.passes.interval_s * np.arange(count) / correlation
    sides, apart = (-1.0) ** np.arange(count), np.abs(times[:, None] - times)
    turned = flight.slant_range_m * np.vstack([np.cos(look) * np.eye(count), np.sin(look) * np.diag(sides)])
    outwards = np.concatenate([sides, np.zeros(count)])
    # Covariance of the integrals of a Gauss-Markov process of variance 1 from the first pass, over T^2.
    faded = np.exp(-times)
    moved = 2 * np.minimum(times[:, None], times) + faded[:, None] + faded - np.exp(-apart) - 1
    covariance = np.kron(np.eye(2), (odometry.velocity_mps * correlation) ** 2 * moved)
    covariance += turned @ (odometry.attitude_rad**2 * np.exp(-apart)) @ turned.T
    arm_m = preset.processing["sar_compression"]["lever_arm_sigma_m"]
    covariance += (edges_m**2 + arm_m**2) * np.outer(outwards, outwards)
    between = np.kron(np.eye(2), np.diff(np.eye(count), axis=0))
    shifts = between @ turned @ sides
    information = float(shifts @ np.linalg.solve(between @ covariance @ between.T, shifts))
    return _with_prior(preset, 1 / information)


def _with_prior(preset: Preset, variance: float) -> float:
    """Standard deviation (rad) of a boresight that the prior and passes determine, these with a variance in rad^2."""
    prior = preset.processing["sar_compression"]["boresight_sigma_rad"]
    return float(1 / np.sqrt(1 / prior**2 + 1 / variance))
