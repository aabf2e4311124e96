"""Texts and hashes of message types, by which programs understand each other and bags."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass

from sal_height.messages.definitions import HASHES, TEXTS
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
def shipped_definition(type_name: str) -> Definition | None:
    """Text and hash of a shipped message type; None if it is not shipped."""
    if type_name not in TEXTS:
        return None
    contained = {name: TEXTS[name] for name in sorted(_contained(type_name))}
    return Definition(composed(TEXTS[type_name], contained), HASHES[type_name])


@functools.cache
def shipped_layout(type_name: str) -> Layout:
    """Fields of a shipped message type.

    Raises:
        KeyError: it is not shipped.
    """
    return read_layout(type_name, TEXTS[type_name])


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
