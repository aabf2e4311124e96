"""Message types by name: their Python class, and the text and hash by which other programs understand a bag."""

from __future__ import annotations

import functools
import importlib
import json
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sal_height.errors import UserError

SEPARATOR = "=" * 80

# Type and name of a field; an equals sign after the name makes it a constant, which is not part of the layout.
_FIELD = re.compile(r"\s*([^\s#]+)\s+(\w+)\s*(=?)")


@dataclass(frozen=True)
class Definition:
    """What a bag stores about a message type.

    Attributes:
        text: the .msg text, then the texts of all types it contains, each under a line of 80 ``=`` and ``MSG: name``.
        type_hash: ROS 2 type hash (``RIHS01_…``); empty where it is not known (bags older than ROS 2 Iron).
        encoding: language of the text, ``ros2msg`` or ``ros2idl``.
    """

    text: str
    type_hash: str
    encoding: str = "ros2msg"

    def same_layout(self, other: Definition) -> bool:
        """Whether equal messages have the same bytes by both definitions: decided by hash, or else field by field."""
        if self.type_hash and other.type_hash:
            return self.type_hash == other.type_hash
        return self.encoding == other.encoding and _fields(self.text) == _fields(other.text)


def installed_definition(type_name: str) -> Definition:
    """Text and hash of an installed message type such as ``std_msgs/msg/Header``.

    Raises:
        UserError: it is not installed.
    """
    # The installation is part of the key: a test or an overlay may add packages while the process runs.
    return _read_definition(type_name, _share_folders())


def message_class(type_name: str) -> type[Any]:
    """Python class of an installed message type such as ``std_msgs/msg/Header``.

    Raises:
        UserError: it is not installed.
    """
    package, name = _split(type_name)
    try:
        found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise _not_installed(type_name) from None
    return found


def _share_folders() -> tuple[Path, ...]:
    """Where packages keep their message texts: ROS overlays first, then this Python environment."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    return tuple(Path(prefix, "share") for prefix in prefixes if prefix)


@functools.cache
def _read_definition(type_name: str, folders: tuple[Path, ...]) -> Definition:
    description = json.loads(_find(type_name, ".json", folders).read_text(encoding="utf-8"))
    contained = description["type_description_msg"]["referenced_type_descriptions"]
    text = _find(type_name, ".msg", folders).read_text(encoding="utf-8")
    for name in (entry["type_name"] for entry in contained):
        dependency = _find(name, ".msg", folders).read_text(encoding="utf-8")
        text += f"\n{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{dependency}"
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    return Definition(text, hashes[type_name])


def _find(type_name: str, suffix: str, folders: tuple[Path, ...]) -> Path:
    package, name = _split(type_name)
    for folder in folders:
        path = folder / package / "msg" / (name + suffix)
        if path.is_file():
            return path
    raise _not_installed(type_name)


def _split(type_name: str) -> tuple[str, str]:
    match = re.fullmatch(r"(\w+)/msg/(\w+)", type_name)
    if match is None:
        raise UserError(f"{type_name!r} is not the name of a message type, which has the form package/msg/Type.")
    return match[1], match[2]


def _not_installed(type_name: str) -> UserError:
    package, _ = _split(type_name)
    return UserError(
        f"Message type {type_name} is not installed in this environment; install or source a package {package} that "
        "has it."
    )


def _fields(text: str) -> dict[str, list[tuple[str, str]]]:
    """(type, name) of every field, by the message type that has it; the first type of the text is called ''.

    Names of types are without their package: ``BeamTable[]`` and ``sal_height_msgs/BeamTable[]`` are the same type, as
    programs write the one or the other. That is enough, for the types themselves are compared too.
    """
    fields: dict[str, list[tuple[str, str]]] = {}
    for section in re.split(rf"^{SEPARATOR}\n", "MSG:\n" + text, flags=re.MULTILINE):
        title, _, body = section.partition("\n")
        matches = (_FIELD.match(line) for line in body.splitlines())
        name = title.removeprefix("MSG:").strip().replace("/msg/", "/")
        fields[name] = [(m[1].rpartition("/")[2], m[2]) for m in matches if m and not m[3]]
    return fields
