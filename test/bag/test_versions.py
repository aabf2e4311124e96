"""Messages of version 0 become those of today without a value lost, and new fields get their documented defaults.

What the recorded bytes say is read by the schema in the bag, with rosbags alone.
"""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from sal_height.bag.reader import BagReader
from sal_height.bag.versions import VERSION_0, needs_upgrade, upgraded
from sal_height.engine.frame_items import samples_of
from sal_height.messages import deserialize, sensor_from_message, stages_of
from sal_height.messages import types as messages
from sal_height.messages.codec import recorded_types
from sal_height.messages.definition import Definition, composed, shipped_texts
from sal_height.messages.frames import frame_of
from sal_height.messages.parameters import parameter_of, value_of
from sal_height.messages.plain import fields_of_message

BAG = Path(__file__).parents[2] / "bags" / "version_0"

RENAMED = {
    "/sensor_info": {
        "waveform.kind": "waveform",
        "beams.elevation_diameter": "aperture",
        "beams.azimuth_diameter": "aperture",
        **{
            f"{part}.{name}": name
            for part, names in {
                "waveform": "wavelength bandwidth sample_count chirp_rate pulse_duration sampling_rate",
                "beams": "pattern elevation_boresights detector_size detector_rotation",
                "channels": "matrix_in_antenna noise_power full_scale",
            }.items()
            for name in names.split()
        },
    },
    "/phase_history": {"channel": "detector"},
    "/monopulse/height": {
        **{f"aperture.pose.position.{axis}": f"aperture.pose.pose.position.{axis}" for axis in "xyz"},
        **{f"aperture.pose.orientation.{axis}": f"aperture.pose.pose.orientation.{axis}" for axis in "xyzw"},
    },
}
"""Fields of today by topic, and those of version 0 that they are read from; fields of equal name are not listed."""

DEFAULTS = {
    "/sensor_info": {
        "contract_version": 3,
        **{f"uncertainty.{name}": [] for name in messages.SensorUncertainty.__slots__},
        "mounting.lever_arm_covariance": [],
        "mounting.rotation_covariance": [],
        "beam_uncertainty": 0.0,
        "channels.blanked_channels": [],
        "channels.blanked_ranges": [],
        "beams.tables": [],
        "channels.matrix": [],
        "mounting.frame_id": "base_link",
        "mounting.lever_arm.x": 0.0,
        "mounting.lever_arm.y": 0.0,
        "mounting.lever_arm.z": 0.0,
        "mounting.rotation.x": 0.0,
        "mounting.rotation.y": 0.0,
        "mounting.rotation.z": 0.0,
        "mounting.rotation.w": 1.0,
    },
    "/phase_history": {"encoding": "complex_float32", "scale": 0.0},
    "/monopulse/height": {
        "order_probability": [],
        "order": 0,
        "doubts": [],
        "fit": [],
        "aperture.pose_covariance": [],  # it was 0
        "aperture.velocity_covariance": [],
    },
}
"""Fields of today that version 0 does not have, and their values (docstring of `bag.versions`)."""

ELSEWHERE = {"samples", "surfaces", "provenance.parameters"}
"""Fields of the same name but another type, which tests of their own compare."""


def flat(message: Any, prefix: str = "") -> dict[str, Any]:
    """Values of a message by dotted path; works for plain messages and those of rosbags."""
    if fields_of_message(message) and not hasattr(message, "__dataclass_fields__"):
        names = list(fields_of_message(message))
    elif hasattr(message, "__dataclass_fields__"):
        names = [name for name in message.__dataclass_fields__ if name[0].islower()]
    else:
        return {prefix: message}
    values: dict[str, Any] = {}
    for name in names:
        values |= flat(getattr(message, name), f"{prefix}.{name}" if prefix else name)
    return values


def typestore(type_name: str, definition: Definition) -> Typestore:
    """rosbags' types of a definition."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition.text, type_name))
    return store


def last_of(topic: str) -> tuple[Any, Any]:
    """The last message on a topic as recorded, and as it is read today; of a dwell's frames that of channel 7."""
    reader = BagReader(BAG)
    *_, new = reader.messages([topic])
    with (BAG / "bag_0.mcap").open("rb") as stream:
        *_, (schema, _, record) = make_reader(stream).iter_messages([topic])
    assert schema
    old = typestore(schema.name, reader.topics[topic].definition).deserialize_cdr(record.data, schema.name)
    return old, reader.decode(new.type_name, new.cdr)


@pytest.mark.parametrize("topic", sorted(RENAMED))
def test_every_field_has_its_recorded_value_or_its_documented_default(topic: str) -> None:
    old, new = map(flat, last_of(topic))
    expected = {name: old[name] for name in new if name in old}
    expected |= {name: old[source] for name, source in RENAMED[topic].items()} | DEFAULTS[topic]
    assert expected.keys() | ELSEWHERE >= new.keys()
    for name in new.keys() - ELSEWHERE:
        np.testing.assert_array_equal(new[name], expected[name], err_msg=name)


