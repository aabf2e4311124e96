"""Bad input: one clear reason, a count, and the next good dwell exactly as if nothing had happened."""

from __future__ import annotations

import copy
import functools
import math
from typing import Any

import numpy as np
import pytest
from chain_fixture import DETECTORS, START_NS, Chain, next_dwell_is_exact, same_heights
from helpers import publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height import messages
from sal_height.errors import Rejected
from sal_height.geometry import Motion, Trajectory
from sal_height.imaging import ImageSettings
from sal_height.messages import deserialize, serialize
from sal_height.messages.types import ChannelFrame, ComplexImage, HeightImage, Provenance
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.quality import FRAMES_QOS
from sal_height.pipeline import Compressor
from sal_height.simulation import SimulatedFlight


def truncated(frame: ChannelFrame) -> None:
    frame.samples = frame.samples[:-8]


def not_a_number(frame: ChannelFrame) -> None:
    np.frombuffer(frame.samples, np.float32)[17] = math.nan


def infinite(frame: ChannelFrame) -> None:
    np.frombuffer(frame.samples, np.float32)[0] = math.inf


def infinite_time(frame: ChannelFrame) -> None:
    frame.pulse_time[3] = math.inf


def backwards_in_time(frame: ChannelFrame) -> None:
    frame.pulse_time[3] = 0.0


def unknown_channel(frame: ChannelFrame) -> None:
    frame.channel = DETECTORS


def other_shape(frame: ChannelFrame) -> None:
    frame.pulse_count -= 1


def too_few_ranges(frame: ChannelFrame) -> None:
    frame.reference_range = frame.reference_range[:-1]


def endless(frame: ChannelFrame) -> None:
    frame.pulse_time[-1] = 1e300


def instantaneous(frame: ChannelFrame) -> None:
    frame.pulse_time = np.zeros_like(frame.pulse_time)


def touching(frame: ChannelFrame) -> None:
    frame.reference_range[4] = 0.0


def beyond(frame: ChannelFrame) -> None:
    frame.reference_range[4] = 1e300


@pytest.fixture(scope="module")
def good_frame(flight: SimulatedFlight) -> bytes:
    """A serialised frame of detector 3."""
    stamp = messages.to_stamp(START_NS)
    return serialize(messages.history_to_messages(flight.phase_history(0), flight.sensor, 0, stamp)[3])


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (truncated, "wrong size"),
        (not_a_number, "not finite"),
        (infinite, "not finite"),
        (infinite_time, "not finite"),
        (backwards_in_time, "wrong pulse times"),
        (unknown_channel, "unknown channel"),
        (other_shape, "contradicts sensor info"),
        (too_few_ranges, "wrong size"),
        (endless, "wrong pulse times"),
        (instantaneous, "wrong pulse times"),
        (touching, "wrong reference range"),
        (beyond, "wrong reference range"),
    ],
)
def test_a_bad_frame_is_rejected_with_its_reason(
    flight: SimulatedFlight, good_frame: bytes, spoil: Any, reason: str
) -> None:
    frame = copy.deepcopy(deserialize(good_frame, ChannelFrame))
    messages.check_frame(frame, flight.sensor)
    spoil(frame)
    with pytest.raises(Rejected) as error:
        messages.check_frame(frame, flight.sensor)
    assert error.value.reason == reason


@pytest.mark.parametrize(("spoil", "reason"), [(truncated, "wrong size"), (unknown_channel, "unknown channel")])
def test_a_bad_frame_costs_its_dwell_only(chain: Chain, reference: Any, spoil: Any, reason: str) -> None:
    frames = chain.frames(0)
    spoil(frames[3])
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    chain.await_drops("sar_compression", "incomplete dwell", DETECTORS - 1)
    assert chain.dropped("sar_compression") == {reason: 1, "incomplete dwell": DETECTORS - 1}
    next_dwell_is_exact(chain, reference)
    assert ("ml", 0) not in chain.heights


