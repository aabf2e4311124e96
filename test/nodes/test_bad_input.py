"""Bad input: one clear reason, a count, and the next good dwell exactly as if nothing had happened."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from chain_fixture import DETECTORS, START_NS, StageChain, heights_of_messages, next_dwell_is_exact, same_heights

from sal_height import messages
from sal_height.engine.frame_items import check_frame
from sal_height.errors import Rejected
from sal_height.geometry import Motion
from sal_height.imaging import ImageSettings
from sal_height.messages import deserialize, serialize
from sal_height.messages.frames import frame_of
from sal_height.messages.types import ChannelFrame, ComplexImage, HeightImage, Provenance
from sal_height.pipeline import Compressor
from sal_height.simulation import SimulatedFlight


def at(values: Any, place: int, value: float) -> Any:
    """A copy of an array, or of the bytes of one of float32, with another value at a place."""
    changed = np.array(values)
    numbers = changed.view(np.float32) if changed.dtype == np.uint8 else changed
    numbers[place] = value
    return changed


FRAMES: Mapping[str, tuple[str, Callable[[Any], Any], str]] = {
    "truncated": ("samples", lambda samples: samples[:-8], "wrong size"),
    "not a number": ("samples", lambda samples: at(samples, 17, math.nan), "not finite"),
    "infinite": ("samples", lambda samples: at(samples, 0, math.inf), "not finite"),
    "infinite time": ("pulse_time", lambda times: at(times, 3, math.inf), "not finite"),
    "backwards in time": ("pulse_time", lambda times: at(times, 3, 0.0), "wrong pulse times"),
    "unknown channel": ("channel", lambda _: DETECTORS, "unknown channel"),
    "other shape": ("pulse_count", lambda count: count - 1, "contradicts sensor info"),
    "too few ranges": ("reference_range", lambda ranges: ranges[:-1], "wrong size"),
    "endless": ("pulse_time", lambda times: at(times, -1, 1e300), "wrong pulse times"),
    "instantaneous": ("pulse_time", np.zeros_like, "wrong pulse times"),
    "touching": ("reference_range", lambda ranges: at(ranges, 4, 0.0), "wrong reference range"),
    "beyond": ("reference_range", lambda ranges: at(ranges, 4, 1e300), "wrong reference range"),
}
"""Of a bad frame its field, what is done to it, and the reason for which it is refused."""

IMAGES: Mapping[str, tuple[str, Callable[[Any], Any], str]] = {
    "shortened": ("samples", lambda samples: samples[:-2], "wrong size"),
    "of nobody": ("channel", lambda _: 99, "unknown channel"),
    "of unknown noise": ("noise_power", lambda _: math.nan, "not finite"),
}
"""The same of a bad image."""


@pytest.fixture
def chain(flight: SimulatedFlight) -> StageChain:
    """A chain that drops what misses something after 0.5 s."""
    return StageChain(flight)


@pytest.fixture(scope="module")
def good_frame(flight: SimulatedFlight) -> bytes:
    """A serialised frame of detector 3."""
    stamp = messages.to_stamp(START_NS)
    return serialize(messages.history_to_messages(flight.phase_history(0), flight.sensor, 0, stamp)[3])


@pytest.fixture(scope="module")
def good_image(flight: SimulatedFlight) -> bytes:
    """A serialised image of channel 0."""
    history, track = flight.phase_history(0), flight.track(0)
    slc = Compressor().add(history, track, flight.sensor, ImageSettings(air="none", rows=46, cols=12))
    assert slc
    frame = messages.history_to_messages(history, flight.sensor, 0, messages.to_stamp(START_NS))[0]
    return serialize(messages.slc_to_messages(slc, frame, Provenance())[0])


@pytest.mark.parametrize("name", [*FRAMES, *IMAGES])
def test_a_bad_frame_or_image_is_rejected_with_its_reason(
    flight: SimulatedFlight, good_frame: bytes, good_image: bytes, name: str
) -> None:
    is_frame = name in FRAMES
    message = deserialize(good_frame, ChannelFrame) if is_frame else deserialize(good_image, ComplexImage)

    def check() -> None:
        if is_frame:
            check_frame(frame_of(message), flight.sensor)
        else:
            messages.check_slc(message, flight.sensor)

    check()
    field, spoil, reason = FRAMES[name] if is_frame else IMAGES[name]
    setattr(message, field, spoil(getattr(message, field)))
    with pytest.raises(Rejected) as error:
        check()
    assert error.value.reason == reason


@pytest.mark.parametrize("name", ["truncated", "unknown channel"])
def test_a_bad_frame_costs_its_dwell_only(chain: StageChain, reference: Any, name: str) -> None:
    frames = chain.frames(0)
    field, spoil, reason = FRAMES[name]
    setattr(frames[3], field, spoil(getattr(frames[3], field)))
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    chain.await_drops("sar_compression", "incomplete dwell", DETECTORS - 1)
    assert chain.dropped("sar_compression") == {reason: 1, "incomplete dwell": DETECTORS - 1}
    next_dwell_is_exact(chain, reference)
    assert ("ml", 0) not in chain.heights


@pytest.mark.parametrize(
    "field",
    [
        "waveform.wavelength",
        "waveform.bandwidth",
        "beams.elevation_diameter",
        "beams.azimuth_diameter",
        "pulse_repetition_frequency",
    ],
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_sensor_info_with_an_impossible_value_is_refused(field: str, value: float, flight: Any) -> None:
    message = messages.sensor_to_message(flight.sensor, messages.to_stamp(0))
    *part, name = field.split(".")
    setattr(getattr(message, part[0]) if part else message, name, value)
    with pytest.raises(ValueError, match=name):
        messages.sensor_from_message(message)


def test_useless_sensor_info_leaves_the_good_one_in_force(chain: StageChain, reference: Any) -> None:
    useless = chain.sensor_info()
    useless.waveform.wavelength = math.nan
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    chain.publish(useless)
    for stage in chain.stages:
        chain.wait(lambda s=stage: chain.accounts()[s].get("ignored.sensor info") == 1, "the count")
    next_dwell_is_exact(chain, reference)


def test_odometry_with_nan_is_ignored(chain: StageChain, reference: Any) -> None:
    odometry = chain.odometry(0)
    spoiled = deserialize(serialize(odometry[2]), type(odometry[2]))
    spoiled.pose.pose.position.x = math.nan
    turned = deserialize(serialize(odometry[2]), type(odometry[2]))
    turned.pose.pose.orientation.w = 0.0
    chain.publish(chain.sensor_info(), *odometry[:3], spoiled, turned, *odometry[3:], *chain.frames(0))
    chain.await_heights(0)
    assert chain.accounts()["sar_compression"]["ignored.odometry"] == 2
    assert same_heights(chain.heights["ml", 0], reference["ml", 0])


def test_detectors_that_disagree_on_pulse_times(chain: StageChain, reference: Any) -> None:
    frames = chain.frames(0)
    frames[5].pulse_time[-1] += 1e-6
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    chain.await_drops("sar_compression", "channels disagree", DETECTORS)
    next_dwell_is_exact(chain, reference)


def test_a_sensor_that_starts_anew_is_processed_anew(chain: StageChain, reference: Any) -> None:
    for _ in range(2):
        chain.heights.clear()
        chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
        chain.await_heights(0)
        assert same_heights(chain.heights["ml", 0], reference["ml", 0])


def images_of_dwell(chain: StageChain) -> list[ComplexImage]:
    """The images of dwell 0, to be spoilt and published as those of somebody else's compression."""
    chain.fly()
    return chain.graph.heard["slc"][:DETECTORS]