def test_the_sensor_of_an_old_bag_is_at_base_link() -> None:
    sensor = sensor_from_message(last_of("/sensor_info")[1])
    assert sensor.mounting.is_identity
    assert sensor.elevation_diameter == sensor.azimuth_diameter == 0.01


def test_samples_are_those_recorded() -> None:
    old, new = last_of("/phase_history")
    recorded = np.asarray(old.samples, dtype=np.float32).view(np.complex64)
    assert recorded.any()
    np.testing.assert_array_equal(samples_of(frame_of(new)).ravel(), recorded)


@pytest.mark.parametrize(("topic", "count"), [("/monopulse/height", 1), ("/ml/height", 2)])
def test_layers_are_those_recorded(topic: str, count: int) -> None:
    old, new = last_of(topic)
    assert len(new.surfaces) == count
    for surface, prefix in zip(new.surfaces, ("", "second_"), strict=False):
        for name in ("height", "sigma", "cnr_db", "east", "north"):
            assert len(getattr(surface, name)) == old.grid.rows * old.grid.cols
            np.testing.assert_array_equal(getattr(surface, name), getattr(old, prefix + name))


@pytest.mark.parametrize("version", ["version_1", "version_2"])
def test_messages_of_later_versions_keep_every_value(version: str) -> None:
    """All fields that they had, lists of messages included; of the others each is as in an empty message."""
    bag = BAG.parent / version
    reader = BagReader(bag)
    read = ((message.topic, message.cdr) for message in reader.messages(list(CHANGED)))
    with (bag / "bag_0.mcap").open("rb") as stream:
        for (schema, channel, record), (topic, cdr) in zip(
            make_reader(stream).iter_messages(list(CHANGED)), read, strict=True
        ):
            assert schema
            assert channel.topic == topic
            old = typestore(schema.name, reader.topics[topic].definition).deserialize_cdr(record.data, schema.name)
            new = reader.decode(schema.name, cdr)
            assert_holds(new, old, CHANGED[topic])
            if hasattr(old, "aperture"):
                assert_holds(new.aperture.pose, old.aperture.pose.pose, set())
                known = old.aperture.pose.covariance if old.aperture.pose.covariance.any() else []
                np.testing.assert_array_equal(new.aperture.pose_covariance, known)


def assert_holds(new: Any, old: Any, changed: set[str]) -> None:
    """Every field of the old message has its value in the new one, but for those that changed on purpose."""
    for name in (name for name in old.__dataclass_fields__ if name[0].islower()):
        before, after = getattr(old, name), getattr(new, name)
        if name in changed:
            continue
        if isinstance(before, list):
            assert len(before) == len(after)
            for one, other in zip(before, after, strict=True):
                assert_holds(other, one, changed)
        elif hasattr(before, "__dataclass_fields__"):
            assert_holds(after, before, changed)
        else:
            np.testing.assert_array_equal(after, before, err_msg=name)


CHANGED = {"/sensor_info": {"contract_version"}, "/ml/height": {"pose"}, "/monopulse/height": {"pose"}}
"""Topics of which some messages are read, and the fields whose values are others today."""


def test_parameters_are_listed_by_node_and_name() -> None:
    parameters = last_of("/ml/height")[1].provenance.parameters
    assert stages_of(parameters)["ml_height"]["azimuth_looks"] == 2
    assert {type(value_of(parameter.value)) for parameter in parameters} >= {int, float, str, bool}


def test_standard_errors_of_zero_were_not_measured() -> None:
    old = SimpleNamespace(
        id="abc",
        channels=2,
        frequencies=1,
        response_real=np.array([1.0, 2.0]),
        response_imaginary=np.array([-3.0, 0.0]),
        response_sigma=np.array([0.0, 0.1]),
        gain_sigma=np.array([0.0, 0.2]),
        phase_sigma=np.array([0.3, 0.0]),
        width_factor=1.1,
        width_sigma=0.0,
    )
    new: messages.Calibration = VERSION_0["sal_height_msgs/msg/Calibration"](old)
    assert new.id == "abc"
    assert list(new.response) == [1.0, -3.0, 2.0, 0.0]
    np.testing.assert_array_equal(new.response_sigma, [math.nan, 0.1])
    np.testing.assert_array_equal(new.gain_sigma, [math.nan, 0.2])
    np.testing.assert_array_equal(new.phase_sigma, [0.3, math.nan])
    assert math.isnan(new.width_sigma)
    assert new.width_factor == 1.1


