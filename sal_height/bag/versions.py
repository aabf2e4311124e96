"""Messages of older versions of sal_height_msgs, read by the schema in their bag and converted to those of today.

Version 0 was recorded before messages had a SensorInfo.contract_version. It lacks some fields of version 1,
which get these values: no mounting (the sensor frame is "base_link"), both antenna diameters are the single one that is
given, samples are "complex_float32", and every other field is as in an empty message.

Versions 1 and 2 lack some fields of version 3, which are as in an empty message. A covariance of the pose that is 0
everywhere is not known. A relief map has one layer, which is called "ground" if it was made by ground_mapper and else
"mean"; its frame_id is a coordinate reference system unless it is the map frame by the parameters of its provenance.
Numbers that an account of version 2 lacks are 0 or NaN, as are those that were not whole.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from sal_height.messages import MAP_FRAME, serialize
from sal_height.messages import types as current
from sal_height.messages.accounts import account_of_numbers
from sal_height.messages.codec import SHIPPED, recorded_types
from sal_height.messages.definition import Definition, shipped_definition
from sal_height.messages.parameters import FIELDS, parameter_of, value_of
from sal_height.messages.plain import fields_of_message

PACKAGE = "sal_height_msgs/msg/"

RENAMED = {f"{PACKAGE}DetectorFrame": f"{PACKAGE}ChannelFrame"}
"""Types of version 0 that have another name today."""


def current_name(type_name: str) -> str:
    """Name that a recorded type has today."""
    return RENAMED.get(type_name, type_name)


def needs_upgrade(type_name: str, definition: Definition) -> bool:
    """True if messages of a type, recorded with that definition, are of an older version that `upgraded` reads."""
    name = current_name(type_name)
    known = shipped_definition(name) if name in UPGRADED else None
    return known is not None and not (name == type_name and definition.same_layout(known))


def upgraded(type_name: str, definition: Definition, cdr: bytes) -> bytes:
    """The CDR bytes of a message of version 0, 1 or 2, converted to that of today.

    Args:
        type_name: type as recorded.
        definition: definition as recorded.
        cdr: CDR bytes of the recorded message.

    Raises:
        BrokenMessage, ValueError, KeyError, AttributeError: the bytes or the definition are not of a known
            version.
    """
    old = recorded_types(type_name, definition).reader(type_name)(cdr)
    name = current_name(type_name)
    new = VERSION_0[name](old) if _is_of_version_0(name, old) else _copied(old, SHIPPED.message_class(name))
    if isinstance(new, current.SensorInfo):
        new.contract_version = current.SensorInfo.CONTRACT_VERSION
    return serialize(new)


def _is_of_version_0(name: str, old: Any) -> bool:
    """True if a message, whose type has that name today, lacks the fields of version 1."""
    if name == f"{PACKAGE}SensorInfo":
        return not hasattr(old, "contract_version")
    if name == f"{PACKAGE}ChannelFrame":
        return hasattr(old, "detector")
    if name == f"{PACKAGE}Calibration":
        return hasattr(old, "response_real")
    if name == f"{PACKAGE}NodeAccount":
        return False
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
    new.samples = np.ascontiguousarray(old.samples, "<f4").view(np.uint8)
    return new


def _complex_image(old: Any) -> current.ComplexImage:
    new = _copied(old, current.ComplexImage)
    new.channel = old.detector
    new.provenance.parameters = _parameters(old.provenance.parameters)
    return new


def _height_image(old: Any) -> current.HeightImage:
    new = _copied(old, current.HeightImage)
    for prefix in ("", "second_"):
        layers = {name: getattr(old, prefix + name, None) for name in fields_of_message(current.Surface)}
        if prefix == "" or any(layer is not None and layer.size for layer in layers.values()):
            new.surfaces.append(current.Surface(**layers))
    new.provenance.parameters = _parameters(old.provenance.parameters)
    return new


def _relief_map(old: Any) -> current.ReliefMap:
    new = _copied(old, current.ReliefMap)
    new.provenance.parameters = _parameters(old.provenance.parameters)
    return new


def _calibration(old: Any) -> current.Calibration:
    """Today's message of a calibration; a standard error of 0 meant "not measured"."""
    new = _copied(old, current.Calibration)
    new.response = _pairs(old.response_real, old.response_imaginary)
    for name in ("response_sigma", "gain_sigma", "phase_sigma", "width_sigma"):
        sigma = np.atleast_1d(getattr(old, name))
        measured = np.where(sigma > 0, sigma, np.nan)
        setattr(new, name, float(measured[0]) if name == "width_sigma" else measured)
    return new


