"""Quality of service of publishers as rosbag2 writes it, in YAML with names (version 9) or numbers before."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import yaml

from sal_height.errors import UserError

RELIABLE, BEST_EFFORT = "reliable", "best_effort"
TRANSIENT_LOCAL, VOLATILE = "transient_local", "volatile"


@dataclass(frozen=True)
class Qos:
    """Quality of service of a publisher or subscription; the policies are named as in metadata.yaml.

    Attributes:
        history: choice of the messages that are kept for subscribers.
        depth: number of messages that are kept.
        reliability: repetition of messages that are lost.
        durability: delivery of the kept messages to late subscribers.
        deadline_ns: longest time between messages, ns; 0: not stated, as in the next two times.
        lifespan_ns: time after which a message is no longer delivered, ns.
        liveliness: sign by which a publisher shows that it is alive.
        liveliness_lease_ns: longest time until it does so again, ns.
        avoid_ros_namespace_conventions: True if the topic's name is that of the middleware.
    """

    history: str = "keep_last"
    depth: int = 10
    reliability: str = RELIABLE
    durability: str = VOLATILE
    deadline_ns: int = 0
    lifespan_ns: int = 0
    liveliness: str = "system_default"
    liveliness_lease_ns: int = 0
    avoid_ros_namespace_conventions: bool = False


FRAMES = Qos(depth=256)
"""Profile of phase histories and images: deep enough for the burst of messages of a dwell."""

ODOMETRY = Qos(depth=5000)
"""Profile of platform states: small messages, but thousands of them may arrive with a dwell. Fast DDS keeps 5000 at
most; at a greater depth it loses the newest ones instead of the oldest."""

LATCHED = Qos(depth=1, durability=TRANSIENT_LOCAL)
"""Profile of sensor info and the like: a late subscriber receives the last message."""

POLICIES = {
    "history": {0: "system_default", 1: "keep_last", 2: "keep_all", 3: "unknown"},
    "reliability": {0: "system_default", 1: RELIABLE, 2: BEST_EFFORT, 3: "unknown", 4: "best_available"},
    "durability": {0: "system_default", 1: TRANSIENT_LOCAL, 2: VOLATILE, 3: "unknown", 4: "best_available"},
    "liveliness": {0: "system_default", 1: "automatic", 3: "manual_by_topic", 4: "unknown", 5: "best_available"},
}
"""Values of the policies, by the numbers that rosbag2 wrote before version 9."""

DURATIONS = {"deadline_ns": "deadline", "lifespan_ns": "lifespan", "liveliness_lease_ns": "liveliness_lease_duration"}
"""Names of the times in metadata.yaml."""


def to_dicts(profiles: Iterable[Qos]) -> list[dict[str, Any]]:
    """Profiles as plain data in the layout of metadata.yaml version 9."""
    return [
        {DURATIONS.get(name, name): _duration(value) if name in DURATIONS else value for name, value in one.items()}
        for one in map(asdict, profiles)
    ]


def to_yaml(profiles: Iterable[Qos]) -> str:
    """Profiles as the text that a channel's metadata has under ``offered_qos_profiles``."""
    return yaml_text(to_dicts(profiles), sort_keys=False)


def from_yaml(text: str) -> list[Qos]:
    """Profiles from the text under ``offered_qos_profiles``, of any version; UserError if it is invalid."""
    try:
        return [_profile(entry) for entry in _entries(text)]
    except (yaml.YAMLError, KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise UserError(
            f"Key offered_qos_profiles contains no list of QoS profiles as rosbag2 has: {error!r}."
        ) from error


@lru_cache(maxsize=64)
def _entries(text: str) -> list[dict[str, Any]]:
    """Profiles of a text as plain data, which must not be changed: most topics of most bags have one of a few texts."""
    return read_yaml(text) or []


def _profile(entry: dict[str, Any]) -> Qos:
    policies: dict[str, Any] = {name: _policy(name, entry[name]) for name in POLICIES}
    times: dict[str, Any] = {
        name: entry[stored]["sec"] * 10**9 + entry[stored]["nsec"] for name, stored in DURATIONS.items()
    }
    if not all(0 <= ns < 2**63 for ns in times.values()) or not 0 <= entry["depth"] < 2**31:
        raise ValueError("a time or the depth is out of range")
    plain = bool(entry["avoid_ros_namespace_conventions"])
    return Qos(depth=int(entry["depth"]), avoid_ros_namespace_conventions=plain, **policies, **times)


def _policy(name: str, value: str | int) -> str:
    known = POLICIES[name]
    if isinstance(value, str) and value.lower() in known.values():
        return value.lower()
    return known[int(value)]


def _duration(ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(ns, 10**9)
    return {"sec": seconds, "nsec": nanoseconds}


_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def read_yaml(text: str) -> Any:
    """Plain data of a text.

    Raises:
        yaml.YAMLError: it is not YAML.
    """
    return yaml.load(text, _LOADER)  # noqa: S506 (a safe one)


def yaml_text(content: object, *, sort_keys: bool = True) -> str:
    """Plain data as a text."""
    return str(yaml.dump(content, Dumper=_DUMPER, sort_keys=sort_keys))
