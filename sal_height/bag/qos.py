"""Offered QoS profiles as rosbag2 writes them: YAML with the policies' names (version 9), or their numbers before."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import yaml
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from sal_height.bag.metadata_text import read_yaml, yaml_text
from sal_height.errors import UserError


def to_dicts(profiles: Iterable[QoSProfile]) -> list[dict[str, Any]]:
    """Profiles as plain data in the layout of metadata.yaml version 9."""
    return [
        {
            "history": profile.history.short_key,
            "depth": profile.depth,
            "reliability": profile.reliability.short_key,
            "durability": profile.durability.short_key,
            "deadline": _duration_to_dict(profile.deadline),
            "lifespan": _duration_to_dict(profile.lifespan),
            "liveliness": profile.liveliness.short_key,
            "liveliness_lease_duration": _duration_to_dict(profile.liveliness_lease_duration),
            "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
        }
        for profile in profiles
    ]


def to_yaml(profiles: Iterable[QoSProfile]) -> str:
    """Profiles as the text that a channel's metadata holds under ``offered_qos_profiles``."""
    return yaml_text(to_dicts(profiles), sort_keys=False)


def from_yaml(text: str) -> list[QoSProfile]:
    """Profiles from the text under ``offered_qos_profiles``, of any version; UserError if it is something else."""
    try:
        return [_profile(entry) for entry in _entries(text)]
    except (yaml.YAMLError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise UserError(f"Key offered_qos_profiles holds no list of QoS profiles as rosbag2 has: {error!r}.") from error


@lru_cache(maxsize=64)
def _entries(text: str) -> list[dict[str, Any]]:
    """Profiles of a text as plain data, which nobody changes: most topics of most bags have one of a few texts."""
    return read_yaml(text) or []


def _profile(entry: dict[str, Any]) -> QoSProfile:
    return QoSProfile(
        history=_policy(HistoryPolicy, entry["history"]),
        depth=entry["depth"],
        reliability=_policy(ReliabilityPolicy, entry["reliability"]),
        durability=_policy(DurabilityPolicy, entry["durability"]),
        deadline=_duration_from_dict(entry["deadline"]),
        lifespan=_duration_from_dict(entry["lifespan"]),
        liveliness=_policy(LivelinessPolicy, entry["liveliness"]),
        liveliness_lease_duration=_duration_from_dict(entry["liveliness_lease_duration"]),
        avoid_ros_namespace_conventions=entry["avoid_ros_namespace_conventions"],
    )


def _policy(policies: Any, value: str | int) -> Any:
    return policies[value.upper()] if isinstance(value, str) else policies(value)


def _duration_to_dict(duration: Duration) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration.nanoseconds, 10**9)
    return {"sec": seconds, "nsec": nanoseconds}


def _duration_from_dict(entry: dict[str, int]) -> Duration:
    return Duration(nanoseconds=entry["sec"] * 10**9 + entry["nsec"])
