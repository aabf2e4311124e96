"""The compiled loops of the simulator against their formulas in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import circular
from scipy.spatial.transform import Rotation

from sal_height.simulation._kernels import angles_in, mix_beams, place_echoes, read_lattice, spread_echoes


@pytest.mark.parametrize("rate_taps", [1, 6])
def test_echoes_are_spread_over_their_taps(rate_taps: int) -> None:
    """grid[rate + i, range + j, column] += rate weight[i] weight[j] response[column] echo, for every scatterer."""
    rng, rows, ranges, taps, columns, count = np.random.default_rng(110), 12, 50, 6, 3, 40
    bins = np.stack([rng.integers(0, ranges - taps, count), rng.integers(0, rows - 6, count)]).astype(np.int32)
    if rate_taps == 1:
        rows, bins[1] = 1, 0
    weights = rng.uniform(0, 1, (taps, count)).astype(np.float32)
    rate_weights = rng.uniform(0, 1, (rate_taps, count)).astype(np.float32)
    if rate_taps == 1:
        rate_weights[:] = 1
    echoes = circular(rng, (count,)).astype(np.complex64)
    response = rng.uniform(-1, 1, (count, columns)).astype(np.float32)
    grid = np.zeros((rows, ranges * columns * 2), np.float32)
    spread_echoes(bins, weights, rate_weights, echoes, response, grid)
    expected = np.zeros((rows, ranges, columns), complex)
    for i in range(rate_taps):
        for j in range(taps):
            values = (rate_weights[i] * weights[j] * echoes)[:, None] * response
            np.add.at(expected, (bins[1] + i, bins[0] + j), values)
    np.testing.assert_allclose(grid.view(np.complex64).reshape(expected.shape), expected, atol=1e-5)


@pytest.mark.parametrize("steps", [(-3.0, 5.0), (0.0, 0.0)], ids=["line", "one pulse"])
def test_echoes_are_placed_by_range_and_range_rate(steps: tuple[float, float]) -> None:
    rng, count = np.random.default_rng(111), 60
    positions = np.array([[0.0], [3000.0], [-3000.0]]) + rng.uniform(-2, 2, (3, count))
    ends = np.array([[0.1, 0, 0, 4242.6], [0.4, 0.01, 0, 4242.64]])
    if steps[0] == steps[1]:
        ends[1] = ends[0]
    scales, periods = np.array([1e5, 20.0, 3e4]), np.array([64.0, 24.0])
    strengths = circular(rng, (count,)).astype(np.complex64)
    echoes = np.empty(count, np.complex64)
    bins, fractions = np.empty((2, count), np.int32), np.empty((2, count), np.float32)
    place_echoes(positions, ends, np.array(steps), scales, periods, strengths, echoes, bins, fractions)
    first, last = (np.linalg.norm(positions.T - end[:3], axis=-1) - end[3] for end in ends)
    rate = (last - first) / (steps[1] - steps[0]) if steps[1] > steps[0] else np.zeros(count)
    delay = first - steps[0] * rate
    np.testing.assert_allclose(echoes, strengths * np.exp(-2j * np.pi * scales[0] * delay), atol=5e-6)
    places = np.mod([delay * scales[1] + 32, rate * scales[2] + 12], periods[:, None])
    off = np.mod(bins + fractions - places + periods[:, None] / 2, periods[:, None]) - periods[:, None] / 2
    assert np.abs(off).max() < 2e-6
    assert fractions.min() >= 0
    assert fractions.max() <= 1
    assert np.all((bins >= 0) & (bins < periods[:, None]))
    assert np.unique(bins[0]).size > 20


def test_lattice_is_read_by_lagranges_cubic() -> None:
    """Exact for polynomials of the third degree in each angle; the columns of a result lie side by side."""
    rng, columns, spacing, count = np.random.default_rng(112), 5, 0.25, 30
    rows, cols = np.arange(-4, 5) * spacing, np.arange(-5, 6) * spacing
    factors = rng.uniform(-1, 1, (columns, 4, 4))
    table = np.stack([np.polynomial.polynomial.polygrid2d(rows, cols, c) for c in factors], axis=-1)
    offset, squint = rng.uniform(-0.7, 0.7, count), rng.uniform(-0.9, 0.9, count)
    result = np.zeros((count, 2 + columns), np.float32)
    flat = np.ascontiguousarray(table.reshape(9, -1), np.float32)
    read_lattice(flat, spacing, np.array([4, 5]), offset, squint, 2, result)
    expected = [np.polynomial.polynomial.polyval2d(offset, squint, c) for c in factors]
    np.testing.assert_allclose(result[:, 2:].T, expected, atol=1e-5)
    np.testing.assert_array_equal(result[:, :2], 0)


@pytest.mark.parametrize("spread", [10.0, 4000.0], ids=["near the axis", "all around"])
def test_angles_are_those_of_the_line_of_sight_in_the_axes(spread: float) -> None:
    rng = np.random.default_rng(113)
    axes = Rotation.from_rotvec([0.3, -0.2, 0.1]).as_matrix()
    antenna = np.array([1.0, 2.0, 3000.0])
    positions = (antenna + 3000 * axes[2])[:, None] + rng.uniform(-spread, spread, (3, 400))
    elevation, squint = np.empty((2, 400))
    angles_in(positions, antenna, axes, elevation, squint)
    ahead, outwards, down = axes @ (positions - antenna[:, None])
    np.testing.assert_allclose(elevation, np.arctan2(outwards, down), atol=1e-14)
    np.testing.assert_allclose(squint, np.arctan2(ahead, np.hypot(outwards, down)), atol=1e-14)


def test_beams_of_nodes_are_mixed_in_each_pulse() -> None:
    rng, pulses, places, nodes, detectors = np.random.default_rng(114), 3, 5, 2, 4
    rates = circular(rng, (7, places, nodes * detectors)).astype(np.complex64)
    weights, steps = rng.uniform(-1, 1, (nodes, pulses)).astype(np.float32), np.array([5, 0, 2])
    phasors, result = (circular(rng, shape).astype(np.complex64) for shape in ((3, 5), (3, 5, 4)))
    mix_beams(rates, steps, weights, phasors, result)
    expected = np.einsum("pmkd,kp,pm->pmd", rates[steps].reshape(pulses, places, nodes, detectors), weights, phasors)
    np.testing.assert_allclose(result, expected, atol=1e-6)
