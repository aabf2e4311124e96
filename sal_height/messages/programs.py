"""The functions that read and write messages, and their classes, made from layouts as Python source.

Neighbouring numbers are read and written at once, also those of nested messages. Offsets count from the beginning of
the bytes, alignment from ENCAPSULATION.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from sal_height.messages import cdr_parts as parts
from sal_height.messages.definition import ARRAY, CODES, LIST, TEXT, Field, Layout
from sal_height.messages.plain import DTYPES, Message, attribute, message_class

SHARED: Mapping[str, int] = {"sal_height_msgs/msg/Provenance": 16}
"""Types of which several messages may share an object, and the number of them whose bytes are cached. It must be the
last field of those that have it."""

PARTS: Mapping[str, int] = {"rcl_interfaces/msg/Parameter": 512}
"""Types of the elements of these that are cached one by one, for most are the same from one to the next."""

KEPT = {**SHARED, **PARTS}
"""Types whose messages are cached, read and written, if they are never changed."""

Order = Literal["<", ">"]
"""Order of bytes: the least significant first, or last."""

Read = Callable[[bytes, int], tuple[Any, int]]
Write = Callable[[Any, parts.Put, int], int]


class Programs:
    """Classes, readers and writers of the types of a store, each made when it is first needed.

    Attributes:
        layout: function that returns the layout of a type by its name, or raises KeyError.
    """

    def __init__(self, layout: Callable[[str], Layout], module: str) -> None:
        """Start without types; `module`: module from which their classes can be imported."""
        self.layout = layout
        self._module = module
        self._classes: dict[str, type[Message]] = {}
        self._readers: dict[tuple[str, Order, bool], Read] = {}
        self._writers: dict[tuple[str, bool], Write] = {}
        self._sizes: dict[str, tuple[int, int]] = {}

    def message_class(self, type_name: str) -> type[Message]:
        """The class of the messages of a type."""
        if type_name not in self._classes:
            made = message_class(self.layout(type_name), self.message_class, self._module)
            self._classes.setdefault(type_name, made)  # another thread may have been faster
        return self._classes[type_name]

    def reader(self, type_name: str, order: Order, *, shared: bool) -> Read:
        """The function that reads a message of a type.

        Args:
            type_name: name of the type.
            order: order of bytes, "<" or ">".
            shared: True if messages share their parts of the types SHARED and PARTS.
        """
        key = type_name, order, shared
        if key not in self._readers:
            made = _ReaderSource(self, order, shared=shared).function(type_name)
            if shared and type_name in SHARED:
                made = _shared_reader(made, SHARED[type_name])
            elif shared and type_name in PARTS:
                made = _parts_reader(made, PARTS[type_name])
            self._readers.setdefault(key, made)  # another thread may have been faster
        return self._readers[key]

    def writer(self, type_name: str, *, shared: bool) -> Write:
        """The function that writes the parts of a message and returns the offset after it.

        Args:
            type_name: name of the type.
            shared: True if parts of the types SHARED and PARTS are never changed, so that their bytes can be cached.
        """
        key = type_name, shared
        if key not in self._writers:
            made = _WriterSource(self, shared=shared).function(type_name)
            if shared and type_name in KEPT:
                made = _shared_writer(made, KEPT[type_name])
            self._writers.setdefault(key, made)
        return self._writers[key]

    def is_inlined(self, type_name: str) -> bool:
        """True if a nested message of a type is read and written by the function of its parent."""
        return self._size(type_name)[0] <= 64  # numbers, texts and lists

    def least_bytes(self, type_name: str) -> int:
        """Least number of bytes of a message of a type."""
        return self._size(type_name)[1]

    def _size(self, type_name: str, depth: int = 0) -> tuple[int, int]:
        """Numbers, texts and lists of a message of a type, and its least bytes.

        Raises:
            ValueError: it contains itself, or has a field of a kind that is not read.
        """
        deepest = 32  # levels of nested messages
        if depth > deepest:
            raise ValueError(f"{type_name} contains messages at more than {deepest} levels")
        if type_name not in self._sizes:
            sizes = [self._size_of_field(field, depth) for field in self.layout(type_name).fields]
            self._sizes[type_name] = sum(leaves for leaves, _ in sizes), sum(least for _, least in sizes)
        return self._sizes[type_name]

    def _size_of_field(self, field: Field, depth: int) -> tuple[int, int]:
        inner = self._size(field.kind, depth + 1) if field.is_message else (1, 4)
        if field.form == ARRAY and field.kind not in CODES:
            raise ValueError(f"field {field.name} is an array of texts or messages, which is not read")
        if field.form == LIST or field.kind == TEXT:
            return 1, 4
        count = field.size if field.form == ARRAY else 1
        return inner if field.is_message else (1, count * DTYPES[field.kind].itemsize)


def _shared_reader(read: Read, most: int) -> Read:
    """A function that reads a message at the end of the bytes, and returns the same object for the same bytes.

    Args:
        read: function that reads the message.
        most: number of messages that are kept, those used last.
    """

    @lru_cache(most)
    def kept(tail: bytes, place: int) -> tuple[Any, int]:
        begin = parts.ENCAPSULATION + place
        message, end = read(bytes(begin) + tail, begin)
        return message, end - begin

    def read_shared(cdr: bytes, at: int) -> tuple[Any, int]:
        message, size = kept(cdr[at:], at - parts.ENCAPSULATION & 7)
        return message, at + size

    return read_shared


def _parts_reader(read: Read, most: int) -> Read:
    """A function that reads a message, and returns the same object where the bytes are those it read there last.

    What is kept is read from a copy of its own bytes, for lists of numbers are views, and is not large.

    Args:
        read: function that reads the message.
        most: number of offsets for which a message is kept.
    """
    kept: dict[int, tuple[bytes, Any]] = {}

    def read_part(cdr: bytes, at: int) -> tuple[Any, int]:
        known, message = kept.get(at, (b"", None))
        if known and cdr.startswith(known, at):
            return message, at + len(known)
        message, end = read(cdr, at)
        largest = 4096  # bytes of a part that is kept
        if end - at > largest:
            return message, end
        known, begin = cdr[at:end], parts.ENCAPSULATION + (at - parts.ENCAPSULATION & 7)
        message, _ = read(bytes(begin) + known, begin)
        if len(kept) >= most:
            kept.clear()
        kept[at] = known, message
        return message, end

    return read_part


def _shared_writer(write: Write, most: int) -> Write:
    """A function that writes a message that is never changed; caches the bytes of `most` messages."""
    kept: dict[tuple[int, int], tuple[Any, bytes]] = {}  # with the message, so that no other one gets its identity

    def write_shared(message: Any, put: parts.Put, at: int) -> int:
        key = id(message), at - parts.ENCAPSULATION & 7
        found = kept.get(key)
        if found is None:
            made: list[Any] = []
            write(message, made.append, parts.ENCAPSULATION + key[1])
            if len(kept) >= most:
                kept.clear()
            found = kept[key] = message, b"".join(made)
        put(found[1])
        return at + len(found[1])

    return write_shared


class _Source:
    """Source of a function, and the objects it needs.

    Numbers wait until something else follows, to be read or written at once.
    """

    def __init__(self, programs: Programs, order: Order, *, shared: bool) -> None:
        self.programs, self.order, self.shared = programs, order, shared
        self.lines: list[str] = []
        self.names: dict[str, Any] = {"parts": parts, "frombuffer": np.frombuffer}
        self.known = 1
        """Bytes of which the offset is known to be a multiple, from ENCAPSULATION."""
        self.codes = ""
        self.waiting: list[str] = []
        self.size = 0

    def line(self, text: str) -> None:
        self.lines.append(f" {text}")

    def name(self, value: Any, stem: str) -> str:
        """A name by which the function knows a value."""
        name = f"{stem}{len(self.names)}"
        self.names[name] = value
        return name

    def add(self, code: str, align: int, size: int, expression: str) -> None:
        """Add numbers to those that wait; the first is at a multiple of `align` bytes."""
        padding = -self.size % align
        if align > self.known:
            self.flush()
            self.align(align)
            padding = 0
        self.codes += f"{padding}x{code}" if padding else code
        self.size += padding + size
        self.waiting.append(expression)

    def flush(self) -> None:
        """Read or write the numbers that wait."""
        if self.size:
            self.move()
            self.line(f"at += {self.size}")
            self.known = min(self.known, self.size & -self.size)
        self.codes, self.waiting, self.size = "", [], 0

    def move(self) -> None:
        """Read or write the numbers that wait, at the offset."""
        raise NotImplementedError

    def align(self, size: int) -> None:
        """Go to the next multiple of a number of bytes."""
        self.line(f"at += 4 - at & {size - 1}")
        self.known = size

    def compile(self, head: str, result: str) -> Any:
        source = "\n".join([f"def program({head}):", *self.lines, f" return {result}"])
        exec(source, self.names)  # noqa: S102 (names of fields are words, and constants are not in it)
        return self.names["program"]

    def dtype(self, field: Field) -> np.dtype[Any]:
        return DTYPES[field.kind].newbyteorder(self.order)


class _ReaderSource(_Source):
    """Source of a function that reads a message."""

    def __init__(self, programs: Programs, order: Order, *, shared: bool) -> None:
        super().__init__(programs, order, shared=shared)
        self.making: list[str] = []
        """Lines that make the messages, once all fields are read."""
        self.names |= {"unpack": struct.Struct(f"{order}I").unpack_from, "new": object.__new__}

    def function(self, type_name: str) -> Read:
        self.programs.least_bytes(type_name)  # refuses types that cannot be read
        result = self.message(type_name)
        self.flush()
        self.lines += self.making
        return self.compile("cdr, at", f"{result}, at")

    def message(self, type_name: str) -> str:
        """Read the fields of a message; returns its variable."""
        fields = self.programs.layout(type_name).fields
        values = [(attribute(field.name), self.field(field)) for field in fields]
        made = self.variable()
        self.making.append(f" {made} = new({self.name(self.programs.message_class(type_name), 'Made')})")
        self.making += [f" {made}.{name} = {value}" for name, value in values]
        return made

    def field(self, field: Field) -> str:
        if field.form == LIST:
            return self.list(field)
        if field.is_message:
            return self.nested(field.kind)
        if field.kind == TEXT:
            return self.call(f"parts.read_text(cdr, at, unpack, {field.longest})")
        variable, dtype = self.variable(), self.dtype(field)
        if field.form == ARRAY:
            self.add(f"{field.size * dtype.itemsize}s", dtype.itemsize, field.size * dtype.itemsize, variable)
            made = f"frombuffer({variable}, {self.name(dtype, 'dtype')})"
            return made if dtype.isnative and dtype.kind != "b" else f"parts.as_native({made})"
        self.add(CODES[field.kind], dtype.itemsize, dtype.itemsize, variable)
        return variable

    def nested(self, type_name: str) -> str:
        if self.programs.is_inlined(type_name) and not (self.shared and type_name in KEPT):
            return self.message(type_name)
        return self.call(f"{self.reader(type_name)}(cdr, at)")

    def list(self, field: Field) -> str:
        count = self.variable()
        self.add("I", 4, 4, count)
        self.flush()
        if field.size:
            self.line(f"parts.check_count({count}, {field.size})")
        if field.is_message:
            least = self.programs.least_bytes(field.kind)
            return self.several(
                count, f"parts.read_messages(cdr, at, {count}, {self.reader(field.kind)}, {least})", "[]"
            )
        if field.kind == TEXT:
            return self.several(count, f"parts.read_texts(cdr, at, {count}, unpack, {field.longest})", "[]")
        dtype = self.dtype(field)
        none = self.name(np.empty(0, DTYPES[field.kind]), "none")
        variable = self.several(count, f"{self.name(parts.numbers_reader(dtype), 'read')}(cdr, at, {count})", none)
        self.known = min(4, dtype.itemsize)
        return variable

    def several(self, count: str, call: str, none: str) -> str:
        """Read the elements of a list by a function, if it has any; returns the variable of the list."""
        variable = self.variable()
        self.line(f"if {count}: {variable}, at = {call}")
        self.line(f"else: {variable} = {none}")
        self.known = 1
        return variable

    def reader(self, type_name: str) -> str:
        return self.name(self.programs.reader(type_name, self.order, shared=self.shared), "read")

    def call(self, call: str) -> str:
        """Read by a function, after the numbers that wait; returns the variable of its result."""
        self.flush()
        variable = self.variable()
        self.line(f"{variable}, at = {call}")
        self.known = 1
        return variable

    def variable(self) -> str:
        self.names[name := f"value{len(self.names)}"] = None
        return name

    def move(self) -> None:
        unpack = self.name(struct.Struct(self.order + self.codes).unpack_from, "unpack")
        self.line(f"{', '.join(self.waiting)}, = {unpack}(cdr, at)")


class _WriterSource(_Source):
    """Source of a function that writes the parts of a message."""

    def __init__(self, programs: Programs, *, shared: bool) -> None:
        super().__init__(programs, "<", shared=shared)

    def function(self, type_name: str) -> Write:
        self.programs.least_bytes(type_name)  # refuses types that cannot be written
        self.message("message", type_name)
        self.flush()
        return self.compile("message, put, at", "at")

    def message(self, message: str, type_name: str) -> None:
        for field in self.programs.layout(type_name).fields:
            self.field(f"{message}.{attribute(field.name)}", field)

    def field(self, value: str, field: Field) -> None:
        dtype = self.dtype(field) if field.kind in CODES else None
        if field.form == LIST:
            self.list(value, field)
        elif field.is_message:
            self.nested(value, field.kind)
        elif field.kind == TEXT:
            self.call(f"parts.write_text(put, at, {value}, {field.longest})")
        elif dtype and field.form == ARRAY:
            size = field.size * dtype.itemsize
            made = f"parts.bytes_of({value}, {field.kind!r}, {self.name(dtype, 'dtype')}, {field.size})"
            self.add(f"{size}s", dtype.itemsize, size, made)
        elif dtype:
            self.add(CODES[field.kind], dtype.itemsize, dtype.itemsize, value)

    def nested(self, value: str, type_name: str) -> None:
        if self.programs.is_inlined(type_name) and not (self.shared and type_name in KEPT):
            self.message(value, type_name)
        else:
            self.call(f"{self.writer(type_name)}({value}, put, at)")

    def list(self, value: str, field: Field) -> None:
        if field.is_message:
            self.call(f"parts.write_messages(put, at, {value}, {field.size}, {self.writer(field.kind)})")
        elif field.kind == TEXT:
            self.call(f"parts.write_texts(put, at, {value}, {field.size}, {field.longest})")
        else:
            dtype = self.name(self.dtype(field), "dtype")
            self.call(f"parts.write_numbers(put, at, {value}, {field.size}, {field.kind!r}, {dtype})")

    def writer(self, type_name: str) -> str:
        return self.name(self.programs.writer(type_name, shared=self.shared), "write")

    def call(self, call: str) -> None:
        self.flush()
        self.line(f"at = {call}")
        self.known = 1

    def align(self, size: int) -> None:
        self.line(f"padding = 4 - at & {size - 1}")
        self.line("if padding: put(parts.ZEROS[padding])")
        self.line("at += padding")
        self.known = size

    def move(self) -> None:
        pack = self.name(struct.Struct(self.order + self.codes).pack, "pack")
        self.line(f"put({pack}({', '.join(self.waiting)}))")
