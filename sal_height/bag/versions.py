"""Messages of older versions of sal_height_msgs, read by the schema in their bag and made into those of today.

Version 0 is what was recorded before messages had a SensorInfo.contract_version. It lacks some fields of version 1,
which get these values: no mounting (the sensor frame is "base_link"), both antenna diameters are the single one that is
given, samples are "complex_float32", and every other field is as in an empty message.

Version 1 lacks some fields of version 2, which are as in an empty message.
"""

from __future__ import annotations

import array
import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rclpy.parameter import Parameter
from sal_height_msgs import msg as current

from sal_height.bag.codec import serialized, typestore
from sal_height.bag.definitions import Definition, installed_definition, message_class

PACKAGE = "sal_height_msgs/msg/"

RENAMED = {f"{PACKAGE}DetectorFrame": f"{PACKAGE}ChannelFrame"}
"""Types of version 0 that have another name today."""


def current_name(type_name: str) -> str:
    """Name that a recorded type has today."""
    return RENAMED.get(type_name, type_name)


def needs_upgrade(type_name: str, definition: Definition) -> bool:
    """Whether messages of a type, recorded with that definition, are of an older version that `upgraded` reads."""
    name = current_name(type_name)
    return name in UPGRADES and not (name == type_name and definition.same_layout(installed_definition(name)))


def upgraded(type_name: str, definition: Definition, cdr: bytes) -> bytes:
    """The CDR bytes of today's message that says what an older one of version 0 or 1 said.

    Args:
        type_name: as recorded.
        definition: as recorded.
        cdr: the recorded message.

    Raises:
        ValueError, AttributeError: the bytes or the definition are not of a version that is known.
    """
    old = typestore(type_name, definition).deserialize_cdr(cdr, type_name)
    name = current_name(type_name)
    new = UPGRADES[name](old) if _is_of_version_0(name, old) else _copied(old, message_class(name))
    if isinstance(new, current.SensorInfo):
        new.contract_version = current.SensorInfo.CONTRACT_VERSION
    return serialized(new)


def _is_of_version_0(name: str, old: Any) -> bool:
    """Whether a message, whose type has that name today, lacks what version 1 brought."""
    if name == f"{PACKAGE}SensorInfo":
        return not hasattr(old, "contract_version")
    if name == f"{PACKAGE}ChannelFrame":
        return hasattr(old, "detector")
    if name == f"{PACKAGE}Calibration":
        return hasattr(old, "response_real")
    return isinstance(old.provenance.parameters, str)


def _sensor_info(old: Any) -> current.SensorInfo:
    new = _copied(old, current.SensorInfo)
    new.waveform = _copied(old, current.Waveform)
    new.waveform.kind = old.waveform
    new.beams = _copied(old, current.BeamModel)
    new.beams.elevation_diameter = new.beams.azimuth_diameter = old.aperture
    new.beams.tables = [_beam_table(table) for table in old.beam_tables]
    new.channels = _copied(old, current.ChannelModel)
    new.channels.matrix = _pairs(old.channel_matrix_real, old.channel_matrix_imaginary)
    new.mounting.frame_id = "base_link"
    return new


def _beam_table(old: Any) -> current.BeamTable:
    new = _copied(old, current.BeamTable)
    new.amplitude = _pairs(old.real, old.imaginary)
    return new


def _channel_frame(old: Any) -> current.ChannelFrame:
    new = _copied(old, current.ChannelFrame)
    new.channel = old.detector
    new.encoding = current.ChannelFrame.COMPLEX_FLOAT32
    new.samples = array.array("B", old.samples.astype("<f4", copy=False).tobytes())
    return new


def _complex_image(old: Any) -> current.ComplexImage:
    new = _copied(old, current.ComplexImage)
    new.channel = old.detector
    new.provenance.parameters = _parameters(old.provenance.parameters)
    return new


def _height_image(old: Any) -> current.HeightImage:
    new = _copied(old, current.HeightImage)
    layers = tuple(current.Surface.get_fields_and_field_types())
    for prefix in ("", "second_"):
        values = {name: getattr(old, prefix + name, np.empty(0, np.float32)) for name in layers}
        if prefix == "" or any(array.size for array in values.values()):
            new.surfaces.append(current.Surface(**{name: _array(value, "f") for name, value in values.items()}))
    new.provenance.parameters = _parameters(old.provenance.parameters)
    return new


def _relief_map(old: Any) -> current.ReliefMap:
    new = _copied(old, current.ReliefMap)
    new.provenance.parameters = _parameters(old.provenance.parameters)
    return new


def _calibration(old: Any) -> current.Calibration:
    """Of a calibration; a standard error of 0 meant "not measured"."""
    new = _copied(old, current.Calibration)
    new.response = _pairs(old.response_real, old.response_imaginary)
    for name in ("response_sigma", "gain_sigma", "phase_sigma", "width_sigma"):
        sigma = np.atleast_1d(getattr(old, name))
        measured = np.where(sigma > 0, sigma, np.nan)
        setattr(new, name, float(measured[0]) if name == "width_sigma" else _array(measured, "d"))
    return new


UPGRADES: Mapping[str, Callable[[Any], Any]] = {
    f"{PACKAGE}SensorInfo": _sensor_info,
    f"{PACKAGE}ChannelFrame": _channel_frame,
    f"{PACKAGE}ComplexImage": _complex_image,
    f"{PACKAGE}HeightImage": _height_image,
    f"{PACKAGE}ReliefMap": _relief_map,
    f"{PACKAGE}Calibration": _calibration,
}
"""What makes a message of today of one of version 0, by the name of its type today."""


def _parameters(text: str) -> list[Any]:
    """Provenance.parameters from the JSON text that it was: an object by stage, of objects by name."""
    try:
        stages = json.loads(text or "{}")
    except ValueError:
        return []
    flat = _flat(stages, "") if isinstance(stages, dict) else {}
    return [Parameter(name, value=value).to_parameter_msg() for name, value in flat.items() if value is not None]


def _flat(values: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def _copied(old: Any, message_type: type[Any]) -> Any:
    """A new message with the values of all fields that the old one has under the same name and of the same kind."""
    new = message_type()
    for name in new.get_fields_and_field_types():
        value, default = getattr(old, name, None), getattr(new, name)
        if isinstance(default, array.array) and isinstance(value, np.ndarray):
            setattr(new, name, _array(value, default.typecode))
        elif hasattr(default, "get_fields_and_field_types") and hasattr(value, "__msgtype__"):
            setattr(new, name, _copied(value, type(default)))
        elif isinstance(value, list) and value and hasattr(value[0], "__msgtype__"):
            setattr(new, name, [_copied(one, message_class(one.__msgtype__)) for one in value])
        elif type(value) is type(default) and not isinstance(value, list):
            setattr(new, name, value)
    return new


def _pairs(real: Any, imaginary: Any) -> array.array[float]:
    """Real and imaginary parts in turn."""
    return _array(np.stack([real, imaginary], axis=-1), "d")


def _array(values: Any, typecode: str) -> array.array[Any]:
    return array.array(typecode, np.ascontiguousarray(values, dtype=typecode).tobytes())
