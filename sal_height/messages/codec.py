"""Messages as plain objects, to CDR bytes and back, by the text of their definitions and without ROS.

A type has a class, a function that reads its messages and one that writes them; `programs` writes their source, once
for each type that is used. Equal messages give equal bytes: padding is zero, and nothing follows the last field.

The layout is that of plain CDR (OMG DDS-XTypes 1.3, section 7.4.3), which ROS middlewares use. Texts are read as rclpy
reads them: they end at their first zero byte, and bytes that are not UTF-8 are replaced. Bytes after the last field,
which some serializers append, are skipped. Lists of numbers are views of the bytes, but for numbers of eight bytes,
which are copied.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Mapping
from typing import Any

from sal_height.messages.cdr_parts import ENCAPSULATION
from sal_height.messages.definition import Definition, Layout, read_layouts, shipped_layout
from sal_height.messages.programs import Programs, Read

BIG_ENDIAN, LITTLE_ENDIAN = b"\x00\x00", b"\x00\x01"
"""First bytes of a message in plain CDR."""

HEAD = LITTLE_ENDIAN + b"\x00\x00"


class BrokenMessage(RuntimeError):  # noqa: N818 (not an error of the program)
    """Bytes that are not a message of their type; the text completes a message to the user."""


class TypeStore:
    """Types of messages, and the functions that read and write them."""

    def __init__(self, layout_of: Callable[[str], Layout], module: str = __name__) -> None:
        """Create a store.

        Args:
            layout_of: function that returns the layout of a type by its name, or raises KeyError.
            module: module from which the classes can be imported.
        """
        self._programs = Programs(layout_of, module)
        self._readers: dict[tuple[str, bool], Callable[[bytes], Any]] = {}

    def layout(self, type_name: str) -> Layout:
        """The fields of a type.

        Raises:
            KeyError: it is not known.
        """
        return self._programs.layout(type_name)

    def message_class(self, type_name: str) -> type[Any]:
        """The class of the messages of a type.

        Raises:
            KeyError: it is not known.
        """
        return self._programs.message_class(type_name)

    def reader(self, type_name: str, *, shared: bool = False) -> Callable[[bytes], Any]:
        """The function that reads a message of a type from its bytes, or raises BrokenMessage if they are invalid.

        Args:
            type_name: name of the type.
            shared: True if messages may share their provenance, which must then not be changed.

        Raises:
            KeyError: the type is not known.
        """
        key = type_name, shared
        if key not in self._readers:
            self._readers[key] = _guarded(
                self._programs.reader(type_name, "<", shared=shared),
                self._programs.reader(type_name, ">", shared=shared),
            )
        return self._readers[key]

    def serialize(self, message: Any, *, shared: bool = False) -> bytes:
        """The bytes of a message.

        Args:
            message: message of a class of this store.
            shared: True if its provenance is never changed, so that its bytes can be cached for further messages.

        Raises:
            ValueError, TypeError, OverflowError, struct.error, AttributeError: a field has a value that its type does
                not allow.
        """
        parts = [HEAD]
        self._programs.writer(message.__msgtype__, shared=shared)(message, parts.append, ENCAPSULATION)
        return b"".join(parts)


def _guarded(read_little: Read, read_big: Read) -> Callable[[bytes], Any]:
    """A function that reads a message in either byte order, and raises BrokenMessage if it cannot."""

    def read(cdr: bytes) -> Any:
        try:
            if cdr.startswith(LITTLE_ENDIAN):
                return read_little(cdr, ENCAPSULATION)[0]
            if cdr.startswith(BIG_ENDIAN):
                return read_big(cdr, ENCAPSULATION)[0]
        except struct.error as error:
            raise BrokenMessage("it ends before its last field") from error
        except ValueError as error:
            raise BrokenMessage(str(error)) from error
        raise BrokenMessage("it is not in plain CDR")

    return read


SHIPPED = TypeStore(shipped_layout, "sal_height.messages.types")
"""The types of this package and those of ROS that it reads and writes."""


def serialize(message: Any) -> bytes:
    """The bytes of a message of a shipped type: zeros as padding, nothing after the last field.

    Raises:
        ValueError, TypeError, OverflowError, struct.error, AttributeError: a field has a value that its type does
            not allow.
    """
    return SHIPPED.serialize(message)


def deserialize(cdr: bytes, kind: type[Any] | str, *, shared: bool = False) -> Any:
    """Read bytes as a message of a shipped type.

    Args:
        cdr: bytes of the message.
        kind: class of the message, or name of its type.
        shared: True if messages may share their provenance, which must then not be changed.

    Raises:
        BrokenMessage: the bytes are not such a message.
        KeyError: the type is not shipped.
    """
    return SHIPPED.reader(kind if isinstance(kind, str) else kind.__msgtype__, shared=shared)(cdr)


@functools.lru_cache(maxsize=64)
def recorded_types(type_name: str, definition: Definition) -> TypeStore:
    """The types that a definition in a bag describes, `type_name` and those that it contains.

    Raises:
        ValueError: the text is not a definition.
    """
    layouts: Mapping[str, Layout] = read_layouts(type_name, definition.text)
    return TypeStore(layouts.__getitem__)