def test_frames_may_come_in_any_order(chain: Chain, reference: Any) -> None:
    frames = [frame for pair in zip(chain.frames(1)[::-1], chain.frames(0), strict=True) for frame in pair]
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.odometry(1), *frames)
    for dwell in (0, 1):
        chain.await_heights(dwell)
        assert same_heights(chain.heights["ml", dwell], reference["ml", dwell])


def test_a_duplicate_is_counted_and_the_dwell_is_exact(chain: Chain, reference: Any) -> None:
    frames = chain.frames(0)
    chain.publish(chain.sensor_info(), *chain.odometry(0), frames[0], *frames[:-1], frames[-1])
    chain.await_heights(0)
    assert same_heights(chain.heights["ml", 0], reference["ml", 0])
    assert chain.dropped("sar_compression") == {"duplicate": 1}
    chain.publish(frames[0])
    chain.await_drops("sar_compression", "late", 1)
    next_dwell_is_exact(chain, reference)


def test_missing_detectors_are_given_up_after_the_timeout(chain: Chain, reference: Any) -> None:
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0)[2:])
    chain.await_drops("sar_compression", "incomplete dwell", DETECTORS - 2)
    next_dwell_is_exact(chain, reference)


def test_dwells_that_never_become_complete_do_not_pile_up(chain: Chain, reference: Any) -> None:
    chain.publish(chain.sensor_info(), *chain.odometry(0))
    frame = chain.frames(0)[0]
    for number in range(100, 130):
        frame.dwell = number
        chain.publish(frame)
    chain.wait(lambda: sum(chain.dropped("sar_compression").values()) == 30, "30 frames to be dropped")
    next_dwell_is_exact(chain, reference)


def test_frames_before_their_sensor_info_wait_for_it(chain: Chain, reference: Any) -> None:
    chain.publish(*chain.odometry(0), *chain.frames(0))
    chain.wait(lambda: chain.accounts()["sar_compression"]["in"] == DETECTORS, "the frames")
    chain.publish(chain.sensor_info())
    chain.await_heights(0)
    assert same_heights(chain.heights["ml", 0], reference["ml", 0])


def test_without_sensor_info_frames_are_dropped(chain: Chain, reference: Any) -> None:
    chain.publish(*chain.odometry(0), *chain.frames(0))
    chain.await_drops("sar_compression", "no sensor info", DETECTORS)
    chain.publish(chain.sensor_info())
    next_dwell_is_exact(chain, reference)


def test_sensor_info_that_is_not_of_these_frames(chain: Chain, reference: Any) -> None:
    other = chain.sensor_info()
    other.waveform.wavelength *= 2
    other.config_hash = "another"
    chain.publish(other, *chain.odometry(0), *chain.frames(0))
    chain.await_drops("sar_compression", "contradicts sensor info", DETECTORS)
    chain.publish(chain.sensor_info())
    next_dwell_is_exact(chain, reference)


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


def test_useless_sensor_info_leaves_the_good_one_in_force(chain: Chain, reference: Any) -> None:
    useless = chain.sensor_info()
    useless.waveform.wavelength = math.nan
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    chain.publish(useless)
    for stage in chain.stages:
        chain.wait(lambda s=stage: chain.accounts()[s].get("ignored.sensor info") == 1, "the count")
    next_dwell_is_exact(chain, reference)


def test_odometry_that_ends_before_the_aperture(chain: Chain, reference: Any) -> None:
    start = messages.to_ns(chain.frames(0)[0].header.stamp)
    early = [message for message in chain.odometry(0) if messages.to_ns(message.header.stamp) <= start]
    assert early
    chain.publish(chain.sensor_info(), *early, *chain.frames(0))
    chain.await_drops("sar_compression", "odometry gap", DETECTORS)
    chain.publish(*chain.odometry(0))
    next_dwell_is_exact(chain, reference)


