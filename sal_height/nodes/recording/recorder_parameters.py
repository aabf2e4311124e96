"""The parameters of node recorder, and the topics that they select."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence

from sal_height.bag.described import PARAMETER_EVENTS
from sal_height.bag.mcap_file import COMPRESSIONS
from sal_height.bag.writer import Packing
from sal_height.errors import UserError
from sal_height.nodes.accounts.account import PROGRESS
from sal_height.settings import Settings, setting

NEVER_BY_DEFAULT = ("/rosout", "/parameter_events", PROGRESS)
"""Topics that are recorded only if they are asked for."""


class Selection:
    """The topics that are asked for by name, by a pattern of names, or by type; nothing asked for: all there are.

    Attributes:
        names: names of topics that are asked for.
        is_open: True if there may always be one more, so that the search for topics does not end.
    """

    def __init__(
        self,
        names: Iterable[str] = (),
        patterns: Sequence[str] = (),
        types: Iterable[str] = (),
        excluded: Sequence[str] = (),
    ) -> None:
        """Select topics.

        Args:
            names: names of topics, with their namespace.
            patterns: regular expressions that the whole name of a topic matches.
            types: types of messages, such as nav_msgs/msg/Odometry.
            excluded: regular expressions of names; they count only for topics that are not asked for by name.

        Raises:
            UserError: a regular expression is invalid.
        """
        self.names = frozenset(names)
        self._patterns, self._excluded = _compiled("patterns", patterns), _compiled("excluded", excluded)
        self._types = frozenset(types)
        self._is_all = not (self.names or self._patterns or self._types)
        self.is_open = bool(self._is_all or self._patterns or self._types)

    def wants(self, name: str, types: Collection[str]) -> bool:
        """True if a topic is to be recorded, whose publishers have these types."""
        if name in self.names:
            return True
        if any(pattern.fullmatch(name) for pattern in self._excluded):
            return False
        if self._is_all:
            return name not in NEVER_BY_DEFAULT
        return any(pattern.fullmatch(name) for pattern in self._patterns) or not self._types.isdisjoint(types)


def _compiled(parameter: str, patterns: Sequence[str]) -> list[re.Pattern[str]]:
    compiled = []
    for pattern in patterns:
        try:
            compiled.append(re.compile(pattern))
        except re.error as error:
            raise UserError(
                f"Parameter {parameter} has {pattern!r}, which is no regular expression ({error}); '/ml/.*' is one."
            ) from error
    return compiled


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
