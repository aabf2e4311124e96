"""The compiled loops over terrain against their formulas in NumPy and SciPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import make_aperture
from scipy.interpolate import RegularGridInterpolator

from sal_height.geometry.earth import sphere_point
from sal_height.geometry.frames import angles_of, aperture_at
from sal_height.numeric.bilinear import interpolate
from sal_height.simulation._terrain_kernels import divide_cuts, mark_lit, rise_in_canopy, see


def test_interpolation_is_that_of_scipy_and_nan_outside() -> None:
    rng = np.random.default_rng(81)
    rows, cols = np.cumsum(rng.uniform(0.5, 2, 7)), np.cumsum(rng.uniform(0.5, 2, 9))
    values = rng.standard_normal((7, 9))
    row, col = rng.uniform(rows[0] - 1, rows[-1] + 1, 500), rng.uniform(cols[0] - 1, cols[-1] + 1, 500)
    row[:16], col[:16] = np.tile(rows, 3)[:16], np.tile(cols, 2)[:16]  # on nodes, the last ones included
    row[16], col[17] = np.nan, np.nan
    result = np.empty(500)
    interpolate(rows, cols, values, row, col, result)
    table = RegularGridInterpolator((rows, cols), values, bounds_error=False, fill_value=np.nan)
    np.testing.assert_allclose(result, table(np.stack([row, col], axis=-1)), atol=1e-14)
    assert np.isnan(result).any()


def test_rise_in_a_canopy_is_the_sum_of_the_steps_inside() -> None:
    """Over uneven ground and gaps, on paths that begin and leave at any side of the nodes, or under or over all."""
    rng = np.random.default_rng(85)
    rows, cols = np.cumsum(rng.uniform(0.5, 2, 12)), np.cumsum(rng.uniform(0.5, 2, 9))
    ground, top, base = rng.uniform(-1, 1, (12, 9)), np.maximum(0.0, rng.uniform(-4, 8, (12, 9))), 0.7
    points = np.stack([rng.uniform(-1, cols[-1] + 1, 400), rng.uniform(-1, rows[-1] + 1, 400), rng.uniform(-2, 9, 400)])
    slope, ceiling, steps = rng.uniform(-2, 2, (2, 400)), 8.0, 5
    result = np.empty(400)
    rise_in_canopy(rows, cols, ground, top, base, ceiling, points, slope, steps, result)
    step, expected = np.maximum(ceiling - points[2], 0) / steps, np.zeros(400)
    tables = [RegularGridInterpolator((rows, cols), v, bounds_error=False, fill_value=0) for v in (ground, top)]
    for number in range(steps):
        climb = (number + 0.5) * step
        places = (points[:2] + slope * climb)[::-1].T
        above, tops = points[2] + climb - tables[0](places), tables[1](places)
        expected += np.maximum(0, np.minimum(above + step / 2, tops) - np.maximum(above - step / 2, base))
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-13)
    assert 100 < np.count_nonzero(result) < 300


@pytest.mark.parametrize("sliding", [False, True])
@pytest.mark.parametrize("far", [1.0, 1000.0], ids=["near the origin", "up to 400 km from it"])
def test_points_are_seen_as_by_the_formulas_of_the_earth_and_of_frames(far: float, sliding: bool) -> None:
    rng = np.random.default_rng(82)
    east, north, height = (
        rng.uniform(-400, 400, 300) * far,
        rng.uniform(-400, 400, 300) * far,
        rng.uniform(-5, 900, 300),
    )
    aperture = replace(make_aperture(angles=(0.02, -0.03, 0.1), velocity=(50.0, 1.0, -2.0)), sliding=sliding)
    glide = aperture.velocity / (aperture.velocity @ aperture.forward) * sliding
    positions, seen = np.empty((3, 300)), np.empty((3, 300))
    see(east, north, height, aperture.position, glide, aperture.rotation, -1, positions, seen)
    expected = sphere_point(east, north, height)
    np.testing.assert_allclose(positions.T, expected, rtol=1e-14, atol=1e-15 * 6.4e6)
    angles = angles_of(expected, aperture_at(expected, aperture), -1)
    np.testing.assert_allclose(seen[0], angles[0], rtol=1e-12)
    np.testing.assert_allclose(seen[1:], angles[1:], atol=2e-12)


def test_cuts_are_divided_into_equal_pieces() -> None:
    rng = np.random.default_rng(83)
    pieces, cuts = rng.integers(0, 4, (3, 5)), rng.standard_normal((2, 3, 6))
    points = np.empty((2, pieces.sum()))
    strip, node = (np.empty(pieces.sum(), np.int32) for _ in range(2))
    divide_cuts(pieces, cuts, points, strip, node)
    expected = [
        (s, n, *(cuts[:, s, n] + (cuts[:, s, n + 1] - cuts[:, s, n]) * (i + 0.5) / pieces[s, n]))
        for s in range(3)
        for n in range(5)
        for i in range(pieces[s, n])
    ]
    np.testing.assert_allclose(np.stack([strip, node, *points], axis=-1), expected, atol=1e-15)


def test_point_is_lit_if_nothing_before_it_in_its_strip_is_as_high() -> None:
    rng = np.random.default_rng(84)
    elevation, strip = rng.uniform(0, 1, 200), np.sort(rng.integers(0, 9, 200)).astype(np.int32)
    elevation[20] = np.nan  # no terrain: not lit, and hides nothing
    lit = np.empty(200, dtype=bool)
    node = rng.integers(0, 2, 200).astype(np.int32)
    horizon = np.where(np.arange(9)[:, None] == 4, 0.9, -np.pi) * np.ones(2)
    mark_lit(elevation, strip, node, horizon, lit)
    expected = [e >= np.nanmax(elevation[: i + 1][strip[: i + 1] == strip[i]]) for i, e in enumerate(elevation)]
    np.testing.assert_array_equal(lit, expected & ((strip != 4) | (elevation >= 0.9)))
    assert 8 <= np.count_nonzero(lit) < 60