def test_odometry_with_nan_is_ignored(chain: Chain, reference: Any) -> None:
    odometry = chain.odometry(0)
    spoiled = deserialize(serialize(odometry[2]), type(odometry[2]))
    spoiled.pose.pose.position.x = math.nan
    turned = deserialize(serialize(odometry[2]), type(odometry[2]))
    turned.pose.pose.orientation.w = 0.0
    chain.publish(chain.sensor_info(), *odometry[:3], spoiled, turned, *odometry[3:], *chain.frames(0))
    chain.await_heights(0)
    assert chain.accounts()["sar_compression"]["ignored.odometry"] == 2
    assert same_heights(chain.heights["ml", 0], reference["ml", 0])


def test_odometry_with_an_unset_stamp_costs_no_other_sample(chain: Chain, reference: Any) -> None:
    unset = chain.odometry(0)[2]
    unset.header.stamp = messages.to_stamp(0)
    chain.publish(chain.sensor_info(), *chain.odometry(0)[:3], unset, *chain.odometry(0)[3:], *chain.frames(0))
    chain.await_heights(0)
    assert chain.accounts()["sar_compression"]["ignored.odometry out of time"] == 1
    assert same_heights(chain.heights["ml", 0], reference["ml", 0])


def test_detectors_that_disagree_on_pulse_times(chain: Chain, reference: Any) -> None:
    frames = chain.frames(0)
    frames[5].pulse_time[-1] += 1e-6
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    chain.await_drops("sar_compression", "channels disagree", DETECTORS)
    next_dwell_is_exact(chain, reference)


def test_a_sensor_that_starts_anew_is_processed_anew(chain: Chain, reference: Any) -> None:
    for _ in range(2):
        chain.heights.clear()
        chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
        chain.await_heights(0)
        assert same_heights(chain.heights["ml", 0], reference["ml", 0])


def test_bad_pixels_are_marked_as_missing(chain: Chain, graph: Graph) -> None:
    """An image from somebody else's compression, with a hole of one pixel in one detector."""
    images: list[ComplexImage] = []
    tap = graph.add(Node("tap", context=graph.context))
    subscribe(tap, ComplexImage, "slc", lambda image: images.append(copy.deepcopy(image)), 100)
    chain.wait(lambda: tap.count_publishers("slc") == 1, "discovery")
    chain.wait(lambda: chain.stages["sar_compression"]._outlets["slc"][0].subscribers == 3, "the tap")
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    chain.wait(lambda: len(images) == DETECTORS, "the images")
    before = np.array(chain.heights["ml", 0].validity)
    source = publisher_of(tap, ComplexImage, "slc", 100)
    chain.wait(lambda: source.get_subscription_count() == 3, "the estimators")
    chain.heights.clear()
    images[2].samples[2 * (5 * images[2].grid.cols + 7)] = math.nan
    for image in images[:DETECTORS]:
        image.dwell = 55
        source.publish(image)
    chain.await_heights(55)
    after = np.array(chain.heights["ml", 55].validity)
    changed = np.flatnonzero(before != after)
    assert changed.tolist() == [2 * chain.heights["ml", 55].grid.cols + 3]
    assert after[changed] == HeightImage.MISSING_DATA


def shortened(image: ComplexImage) -> None:
    image.samples = image.samples[:-2]


def of_nobody(image: ComplexImage) -> None:
    image.channel = 99


def of_unknown_noise(image: ComplexImage) -> None:
    image.noise_power = math.nan


@pytest.fixture(scope="module")
def good_image(flight: SimulatedFlight) -> bytes:
    """A serialised image of channel 0."""
    history, track = flight.phase_history(0), Trajectory(flight.platform_states(0))
    slc = Compressor().add(history, track, flight.sensor, ImageSettings(rows=46, cols=12))
    assert slc
    frame = messages.history_to_messages(history, flight.sensor, 0, messages.to_stamp(START_NS))[0]
    return serialize(messages.slc_to_messages(slc, frame, Provenance())[0])


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [(shortened, "wrong size"), (of_nobody, "unknown channel"), (of_unknown_noise, "not finite")],
)
def test_a_bad_image_is_rejected_with_its_reason(
    flight: SimulatedFlight, good_image: bytes, spoil: Any, reason: str
) -> None:
    image = copy.deepcopy(deserialize(good_image, ComplexImage))
    messages.check_slc(image, flight.sensor)
    spoil(image)
    with pytest.raises(Rejected) as error:
        messages.check_slc(image, flight.sensor)
    assert error.value.reason == reason