def test_bad_pixels_are_marked_as_missing(chain: StageChain) -> None:
    """A hole of one pixel in one detector."""
    images = images_of_dwell(chain)
    before = np.array(chain.heights["ml", 0].validity)
    images[2].samples = np.array(images[2].samples)
    images[2].samples[2 * (5 * images[2].grid.cols + 7)] = math.nan
    publish_as(chain, images, 55)
    chain.await_heights(55)
    after = np.array(chain.heights["ml", 55].validity)
    changed = np.flatnonzero(before != after)
    assert changed.tolist() == [2 * chain.heights["ml", 55].grid.cols + 3]
    assert after[changed] == HeightImage.MISSING_DATA


def publish_as(chain: StageChain, images: list[ComplexImage], dwell: int) -> None:
    """Publish images as those of another dwell."""
    for image in images:
        image.dwell = dwell
        chain.graph.publish("slc", image)


def test_bad_images_are_counted_by_the_estimators(chain: StageChain, reference: Any) -> None:
    """A dwell whose images do not share a grid, and one image of a wrong size."""
    images = images_of_dwell(chain)
    images[0].grid.row_spacing *= 2
    publish_as(chain, images, 55)
    expected = {"channels disagree": DETECTORS}
    assert [chain.dropped(stage) for stage in ("monopulse", "ml_height")] == 2 * [expected]
    images[0].grid.row_spacing /= 2
    images[0].samples = images[0].samples[:-2]
    publish_as(chain, images, 56)
    expected |= {"wrong size": 1, "incomplete dwell": DETECTORS - 1}
    for stage in ("monopulse", "ml_height"):
        chain.wait(lambda s=stage: chain.dropped(s) == expected, f"{expected} in {stage}")
    chain.publish(*chain.odometry(1), *chain.frames(1))
    assert same_heights(chain.heights["ml", 1], reference["ml", 1])


