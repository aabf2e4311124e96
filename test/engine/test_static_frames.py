"""The place of the sensor on the platform, through whatever frames are between, and dwells that need it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from driven import accept, drive
from flown_items import SMALL, flight_items, small_flight
from scipy.spatial.transform import Rotation
from stage_cases import transform

from sal_height.engine import frames as module
from sal_height.engine.compression import Compression
from sal_height.engine.frames import StaticFrames, StaticTransform
from sal_height.errors import UserError
from sal_height.topics import SLC, TF_STATIC


def frames_of(*transforms: StaticTransform) -> StaticFrames:
    frames = StaticFrames()
    for each in transforms:
        frames.add(each)
    return frames


def test_a_frame_is_placed_through_those_between() -> None:
    """A quarter turn about z in the middle: what is forward of the pod is left of the body."""
    frames = frames_of(
        transform("pod", "sensor", (2.0, 0.0, -0.5), Rotation.from_euler("x", 0.1)),
        transform("base_link", "pod", (1.0, 0.0, 0.0), Rotation.from_euler("z", math.pi / 2)),
        transform("base_link", "gps", (-3.0, 0.0, 1.0)),
    )
    place = frames.place("sensor", "base_link")
    assert np.allclose(place.translation, [1.0, 2.0, -0.5], rtol=0, atol=1e-15)
    c, s = math.cos(0.1), math.sin(0.1)
    assert np.allclose(place.rotation.as_matrix(), [[0, -c, s], [1, 0, 0], [0, s, c]], rtol=0, atol=1e-15)
    assert np.allclose(frames.place("sensor", "gps").translation, [4.0, 2.0, -1.5], rtol=0, atol=1e-15)
    back = frames.place("base_link", "sensor")
    assert np.allclose((back * place).as_matrix(), np.eye(4), rtol=0, atol=1e-15)


def test_a_later_transform_replaces_the_earlier() -> None:
    frames = frames_of(transform("base_link", "sensor", (1.0, 0.0, 0.0)), transform("base_link", "sensor"))
    assert np.array_equal(frames.place("sensor", "base_link").translation, np.zeros(3))


def test_frames_that_nothing_joins_have_no_place_in_each_other() -> None:
    frames = frames_of(transform("base_link", "pod"), transform("mast", "sensor"))
    assert frames.place("sensor", "base_link") is None
    assert frames.place("nowhere", "base_link") is None


def test_frames_in_a_circle_end_the_search() -> None:
    frames = frames_of(transform("a", "b"), transform("b", "c"), transform("c", "a"))
    assert frames.place("c", "base_link") is None


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (transform("", "sensor"), "two frames with names"),
        (transform("base_link", ""), "two frames with names"),
        (transform("sensor", "sensor"), "two frames with names"),
        (transform("base_link", "sensor", (math.nan, 0.0, 0.0)), "finite and a quaternion"),
        (transform("base_link", "sensor", (0.0, math.inf, 0.0)), "finite and a quaternion"),
    ],
)
def test_what_is_no_transform_is_refused(bad: StaticTransform, words: str) -> None:
    with pytest.raises(UserError, match=words):
        StaticFrames().add(bad)


@pytest.mark.parametrize("w", [0.0, 0.98, 1.02, math.nan])
def test_a_rotation_must_be_a_unit_quaternion(w: float) -> None:
    bad = transform("base_link", "sensor")._replace(quaternion=np.array([0.0, 0.0, 0.0, w]))
    with pytest.raises(UserError, match="norm 1"):
        StaticFrames().add(bad)


def test_no_more_frames_are_kept_than_a_platform_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_FRAMES", 2)
    frames = frames_of(transform("base_link", "sensor"), transform("base_link", "gps"))
    with pytest.raises(UserError, match="more than 2 frames; 'third' is left out"):
        frames.add(transform("base_link", "third"))
    frames.add(transform("base_link", "sensor", (1.0, 0.0, 0.0)))
    assert frames.place("sensor", "base_link").translation[0] == 1.0


def test_what_is_no_transform_is_reported_and_the_next_one_is_used() -> None:
    script = [
        accept(TF_STATIC, transform("base_link", "gps")),
        accept(TF_STATIC, transform("base_link", "sensor", (math.nan, 0.0, 0.0))),
        *(accept(*item) for item in flight_items(small_flight(), dwells=[0])),
    ]
    driven = drive(Compression(Compression.settings(**SMALL, mounting_from_tf=True)), script)
    assert (driven.warned(), driven.made) == ({"transform": 1}, [])
    driven.do(accept(TF_STATIC, transform("base_link", "sensor")))
    assert [one.port for one in driven.made] == [SLC]


def test_a_sensor_farther_than_any_platform_costs_its_dwells_only() -> None:
    stage = Compression(Compression.settings(**SMALL, mounting_from_tf=True))
    driven = drive(stage, [accept(TF_STATIC, transform("base_link", "sensor", (2e3, 0.0, 0.0)))])
    driven.deliver(flight_items(small_flight(), dwells=[0]))
    assert driven.lost() == {"cannot be processed": 8}
    assert "lever arm" in driven.losses[0].sentence
    driven.do(accept(TF_STATIC, transform("base_link", "sensor")))
    driven.deliver(flight_items(small_flight(), dwells=[1]))
    assert [one.item.key.number for one in driven.made] == [1]
