"""Writes texts and hashes of message types into `sal_height/messages/definitions.json`.

Ours are read from msg_defs, those of others from the installed ROS.

usage: python -m tools.definitions
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROOT = Path(__file__).parents[1]
FILE = ROOT / "sal_height" / "messages" / "definitions.json"

OWN = "sal_height_msgs"

TAKEN = (
    "diagnostic_msgs/msg/DiagnosticArray",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/TwistStamped",
    "nav_msgs/msg/Odometry",
    "rcl_interfaces/msg/ParameterEvent",
    "rcl_interfaces/msg/ParameterType",
    "rosgraph_msgs/msg/Clock",
    "sensor_msgs/msg/FluidPressure",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/RelativeHumidity",
    "sensor_msgs/msg/Temperature",
    "tf2_msgs/msg/TFMessage",
)
"""Types of ROS that the package reads and writes, but for those that they contain."""


def texts() -> dict[str, str]:
    """The text of every type by its name: ours, those taken, and what these contain."""
    files = (ROOT / "msg_defs" / "msg").glob("*.msg")
    found = {f"{OWN}/msg/{file.stem}": file.read_text(encoding="utf-8") for file in files}
    waiting = [*found, *TAKEN]
    while waiting:
        name = waiting.pop()
        if name not in found:
            package, _, stem = name.split("/")
            found[name] = Path(sys.prefix, "share", package, "msg", f"{stem}.msg").read_text(encoding="utf-8")
        (fields,) = (fields for _, fields in get_types_from_msg(found[name], name).values())
        for _, description in fields:
            kind = description[1] if description[0] == 2 else description[1][0][1] if description[0] > 2 else ""
            if isinstance(kind, str) and kind and kind not in found:
                waiting.append(kind)
    return dict(sorted(found.items()))


def content() -> str:
    """The content of the file."""
    known, store = texts(), get_typestore(Stores.EMPTY)
    store.register(
        {name: entry for one, text in known.items() for name, entry in get_types_from_msg(text, one).items()}
    )
    shipped = {"texts": known, "hashes": {name: store.hash_rihs01(name) for name in known}}
    return json.dumps(shipped, ensure_ascii=False, indent=1) + "\n"


if __name__ == "__main__":
    FILE.write_text(content(), encoding="utf-8")
