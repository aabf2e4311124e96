"""Messages as plain objects and as bytes, without ROS, and their conversion to arrays and back.

`types` has the classes of messages, `codec` reads and writes their bytes. Only this package knows both the types of
messages and those of the core. Samples are read without a copy (but for frames of 16-bit integers), and
new messages have views of the arrays that they are made of, until they are serialized.
"""

from sal_height.engine.air import AIR_LATENCY_NS, AIR_OF_TOPICS, AirSample, needed_air
from sal_height.engine.frame_items import LONGEST_DWELL
from sal_height.engine.frames import MAP_FRAME, Frames
from sal_height.engine.provenance import autofocus_values
from sal_height.messages.basics import (
    aperture_from_message,
    complex_view,
    float_view,
    grid_from_message,
    to_bytes,
    to_floats,
    to_ns,
    to_stamp,
)
from sal_height.messages.codec import BrokenMessage, deserialize, serialize
from sal_height.messages.frames import (
    history_from_messages,
    history_to_messages,
    received_frame,
    state_from_message,
    state_to_message,
)
from sal_height.messages.navigation import (
    AIR,
    AIR_TYPES,
    air_to_messages,
    origin_to_message,
    read_air,
    read_attitude,
    read_fix,
    read_origin,
)
from sal_height.messages.parameters import stages_of, with_stage
from sal_height.messages.products import (
    check_slc,
    field_from_message,
    height_to_message,
    received_image,
    recorded_window,
    slc_from_messages,
    slc_to_messages,
)
from sal_height.messages.sensors import (
    calibration_from_message,
    calibration_to_message,
    sensor_from_message,
    sensor_to_message,
)

__all__ = [
    "AIR",
    "AIR_LATENCY_NS",
    "AIR_OF_TOPICS",
    "AIR_TYPES",
    "LONGEST_DWELL",
    "MAP_FRAME",
    "AirSample",
    "BrokenMessage",
    "Frames",
    "air_to_messages",
    "aperture_from_message",
    "autofocus_values",
    "calibration_from_message",
    "calibration_to_message",
    "check_slc",
    "complex_view",
    "deserialize",
    "field_from_message",
    "float_view",
    "grid_from_message",
    "height_to_message",
    "history_from_messages",
    "history_to_messages",
    "needed_air",
    "origin_to_message",
    "read_air",
    "read_attitude",
    "read_fix",
    "read_origin",
    "received_frame",
    "received_image",
    "recorded_window",
    "sensor_from_message",
    "sensor_to_message",
    "serialize",
    "slc_from_messages",
    "slc_to_messages",
    "stages_of",
    "state_from_message",
    "state_to_message",
    "to_bytes",
    "to_floats",
    "to_ns",
    "to_stamp",
    "with_stage",
]
