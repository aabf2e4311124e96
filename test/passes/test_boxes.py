"""Boxes: they fill the volume, and what they see of a point is what the phases of their middle say."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from pass_scenes import SETTINGS, array_of, flown

from sal_height.elevation import ESTIMATORS
from sal_height.passes import Tie
from sal_height.passes.boxes import MARGIN, SHIFT, Lattice, background, brightest
from sal_height.passes.points import PointHeights, PowerPeaks


def test_boxes_fill_the_volume() -> None:
    rng = np.random.default_rng(2)
    lattice = Lattice.of(array_of(flown(rng, np.zeros((1, 3)))), SETTINGS)
    boxes = [lattice.box(number) for column in lattice.columns() for number in column]
    places = np.column_stack([rng.uniform(-8, 8, (500, 2)), rng.uniform(-1.0, 4.5, 500)])
    off = np.array([np.abs((places - box.centre) @ lattice.array.axes.T) for box in boxes])
    inside = np.all(off <= np.array(lattice.size) / 2 * 1.001, axis=-1)
    assert inside.any(axis=0).all()
    assert inside.sum(axis=0).max() <= 2  # and do not overlap, but at their faces


def test_a_point_has_the_phases_of_its_box() -> None:
    """Wherever in a box: all phases within .05 rad, and in register: no pass loses more than a tenth of the power."""
    rng = np.random.default_rng(3)
    probe = Lattice.of(array_of(flown(rng, np.zeros((1, 3)))), SETTINGS)
    box = probe.box((1, 0, 1))
    for share in ((0.0, 0.0, 0.0), (0.45, -0.4, 0.45), (-0.4, 0.45, -0.48)):
        place = box.centre + np.array(share) * probe.size @ probe.array.axes
        array = array_of(flown(np.random.default_rng(4), place[None], cnr_db=70.0))
        lattice = Lattice.of(array, SETTINGS)
        (image,) = lattice.images([box])
        power = np.mean(np.abs(image) ** 2, axis=0)
        (row,), (col,) = brightest(power, box, 0.5 * power.max())
        samples = image[:, round(row), round(col)]
        # The point lies across from the pixel in which it is seen.
        across = (array.seen(place)[2] - box.steering.elevation) / box.steering.beamwidth
        left = samples * np.exp(-1j * box.steering.phase(across))
        assert np.angle(left / left.mean()) == pytest.approx(0.0, abs=0.05)
        each = np.abs(samples) ** 2
        assert each.min() > 0.9 * each.max()
        seen = box.grid.points(row, col)
        assert array.seen(seen)[0] == pytest.approx(array.seen(place)[0], abs=0.02)


def test_a_point_of_another_box_is_out_of_register() -> None:
    """4 m across from the plane of an image the outermost passes see it .18 m apart."""
    rng = np.random.default_rng(5)
    probe = Lattice.of(array_of(flown(rng, np.zeros((1, 3)))), SETTINGS)
    box = probe.box((0, 0, 0))
    place = box.centre + 4.0 * probe.array.axes[2]
    (image,) = Lattice.of(array_of(flown(rng, place[None], cnr_db=70.0)), SETTINGS).images([box])
    rows = []
    for power in np.abs(image) ** 2:
        (row,), _ = brightest(power, box, 0.5 * power.max())
        rows.append(row * box.grid.row_spacing)
    assert np.ptp(rows) == pytest.approx(4.0 * np.ptp(probe.array.elevations), rel=0.1)
    assert probe.size[2] / 2 * np.ptp(probe.array.elevations) <= SHIFT * 1.001 * 0.2342


def test_background_is_the_power_of_noise() -> None:
    """Within 3 % on 12 000 pixels of noise and some bright points."""
    rng = np.random.default_rng(6)
    noise = (rng.standard_normal((3, 60, 200, 2)) @ [1.0, 1j]) * np.sqrt([0.5, 2.0, 8.0])[:, None, None]
    noise[:, ::20, ::20] += 1000.0
    assert background([noise.astype(np.complex64)]) == pytest.approx([1.0, 4.0, 16.0], rel=0.04)


def test_peaks_are_found_between_pixels() -> None:
    """A Gaussian is a parabola in its logarithm; peaks in the margin are not those of the box."""
    lattice = Lattice.of(array_of(flown(np.random.default_rng(7), np.zeros((1, 3)))), SETTINGS)
    box = lattice.box((0, 0, 0))
    row, col = np.indices(box.grid.shape)
    places = [(MARGIN + 4.3, MARGIN + 6.8), (MARGIN + 12.0, MARGIN + 20.4), (1.0, 30.0)]
    power = sum(np.exp(-((row - r) ** 2) - (col - c) ** 2) for r, c in places)
    rows, cols = brightest(power, box, 0.1)
    assert rows == pytest.approx([r for r, _ in places[:2]], abs=1e-3)
    assert cols == pytest.approx([c for _, c in places[:2]], abs=1e-3)
    assert all(before < after for before, after in pairwise(rows))


NO_ERRORS = Tie(np.zeros(8), np.zeros((8, 2)), np.zeros((24, 24)), 0.0, np.ones(8), 5, 1, np.zeros((5, 3)))


def points_of(lattice: Lattice, number: tuple[int, int, int]) -> PointHeights:
    """The points that a box holds, by maximum likelihood."""
    box = lattice.box(number)
    (image,) = lattice.images([box])
    scaled = (image / np.sqrt(background([image]))[:, None, None]).astype(np.complex64)
    peaks = PowerPeaks.of(box, scaled, lattice.response, 10.0)
    assert peaks
    ml = ESTIMATORS["ml"]
    estimate = peaks.estimate(0.0, ml, ml.settings(range_looks=1, azimuth_looks=1))
    return peaks.placed(estimate, NO_ERRORS, lattice)


def test_a_box_keeps_the_points_within_it() -> None:
    """One .3 m across from its middle; another box sees it, too, but 1.2 m from its own middle."""
    probe = Lattice.of(array_of(flown(np.random.default_rng(0), np.zeros((1, 3)))), SETTINGS)
    place = probe.box((0, 0, 1)).centre + 0.3 * probe.array.axes[2]
    lattice = Lattice.of(array_of(flown(np.random.default_rng(1), place[None], cnr_db=26.0)), SETTINGS)
    own, other = points_of(lattice, (0, 0, 1)), points_of(lattice, (0, 0, 0))
    assert own.positions == pytest.approx(place[None], abs=0.02)
    assert len(other.height) == 0