ACCOUNT_2 = Definition(
    "std_msgs/Header header\nstring node\nbool whole\nstring[] names\nfloat64[] numbers\nstring last_drop", ""
)
"""NodeAccount of version 2 without what it contains, which a bag has with it."""

MAP_2 = Definition(
    "std_msgs/Header header\nuint32 dwell\nuint32 images\nstring estimator\nfloat64 origin_east\nfloat64 origin_north\n"
    "float64 cell_size\nuint32 rows\nuint32 cols\nfloat32[] height\nfloat32[] sigma\nfloat32[] disagreement\n"
    "uint8[] kind\nuint32[] count\nProvenance provenance",
    "",
)
"""ReliefMap of version 2, likewise."""


def of_version_2(type_name: str, bare: Definition, **values: Any) -> Any:
    """Today's message of one of version 2 with these values."""
    names = ["std_msgs/msg/Header", "builtin_interfaces/msg/Time", "sal_height_msgs/msg/Provenance"]
    names += ["rcl_interfaces/msg/Parameter", "rcl_interfaces/msg/ParameterValue"]
    contained = {name: shipped_texts()[name] for name in names}
    definition = Definition(composed(bare.text, contained), "")
    store = recorded_types(type_name, definition)
    cdr = store.serialize(store.message_class(type_name)(**values))
    assert needs_upgrade(type_name, definition)
    return deserialize(upgraded(type_name, definition, cdr), type_name)


def test_an_account_of_version_2_has_its_numbers_in_fields() -> None:
    numbers = dict.fromkeys(["in", "processed", "out"], 9.0) | {
        "processed": 5.0,
        "out": 4.0,
        "waiting": 1.0,
        "jobs": 2.0,
    }
    numbers |= {"ready": 1.0, "untold": 3.0, "pid": 77.0, "dropped.late": 3.0, "last_minute.dropped.late": 2.0}
    numbers |= {"ignored.odometry": 6.0, "odometry.bridged": 8.0, "published./slc": 4.0, "subscribers./slc": 1.0}
    numbers |= {"offered_hz": 2.5, "cpu_s": 1.25, "dwells": math.nan, "calibrations": -1.0, "dropped.absurd": 1e300}
    account = of_version_2(
        "sal_height_msgs/msg/NodeAccount",
        ACCOUNT_2,
        node="a/b",
        whole=True,
        names=[*numbers, "one more"],
        numbers=np.array(list(numbers.values())),
        last_drop="Dwell 3 came late.",
    )
    expected = messages.NodeAccount(node="a/b", last_drop="Dwell 3 came late.", offered_hz=2.5, cpu_s=1.25, pid=77)
    expected.received, expected.processed, expected.published, expected.waiting, expected.jobs = 9, 5, 4, 1, 2
    expected.ready, expected.unpublished = True, 3
    expected.achieved_hz = expected.latency_p50_ms = expected.latency_p95_ms = math.nan
    expected.dropped, expected.dropped_last_minute = [count("late", 3)], [count("late", 2)]
    expected.ignored, expected.events = [count("odometry", 6)], [count("odometry.bridged", 8)]
    expected.published_on, expected.subscribers = [count("/slc", 4)], [count("/slc", 1)]
    assert account == expected


def count(name: str, number: int) -> messages.Count:
    return messages.Count(name=name, count=number)


@pytest.mark.parametrize(
    ("frame_id", "parameters", "crs", "map_frame", "layer"),
    [
        ("map", {}, "", "map", "mean"),
        ("EPSG:32632", {"relief_mapper.map_frame": "map"}, "EPSG:32632", "map", "mean"),
        ("odom", {"relief_mapper.map_frame": "odom"}, "", "odom", "mean"),
        ("EPSG:25832", {"ground_mapper.map_frame": "odom"}, "EPSG:25832", "odom", "ground"),
    ],
)
def test_a_map_of_version_2_has_one_layer_and_its_system_apart(
    frame_id: str, parameters: dict[str, str], crs: str, map_frame: str, layer: str
) -> None:
    stated = [parameter_of(name, value) for name, value in parameters.items()]
    values = {"dwell": 3, "images": 4, "estimator": "ml", "origin_east": 1.5, "cell_size": 2.0, "rows": 1, "cols": 2}
    layers = {"height": [1.0, np.nan], "sigma": [0.1, 0.2], "disagreement": [1.0, 2.0], "kind": [0, 2], "count": [3, 0]}
    new = of_version_2(
        "sal_height_msgs/msg/ReliefMap",
        MAP_2,
        header=messages.Header(frame_id=frame_id),
        provenance=messages.Provenance(parameters=stated),
        **values,
        **layers,
    )
    assert (new.crs, new.header.frame_id) == (crs, map_frame)
    assert {name: getattr(new, name) for name in values} == values
    assert new.layers == [messages.ReliefLayer(name=layer, **layers)]
    assert new.provenance.parameters == stated
