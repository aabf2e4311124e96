"""Stage height_adjuster: heights of passes over the same ground come together; what cannot be adjusted is passed on."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown_heights import STATED, FlownHeights, flown_heights
from flown_passes import STREET
from helpers import assert_one_sentence
from stage_graph import StageGraph

from sal_height import messages
from sal_height.adjustment import LEAST_POINTS, AdjustmentWindow
from sal_height.errors import UserError
from sal_height.geometry import sphere_coordinates
from sal_height.messages.types import (
    HeightImage,
    Odometry,
    SensorInfo,
    Surface,
)
from sal_height.relief import HeightField
from sal_height.sensor import Sensor
from sal_height.simulation.scenes import load_scene

TIMEOUT_S = 120.0
JITTER = {"jitter_rad": 1e-7}
LAYERS = Surface.__slots__


class Adjusting:
    """An adjuster that is fed with messages, and those that it publishes."""

    def __init__(self, sensor: SensorInfo | None, **parameters: Any) -> None:
        """Start it; it knows its sensor, if there is one."""
        self.graph = StageGraph()
        self.stage = self.graph.add("height_adjuster", **{**JITTER, **parameters})
        self.wait = self.graph.wait
        if sensor:
            self.graph.publish("sensor_info", sensor)

    def heard(self, name: str) -> list[Any]:
        """Messages on a topic of the adjuster."""
        return self.graph.heard[f"adjusted/{name}"]

    def feed(self, image: HeightImage, odometry: Sequence[Odometry]) -> HeightImage:
        """The adjusted image of one."""
        count = len(self.heard("height"))
        self.graph.publish("platform/odometry", *odometry)
        self.graph.publish("ml/height", image)
        self.wait(lambda: len(self.heard("height")) > count, "heights")
        return self.heard("height")[-1]

    def fly(self, flown: FlownHeights, dwells: Sequence[int] | None = None) -> list[HeightImage]:
        numbers = range(len(flown.images)) if dwells is None else dwells
        return [self.feed(flown.images[number], flown.odometry[number]) for number in numbers]


def fields_of(images: Sequence[HeightImage]) -> list[HeightField]:
    return [messages.field_from_message(image) for image in images]


def same_heights(one: HeightImage, other: HeightImage) -> bool:
    """Whether all numbers are the same, to the last bit."""
    numbers = [
        [getattr(surface, name).tobytes() for surface in image.surfaces for name in LAYERS] for image in (one, other)
    ]
    return numbers[0] == numbers[1] and one.grid == other.grid and one.aperture == other.aperture


@pytest.fixture(scope="module")
def flown() -> FlownHeights:
    return flown_heights()


@pytest.fixture
def adjusting(flown: FlownHeights) -> Adjusting:
    return Adjusting(flown.sensor_info)


def test_heights_of_passes_come_together(adjusting: Adjusting, flown: FlownHeights) -> None:
    """Median errors, 30 cm apart, are within 10 cm once the ground of a pass is recognised, and as stated."""
    images = adjusting.fly(flown)
    before, after = flown.errors(flown.fields), flown.errors(fields_of(images))
    assert np.ptp(before) > 0.3
    stated = np.array([np.nanmedian(field.first.sigma) for field in fields_of(images)])
    recognised = stated < 0.5 * np.array([np.nanmedian(field.first.sigma) for field in flown.fields])
    assert recognised[5::3].all(), "at the end of each pass"
    assert np.ptp(after[recognised]) < 0.1, after
    for image, field, error in zip(images, fields_of(images), after.tolist(), strict=True):
        assert image.estimator == "adjusted"
        assert abs(error) < 3 * np.nanmedian(field.first.sigma)
        stage = messages.stages_of(image.provenance.parameters)["height_adjuster"]
        assert len(stage["pose_error"]) == 7
        np.testing.assert_array_equal(image.validity, flown.images[image.dwell].validity)
    assert adjusting.stage.counted("ignored.") == {}
    counts = adjusting.stage.summary()
    assert counts["flights begun"] == 1
    assert counts["dwells compared with others"] >= np.count_nonzero(recognised)
    assert counts["dwells compared with others"] + counts["dwells that nothing recognises"] == len(images)
    assert adjusting.stage.summary()["processed"] == len(images)


def test_odometry_and_mounting_come_without_their_errors(adjusting: Adjusting, flown: FlownHeights) -> None:
    """Every sample once, with its stamp; the antenna where the corrected aperture has it; the mounting with sigma."""
    images = adjusting.fly(flown)
    adjusting.wait(lambda: len(adjusting.heard("mounting")) == len(images), "the mounting")
    fed = {messages.to_ns(one.header.stamp) for part in flown.odometry for one in part}
    begins = [messages.to_ns(image.header.stamp) for image in images]
    wanted = {stamp for stamp in fed for first in begins[::3] if first <= stamp <= first + begins[2] - begins[0]}
    assert len(wanted) > 12

    def stamps() -> list[int]:
        return [messages.to_ns(one.header.stamp) for one in adjusting.heard("odometry")]

    adjusting.wait(lambda: wanted <= set(stamps()), "odometry")
    assert stamps() == sorted(set(stamps()))
    assert set(stamps()) <= fed
    image = images[-1]
    nearest = min(
        adjusting.heard("odometry"),
        key=lambda one: abs(messages.to_ns(one.header.stamp) - messages.to_ns(image.header.stamp)),
    )
    aperture = messages.aperture_from_message(image.aperture)
    state = messages.state_from_message(nearest)
    seconds = (state.stamp_ns - messages.to_ns(image.header.stamp)) * 1e-9
    across = (state.position - aperture.position - seconds * state.velocity)[1:]
    assert np.all(np.abs(across) < 0.01), across
    mounting = adjusting.heard("mounting")[-1]
    assert mounting.header.frame_id == "base_link"
    assert mounting.header.stamp == image.header.stamp
    sigmas = np.sqrt(np.diag(np.array(mounting.pose.covariance).reshape(6, 6)))
    assert np.all((sigmas[:3] > 1e-3) & (sigmas[:3] < 0.0101))
    assert np.all((sigmas[3:] > 1e-6) & (sigmas[3:] < 3.01e-5))


def test_what_the_compression_states_of_the_mounting_counts(flown: FlownHeights) -> None:
    """Before anything was compared: 30 urad and 1 cm, not the default; the default where it states nothing."""
    adjusting = Adjusting(flown.sensor_info)
    adjusting.fly(flown, [0])
    silent = copy.deepcopy(flown.images[1])
    silent.provenance.parameters = [
        one for one in silent.provenance.parameters if one.name.removeprefix("sar_compression.") not in STATED
    ]
    adjusting.feed(silent, flown.odometry[1])
    adjusting.wait(lambda: len(adjusting.heard("mounting")) == 2, "the mounting")
    sigmas = [np.sqrt(np.diag(np.array(one.pose.covariance).reshape(6, 6))) for one in adjusting.heard("mounting")]
    np.testing.assert_allclose(sigmas[0][[0, 3]], [0.01, 3e-5], rtol=0.01)
    np.testing.assert_allclose(sigmas[1][[0, 3]], [0.05, 1e-3], rtol=0.01)


def test_known_ground_places_heights(flown: FlownHeights, tmp_path: Path) -> None:
    """Within 5 cm of the truth from the first dwell on; a file that cannot be read is refused at the start."""
    scene = load_scene(STREET)
    step = 0.05
    east, north = np.arange(-6, 6, step), np.arange(6, -6, -step)
    elevation = scene.heights(*np.meshgrid(east, north))
    np.savez(tmp_path / "ground.npz", elevation=elevation, dx=step, dy=step)
    adjusting = Adjusting(flown.sensor_info, terrain=str(tmp_path / "ground.npz"), terrain_sigma_m=0.02)
    after = flown.errors(fields_of(adjusting.fly(flown, range(12))))
    assert np.all(np.abs(after) < 0.05), after
    with pytest.raises(UserError) as refused:
        Adjusting(None, terrain="ground.txt")
    assert_one_sentence(str(refused.value), "ground.txt", "allowed are .tif, .tiff and .npz")


def test_known_ground_that_is_not_there_counts_no_more(flown: FlownHeights, tmp_path: Path) -> None:
    """A metre too high: one dwell is passed on as it is, with the reason, and heights are then as without it."""
    scene = load_scene(STREET)
    east, north = np.arange(-6, 6, 0.05), np.arange(6, -6, -0.05)
    elevation = scene.heights(*np.meshgrid(east, north)) + 1.0
    np.savez(tmp_path / "ground.npz", elevation=elevation, dx=0.05, dy=0.05)
    adjusting = Adjusting(flown.sensor_info, terrain=str(tmp_path / "ground.npz"), terrain_sigma_m=0.02)
    fields = fields_of(adjusting.fly(flown, range(12)))
    assert adjusting.stage.summary()["ignored.known ground"] == 1
    assert_one_sentence(adjusting.stage.last_rejection.partition(": ")[2], "elevation model contradicts", "m too high")
    assert np.all(np.abs(flown.errors(fields)) < 0.5)


def test_a_known_target_moves_heights_to_where_it_is(flown: FlownHeights, tmp_path: Path) -> None:
    """A point that outshines all others, and is known to be 10 cm higher: its dwell rises by that, within 4 cm."""
    image = copy.deepcopy(flown.images[0])
    usable = np.flatnonzero(np.array(image.validity) == HeightImage.OK)
    first, bright = image.surfaces[0], int(usable[usable.size // 2])
    first.cnr_db[bright] = 70.0
    field = fields_of([image])[0]
    east, north, height = (one.flat[bright] for one in sphere_coordinates(field.first.positions))
    targets = tmp_path / "targets.csv"
    targets.write_text(f"east_m,north_m,height_m\n{east},{north},{height + 0.1}\n", encoding="utf-8")
    adjusting = Adjusting(flown.sensor_info, targets=str(targets))
    moved = fields_of([adjusting.feed(image, flown.odometry[0])])[0]
    assert np.nanmedian(moved.first.height - field.first.height) == pytest.approx(0.1, abs=0.04)


def test_a_file_of_targets_that_cannot_be_read_is_refused() -> None:
    with pytest.raises(UserError) as refused:
        Adjusting(None, targets="none.csv")
    assert_one_sentence(str(refused.value), "Cannot read none.csv with targets")


def stripmap(sensor: Sensor) -> SensorInfo:
    info = messages.sensor_to_message(sensor, messages.to_stamp(0))
    info.mode = "stripmap"
    return info


def spoilt(flown: FlownHeights, how: str) -> HeightImage:
    """A height image that cannot be adjusted: a dwell of another number right after dwell 1, or after dwell 0."""
    image = copy.deepcopy(flown.images[0 if how == "out of order" else 1])
    image.dwell = 100
    image.header.stamp = messages.to_stamp(messages.to_ns(image.header.stamp) + 1)
    provenance = image.provenance
    values = messages.stages_of(provenance.parameters)["sar_compression"]
    if how == "mounting from tf":
        values["mounting_from_tf"] = True
    elif how == "wrong provenance":
        values["placement.speed"] = float("nan")
    elif how == "not adjusted":
        values["boresight_sigma_rad"] = 7.0
    elif how == "few heights":
        usable = np.flatnonzero(np.array(image.validity) == HeightImage.OK)
        for pixel in usable[LEAST_POINTS - 1 :].tolist():
            image.validity[pixel] = HeightImage.LOW_CNR
        others = np.flatnonzero(np.array(image.validity) != HeightImage.OK)
        for pixel in others.tolist():
            image.validity[pixel] = HeightImage.LOW_CNR
    provenance.parameters = messages.with_stage([], "sar_compression", values)
    return image


REASONS = ["mounting from tf", "wrong provenance", "not adjusted", "few heights", "out of order"]


@pytest.mark.parametrize("reason", REASONS)
def test_heights_that_cannot_be_adjusted_are_passed_on_as_they_are(
    adjusting: Adjusting, flown: FlownHeights, reason: str
) -> None:
    """And counted, with a sentence; those after them are adjusted as if they had not come."""
    bad = spoilt(flown, reason)
    adjusting.fly(flown, [0, 1])
    passed = adjusting.feed(bad, [])
    assert same_heights(passed, bad) or reason == "few heights"
    assert passed.estimator == "adjusted"
    assert "pose_error" not in messages.stages_of(passed.provenance.parameters)["height_adjuster"]
    assert adjusting.stage.counted("ignored.") == {reason: 1}
    assert "passed on as they are" in adjusting.stage.last_rejection
    (after,) = adjusting.fly(flown, [2])
    assert same_heights(after, undisturbed(flown, 0, 1, 2)[2])


@cache
def undisturbed(flown: FlownHeights, *dwells: int) -> list[HeightImage]:
    """The adjusted images of a stage at which nothing else arrives."""
    return Adjusting(flown.sensor_info).fly(flown, dwells)


def test_an_image_of_a_strip_that_lies_nowhere_is_passed_on_as_it_is(flown: FlownHeights) -> None:
    """Autofocus has removed the phase of the first block, and not its own; the next one is adjusted."""
    adjusting = Adjusting(stripmap(flown.sensor))
    image, after = (copy.deepcopy(flown.images[number]) for number in (0, 1))
    after.provenance.autofocus_phase = [0.1]
    for one in (image, after):
        one.aperture.sliding = True
    passed = adjusting.feed(image, flown.odometry[0])
    assert same_heights(passed, image)
    assert adjusting.stage.counted("ignored.") == {"autofocus": 1}
    moved = adjusting.feed(after, flown.odometry[1])
    assert "pose_error" in messages.stages_of(moved.provenance.parameters)["height_adjuster"]


def test_a_bag_that_is_played_again_is_adjusted_from_its_first_dwell_on(
    adjusting: Adjusting, flown: FlownHeights
) -> None:
    """At once the platform is where the flight began: no odometry tells of the way there."""
    adjusting.fly(flown, [0, 1, 2])
    end_ns = messages.to_ns(flown.odometry[2][-1].header.stamp)
    shift_ns = end_ns + 1 - messages.to_ns(flown.odometry[0][0].header.stamp)
    image, odometry = copy.deepcopy((flown.images[0], flown.odometry[0]))
    for one in (image, *odometry):
        one.header.stamp = messages.to_stamp(messages.to_ns(one.header.stamp) + shift_ns)
    again = adjusting.feed(image, odometry)
    assert adjusting.stage.counted("ignored.") == {}
    assert "pose_error" in messages.stages_of(again.provenance.parameters)["height_adjuster"]


@pytest.mark.parametrize("length", [0.0, -1.0, math.nan, math.inf, 1e9])
def test_an_aperture_that_takes_no_time_or_too_long_is_refused(
    adjusting: Adjusting, flown: FlownHeights, length: float
) -> None:
    image = copy.deepcopy(flown.images[0])
    image.aperture.length = length
    adjusting.graph.publish("ml/height", image)
    adjusting.wait(lambda: adjusting.stage.counted("dropped.") == {"wrong geometry": 1}, "a drop")
    assert "aperture.length" in adjusting.stage.last_drop
    assert adjusting.fly(flown, [0])


@pytest.mark.parametrize("variance", [0.0, -1.0, 1e30, 1e308, math.nan, math.inf])
def test_absurd_covariances_do_no_harm(flown: FlownHeights, variance: float) -> None:
    """Heights come out with a finite sigma, and those of the next pass are adjusted to them."""
    adjusting = Adjusting(flown.sensor_info)
    odometry = [[copy.deepcopy(state) for state in part] for part in flown.odometry]
    for part in odometry:
        for state in part:
            state.pose.covariance = np.diag(np.full(6, variance)).ravel()
            state.twist.covariance = np.diag(np.full(6, variance)).ravel()
    images = [adjusting.feed(flown.images[number], odometry[number]) for number in (0, 1, 3, 4)]
    for field in fields_of(images):
        there = np.isfinite(field.first.height)
        assert np.count_nonzero(there) > 100
        assert np.all(np.isfinite(field.first.sigma[there]))
    assert not [reason for reason in adjusting.stage.counted("dropped.") if reason]


def test_an_error_within_begins_anew(
    adjusting: Adjusting, flown: FlownHeights, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The dwell is lost and counted; the next one is adjusted as the first of a flight."""
    adjusting.fly(flown, [0, 1])

    def fail(*_: object) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as broken:
        broken.setattr(AdjustmentWindow, "add", fail)
        adjusting.graph.publish("ml/height", flown.images[2])
        for state in flown.odometry[2]:
            adjusting.graph.publish("platform/odometry", state)
        adjusting.wait(lambda: sum(adjusting.stage.counted("dropped.").values()) == 1, "a drop")
    (after,) = adjusting.fly(flown, [3])
    assert same_heights(after, undisturbed(flown, 3)[0])


