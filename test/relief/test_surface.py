"""Surfaces as messages have them: what is possible, what is chosen, and single precision."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from sal_height.relief import Surface, folded
from sal_height.relief.prior import _quantiles
from sal_height.relief.slope import median

SHAPE, FARTHEST = (4, 7), 1e3


def surface(seed: int, *, is_common: bool = True) -> Surface:
    """A surface of random numbers, all of them possible."""
    rng = np.random.default_rng(seed)
    own, common = (root @ np.swapaxes(root, -1, -2) for root in rng.standard_normal((2, *SHAPE, 3, 3)))
    height, cnr_db = rng.standard_normal((2, *SHAPE))
    sigma, spread = rng.uniform(0.1, 1.0, (2, *SHAPE))
    positions = rng.standard_normal((*SHAPE, 3))
    return Surface(height, sigma, cnr_db, positions, spread, own, common if is_common else None)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("height", np.nan),
        ("height", -2 * FARTHEST),
        ("sigma", 0.0),
        ("sigma", 1e39),
        ("sigma", np.nan),
        ("spread", -0.1),
        ("spread", 2 * FARTHEST),
        ("positions", np.inf),
        ("own_covariance", np.nan),
        ("own_covariance", -np.eye(3)),
        ("own_covariance", 2 * FARTHEST**2 * np.eye(3)),
        ("common_covariance", -np.eye(3)),
        ("common_covariance", 2 * FARTHEST**2 * np.eye(3)),
    ],
)
def test_a_scatterer_with_an_impossible_number_is_found(name: str, value: Any) -> None:
    one = surface(1)
    assert one.is_possible(FARTHEST).all()
    assert replace(one, common_covariance=None).is_possible(FARTHEST).all()
    getattr(one, name)[2, 3] = value
    expected = np.ones(SHAPE, np.bool_)
    expected[2, 3] = False
    np.testing.assert_array_equal(one.is_possible(FARTHEST), expected)


@pytest.mark.parametrize("is_common", [True, False])
def test_a_surface_is_elsewhere_absent_or_another_one(is_common: bool) -> None:
    one, other = surface(1, is_common=is_common), surface(2)
    there, taken = np.random.default_rng(3).integers(0, 2, (2, *SHAPE)).astype(np.bool_)
    assert one.where(np.ones(SHAPE, np.bool_)) is one
    chosen = one.where(there)
    chosen.take(other, taken)
    assert chosen.cnr_db is one.cnr_db
    for name in {field.name for field in fields(Surface)} - {"cnr_db"}:
        mine, theirs, found = (getattr(each, name) for each in (one, other, chosen))
        if mine is None:
            assert found is None
            continue
        masks = (mask.reshape(SHAPE + (1,) * (mine.ndim - 2)) for mask in (taken, there))
        np.testing.assert_array_equal(found, np.select(np.broadcast_arrays(*masks), [theirs, mine], np.nan))


def test_single_precision_counts_from_an_origin() -> None:
    one, origin = surface(1), np.array([100.0, -50.0, 7.0])
    layers, own, common = one.singles(origin)
    offset = one.positions - origin
    expected = [one.height, one.sigma, one.cnr_db, offset[..., 0], offset[..., 1], one.spread]
    np.testing.assert_array_equal(layers, np.array(expected, np.float32).reshape(6, -1))
    np.testing.assert_array_equal(own, folded(one.own_covariance).reshape(-1, 6))
    np.testing.assert_array_equal(common, folded(one.common_covariance).reshape(-1, 6))
    unknown = replace(one, own_covariance=np.full_like(one.own_covariance, np.nan), common_covariance=None)
    assert [part.size for part in unknown.singles(origin)[1:]] == [0, 0]


@pytest.mark.parametrize("count", [1, 2, 3, 50, 439])
def test_quantiles_and_median_are_those_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).standard_normal(count)
    assert _quantiles(values, (0.0, 0.16, 0.5, 0.84, 1.0)) == np.percentile(values, [0, 16, 50, 84, 100]).tolist()
    assert median(values) == np.median(values)
