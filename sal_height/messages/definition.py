"""Definitions of message types: texts and hashes, of the package and of the environment, and the fields in a text.

The language is that of ROS 2 interfaces (https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html).
"""

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
from types import MappingProxyType
from typing import Any

from sal_height.errors import UserError

SEPARATOR = "=" * 80
"""Line before each contained type in the definition of a type."""

CODES: Mapping[str, str] = MappingProxyType(
    {
        "bool": "?",
        "byte": "B",
        "char": "B",
        "int8": "b",
        "uint8": "B",
        "int16": "h",
        "uint16": "H",
        "int32": "i",
        "uint32": "I",
        "int64": "q",
        "uint64": "Q",
        "float32": "f",
        "float64": "d",
    }
)
"""Letters of the module struct by the names of numbers."""

TEXT = "string"

SINGLE, ARRAY, LIST = "single", "array", "list"
"""Forms of a field: one value, a fixed number of values, and any number of values up to a limit."""

_TYPE = re.compile(r"(?P<kind>[A-Za-z]\w*(?:/[A-Za-z]\w*){0,2})(?:<=(?P<longest>\d+))?(?P<list>\[(?:<=)?\d*\])?")
_NAME = re.compile(r"[A-Za-z]\w*")


@dataclass(frozen=True)
class Field:
    """A field of a message type.

    Attributes:
        name: name of the field.
        kind: type of the values: a number of CODES, TEXT, or the name of a message type.
        form: form of the field, SINGLE, ARRAY or LIST.
        size: number of elements of an array; greatest number of elements of a list, 0: no limit.
        longest: greatest number of bytes of a text; 0: no limit.
        default: value of a single number or text in a new message.
    """

    name: str
    kind: str
    form: str = SINGLE
    size: int = 0
    longest: int = 0
    default: Any = None

    @property
    def is_message(self) -> bool:
        """True if its values are messages."""
        return "/" in self.kind


NO_FIELD = Field("structure_needs_at_least_one_member", "uint8")
"""Field of a message whose type states no field, by ROS's rules."""


@dataclass(frozen=True)
class Layout:
    """Fields and constants of a message type.

    Attributes:
        type_name: name of the type, such as ``std_msgs/msg/Header``.
        fields: fields in the order of the message.
        constants: values of its constants by name.
    """

    type_name: str
    fields: tuple[Field, ...]
    constants: Mapping[str, Any]


def read_layout(type_name: str, text: str) -> Layout:
    """The layout of a type by its own text, without those of the types that it contains.

    Raises:
        ValueError: a line is no part of a definition, or of an unknown kind.
    """
    package = type_name.partition("/")[0]
    fields, constants = [], {}
    for line in text.splitlines():
        words = line.partition("#")[0].strip()
        if not words:
            continue
        kind, *others = words.split(maxsplit=1)
        rest = "".join(others)
        name, equals, value = (part.strip() for part in rest.partition("="))
        if equals and _NAME.fullmatch(name) and (kind in CODES or kind.startswith(TEXT)):
            constants[name] = _value(kind, value)
        else:
            fields.append(_field(package, kind, rest))
    if len({field.name for field in fields}) != len(fields):
        raise ValueError(f"{type_name} has two fields of one name")
    return Layout(type_name, tuple(fields or [NO_FIELD]), MappingProxyType(constants))


def read_layouts(type_name: str, text: str) -> dict[str, Layout]:
    """The layouts of a type and of those that it contains, by name, from the definition in a bag.

    Raises:
        ValueError: the text is not a definition.
    """
    own, *others = re.split(rf"^{SEPARATOR}\n", text, flags=re.MULTILINE)
    layouts = {type_name: read_layout(type_name, own)}
    for section in others:
        title, _, body = section.partition("\n")
        name = full_name(title.removeprefix("MSG:").strip())
        layouts[name] = read_layout(name, body)
    return layouts


def full_name(name: str, package: str = "") -> str:
    """The name of a message type with package and ``msg``; `package`: that of a name without.

    Raises:
        ValueError: it is no name of a message type.
    """
    parts = name.split("/")
    if len(parts) == 3 and parts[1] == "msg":
        return name
    if len(parts) > 2 or not (package or len(parts) == 2):
        raise ValueError(f"{name!r} is no message type")
    return f"{parts[0] if len(parts) == 2 else package}/msg/{parts[-1]}"


def _field(package: str, type_text: str, rest: str) -> Field:
    name, *defaults = rest.split(maxsplit=1) or [""]
    match = _TYPE.fullmatch(type_text)
    if match is None or _NAME.fullmatch(name) is None:
        raise ValueError(f"{f'{type_text} {rest}'!r} is no field of a message")
    kind, brackets = match["kind"], match["list"] or ""
    if kind not in CODES and kind != TEXT:
        kind = full_name(kind, package)
    form = SINGLE if not brackets else ARRAY if brackets[1:-1].isdecimal() else LIST
    value = _value(kind, defaults[0]) if defaults and form == SINGLE and "/" not in kind else None
    return Field(name, kind, form, int(brackets.strip("[]<=") or 0), int(match["longest"] or 0), value)


def _value(kind: str, text: str) -> Any:
    """The value that a text stands for in a definition.

    Raises:
        ValueError: it stands for none of that kind.
    """
    if kind.startswith(TEXT):
        return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text
    if kind == "bool":
        return text.lower() in {"true", "1"}
    return float(text) if kind.startswith("float") else int(text, 0)


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
