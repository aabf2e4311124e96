"""Stage navigation and its node: odometry of poses and twists, or of satellite fixes and an inertial unit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence, publisher_of, refused
from instrument_messages import fix_at, imu_at, in_aviation_axes, pose_of, twist_of
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from stage_graph import StageGraph

from sal_height import messages
from sal_height.errors import UserError
from sal_height.geometry import Origin, PlatformState, Trajectory, rotation_matrix
from sal_height.messages.types import Header, Imu, NavSatFix, Odometry, PoseStamped, Twist, TwistStamped, Vector3
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import LATCHED_QOS, ODOMETRY_QOS
from sal_height.simulation.flight import SimulatedFlight

TIMEOUT_S = 120.0
ORIGIN_DEG = {"origin_latitude_deg": 48.1, "origin_longitude_deg": 11.3, "origin_height_m": 550.0}
ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 550.0)


TOPICS = {
    PoseStamped: "platform/pose",
    TwistStamped: "platform/twist",
    NavSatFix: "platform/fix",
    Imu: "platform/imu",
}


class Instruments:
    """Stage navigation, fed with what instruments measure, and the odometry that it makes."""

    def __init__(self, **parameters: Any) -> None:
        self.graph = StageGraph()
        self.stage = self.graph.add("navigation", **parameters)

    def send(self, *sent: Any) -> None:
        for message in sent:
            self.graph.publish(TOPICS[type(message)], message)

    @property
    def odometry(self) -> list[Odometry]:
        return self.graph.heard["platform/odometry"]

    def states(self) -> list[PlatformState]:
        return [messages.state_from_message(message) for message in self.odometry]

    def assert_ignored(self, reason: str, said: str) -> None:
        assert reason in self.stage.counted("ignored.")
        assert said in self.stage.last_rejection


@pytest.mark.parametrize("frame", ["map", "base_link"])
def test_poses_and_twists_are_the_odometry_that_they_were_made_of(frame: str, flight: SimulatedFlight) -> None:
    sent = [replace(state, stamp_ns=state.stamp_ns + 10**12) for state in flight.platform_states(0)]
    instruments = Instruments()
    for state in sent:
        instruments.send(twist_of(state, frame), pose_of(state))
    made = instruments.states()
    assert len(sent) == 5
    for one, other in zip(made, sent, strict=True):
        assert one.stamp_ns == other.stamp_ns
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_allclose(one.orientation, other.orientation, rtol=0, atol=1e-15)
        np.testing.assert_allclose(one.velocity, other.velocity, rtol=0, atol=1e-13)


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE])
def test_the_node_receives_instruments_of_either_quality_of_service(
    reliability: ReliabilityPolicy, graph: Graph, flight: SimulatedFlight
) -> None:
    source = graph.add(Node("instruments", context=graph.context))
    node = graph.add(PROCESSING["navigation"](context=graph.context))
    odometry: list[Odometry] = []
    subscribe(source, Odometry, "platform/odometry", odometry.append, ODOMETRY_QOS)
    qos = QoSProfile(depth=1000, reliability=reliability)
    twists, poses = (publisher_of(source, kind, TOPICS[kind], qos) for kind in (TwistStamped, PoseStamped))
    assert graph.spin_until(
        lambda: (
            twists.get_subscription_count() == poses.get_subscription_count() == 1
            and source.count_publishers("platform/odometry") == 1
            and node.is_ready
        ),
        TIMEOUT_S,
    )
    sent = flight.platform_states(0)
    for state in sent:
        twists.publish(twist_of(state, "map"))
        poses.publish(pose_of(state))
    assert graph.spin_until(lambda: len(odometry) == len(sent), TIMEOUT_S), node.last_rejection


ELLIPSOID = {**ORIGIN_DEG, "altitude_above": "ellipsoid"}


def test_altitudes_above_the_geoid_are_raised_and_those_above_an_unknown_level_are_uncertain() -> None:
    """The fixes state 3 m of standard deviation."""
    made = {}
    settings: dict[str, dict[str, Any]] = {
        "ellipsoid": ELLIPSOID,
        "geoid": {**ORIGIN_DEG, "altitude_above": "geoid", "geoid_height_m": 47.0},
        "unknown": ORIGIN_DEG,
    }
    for name, parameters in settings.items():
        instruments = Instruments(position="fix", velocity="positions", **parameters)
        for tenth in range(6):
            instruments.send(fix_at(0.1 * tenth, 48.1 + 1e-5 * tenth), imu_at(0.1 * tenth + 0.02))
        made[name] = instruments.states()[0], instruments.stage.summary()
    up = {name: state.position[2] - made["ellipsoid"][0].position[2] for name, (state, _) in made.items()}
    assert up["geoid"] == pytest.approx(47.0, abs=1e-3)
    assert up["unknown"] == 0
    assert [made[name][0].covariance[2, 2] for name in made] == [9.0, 9.0, 909.0]
    assert [name for name in made if "altitude above an unknown level" in made[name][1]] == ["unknown"]


def test_a_geoid_of_unknown_height_is_refused() -> None:
    with refused(UserError, "geoid_height_m"):
        Instruments(position="fix", altitude_above="geoid", **ORIGIN_DEG)


@pytest.mark.parametrize("above", ["unknown", "ellipsoid"])
def test_a_height_of_the_geoid_is_refused_where_altitudes_are_not_above_it(above: str) -> None:
    """Whoever states it means that they are."""
    with refused(UserError, "altitude_above: geoid"):
        Instruments(position="fix", altitude_above=above, geoid_height_m=47.0, **ORIGIN_DEG)


def test_fixes_and_attitudes_become_odometry_in_a_map_on_the_earth() -> None:
    """The platform flies north at a constant rate of latitude: 1e-5 degrees in 0.1 s are 11.1 m/s."""
    instruments = Instruments(position="fix", velocity="positions", **ELLIPSOID)
    for tenth in range(6):
        instruments.send(fix_at(0.1 * tenth, 48.1 + 1e-5 * tenth))
        instruments.send(*(imu_at(0.1 * tenth + 0.02 * step) for step in range(1, 5)))
    made = instruments.states()
    assert len(made) == 4 * 3, "between the second fix and the last but one"
    latitudes = [48.1 + 1e-4 * (state.stamp_ns * 1e-9 - 1000) for state in made]
    for state, latitude in zip(made, latitudes, strict=True):
        place = ORIGIN.to_map(math.radians(latitude), math.radians(11.3), 3000.0)
        np.testing.assert_allclose(state.position, place, rtol=0, atol=1e-6)
        np.testing.assert_allclose(state.velocity, [0.0, 11.12, 0.0], rtol=0, atol=0.01)
        assert state.covariance[2, 2] == 9.0
    assert "no velocity" in instruments.stage.counted("ignored.")  # at the first fix there is none


@pytest.mark.parametrize("number", [0.0, -1.0, math.nan, 1e-12, 1e6])
def test_what_instruments_do_not_state_is_unknown_of_the_odometry(number: float) -> None:
    """Also a covariance of the type UNKNOWN, whatever it is; the velocity is known of neither."""
    for of_type in (NavSatFix.COVARIANCE_TYPE_UNKNOWN, NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN):
        instruments = Instruments(position="fix", velocity="positions", **ELLIPSOID)
        for tenth in range(6):
            fix, imu = fix_at(0.1 * tenth, 48.1 + 1e-5 * tenth), imu_at(0.1 * tenth + 0.02)
            fix.position_covariance_type = of_type
            imu.orientation_covariance = np.diag([abs(number), 0.0 if number < 0 else number, number]).ravel()
            if of_type == NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN:
                fix.position_covariance = np.diag([number] * 3).ravel()
            instruments.send(fix, imu)
        track = Trajectory(instruments.states())
        assert np.all(track.assumed(track.states[0].stamp_ns, np.array([0.0, 0.01])).of_samples > 0)


@pytest.mark.parametrize("frame", ["map", "base_link"])
def test_poses_and_twists_in_axes_of_aviation_become_odometry_in_those_of_ros(
    frame: str, flight: SimulatedFlight
) -> None:
    sent = [replace(state, stamp_ns=state.stamp_ns + 10**12) for state in flight.platform_states(0)]
    instruments = Instruments(map_axes="ned", body_axes="frd")
    for state in sent:
        down = in_aviation_axes(state)
        instruments.send(twist_of(down, frame), pose_of(down))
    for one, other in zip(instruments.states(), sent, strict=True):
        np.testing.assert_array_equal(one.position, other.position)
        turn = rotation_matrix(one.orientation).T @ rotation_matrix(other.orientation)
        np.testing.assert_allclose(turn, np.eye(3), rtol=0, atol=1e-14)
        np.testing.assert_allclose(one.velocity, other.velocity, rtol=0, atol=1e-12)


def test_an_attitude_against_north_east_and_down_is_that_against_east_north_and_up() -> None:
    """At rest in NED and FRD, the platform looks north, level: in ROS its yaw is a quarter turn to the left."""
    instruments = Instruments(position="fix", velocity="twist", map_axes="ned", body_axes="frd", **ORIGIN_DEG)
    stamp = fix_at(1.0, 48.1).header.stamp
    twist = TwistStamped(header=Header(stamp=stamp, frame_id="map"), twist=Twist(linear=Vector3(x=50.0, z=-2.0)))
    instruments.send(twist, fix_at(1.0, 48.1), imu_at(1.0))
    (state,) = instruments.states()
    np.testing.assert_allclose(state.velocity, [0, 50.0, 2.0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(rotation_matrix(state.orientation) @ [1, 0, 0], [0, 1, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(rotation_matrix(state.orientation) @ [0, 0, 1], [0, 0, 1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("parameters", [{"position": "fix", "velocity": "positions"}, {}], ids=["fix", "pose"])
def test_the_origin_of_the_map_is_published_for_those_who_come_late(graph: Graph, parameters: dict[str, str]) -> None:
    overrides = [Parameter(name, value=value) for name, value in {**parameters, **ORIGIN_DEG}.items()]
    graph.add(PROCESSING["navigation"](context=graph.context, parameter_overrides=overrides))
    heard: list[NavSatFix] = []
    late = graph.add(Node("late", context=graph.context))
    subscribe(late, NavSatFix, "map_origin", heard.append, LATCHED_QOS)
    assert graph.spin_until(lambda: bool(heard), TIMEOUT_S)
    found = messages.read_origin(heard[0], "map")
    assert (found.latitude, found.longitude, found.height) == pytest.approx((ORIGIN.latitude, ORIGIN.longitude, 550.0))


def test_fixes_without_an_origin_are_refused_at_the_start() -> None:
    """A map at latitude and longitude 0 is not what anybody wants."""
    with pytest.raises(UserError) as refused:
        Instruments(position="fix")
    assert_one_sentence(str(refused.value), "must know where on the earth", "set origin_latitude_deg")


@pytest.mark.parametrize(
    ("message", "reason", "said"),
    [
        (fix_at(0.0, 48.1, status=-1), "no satellite fix", "has no fix"),
        (fix_at(0.0, float("nan")), "not finite", "NavSatFix has NaN"),
        (fix_at(0.0, 148.1), "no satellite fix", "from -90 to 90"),
        (fix_at(0.0, 0.0, 0.0), "far from the origin", "set origin_latitude_deg"),
        (imu_at(0.0, frame="imu_link"), "wrong frames", "must be 'base_link'"),
        (imu_at(0.0, x=0.5), "no rotation", "norm 1"),
    ],
)
def test_what_cannot_be_used_is_counted_and_the_next_is_used(message: Any, reason: str, said: str) -> None:
    instruments = Instruments(position="fix", velocity="twist", **ORIGIN_DEG)
    instruments.send(message)
    instruments.assert_ignored(reason, said)
    stamp = fix_at(1.0, 48.1).header.stamp
    twist = TwistStamped(header=Header(stamp=stamp, frame_id="map"), twist=Twist(linear=Vector3(x=50.0)))
    instruments.send(twist, fix_at(1.0, 48.1), imu_at(1.0))
    (state,) = instruments.states()
    np.testing.assert_allclose(state.position, [0, 0, 2450.0], atol=1e-6)


def test_frames_have_the_names_that_parameters_say(flight: SimulatedFlight) -> None:
    state = flight.platform_states(0)[-1]
    instruments = Instruments(map_frame="odom", body_frame="aircraft")
    instruments.send(twist_of(state, "map"))
    instruments.assert_ignored("wrong frames", "'odom' or 'aircraft'")
    twist = twist_of(state, "map")
    twist.header.frame_id = "odom"
    instruments.send(twist, pose_of(state, "odom"))
    (made,) = instruments.odometry
    assert (made.header.frame_id, made.child_frame_id) == ("odom", "aircraft")
    assert made.pose.pose.position.x == state.position[0]


def test_two_sources_are_told_from_one(flight: SimulatedFlight) -> None:
    first, *_, last = flight.platform_states(0)
    instruments = Instruments()
    instruments.send(pose_of(last), pose_of(first))
    instruments.assert_ignored("late position", "Do two sources publish?")
