"""The parameters of node recorder."""

from __future__ import annotations

import math

from sal_height.bag.file_writer import COMPRESSIONS
from sal_height.bag.parameter_events import PARAMETER_EVENTS
from sal_height.bag.writer import Packing
from sal_height.nodes.recording.selection import NEVER_BY_DEFAULT
from sal_height.settings import Settings, setting


class RecorderParameters(Settings):
    """Parameters of the recorder: topics, folder and packing."""

    directory: str = setting(
        "",
        "new or empty folder for the bag; if it contains a bag already, the next free of NAME_2, … is used",
        read_only=True,
    )
    topics: tuple[str, ...] = setting(
        (),
        "topics to record by name; without these, patterns and types: every topic except "
        f"{', '.join(NEVER_BY_DEFAULT[:-1])} and {NEVER_BY_DEFAULT[-1]}",
        read_only=True,
    )
    patterns: tuple[str, ...] = setting(
        (), "regular expressions of more topics to record, each of a whole name: '/ml/.*'", read_only=True
    )
    types: tuple[str, ...] = setting(
        (), "types of messages to record in addition, on any topic: nav_msgs/msg/Odometry", read_only=True
    )
    excluded: tuple[str, ...] = setting(
        (), "regular expressions of topics not to record, unless they are among topics", read_only=True
    )
    custom_data: tuple[str, ...] = setting(
        (), "texts to store in the bag, each as NAME=TEXT, as with ros2 bag record --custom-data", read_only=True
    )
    node_parameters: bool = setting(
        True,
        f"record the parameters of all nodes, too, on {PARAMETER_EVENTS}: as they are when a node "
        "or the recorder starts, and all changes",
        read_only=True,
    )
    max_memory_mb: int = setting(
        2048, "memory for messages that wait to be written to the disk", unit="MB", minimum=1, maximum=1_000_000
    )
    compression: str = setting(
        "none",
        "compression of chunks in the file; noise and speckle hardly get smaller",
        choices=tuple(COMPRESSIONS),
        read_only=True,
    )
    split_mb: float = setting(
        0.0, "size at which the next file is begun; 0: never", unit="MB", minimum=0.0, maximum=1e9, read_only=True
    )
    split_s: float = setting(
        0.0, "time after which the next file is begun; 0: never", unit="s", minimum=0.0, maximum=1e9, read_only=True
    )
    flush_period_s: float = setting(
        1.0,
        "time after which received messages are handed to the operating system: a killed process loses no more "
        "than that",
        unit="s",
        minimum=0.01,
        maximum=3600.0,
    )

    @property
    def packing(self) -> Packing:
        """Division of the bag into files, and compression."""
        return Packing(self.compression, self.split_mb * 1e6 or math.inf, self.split_s * 1e9 or math.inf)
