"""Points of a box: those within it, each once."""

from __future__ import annotations

import numpy as np
import pytest
from pass_scenes import SETTINGS, array_of, flown

from sal_height.elevation import ESTIMATORS
from sal_height.passes import Tie
from sal_height.passes.boxes import Lattice, background
from sal_height.passes.points import PointHeights, PowerPeaks

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
