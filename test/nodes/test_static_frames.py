"""The sensor's place on the platform comes from /tf_static, through whatever frames lie between."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from chain_fixture import DETECTORS, START_NS, Chain, same_heights
from helpers import publisher_of
from rclpy.node import Node
from rclpy.parameter import Parameter
from scipy.spatial.transform import Rotation

from sal_height import messages
from sal_height.engine import static_frames
from sal_height.engine.static_frames import StaticFrames, StaticTransform
from sal_height.errors import UserError
from sal_height.geometry import Mounting
from sal_height.messages.kinds import read_transforms
from sal_height.messages.types import HeightImage, Quaternion, TFMessage, TransformStamped, Vector3
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transforms import TF_STATIC_QOS, has_transforms
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph

IMAGE = {"rows": 46, "cols": 12}
NEEDS_TF2 = "tf2_msgs is not on PyPI; a ROS installation has it"


def transform(
    parent: str, child: str, shift: tuple[float, float, float] = (0.0, 0.0, 0.0), turn: Rotation | None = None
) -> TransformStamped:
    made = TransformStamped(child_frame_id=child)
    made.header.frame_id = parent
    made.transform.translation = Vector3(**dict(zip("xyz", shift, strict=True)))
    turn = turn or Rotation.identity()
    made.transform.rotation = Quaternion(**dict(zip("xyzw", turn.as_quat().tolist(), strict=True)))
    return made


def frames_of(*transforms: TransformStamped) -> StaticFrames:
    frames = StaticFrames()
    for one in transforms:
        frames.add(read(one))
    return frames


def read(transform: TransformStamped) -> StaticTransform:
    """What the stage is given of a transform in a message."""
    (found,) = read_transforms(messages.serialize(TFMessage(transforms=[transform])))
    return found


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
def test_what_is_no_transform_is_refused(bad: TransformStamped, words: str) -> None:
    with pytest.raises(UserError, match=words):
        StaticFrames().add(read(bad))


@pytest.mark.parametrize("w", [0.0, 0.98, 1.02, math.nan])
def test_a_rotation_must_be_a_unit_quaternion(w: float) -> None:
    bad = transform("base_link", "sensor")
    bad.transform.rotation.w = w
    with pytest.raises(UserError, match="norm 1"):
        StaticFrames().add(read(bad))


def test_no_more_frames_are_held_than_a_platform_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(static_frames, "MOST_FRAMES", 2)
    frames = frames_of(transform("base_link", "sensor"), transform("base_link", "gps"))
    with pytest.raises(UserError, match="more than 2 frames; 'third' is left out"):
        frames.add(read(transform("base_link", "third")))
    frames.add(read(transform("base_link", "sensor", (1.0, 0.0, 0.0))))
    assert frames.place("sensor", "base_link").translation[0] == 1.0


@pytest.mark.skipif(has_transforms(), reason="there is a ROS installation with tf2_msgs")
def test_without_tf2_msgs_the_node_says_what_is_missing(graph: Graph) -> None:
    with pytest.raises(UserError, match="mounting_from_tf needs the package tf2_msgs"):
        PROCESSING["sar_compression"](
            context=graph.context, parameter_overrides=[Parameter("mounting_from_tf", value=True)]
        )


def mounted(chain: Chain, mounting: Mounting) -> Any:
    """The description of the chain's sensor with that mounting."""
    return messages.sensor_to_message(replace(chain.flight.sensor, mounting=mounting), messages.to_stamp(START_NS))


@pytest.fixture
def from_tf(graph: Graph, flight: Any) -> Chain:
    pytest.importorskip("tf2_msgs.msg", reason=NEEDS_TF2)
    return Chain(graph, flight, missing_after_s=2.0, image={**IMAGE, "mounting_from_tf": True})


def broadcast(chain: Chain, *transforms: TransformStamped) -> None:
    """Publish transforms as a node does that knows no more of the platform."""
    node = chain.graph.add(Node("broadcaster", context=chain.graph.context))
    publisher = publisher_of(node, TFMessage, "/tf_static", TF_STATIC_QOS)
    publisher.publish(TFMessage(transforms=transforms))


def test_heights_are_those_of_the_same_mounting_in_sensor_info(graph: Graph, flight: Any, from_tf: Chain) -> None:
    """Not those of sensor_info, which says something else here."""
    turn, arm = Rotation.from_euler("x", 2e-5), (0.3, -0.2, 0.1)
    broadcast(from_tf, transform("base_link", "pod", arm), transform("pod", "sensor", turn=turn))
    from_tf.publish(mounted(from_tf, Mounting()), *from_tf.odometry(0), *from_tf.frames(0))
    from_tf.await_heights(0)
    made = from_tf.heights["ml", 0]
    graph.close()
    stated = Mounting("sensor", arm, tuple(turn.as_quat().tolist()))
    assert same_heights(made, heights_with(flight, stated))
    assert not same_heights(made, heights_with(flight, Mounting()))


def heights_with(flight: Any, mounting: Mounting) -> HeightImage:
    """Heights of a dwell whose sensor is described with a mounting, which counts."""
    with free_domain() as domain, Graph(domain) as graph:
        chain = Chain(graph, flight, missing_after_s=30.0, image=IMAGE)
        chain.publish(mounted(chain, mounting), *chain.odometry(0), *chain.frames(0))
        chain.await_heights(0)
        return chain.heights["ml", 0]


def test_a_dwell_waits_for_the_frame_of_its_sensor(from_tf: Chain) -> None:
    from_tf.publish(from_tf.sensor_info(), *from_tf.odometry(0), *from_tf.frames(0))
    node = from_tf.stages["sar_compression"]
    from_tf.wait(lambda: node.tally.summary()["waiting"] == DETECTORS, "the frames")
    assert not node.is_ready
    broadcast(from_tf, transform("base_link", "sensor"))
    from_tf.await_heights(0)


def test_dwells_of_a_sensor_without_a_frame_are_dropped_and_the_fix_is_named(from_tf: Chain) -> None:
    broadcast(from_tf, transform("base_link", "gps"), transform("base_link", "sensor", (math.nan, 0.0, 0.0)))
    from_tf.publish(from_tf.sensor_info(), *from_tf.odometry(0), *from_tf.frames(0))
    from_tf.await_drops("sar_compression", "no mounting", DETECTORS)
    node = from_tf.stages["sar_compression"]
    assert "where 'sensor' (sensor_info, mounting.frame_id) is in 'base_link'; publish it" in node.last_drop
    assert node.tally.summary()["ignored.transform"] == 1


def test_a_sensor_farther_than_any_platform_costs_its_dwells_only(from_tf: Chain) -> None:
    broadcast(from_tf, transform("base_link", "sensor", (2e3, 0.0, 0.0)))
    from_tf.publish(from_tf.sensor_info(), *from_tf.odometry(0), *from_tf.frames(0))
    from_tf.await_drops("sar_compression", "cannot be processed", DETECTORS)
    assert "lever arm" in from_tf.stages["sar_compression"].last_drop
    broadcast(from_tf, transform("base_link", "sensor"))
    frames = from_tf.stages["sar_compression"].stage._frames
    from_tf.wait(lambda: frames.place("sensor", "base_link").translation[0] == 0, "the sensor's place")
    from_tf.publish(*from_tf.odometry(1), *from_tf.frames(1))
    from_tf.await_heights(1)
