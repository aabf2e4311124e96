"""Messages as plain objects."""

from __future__ import annotations

import keyword
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sal_height.messages.definition import ARRAY, CODES, LIST, TEXT, Field, Layout


class Message:
    """A message. Its class has the constants of the type; its attributes are the fields.

    Lists and arrays of numbers are NumPy arrays, other lists are lists. Messages are equal if they have one type and
    the same values, NaN like NaN.

    Attributes:
        __msgtype__: name of the type, such as ``std_msgs/msg/Header``.
    """

    __slots__: ClassVar[tuple[str, ...]] = ()
    __msgtype__: ClassVar[str] = ""

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(is_same(getattr(self, name), getattr(other, name)) for name in self.__slots__)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={getattr(self, name)!r}" for name in self.__slots__)
        return f"{type(self).__name__}({fields})"


def fields_of_message(message: Any) -> tuple[str, ...]:
    """Names of the fields of a message or of a class of messages; none of anything else."""
    kind = message if isinstance(message, type) else type(message)
    return kind.__slots__ if issubclass(kind, Message) else ()


def is_same(one: Any, other: Any) -> bool:
    """True if two values of a field are the same."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        one, other = np.asarray(one), np.asarray(other)
        return bool(np.array_equal(one, other, equal_nan=one.dtype.kind == other.dtype.kind == "f"))
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(is_same, one, other))
    return bool(one == other) or (one != one and other != other)  # noqa: PLR0124 (NaN)


def array_of(values: Any, kind: str) -> NDArray[Any]:
    """Values of a list of numbers as an array; an array of that kind is returned as it is."""
    if isinstance(values, bytes | bytearray):
        return np.frombuffer(values, DTYPES[kind]) if values else np.empty(0, DTYPES[kind])
    return np.asarray(values, DTYPES[kind])


DTYPES = {name: np.dtype(np.bool_ if name == "bool" else code) for name, code in CODES.items()}
"""Types of arrays by the names of numbers."""


def message_class(layout: Layout, class_of: Callable[[str], type[Message]], module: str) -> type[Message]:
    """The class of the messages that have a layout.

    Args:
        layout: layout of the messages.
        class_of: function that returns the class of nested messages by the name of their type.
        module: module from which the class can be imported.
    """
    names = {"array_of": array_of, "np": np, "class_of": class_of}
    arguments, lines = [], []
    for field in layout.fields:
        name = attribute(field.name)
        default, value = _default_and_value(field, name)
        names[f"default_{name}"] = default
        arguments.append(f"{name}=default_{name}")
        lines.append(f" self.{name} = {value}")
    exec("\n".join([f"def __init__(self, {', '.join(arguments)}):", *lines, " pass"]), names)  # noqa: S102 (names are words)
    attributes = {
        "__slots__": tuple(attribute(field.name) for field in layout.fields),
        "__init__": names["__init__"],
        "__msgtype__": layout.type_name,
        "__module__": module,
        **layout.constants,
    }
    return type(layout.type_name.rpartition("/")[2], (Message,), attributes)


def attribute(field_name: str) -> str:
    """Name of the attribute of a field: with an underscore after it where it is a keyword of Python."""
    return f"{field_name}_" if keyword.iskeyword(field_name) else field_name


def _default_and_value(field: Field, name: str) -> tuple[Any, str]:
    """Default of the argument of a field, and the source of the attribute's value."""
    if field.form == LIST and (field.is_message or field.kind == TEXT):
        return None, f"[] if {name} is None else {name}"
    if field.form in {LIST, ARRAY}:
        size = field.size if field.form == ARRAY else 0
        return None, f"np.zeros({size}, {_dtype(field)}) if {name} is None else array_of({name}, {field.kind!r})"
    if field.is_message:
        return None, f"class_of({field.kind!r})() if {name} is None else {name}"
    return _ZERO.get(field.kind, 0) if field.default is None else field.default, name


def _dtype(field: Field) -> str:
    return repr(DTYPES[field.kind].str)


_ZERO = {TEXT: "", "bool": False, "float32": 0.0, "float64": 0.0}
