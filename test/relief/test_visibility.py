"""Shadow that pixels without a signal show, behind drops seen at 45 degrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sal_height.elevation import Validity
from sal_height.geometry import ApertureState, Grid, sphere_point
from sal_height.relief import HeightField, Surface, circle_covariance
from sal_height.relief.visibility import silent_cells

APERTURE = ApertureState(np.array([0.0, 3535, 3535]), np.array([50.0, 0, 0]), np.eye(3), 0.08, np.zeros((6, 6)))
CELL, SPACING, COLS, SIGMA = 0.05, 0.097, 6, 0.012


def behind_a_drop(drop: float, silent: int) -> HeightField:
    """Pavement `drop` m above the road south of it; the sensor is in the north, and rows are in the order of range.

    The edge is at 0 m north. The road is hidden as far as the drop is high, in `silent` pixels without a signal.
    """
    north = np.concatenate(
        [0.04 + 0.085 * np.arange(20)[::-1], np.full(silent, np.nan), -drop - 0.04 - 0.085 * np.arange(20)]
    )
    place = np.broadcast_to(north[:, None], (len(north), COLS))
    east = np.broadcast_to(SPACING * (np.arange(COLS) + 0.5), place.shape)
    height = np.where(place > 0, drop, np.where(np.isnan(place), np.nan, 0.0))
    positions = sphere_point(east, place, height)
    own = circle_covariance(np.full(place.shape, SIGMA), positions, APERTURE)
    surface = Surface.seen_from(APERTURE, positions, own, np.full(place.shape, 20.0))
    sight = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
    grid = Grid(np.zeros(3), sight, np.array([1.0, 0.0, 0.0]), 0.06, SPACING, len(north), COLS)
    validity = np.where(np.isnan(place), Validity.NO_SIGNAL, Validity.OK).astype(np.uint8)
    return HeightField(grid, validity, (surface,))


@pytest.mark.parametrize(("drop", "silent"), [(0.12, 2), (0.4, 6), (1.45, 24)])
def test_silent_pixels_show_the_cells_behind_a_drop(drop: float, silent: int) -> None:
    row, col = silent_cells(behind_a_drop(drop, silent), APERTURE, 3.0, CELL).T
    north = (row + 0.5) * CELL
    assert north.min() > -drop - 0.01
    assert north.max() < 0.01
    cells = len(np.unique(row)) * len(np.unique(col))
    assert len(row) == cells  # no cell is left out
    assert len(np.unique(row)) >= round(drop / CELL) - 1
    assert len(np.unique(col)) >= 11  # 0.58 m


def test_shadows_do_not_depend_on_an_error_that_all_pixels_share() -> None:
    field = behind_a_drop(0.12, 2)
    common = np.zeros((*field.grid.shape, 3, 3))
    common[..., 2, 2] = 10.0**2
    shared = replace(field.first, sigma=np.hypot(field.first.sigma, 10.0), common_covariance=common)
    found = silent_cells(replace(field, surfaces=(shared,)), APERTURE, 3.0, CELL)
    assert np.array_equal(found, silent_cells(field, APERTURE, 3.0, CELL))
    assert len(found)


def test_nothing_is_shown_where_the_ground_rises_or_where_pixels_are_unknown() -> None:
    field = behind_a_drop(0.12, 2)
    unknown = np.where(field.validity == Validity.NO_SIGNAL, Validity.LOW_CNR, field.validity).astype(np.uint8)
    assert not len(silent_cells(HeightField(field.grid, unknown, field.surfaces), APERTURE, 3.0, CELL))
    assert not len(silent_cells(behind_a_drop(0.0, 2), APERTURE, 3.0, CELL))
    assert not len(silent_cells(behind_a_drop(0.12, 0), APERTURE, 3.0, CELL))