def test_heights_wait_for_odometry_and_for_their_sensor(flown: FlownHeights) -> None:
    adjusting, (first, *others) = Adjusting(None), flown.odometry[0]
    adjusting.graph.publish("ml/height", flown.images[0])
    adjusting.graph.publish("sensor_info", flown.sensor_info)
    adjusting.graph.publish("platform/odometry", first)
    assert not adjusting.heard("height")
    adjusting.graph.publish("platform/odometry", *others)
    assert len(adjusting.heard("height")) == 1
    assert adjusting.stage.counted("dropped.") == {}


def test_heights_without_odometry_are_given_up(flown: FlownHeights) -> None:
    adjusting = Adjusting(flown.sensor_info, timeout_s=0.2)
    adjusting.graph.publish("ml/height", flown.images[0])
    adjusting.wait(lambda: adjusting.stage.counted("dropped.") == {"odometry gap": 1}, "a drop")
    assert "platform/odometry must reach" in adjusting.stage.last_drop
    assert adjusting.feed(flown.images[1], [*flown.odometry[0], *flown.odometry[1]])


def test_odometry_that_goes_on_after_a_gap_does_not_keep_heights_waiting(flown: FlownHeights) -> None:
    adjusting = Adjusting(flown.sensor_info, timeout_s=0.2)
    adjusting.graph.publish("ml/height", flown.images[0])
    state = copy.deepcopy(flown.odometry[2][-1])

    def is_dropped() -> bool:
        state.header.stamp = messages.to_stamp(messages.to_ns(state.header.stamp) + 1_000_000)
        adjusting.graph.publish("platform/odometry", state)
        return bool(adjusting.stage.counted("dropped."))

    adjusting.wait(is_dropped, "a drop while odometry goes on")


