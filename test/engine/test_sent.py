"""Items as they are sent to another process: equal in every field, of few objects, and without what they cache."""

from __future__ import annotations

import io
import pickle
from typing import Any

import numpy as np
import pytest
from flown_items import SMALL, frames_in, heights_in, small_flight
from same_items import difference

from sal_height.engine.height_items import Heights
from sal_height.numeric import arrays_of, joined_bytes


class Counter(pickle.Pickler):
    """Counts the objects that it meets."""

    objects = 0

    def persistent_id(self, _: Any) -> None:
        self.objects += 1


def objects_of(item: Any) -> int:
    counter = Counter(io.BytesIO(), protocol=5)
    counter.dump(item)
    return counter.objects


def sent(item: Any) -> Any:
    return pickle.loads(pickle.dumps(item, protocol=5))  # noqa: S301 (our own bytes)


@pytest.fixture
def heights() -> Heights:
    """Heights of a dwell of the small preset."""
    return heights_in(small_flight(1), **SMALL)[0]


@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("frames", 8 * 28),
        ("state", 8),
        ("grid", 12),
        ("aperture", 14),
        ("surface", 40),
        ("provenance", 8),
        ("heights", 400),  # 150 of them are tests of eight channels
    ],
)
def test_items_arrive_equal_and_are_few_objects(name: str, most: int, heights: Heights) -> None:
    """Each object costs about half a microsecond, and an array is ten."""
    items = {
        "frames": frames_in(small_flight(1), 0),
        "state": small_flight(1).platform_states(0)[0],
        "grid": heights.grid,
        "aperture": heights.aperture,
        "surface": heights.surfaces[0],
        "provenance": heights.provenance,
        "heights": heights,
    }
    assert not difference(items[name], sent(items[name]))
    assert objects_of(items[name]) <= most


def test_what_follows_from_heights_is_not_sent(heights: Heights) -> None:
    before = len(pickle.dumps(heights))
    assert heights.field.validity.any()
    assert heights.aperture.state is heights.aperture.state
    assert len(pickle.dumps(heights)) == before


def test_arrays_are_joined_and_parted_to_the_bit() -> None:
    arrays = [np.array([[1.0, -0.0, np.nan]]), np.arange(4.0)[::2], np.zeros((0, 3)), np.float64(7.5)]
    parted = arrays_of(joined_bytes(arrays), [np.shape(one) for one in arrays])
    for one, other in zip(arrays, parted, strict=True):
        assert (np.shape(one), np.asarray(one).tobytes()) == (other.shape, other.tobytes())
