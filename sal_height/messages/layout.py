"""The fields of message types, read from the text of their definitions.

The language is that of ROS 2 interfaces (https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

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
