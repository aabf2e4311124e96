"""Texts and hashes of message types, of the package and of the environment, by which programs understand bags."""

from __future__ import annotations

import functools
import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from sal_height.errors import UserError
from sal_height.messages.layout import SEPARATOR, Layout, read_layout

# Type and name of a field; an equals sign after the name makes it a constant, which is not part of the layout.
_FIELD = re.compile(r"\s*([^\s#]+)\s+(\w+)\s*(=?)")


@dataclass(frozen=True)
class Definition:
    """Definition of a message type, as a bag stores it.

    Attributes:
        text: .msg text, then the texts of all types it contains, each under a line of 80 ``=`` and ``MSG: name``.
        type_hash: ROS 2 type hash (``RIHS01_…``); empty where it is not known (bags older than ROS 2 Iron).
        encoding: language of the text, ``ros2msg`` or ``ros2idl``.
    """

    text: str
    type_hash: str
    encoding: str = "ros2msg"

    def same_layout(self, other: Definition) -> bool:
        """True if equal messages have the same bytes by both definitions: decided by hash, or else field by field."""
        if self.type_hash and other.type_hash:
            return self.type_hash == other.type_hash
        return self.encoding == other.encoding and _fields(self.text) == _fields(other.text)


@functools.cache
def _shipped() -> Mapping[str, Mapping[str, str]]:
    """Texts and hashes of the shipped types by name, which tools/definitions.py has written."""
    file = resources.files(__package__) / "definitions.json"
    return json.loads(file.read_text(encoding="utf-8"))


def shipped_texts() -> Mapping[str, str]:
    """Text of every shipped message type by its name, without those of the types that it contains."""
    return _shipped()["texts"]


@functools.cache
def shipped_definition(type_name: str) -> Definition | None:
    """Text and hash of a shipped message type; None if it is not shipped."""
    texts = shipped_texts()
    if type_name not in texts:
        return None
    contained = {name: texts[name] for name in sorted(_contained(type_name))}
    return Definition(composed(texts[type_name], contained), _shipped()["hashes"][type_name])


@functools.cache
def shipped_layout(type_name: str) -> Layout:
    """Fields of a shipped message type.

    Raises:
        KeyError: it is not shipped.
    """
    return read_layout(type_name, shipped_texts()[type_name])


def known_definition(type_name: str) -> Definition:
    """Text and hash of a message type such as ``std_msgs/msg/Header``, of the package or else of the environment.

    Raises:
        UserError: it is not known.
    """
    # The installation is part of the key: a test or an overlay may add packages while the process runs.
    return shipped_definition(type_name) or installed_definition(type_name, share_folders())


def share_folders() -> tuple[Path, ...]:
    """Folders of the message texts of packages: ROS overlays first, then this Python environment."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    return tuple(Path(prefix, "share") for prefix in prefixes if prefix)


@functools.cache
def installed_definition(type_name: str, folders: tuple[Path, ...]) -> Definition:
    """Text and hash of a message type in the first of `folders` that has it.

    Raises:
        UserError: none of them has it.
    """
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


def composed(text: str, contained: dict[str, str]) -> str:
    """The text of a definition from those of a type and of the types that it contains, by name."""
    for name, dependency in contained.items():
        text += f"\n{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{dependency}"
    return text


def _contained(type_name: str) -> set[str]:
    """Names of the types that a shipped type contains, at any depth."""
    own = {field.kind for field in shipped_layout(type_name).fields if field.is_message}
    return own.union(*map(_contained, own))


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
