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
from rclpy.parameter import parameter_value_to_python
from sal_height_msgs import msg as messages

from sal_height.bag.codec import typestore
from sal_height.bag.reader import BagReader
from sal_height.bag.versions import UPGRADES
from sal_height.messages import samples_of, sensor_from_message, stages_of

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
    "/monopulse/height": {},
}
"""Fields of today by topic, and those of version 0 that they are read from; fields of equal name are not listed."""

DEFAULTS = {
    "/sensor_info": {
        "contract_version": 2,
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
    "/monopulse/height": {"order_probability": []},
}
"""Fields of today that version 0 does not have, and their values (docstring of `bag.versions`)."""

ELSEWHERE = {"samples", "surfaces", "provenance.parameters"}
"""Fields of the same name but another type, which tests of their own compare."""


def flat(message: Any, prefix: str = "") -> dict[str, Any]:
    """Values of a message by dotted path; works for messages of rclpy and of rosbags."""
    if hasattr(message, "get_fields_and_field_types"):
        names = list(message.get_fields_and_field_types())
    elif hasattr(message, "__dataclass_fields__"):
        names = [name for name in message.__dataclass_fields__ if name[0].islower()]
    else:
        return {prefix: message}
    values: dict[str, Any] = {}
    for name in names:
        values |= flat(getattr(message, name), f"{prefix}.{name}" if prefix else name)
    return values


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
    np.testing.assert_array_equal(samples_of(new).ravel(), recorded)


@pytest.mark.parametrize(("topic", "count"), [("/monopulse/height", 1), ("/ml/height", 2)])
def test_layers_are_those_recorded(topic: str, count: int) -> None:
    old, new = last_of(topic)
    assert len(new.surfaces) == count
    for surface, prefix in zip(new.surfaces, ("", "second_"), strict=False):
        for name in ("height", "sigma", "cnr_db", "east", "north"):
            assert len(getattr(surface, name)) == old.grid.rows * old.grid.cols
            np.testing.assert_array_equal(getattr(surface, name), getattr(old, prefix + name))


def test_messages_of_version_1_keep_every_value() -> None:
    """All fields that version 1 had, lists of messages included; of the others each is as in an empty message."""
    bag = BAG.parent / "version_1"
    reader = BagReader(bag)
    read = ((message.topic, message.cdr) for message in reader.messages(list(VERSION_1)))
    with (bag / "bag_0.mcap").open("rb") as stream:
        for (schema, channel, record), (topic, cdr) in zip(
            make_reader(stream).iter_messages(list(VERSION_1)), read, strict=True
        ):
            assert schema
            assert channel.topic == topic
            old = typestore(schema.name, reader.topics[topic].definition).deserialize_cdr(record.data, schema.name)
            new = reader.decode(schema.name, cdr)
            assert_holds(new, old, VERSION_1[topic])


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


VERSION_1 = {"/sensor_info": {"contract_version"}, "/ml/height": set[str](), "/monopulse/height": set[str]()}
"""Topics of which some messages are read, and the fields whose values are others today."""


def test_parameters_are_listed_by_node_and_name() -> None:
    parameters = last_of("/ml/height")[1].provenance.parameters
    assert stages_of(parameters)["ml_height"]["azimuth_looks"] == 2
    assert {type(parameter_value_to_python(parameter.value)) for parameter in parameters} >= {int, float, str, bool}


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
    new: messages.Calibration = UPGRADES["sal_height_msgs/msg/Calibration"](old)
    assert new.id == "abc"
    assert list(new.response) == [1.0, -3.0, 2.0, 0.0]
    np.testing.assert_array_equal(new.response_sigma, [math.nan, 0.1])
    np.testing.assert_array_equal(new.gain_sigma, [math.nan, 0.2])
    np.testing.assert_array_equal(new.phase_sigma, [0.3, math.nan])
    assert math.isnan(new.width_sigma)
    assert new.width_factor == 1.1