def test_bad_images_are_counted_by_the_estimators(chain: Chain, reference: Any, graph: Graph) -> None:
    """One image of a wrong size, and a dwell whose images do not share a grid."""
    heard: list[ComplexImage] = []
    tap = graph.add(Node("tap", context=graph.context))
    subscribe(tap, ComplexImage, "slc", lambda image: heard.append(copy.deepcopy(image)), 100)
    chain.wait(lambda: chain.stages["sar_compression"]._outlets["slc"][0].subscribers == 3, "the tap")
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    chain.wait(lambda: len(heard) == DETECTORS, "the images")
    source = publisher_of(tap, ComplexImage, "slc", 100)
    chain.wait(lambda: source.get_subscription_count() == 3, "the estimators")
    images = heard[:DETECTORS]
    images[0].grid.row_spacing *= 2
    for image in images:
        image.dwell = 55
        source.publish(image)
    expected = {"channels disagree": DETECTORS}
    for stage in ("monopulse", "ml_height"):
        chain.wait(lambda s=stage: chain.dropped(s) == expected, f"{expected} in {stage}")
    images[0].grid.row_spacing /= 2
    shortened(images[0])
    for image in images:
        image.dwell = 56
        source.publish(image)
    expected |= {"wrong size": 1, "incomplete dwell": DETECTORS - 1}
    for stage in ("monopulse", "ml_height"):
        chain.wait(lambda s=stage: chain.dropped(s) == expected, f"{expected} in {stage}")
    chain.publish(*chain.odometry(1), *chain.frames(1))
    chain.await_heights(1)
    assert same_heights(chain.heights["ml", 1], reference["ml", 1])


def test_frames_are_processed_with_their_own_sensor_info(chain: Chain, reference: Any) -> None:
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


def test_odometry_is_not_interpolated_over_a_gap(chain: Chain, reference: Any) -> None:
    far_before, far_after = chain.odometry(0)[0], chain.odometry(0)[-1]
    start = messages.to_ns(chain.frames(0)[0].header.stamp)
    for message, seconds in ((far_before, -5), (far_after, 5)):
        message.header.stamp = messages.to_stamp(start + seconds * 1_000_000_000)
        message.pose.pose.position.x = 50.0 * seconds
    chain.publish(chain.sensor_info(), far_before, far_after, *chain.frames(0))
    chain.await_drops("sar_compression", "odometry gap", DETECTORS)
    chain.publish(*chain.odometry(0))
    next_dwell_is_exact(chain, reference)


@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (0.0, 50.0, 0.0)], ids=["zero", "sideways"])
def test_odometry_whose_twist_is_not_its_motion_is_not_used(chain: Chain, turned: tuple[float, ...]) -> None:
    odometry = chain.odometry(0)
    for message in odometry:
        linear = message.twist.twist.linear
        linear.x, linear.y, linear.z = turned
    chain.publish(chain.sensor_info(), *odometry, *chain.frames(0))
    chain.await_drops("sar_compression", "cannot be processed", DETECTORS)
    assert not chain.heights


@pytest.mark.parametrize(("field", "name"), [("header", "odom"), ("child", "gps_antenna")])
def test_odometry_of_other_frames_is_ignored(chain: Chain, reference: Any, field: str, name: str) -> None:
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


