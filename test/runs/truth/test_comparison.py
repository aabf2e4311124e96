"""Published surfaces against lit ones, in pixels whose errors are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH

from sal_height.elevation.array.estimate import Validity
from sal_height.geometry.grid import Grid
from sal_height.relief.heights import HeightField, Surface
from sal_height.runs.truth.comparison import FOUND_ORDERS, TRUE_ORDERS, SurfaceComparison, compare
from sal_height.simulation.lit_surfaces import LitSurfaces

NAN = np.nan
SHAPE = (1, 9)
"""A row of pixels; a shadow is two or more without scatterers, as each has a neighbour beside it."""


def truth_of(*heights: tuple[float, ...], wide: bool = False) -> LitSurfaces:
    """Pixels with surfaces at these heights (m), the second a third as bright as the first; then shadow."""
    values = np.full((3, *SHAPE), NAN)
    for col, entry in enumerate(heights):
        values[: len(entry), 0, col] = entry
    received = np.where(np.isfinite(values), np.array([1.0, 1 / 3, 1 / 3])[:, None, None], NAN)
    spread = np.where(np.isfinite(values), 0.2 * BEAMWIDTH * wide, NAN)
    return LitSurfaces(
        values, 0 * values, spread, received, received, np.isfinite(values), 0 * values, 0 * values, 0 * values
    )


def field_of(validity: list[Validity], *heights: list[float], sigma: float = 0.1) -> HeightField:
    """A height image with the heights (m) of its surfaces in the first pixels; then no signal."""
    rest = SHAPE[1] - len(validity)
    codes = np.array([[*validity, *[Validity.NO_SIGNAL] * rest]], dtype=np.uint8)
    grid = Grid(np.zeros(3), np.array([0.0, -1, 0]), np.array([1.0, 0, 0]), 1.0, 1.0, *SHAPE)
    surfaces = []
    for entry in heights:
        height = np.array([[*entry, *[NAN] * rest]])
        surfaces.append(Surface.at(np.stack([height] * 3, axis=-1), height, sigma + 0 * height, 0 * height))
    return HeightField(grid, codes, tuple(surfaces))


def counts(result: SurfaceComparison) -> dict[tuple[str, str], int]:
    """Entries of the confusion table that are not 0."""
    there = np.argwhere(result.confusion)
    return {(TRUE_ORDERS[r], FOUND_ORDERS[c]): int(result.confusion[r, c]) for r, c in there}


def test_each_surface_is_compared_with_the_nearest_and_with_the_one_that_is_left_for_it() -> None:
    truth = truth_of((1.0,), (0.0, 2.0), (0.0, 2.0))
    two = Validity.TWO_SCATTERERS
    field = field_of([Validity.OK, two, two], [1.25, 0.1, 1.9], [NAN, 2.2, 2.3])
    result = compare(field, truth, BEAMWIDTH)
    np.testing.assert_allclose(result.errors.nearest, [0.25, 0.1, -0.1, 0.2, 0.3])
    # In the third pixel the stronger has taken the surface at 2 m.
    np.testing.assert_allclose(result.errors.own, [0.25, 0.1, -0.1, 0.2, 2.3])
    assert (result.pixels, result.valid, result.surfaces, result.missed) == (3, 3, 5, 0)
    assert counts(result) == {("one", "one"): 1, ("two", "two"): 2, ("shadow", "no signal"): 5}


def test_a_surface_that_none_is_published_for_is_missed() -> None:
    result = compare(field_of([Validity.OK, Validity.AMBIGUOUS], [0.0, NAN]), truth_of((0.0, 2.0), (1.0,)), BEAMWIDTH)
    assert (result.pixels, result.valid, result.surfaces, result.missed) == (2, 1, 3, 2)
    assert counts(result) == {("two", "one"): 1, ("one", "refused"): 1, ("shadow", "no signal"): 6}


def test_heights_in_shadow_are_ghosts_and_those_beside_lit_pixels_belong_to_their_neighbours() -> None:
    field = field_of([Validity.OK] * 4, [1.0, 1.5, 1.0, 1.0])
    result = compare(field, truth_of((1.0,)), BEAMWIDTH)
    np.testing.assert_array_equal(result.errors.ghost, [False, False, True, True])
    np.testing.assert_allclose(result.errors.nearest, [0.0, 0.5, NAN, NAN])
    assert (result.shadow, result.ghosts) == (7, 2)


def test_an_extended_surface_stands_for_all_that_the_pixel_holds() -> None:
    result = compare(field_of([Validity.EXTENDED], [0.6]), truth_of((0.0, 2.0)), BEAMWIDTH)
    assert result.errors.nearest == pytest.approx([0.6 - 2 / 3 / (4 / 3)])
    assert result.missed == 0
    wide = compare(field_of([Validity.EXTENDED], [0.6]), truth_of((0.5,), wide=True), BEAMWIDTH)
    assert wide.errors.nearest == pytest.approx([0.1])
    assert ("extended", "extended") in counts(wide)


def test_weak_surfaces_and_those_outside_the_array_need_not_be_found() -> None:
    truth = truth_of((0.0, 2.0, 3.0))
    truth.received[1] = 0.05
    truth.inside[2] = False
    result = compare(field_of([Validity.OK], [0.0]), truth, BEAMWIDTH)
    assert (result.surfaces, result.missed) == (1, 0)
    assert ("one", "one") in counts(result)


def test_error_of_place_counts_by_the_rise_of_the_ground_along_the_flight() -> None:
    """0.1 m of height, and 0.2 m along the flight on ground that rises by a half; a wall beside it is level there."""
    truth = replace(truth_of((1.0,), (0.0, 2.0)), rise=np.full((3, *SHAPE), 0.5))
    truth.rise[1] = 0.0
    field = field_of([Validity.OK, Validity.OK], [1.05, 1.9])
    none = np.zeros((*SHAPE, 3, 3))
    place = none + np.diag([0.2**2, 0.0, 0.0])
    field = replace(field, surfaces=(replace(field.first, own_covariance=none, common_covariance=place),))
    np.testing.assert_allclose(compare(field, truth, BEAMWIDTH).errors.sigma, [np.hypot(0.1, 0.1), 0.1])


def test_what_may_be_elsewhere_in_its_row_is_compared_with_what_is_lit_there() -> None:
    """Two columns more on both sides: only the surface of the seventh is 2 m high, and the last pixel reaches it."""
    field = field_of([Validity.OK] * 3, [2.0, 2.5, 1.9])
    numbers = (values[:, :3] for values in vars(field.first).values() if values is not None)
    grid, validity = replace(field.grid, cols=3), field.validity[:, :3]
    field = HeightField(grid, validity, (Surface(*numbers),))
    truth = truth_of((0.0,), (0.0,), (0.0,), (0.0,), (0.0,), (0.0,), (2.0,))
    truth = LitSurfaces(*(values[..., :7] for values in vars(truth).values()))
    result = compare(field, truth, BEAMWIDTH)
    np.testing.assert_allclose(result.errors.nearest, [2.0, 2.5, -0.1])
    assert not result.errors.ghost.any()


def test_what_may_be_elsewhere_in_an_empty_row_is_compared_as_if_it_were_not() -> None:
    """With what is lit in the rows beside it, as in a comparison without reach."""
    field = field_of([Validity.OK] * 9, [1.1] * 9)
    rows = (np.concatenate([values, values], axis=0) for values in vars(field.first).values() if values is not None)
    field = HeightField(replace(field.grid, rows=2), np.repeat(field.validity, 2, axis=0), (Surface(*rows),))
    lit, dark = truth_of(*[(1.0,)] * 9), truth_of()
    truth = LitSurfaces(
        *(
            np.concatenate([one, other], axis=1)
            for one, other in zip(vars(lit).values(), vars(dark).values(), strict=True)
        )
    )
    expected = compare(field, truth, BEAMWIDTH).errors.nearest
    assert np.isfinite(expected).all()
    middle = HeightField(
        replace(field.grid, cols=7),
        field.validity[:, 1:8],
        (Surface(*(values[:, 1:8] for values in vars(field.first).values() if values is not None)),),
    )
    np.testing.assert_allclose(compare(middle, truth, BEAMWIDTH).errors.nearest, 0.1)


def test_a_crown_has_all_heights_between_its_scatterers() -> None:
    """From 1 to 4 m: heights within are right, those above are compared with its top; a roof has one height."""
    field = field_of([Validity.TWO_SCATTERERS] * 2, [3.5, 3.5], [4.5, 4.5])
    for wide, errors in ((True, [0.0, 0.0, 0.5, 0.5]), (False, [1.5, 1.5, 2.5, 2.5])):
        truth = truth_of((2.0,), (2.0,), wide=wide)
        truth = replace(truth, lowest=truth.height - 3.0, highest=truth.height)
        np.testing.assert_allclose(compare(field, truth, BEAMWIDTH).errors.nearest, errors)


def test_what_is_extended_is_as_sure_as_its_spread() -> None:
    field = field_of([Validity.EXTENDED, Validity.OK], [1.0, 1.0])
    field = replace(field, surfaces=(replace(field.first, spread=0 * field.first.height + 0.2),))
    result = compare(field, truth_of((1.1,), (1.1,)), BEAMWIDTH)
    np.testing.assert_allclose(result.errors.sigma, [np.hypot(0.1, 0.2), 0.1])


def test_heights_within_the_extent_of_a_crown_have_no_error_from_one_height() -> None:
    """The first is within, the second half a metre above, and the third in a pixel next to that, 1 m below."""
    field = field_of([Validity.OK, Validity.OK, Validity.OK], [3.5, 4.5, 0.0])
    truth = truth_of((4.0,), (4.0,), wide=True)
    errors = compare(field, replace(truth, lowest=0 * truth.height - 3.0), BEAMWIDTH).errors
    np.testing.assert_array_equal(errors.within_extent, [True, False, False])
    np.testing.assert_allclose(errors.from_one_height.nearest, [0.5, -1.0])