def test_a_clock_that_begins_anew_begins_a_flight(adjusting: Adjusting, flown: FlownHeights) -> None:
    """The second flight is adjusted as the first one was; a gap of 120 s between passes does not begin one."""
    first = adjusting.fly(flown, [0, 1, 3, 4])
    assert not same_heights(first[2], flown.images[3])
    for part in (flown.odometry[0], flown.odometry[1]):
        for state in part:
            adjusting.graph.publish("platform/odometry", state)
    again = [adjusting.feed(flown.images[number], []) for number in (0, 1)]
    assert all(same_heights(one, other) for one, other in zip(again, first, strict=False))
    assert adjusting.stage.counted("ignored.").get("out of order", 0) == 0


def test_a_reset_begins_a_flight(adjusting: Adjusting, flown: FlownHeights) -> None:
    first = adjusting.fly(flown, [0, 3])
    adjusting.stage.forget()
    again = adjusting.fly(flown, [3])
    assert not same_heights(again[0], first[1])


@pytest.mark.parametrize("limit", [{"window_dwells": 1}, {"window_points": 1000}])
def test_the_window_is_as_long_as_wanted(flown: FlownHeights, limit: dict[str, int]) -> None:
    """Dwells of the third pass are compared with both before it, or with the second alone."""
    adjusting = Adjusting(flown.sensor_info, **limit)
    short, whole = adjusting.fly(flown, range(7)), undisturbed(flown, *range(7))
    assert same_heights(short[3], whole[3])
    assert not same_heights(short[6], whole[6])


def test_another_sensor_or_other_settings_begin_anew(adjusting: Adjusting, flown: FlownHeights) -> None:
    adjusting.fly(flown, [0, 3])
    adjusting.stage.set(correlation_s=50.0)
    (alone,) = adjusting.fly(flown, [4])
    assert not same_heights(alone, undisturbed(flown, 0, 3, 4)[2])