VERSION_0: Mapping[str, Callable[[Any], Any]] = {
    f"{PACKAGE}SensorInfo": _sensor_info,
    f"{PACKAGE}ChannelFrame": _channel_frame,
    f"{PACKAGE}ComplexImage": _complex_image,
    f"{PACKAGE}HeightImage": _height_image,
    f"{PACKAGE}ReliefMap": _relief_map,
    f"{PACKAGE}Calibration": _calibration,
}
"""Converters of messages of version 0 to those of today, by the name of the type today."""

UPGRADED = {*VERSION_0, f"{PACKAGE}NodeAccount"}
"""Types whose older versions are read."""


def _aperture(old: Any) -> current.Aperture:
    """Today's message of an aperture before version 3, whose pose had a covariance; 0 everywhere: not known."""
    if not hasattr(old.pose, "pose"):
        return _copied_fields(old, current.Aperture)
    new = _copied_fields(old, current.Aperture)
    new.pose = _copied(old.pose.pose, current.Pose)
    new.pose_covariance = old.pose.covariance if old.pose.covariance.any() else np.empty(0)
    return new


def _layers_of_map(old: Any) -> current.ReliefMap:
    """Today's message of a relief map before version 3, which had one layer, and its system as frame_id."""
    new = _copied_fields(old, current.ReliefMap)
    if hasattr(old, "layers"):
        return new
    layer = _copied_fields(old, current.ReliefLayer)
    stated = {} if isinstance(old.provenance.parameters, str) else _stated(new.provenance.parameters)
    layer.name = LAYERS[
        "ground_mapper" if any(name.startswith("ground_mapper.") for name in stated) else "relief_mapper"
    ]
    new.layers = [layer]
    frames = [stated.get(f"{mapper}.map_frame") for mapper in LAYERS]
    map_frame = next((frame for frame in frames if isinstance(frame, str)), MAP_FRAME)
    if new.header.frame_id != map_frame:
        new.crs, new.header.frame_id = new.header.frame_id, map_frame
    return new


LAYERS = {"ground_mapper": current.ReliefLayer.GROUND, "relief_mapper": current.ReliefLayer.MEAN}
"""Names of the layers of maps, by the node that makes them."""


def _stated(parameters: Sequence[Any]) -> dict[str, Any]:
    """Values of parameters by name; those of unknown types are left out."""
    return {one.name: value_of(one.value) for one in parameters if one.value.type in FIELDS}


def _node_account(old: Any) -> current.NodeAccount:
    """Today's message of an account of version 2, which had a list of numbers and one of their names."""
    new = _copied_fields(old, current.NodeAccount)
    if not hasattr(old, "names"):
        return new
    numbers = dict(zip(old.names, old.numbers.tolist(), strict=False))
    account = account_of_numbers(numbers)
    account.header, account.node, account.last_drop = new.header, new.node, new.last_drop
    return account


CHANGED: Mapping[str, Callable[[Any], Any]] = {
    f"{PACKAGE}Aperture": _aperture,
    f"{PACKAGE}NodeAccount": _node_account,
    f"{PACKAGE}ReliefMap": _layers_of_map,
}
"""Converters of messages of version 1 or 2 whose fields have other meanings, by the name of the type."""


def _parameters(text: str) -> list[Any]:
    """Provenance.parameters from the JSON text that it was: an object by stage, of objects by name."""
    try:
        stages = json.loads(text or "{}")
    except ValueError:
        return []
    flat = _flat(stages, "") if isinstance(stages, dict) else {}
    return [parameter_of(name, value) for name, value in flat.items() if value is not None]


def _flat(values: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


def _copied(old: Any, message_type: type[Any]) -> Any:
    """A new message with the content of the old one."""
    return CHANGED.get(message_type.__msgtype__, lambda old: _copied_fields(old, message_type))(old)


def _copied_fields(old: Any, message_type: type[Any]) -> Any:
    """A new message with the values of all fields that the old one has under the same name and of the same kind."""
    new = message_type()
    for name in fields_of_message(new):
        value, default = getattr(old, name, None), getattr(new, name)
        if fields_of_message(default):
            if fields_of_message(value):
                setattr(new, name, _copied(value, type(default)))
        elif isinstance(value, list) and isinstance(default, list):
            setattr(new, name, [_copied_element(one) for one in value])
        elif type(value) is type(default):
            setattr(new, name, value)
    return new


def _copied_element(old: Any) -> Any:
    """An element of a list: a message, or a text."""
    return _copied(old, SHIPPED.message_class(old.__msgtype__)) if fields_of_message(old) else old


def _pairs(real: Any, imaginary: Any) -> Any:
    """Real and imaginary parts in turn."""
    return np.stack([real, imaginary], axis=-1).ravel()
