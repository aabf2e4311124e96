"""Text and hash of message types by name: those of the package, and those that are installed."""

from __future__ import annotations

import functools
import json
import os
import re
import sys
from pathlib import Path

from sal_height.errors import UserError
from sal_height.messages.definition import Definition, composed, shipped_definition

__all__ = ["Definition", "known_definition"]


def known_definition(type_name: str) -> Definition:
    """Text and hash of a message type such as ``std_msgs/msg/Header``, of the package or else of the environment.

    Raises:
        UserError: it is not known.
    """
    # The installation is part of the key: a test or an overlay may add packages while the process runs.
    return shipped_definition(type_name) or _read_definition(type_name, _share_folders())


def _share_folders() -> tuple[Path, ...]:
    """Folders of the message texts of packages: ROS overlays first, then this Python environment."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    return tuple(Path(prefix, "share") for prefix in prefixes if prefix)


@functools.cache
def _read_definition(type_name: str, folders: tuple[Path, ...]) -> Definition:
    description = json.loads(_find(type_name, ".json", folders).read_text(encoding="utf-8"))
    contained = [entry["type_name"] for entry in description["type_description_msg"]["referenced_type_descriptions"]]
    texts = {name: _find(name, ".msg", folders).read_text(encoding="utf-8") for name in (type_name, *contained)}
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    return Definition(composed(texts.pop(type_name), texts), hashes[type_name])


def _find(type_name: str, suffix: str, folders: tuple[Path, ...]) -> Path:
    match = re.fullmatch(r"(\w+)/msg/(\w+)", type_name)
    if match is None:
        raise UserError(f"{type_name!r} is not the name of a message type, which has the form package/msg/Type.")
    for folder in folders:
        path = folder / match[1] / "msg" / (match[2] + suffix)
        if path.is_file():
            return path
    raise UserError(
        f"Message type {type_name} is not installed in this environment; install or source a package {match[1]} that "
        "has it."
    )
