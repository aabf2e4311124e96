"""Several dwells estimated side by side: what belongs to one is not mixed with the others."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, make_beams, multilook
from scipy.ndimage import uniform_filter

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import ElevationEstimate, Validity
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.estimators.registry import estimate_dwells, side_by_side
from sal_height.elevation.looks.looks import DwellColumns, Looks, SlcCovariance

BEAMS = make_beams(count=6)


def dwell(seed: int, beams: Beams = BEAMS, rows: int = 24, cols: int = 20) -> Looks:
    """Looks of one or two scatterers a pixel at about 15 dB, at squints of the dwell's own."""
    rng = np.random.default_rng(seed)
    squint = np.linspace(-0.2, 0.3, cols // 2) * BEAMWIDTH * rng.uniform(0.5, 1.5)
    elevation = rng.uniform(*beams.span, (2, rows, cols))
    power = np.where(rng.random((2, rows, cols)) < [[[1.0]], [[0.3]]], 30.0, 0.0)
    echoes = np.sqrt(power) * circular(rng, power.shape)
    slc = np.einsum("src,srcm->mrc", echoes, beams.response(elevation, np.repeat(squint, 2)))
    looks = multilook(slc + circular(rng, slc.shape), 2, 2, squint=squint)
    return replace(looks, level_spread=0.01 * BEAMWIDTH * seed)


def arrays_of(estimate: ElevationEstimate) -> list[np.ndarray]:
    scatterers = [getattr(one, f.name) for one in estimate.scatterers for f in fields(one)]
    chances = [] if estimate.order_probability is None else [estimate.order_probability]
    return [estimate.validity, *chances, *scatterers]


def test_dwells_at_once_are_estimated_as_each_alone() -> None:
    """To the last bit, whatever their order, and of different kinds: other beams, other sizes, other noise."""
    other = make_beams(count=4)
    observed = [(dwell(1), BEAMS), (dwell(2, other), other), (dwell(3), BEAMS), (dwell(4, cols=16), BEAMS)]
    observed += [(replace(dwell(5), noise_powers=np.full(6, 1.5)), BEAMS), (dwell(6), BEAMS)]
    calls = []

    def counted(looks: Looks, beams: Beams, settings: MlSettings) -> ElevationEstimate:
        calls.append(looks.dwells)
        return ml_elevation(looks, beams, settings)

    together = estimate_dwells(counted, observed, MlSettings())
    assert sorted(calls) == [1, 1, 1, 3]
    for (looks, beams), found in zip(observed, together, strict=True):
        alone = ml_elevation(looks, beams, MlSettings())
        assert np.isin(alone.validity, [Validity.OK, Validity.TWO_SCATTERERS]).any()
        for mine, theirs in zip(arrays_of(found), arrays_of(alone), strict=True):
            np.testing.assert_array_equal(mine, theirs)
            assert mine.flags.c_contiguous or not theirs.flags.c_contiguous


def test_covariances_that_are_not_kept_are_estimated_dwell_by_dwell(monkeypatch: pytest.MonkeyPatch) -> None:
    """They would have to be computed to be put side by side."""
    monkeypatch.setattr("sal_height.elevation.looks.looks.NUMBERS_KEPT", 0)
    observed = [(dwell(seed), BEAMS) for seed in (1, 2)]
    assert isinstance(observed[0][0].covariance, SlcCovariance)
    together = estimate_dwells(ml_elevation, observed, MlSettings())
    for (looks, beams), found in zip(observed, together, strict=True):
        for mine, theirs in zip(arrays_of(found), arrays_of(ml_elevation(looks, beams, MlSettings())), strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_looks_side_by_side_are_those_of_each_dwell() -> None:
    several = [dwell(seed) for seed in (1, 2, 3)]
    together = side_by_side(several)
    assert together.columns == DwellColumns(3, 10)
    for looks, part in zip(several, together.columns.slices, strict=True):
        np.testing.assert_array_equal(together.covariance[:, part], looks.covariance[:, :])
        np.testing.assert_array_equal(together.squint[part], looks.squint)
        np.testing.assert_array_equal(np.broadcast_to(together.level_spread, 30)[part], looks.level_spread)
        for name in ("count", "power", "floor", "row", "col", "row_variance", "col_variance", "finite"):
            np.testing.assert_array_equal(getattr(together, name)[:, part], getattr(looks, name))


def test_neighbours_are_those_of_the_own_dwell() -> None:
    """The mean over pixels about each one, and what is computed of each dwell alone."""
    values, columns = np.random.default_rng(2).normal(size=(2, 9, 12)), DwellColumns(3, 4)
    found = columns.mean_of_neighbours(values, 5)
    for part in columns.slices:
        np.testing.assert_array_equal(found[..., part], uniform_filter(values[..., part], (1, 5, 5), mode="nearest"))
    highest = columns.each(lambda one, row: one / one.max() + row, values[0], np.arange(12.0))
    for part in columns.slices:
        np.testing.assert_array_equal(
            highest[:, part], values[0][:, part] / values[0][:, part].max() + np.arange(12.0)[part]
        )
    assert columns.each(lambda one: one, np.arange(12)).tolist() == list(range(12))