def test_two_sources_of_one_channel_are_named(chain: Chain, graph: Graph, reference: Any) -> None:
    other = graph.add(Node("other_driver", context=graph.context))
    publisher = publisher_of(other, ChannelFrame, "phase_history", FRAMES_QOS)
    chain.wait(lambda: publisher.get_subscription_count() == 1, "the other driver")
    frames = chain.frames(0)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames[:4])
    chain.wait(lambda: chain.accounts()["sar_compression"]["in"] == 4, "the frames")
    publisher.publish(frames[2])
    chain.await_drops("sar_compression", "duplicate", 1)
    said = chain.stages["sar_compression"].last_drop
    assert "Dwell 0, channel 2: the same message was received twice." in said
    assert "2 nodes publish phase_history: each must have channels of its own." in said
    chain.publish(*frames[4:])
    next_dwell_is_exact(chain, reference)


@pytest.mark.parametrize("stamp_ns", [0, START_NS + 10 * 365 * 86_400 * 10**9], ids=["zero", "ten years ahead"])
def test_frames_of_another_clock_than_the_odometry_are_told(chain: Chain, reference: Any, stamp_ns: int) -> None:
    frames = chain.frames(0)
    for frame in frames:
        frame.header.stamp = messages.to_stamp(stamp_ns)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    chain.await_drops("sar_compression", "odometry gap", DETECTORS)
    assert "frames and odometry have different clocks" in chain.stages["sar_compression"].last_drop
    next_dwell_is_exact(chain, reference)


def test_a_clock_that_stands_still_or_is_not_there_changes_nothing(
    graph: Graph, flight: SimulatedFlight, reference: Any
) -> None:
    """Nodes take simulated time and nobody publishes /clock: dwells and timeouts go by stamps and a steady clock."""
    simulated = {"use_sim_time": True}
    chain = Chain(graph, flight, 0.5, image={"rows": 46, "cols": 12, **simulated}, heights=simulated)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0)[:3])
    chain.await_drops("sar_compression", "incomplete dwell", 3)
    next_dwell_is_exact(chain, reference)
    assert chain.stages["sar_compression"].get_clock().now().nanoseconds == 0


def test_frames_have_the_names_that_parameters_say(graph: Any, flight: Any, reference: Any) -> None:
    """From odometry to the map: products are placed in the frame of the odometry."""
    names = {"map_frame": "world", "body_frame": "aircraft"}
    chain = Chain(graph, flight, missing_after_s=30.0, image={"rows": 46, "cols": 12, **names})
    others = [Parameter("map_frame", value="world"), Parameter("estimator", value="ml")]
    followers = [
        graph.add(node(context=graph.context, parameter_overrides=others))
        for node in (PROCESSING["relief_tracker"], PROCESSING["relief_mapper"])
    ]
    odometry = chain.odometry(0)
    for message in odometry:
        message.header.frame_id, message.child_frame_id = "world", "aircraft"
    chain.wait(lambda: chain.stages["ml_height"].count_subscribers("ml/height") == 3, "the followers")
    chain.publish(chain.sensor_info(), *odometry, *chain.frames(0))
    chain.await_heights(0)
    made = chain.heights["ml", 0]
    assert made.header.frame_id == "world"
    assert same_heights(made, reference["ml", 0])
    chain.wait(lambda: all(node.tally.summary()["processed"] == 1 for node in followers), "tracker and mapper")


@pytest.mark.parametrize(
    ("field", "value"), [("pose.pose.position", 2e7), ("twist.twist.linear", 2e5), ("twist.twist.linear", 1e300)]
)
def test_odometry_of_no_platform_is_ignored(chain: Chain, reference: Any, field: str, value: float) -> None:
    message = chain.odometry(0)[0]
    functools.reduce(getattr, field.split("."), message).y = value
    chain.publish(chain.sensor_info(), message)
    chain.wait(lambda: chain.accounts()["sar_compression"].get("ignored.odometry") == 1, "the count")
    assert "1e+07 m from the origin and 100000 m/s" in chain.stages["sar_compression"].last_rejection
    chain.publish(*chain.odometry(0))
    next_dwell_is_exact(chain, reference)