def test_frames_are_processed_with_their_own_sensor_info(chain: StageChain, reference: Any) -> None:
    """Another description comes while a dwell still waits for its odometry, and while its images are on their way."""
    other = chain.sensor_info()
    other.beams.elevation_boresights = [angle + 2e-4 for angle in other.beams.elevation_boresights]
    other.config_hash = "another"
    chain.publish(chain.sensor_info(), *chain.frames(0))
    chain.wait(lambda: chain.accounts()["sar_compression"]["in"] == DETECTORS, "the frames")
    chain.publish(other, *chain.odometry(0))
    chain.await_heights(0)
    assert same_heights(chain.heights["ml", 0], reference["ml", 0])
    assert chain.heights["ml", 0].provenance.config_hash == chain.flight.sensor.config_hash
    next_dwell_is_exact(chain, reference)


@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (0.0, 50.0, 0.0)], ids=["zero", "sideways"])
def test_odometry_whose_twist_is_not_its_motion_is_not_used(chain: StageChain, turned: tuple[float, ...]) -> None:
    odometry = chain.odometry(0)
    for message in odometry:
        linear = message.twist.twist.linear
        linear.x, linear.y, linear.z = turned
    chain.publish(chain.sensor_info(), *odometry, *chain.frames(0))
    chain.await_drops("sar_compression", "cannot be processed", DETECTORS)
    assert not chain.heights


@pytest.mark.parametrize(("field", "name"), [("header", "odom"), ("child", "gps_antenna")])
def test_odometry_of_other_frames_is_ignored(chain: StageChain, reference: Any, field: str, name: str) -> None:
    odometry = chain.odometry(0)
    for message in odometry:
        if field == "header":
            message.header.frame_id = name
        else:
            message.child_frame_id = name
    chain.publish(chain.sensor_info(), *odometry)
    chain.wait(lambda: chain.accounts()["sar_compression"].get("ignored.odometry") == len(odometry), "the count")
    chain.publish(*chain.odometry(0))
    next_dwell_is_exact(chain, reference)


def test_frames_have_the_names_that_parameters_say(flight: Any, reference: Any) -> None:
    """From odometry to the map: products are placed in the frame of the odometry."""
    names = {"map_frame": "world", "body_frame": "aircraft"}
    chain = StageChain(flight, image={"rows": 46, "cols": 12, **names})
    followers = [chain.graph.add(name, map_frame="world") for name in ("relief_tracker", "relief_mapper")]
    odometry = chain.odometry(0)
    for message in odometry:
        message.header.frame_id, message.child_frame_id = "world", "aircraft"
    chain.publish(chain.sensor_info(), *odometry, *chain.frames(0))
    made = chain.heights["ml", 0]
    assert made.header.frame_id == "world"
    assert same_heights(made, reference["ml", 0])
    assert [node.summary()["processed"] for node in followers] == [1, 1]


@pytest.mark.parametrize(
    ("field", "value"), [("pose.pose.position", 2e7), ("twist.twist.linear", 2e5), ("twist.twist.linear", 1e300)]
)
def test_odometry_of_no_platform_is_ignored(chain: StageChain, reference: Any, field: str, value: float) -> None:
    message = chain.odometry(0)[0]
    functools.reduce(getattr, field.split("."), message).y = value
    chain.publish(chain.sensor_info(), message)
    chain.wait(lambda: chain.accounts()["sar_compression"].get("ignored.odometry") == 1, "the count")
    assert "1e+07 m from the origin and 100000 m/s" in chain.stages["sar_compression"].last_rejection
    chain.publish(*chain.odometry(0))
    next_dwell_is_exact(chain, reference)


GAP_SETTINGS = {"rows": 46, "cols": 12, "odometry_interval_s": 1e-3}


