"""Parts of messages in plain CDR, from which functions that read and write messages are composed."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sal_height.messages.plain import array_of

ENCAPSULATION = 4
"""Bytes before a message, from which its alignment counts."""

ZEROS = tuple(bytes(count) for count in range(8))
"""Padding by its size."""

Put = Callable[[Any], None]


def read_text(cdr: bytes, at: int, unpack: Any, longest: int = 0) -> tuple[str, int]:
    """The text at the next offset that its length may have, and the offset after it.

    Raises:
        ValueError: it is longer than the bytes, or than the type allows.
        struct.error: the bytes are too few.
    """
    at += -at & 3
    (length,) = unpack(cdr, at)
    begin = at + 4
    end = begin + length
    if end > len(cdr):
        raise ValueError(f"it has a text of {length} bytes, and {max(0, len(cdr) - begin)} are left")
    zero = cdr.find(0, begin, end)
    raw = cdr[begin : end if zero < 0 else zero]
    if longest and len(raw) > longest:
        raise ValueError(f"it has a text of {len(raw)} bytes; {longest} are allowed")
    return raw.decode("utf-8", "replace"), end


def read_texts(cdr: bytes, at: int, count: int, unpack: Any, longest: int = 0) -> tuple[list[str], int]:
    """`count` texts, and the offset after them; errors as of `read_text`."""
    check_room(cdr, at, count, 4)
    texts = []
    for _ in range(count):
        text, at = read_text(cdr, at, unpack, longest)
        texts.append(text)
    return texts, at


def read_messages(
    cdr: bytes, at: int, count: int, read: Callable[[bytes, int], tuple[Any, int]], least_bytes: int
) -> tuple[list[Any], int]:
    """`count` messages of a type, each of `least_bytes` or more, and the offset after them."""
    check_room(cdr, at, count, least_bytes)
    found = []
    for _ in range(count):
        one, at = read(cdr, at)
        found.append(one)
    return found, at


def numbers_reader(dtype: np.dtype[Any]) -> Callable[[bytes, int, int], tuple[NDArray[Any], int]]:
    """A function that reads a given number of numbers, one or more, at an offset, and returns the offset after them.

    It gives a view of the bytes, but a copy of numbers of eight bytes, which are not aligned in memory there. It raises
    ValueError if the bytes are too few.
    """
    size, mask = dtype.itemsize, dtype.itemsize - 1
    is_plain, is_copied, frombuffer = dtype.isnative and dtype.kind != "b", size == 8, np.frombuffer

    def read(cdr: bytes, at: int, count: int) -> tuple[NDArray[Any], int]:
        at += ENCAPSULATION - at & mask
        end = at + count * size
        if end > len(cdr):
            raise ValueError(f"it has a list of {count} numbers, which need {end - len(cdr)} bytes more than there are")
        numbers = frombuffer(cdr[at:end], dtype) if is_copied else frombuffer(cdr, dtype, count, at)
        return (numbers if is_plain else as_native(numbers)), end

    return read


def as_native(numbers: NDArray[Any]) -> NDArray[Any]:
    """Numbers in the byte order of this machine; flags are True for any byte but 0."""
    if numbers.dtype.kind == "b":
        return numbers.view(np.uint8) != 0
    return numbers if numbers.dtype.isnative else numbers.astype(numbers.dtype.newbyteorder("="))


def check_room(cdr: bytes, at: int, count: int, least_bytes: int) -> None:
    """Check that the remaining bytes can contain `count` elements of a list.

    Raises:
        ValueError: they cannot.
    """
    if count * least_bytes > len(cdr) - at:
        raise ValueError(f"it has a list of {count} elements, and {max(0, len(cdr) - at)} bytes are left")


def check_count(count: int, most: int) -> None:
    """Check that a list has no more elements than its type allows.

    Raises:
        ValueError: it has.
    """
    if count > most:
        raise ValueError(f"it has a list of {count} elements; {most} are allowed")


def write_text(put: Put, at: int, text: str, longest: int = 0) -> int:
    """Put a text; returns the offset after it.

    Raises:
        ValueError: it is longer than the type allows.
    """
    raw = text.encode()
    if longest and len(raw) > longest:
        raise ValueError(f"a text has {len(raw)} bytes; {longest} are allowed")
    padding = -at & 3
    put(b"%b%b%b\0" % (ZEROS[padding], COUNT.pack(len(raw) + 1), raw))
    return at + padding + 5 + len(raw)


def write_texts(put: Put, at: int, texts: Sequence[str], most: int, longest: int = 0) -> int:
    """Put a list of texts, at most `most` (0: any number); returns the offset after it."""
    at = write_count(put, at, len(texts), most)
    for text in texts:
        at = write_text(put, at, text, longest)
    return at


def write_messages(put: Put, at: int, messages: Sequence[Any], most: int, write: Callable[[Any, Put, int], int]) -> int:
    """Put a list of messages, at most `most` (0: any number); returns the offset after it."""
    at = write_count(put, at, len(messages), most)
    for message in messages:
        at = write(message, put, at)
    return at


def write_numbers(put: Put, at: int, values: Any, most: int, kind: str, dtype: np.dtype[Any]) -> int:
    """Put a list of numbers, at most `most` (0: any number); returns the offset after it."""
    numbers = np.ascontiguousarray(values if isinstance(values, np.ndarray) else array_of(values, kind), dtype)
    at = write_count(put, at, numbers.size, most)
    if numbers.size:
        if padding := ENCAPSULATION - at & numbers.itemsize - 1:
            put(ZEROS[padding])
        put(numbers)
        at += padding + numbers.nbytes
    return at


def write_count(put: Put, at: int, count: int, most: int) -> int:
    """Put the number of elements of a list; returns the offset after it.

    Raises:
        ValueError: it is greater than `most` (0: any number).
    """
    if most:
        check_count(count, most)
    padding = -at & 3
    put(ZEROS[padding] + COUNT.pack(count))
    return at + padding + 4


def bytes_of(values: Any, kind: str, dtype: np.dtype[Any], size: int) -> bytes:
    """The bytes of a fixed number of numbers.

    Raises:
        ValueError: there are more or less.
    """
    numbers = np.asarray(array_of(values, kind), dtype)
    if numbers.size != size:
        raise ValueError(f"an array has {numbers.size} numbers; it must have {size}")
    return numbers.tobytes()


COUNT = struct.Struct("<I")