GAP_SETTINGS = {"rows": 46, "cols": 12, "odometry_interval_s": 1e-3, "autofocus": "never"}


def test_heights_of_a_dwell_in_a_gap_of_the_odometry_state_what_the_gap_leaves_open(
    graph: Any, flight: Any, reference: Any
) -> None:
    """The platform flies straight on, so that heights stay; sigma grows by roll and height, which the pose tells."""
    chain = Chain(graph, flight, missing_after_s=30.0, image=GAP_SETTINGS)
    odometry = chain.odometry(0)
    ends = [odometry[0], odometry[-1]]
    chain.publish(chain.sensor_info(), *ends, *chain.frames(0))
    chain.await_heights(0)
    made, before = chain.heights["ml", 0], reference["ml", 0]
    gap_s = (messages.to_ns(ends[1].header.stamp) - messages.to_ns(ends[0].header.stamp)) * 1e-9
    grown = Motion(0.1, 0.01, 1e-3).covariance(gap_s / 2, gap_s / 2)
    covariances = [messages.aperture_from_message(image.aperture).covariance for image in (made, before)]
    said = covariances[0] - covariances[1]
    np.testing.assert_allclose(np.diag(said), np.diag(grown), rtol=0.05)
    height, sigma, usual = (
        np.array(getattr(image.surfaces[0], name))
        for image, name in ((made, "height"), (made, "sigma"), (before, "sigma"))
    )
    known = np.isfinite(height) & np.isfinite(usual)
    np.testing.assert_allclose(height[known], np.array(before.surfaces[0].height)[known], atol=0.002)
    assert (sigma[known] > usual[known]).all()
    assert chain.accounts()["sar_compression"]["odometry.bridged"] == 1


@pytest.mark.parametrize("noise", [[0.0] + [1.0] * 7, [0.0] * 8])
def test_noise_that_is_unknown_gives_no_heights(chain: Chain, noise: list[float]) -> None:
    info = chain.sensor_info()
    info.channels.noise_power = noise
    chain.publish(info, *chain.odometry(0), *chain.frames(0))
    for stage in ("monopulse", "ml_height"):
        chain.await_drops(stage, "cannot be processed", DETECTORS)


def silent(frame: ChannelFrame) -> None:
    frame.samples = messages.to_bytes(np.zeros(len(frame.samples), np.uint8))


def test_a_loud_and_a_dead_detector_leave_heights_of_the_others(chain: Chain) -> None:
    info, frames = chain.sensor_info(), chain.frames(0)
    info.channels.noise_power = [1.0, 900.0] + [1.0] * 6
    silent(frames[4])
    chain.publish(info, *chain.odometry(0), *frames)
    chain.await_heights(0)
    for estimator in ("monopulse", "ml"):
        image = chain.heights[estimator, 0]
        assert np.count_nonzero(np.isfinite(image.surfaces[0].height)) > 20
        stage = messages.stages_of(image.provenance.parameters)["ml_height" if estimator == "ml" else estimator]
        assert list(stage["channels_left_out"]) == [4]


def test_a_detector_that_sends_nothing_leaves_heights_of_the_others(graph: Graph, flight: Any) -> None:
    """As if it had sent zeros, which tells that no other channel takes its place."""
    chain = Chain(graph, flight, 0.5, {"rows": 46, "cols": 12, "missing_channels": "proceed"})
    frames = chain.frames(0)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames[:4], *frames[5:])
    chain.await_heights(0)
    without = dict(chain.heights)
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


def test_one_live_detector_is_not_enough(chain: Chain, reference: Any) -> None:
    frames = chain.frames(0)
    for frame in frames[1:]:
        silent(frame)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    for stage in ("monopulse", "ml_height"):
        chain.await_drops(stage, "dead detectors", DETECTORS)
    next_dwell_is_exact(chain, reference)