def test_heights_of_a_dwell_in_a_gap_of_the_odometry_state_what_the_gap_leaves_open(
    flight: Any, reference: Any
) -> None:
    """The platform flies straight on, so that heights stay; sigma grows by roll and height, which the pose tells."""
    chain = StageChain(flight, image=GAP_SETTINGS)
    odometry = chain.odometry(0)
    ends = [odometry[0], odometry[-1]]
    chain.publish(chain.sensor_info(), *ends, *chain.frames(0))
    chain.await_heights(0)
    made, before = chain.heights["ml", 0], reference["ml", 0]
    gap_s = (messages.to_ns(ends[1].header.stamp) - messages.to_ns(ends[0].header.stamp)) * 1e-9
    grown = Motion(0.1, 0.01, 1e-3).variances(gap_s / 2, gap_s / 2)
    covariances = [messages.aperture_from_message(image.aperture).covariance for image in (made, before)]
    said = np.diag(covariances[0] - covariances[1])
    np.testing.assert_allclose(said[1:], grown[1:6], rtol=0.05)
    # Eastwards, along the flight, the error of the velocity moves the image, too.
    preset = flight.preset.flight
    moved = grown[6] * (preset.slant_range_m / preset.speed_mps) ** 2
    # The pointing of this flight leaves many multiples of the Doppler's ambiguity open, the same ones without the gap.
    unsure = covariances[1][0, 0]
    np.testing.assert_allclose(said[0], grown[0] + moved, rtol=0.02, atol=1e-5 * unsure)
    height, sigma, usual = (
        np.array(getattr(image.surfaces[0], name))
        for image, name in ((made, "height"), (made, "sigma"), (before, "sigma"))
    )
    known = np.isfinite(height) & np.isfinite(usual)
    np.testing.assert_allclose(height[known], np.array(before.surfaces[0].height)[known], atol=0.002)
    assert (sigma[known] > usual[known]).all()
    assert chain.accounts()["sar_compression"]["odometry.bridged"] == 1


@pytest.mark.parametrize("noise", [[0.0] + [1.0] * 7, [0.0] * 8])
def test_noise_that_is_unknown_gives_no_heights(chain: StageChain, noise: list[float]) -> None:
    info = chain.sensor_info()
    info.channels.noise_power = noise
    chain.publish(info, *chain.odometry(0), *chain.frames(0))
    for stage in ("monopulse", "ml_height"):
        chain.await_drops(stage, "cannot be processed", DETECTORS)


def silent(frame: ChannelFrame) -> None:
    frame.samples = messages.to_bytes(np.zeros(len(frame.samples), np.uint8))


def left_out_of(image: HeightImage) -> list[int]:
    """Channels that an estimator has left out."""
    node = "ml_height" if image.estimator == "ml" else image.estimator
    return list(messages.stages_of(image.provenance.parameters)[node]["channels_left_out"])


def test_a_loud_and_a_dead_detector_leave_heights_of_the_others(chain: StageChain) -> None:
    info, frames = chain.sensor_info(), chain.frames(0)
    info.channels.noise_power = [1.0, 900.0] + [1.0] * 6
    silent(frames[4])
    chain.publish(info, *chain.odometry(0), *frames)
    chain.await_heights(0)
    for estimator in ("monopulse", "ml"):
        image = chain.heights[estimator, 0]
        assert np.count_nonzero(np.isfinite(image.surfaces[0].height)) > 20
        assert left_out_of(image) == [4]


def test_a_detector_that_sends_nothing_leaves_heights_of_the_others(flight: Any) -> None:
    """As if it had sent zeros, which tells that no other channel takes its place."""
    chain = StageChain(flight, image={"rows": 46, "cols": 12, "missing_channels": "proceed"})
    frames = chain.frames(0)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames[:4], *frames[5:])
    chain.await_heights(0)
    without, of_messages = dict(chain.heights), heights_of_messages(chain)
    assert same_heights(of_messages, without["ml", 0])
    assert left_out_of(of_messages) == left_out_of(without["ml", 0]) == [4]
    chain.heights.clear()
    for frame in frames:
        frame.dwell = 7
    silent(frames[4])
    chain.publish(*frames)
    chain.await_heights(7)
    for estimator in ("monopulse", "ml"):
        assert same_heights(chain.heights[estimator, 7], without[estimator, 0])
        assert np.count_nonzero(np.isfinite(without[estimator, 0].surfaces[0].height)) > 20
        assert "channels_left_out" in str(without[estimator, 0].provenance.parameters)
    assert chain.accounts()["sar_compression"]["ignored.missing channels"] == 1


def test_one_live_detector_is_not_enough(chain: StageChain, reference: Any) -> None:
    frames = chain.frames(0)
    for frame in frames[1:]:
        silent(frame)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    for stage in ("monopulse", "ml_height"):
        chain.await_drops(stage, "dead detectors", DETECTORS)
    next_dwell_is_exact(chain, reference)
