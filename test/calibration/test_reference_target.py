"""A reflector of known place in images: found near its place, and only if it stands out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import circular

from sal_height.calibration.accumulate import Sighting, find_reference_target
from sal_height.geometry.frames import ApertureState, angles_of
from sal_height.geometry.grid import Grid
from sal_height.simulation.flight import flight_of
from sal_height.simulation.preset import load_preset

ROWS, COLS = 64, 24
APERTURE = ApertureState(np.array([0.0, 0.0, 3500.0]), np.array([50.0, 0.0, 0.0]), np.eye(3), 0.1, np.zeros((6, 6)))
SIGHT = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
GRID = Grid(
    APERTURE.position + 4950.0 * SIGHT - np.array([0.4, 0.0, 0.0]),
    SIGHT,
    np.array([1.0, 0.0, 0.0]),
    0.05,
    0.04,
    ROWS,
    COLS,
)
ROW, COL = 30, 7


def seen(over_db: float, row: int = ROW, col: int = COL) -> Sighting | None:
    """A target at ROW and COL whose image, of `over_db` over the speckle of two channels, is at `row` and `col`."""
    pixels = circular(np.random.default_rng(1), (2, ROWS, COLS)).astype(np.complex64)
    pixels[:, row, col] = 10 ** (over_db / 20) * np.array([1, 0.5j])
    return find_reference_target(pixels, GRID, APERTURE, 1, GRID.points(ROW, COL))


def test_it_is_found_within_two_pixels_of_its_place_and_seen_under_its_angles() -> None:
    _, elevation, squint = angles_of(GRID.points(ROW, COL), APERTURE, 1)
    for row, col in ((ROW, COL), (ROW - 2, COL + 2)):
        found = seen(40.0, row, col)
        assert found is not None
        np.testing.assert_allclose(found.samples, [100, 50j], rtol=1e-6)
        assert found.elevation == pytest.approx(float(elevation), abs=1e-12)
        assert found.squint == pytest.approx(float(squint), abs=1e-12)
    assert elevation != pytest.approx(squint, abs=0.1)


def test_it_is_not_taken_from_elsewhere_nor_from_speckle() -> None:
    assert seen(40.0, ROW + 3, COL) is None
    assert seen(40.0, ROW, COL + 3) is None
    assert seen(15.0) is None


@pytest.mark.parametrize(("row", "col"), [(1, COL), (ROWS - 2, COL), (ROW, 1), (ROW, COLS - 2), (-40, COL)])
def test_beyond_the_edge_there_is_none(row: int, col: int) -> None:
    pixels = np.full((2, ROWS, COLS), 1e-3, dtype=np.complex64)
    pixels[:, max(row, 0), col] = 1
    assert find_reference_target(pixels, GRID, APERTURE, 1, GRID.points(row, col)) is None


def test_in_a_strip_it_is_seen_from_abeam() -> None:
    """The strip's images are those of an aperture that slides along: the squint of a target at any column is 0."""
    flight = flight_of(replace(load_preset("sal_stripmap"), dwells=1), seed=1)
    aperture = replace(flight.aperture(0), sliding=True)
    place = aperture.position + 5000.0 * SIGHT + np.array([0.3, 0.0, 0.0])
    grid = replace(GRID, origin=aperture.position + 4999.0 * SIGHT - np.array([0.4, 0.0, 0.0]))
    pixels = np.full((2, ROWS, COLS), 1e-3, dtype=np.complex64)
    pixels[:, 20, 17] = 1
    found = find_reference_target(pixels, grid, aperture, 1, place)
    assert found is not None
    assert found.squint == pytest.approx(0, abs=1e-9)
    assert abs(angles_of(place, aperture, 1)[2]) > 1e-5
