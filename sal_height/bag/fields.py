"""The content of a message as arrays by the names of its fields, whatever its type."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sal_height.messages.plain import fields_of_message

TIMES = {"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"}
"""Types of messages that are one value, in nanoseconds."""

NUMBERS_OF_SAMPLES = {"complex_float32": "<f4", "complex_int16": "<i2"}
"""Type of the numbers in `samples`, two of which make a sample, by the name of their encoding."""


def fields_of(message: Any, without: frozenset[str] = frozenset()) -> dict[str, NDArray[Any]]:
    """All values of a message, as arrays of one dimension by name.

    Args:
        message: message of any type.
        without: fields of the message itself that are left out.

    Returns:
        Numbers and texts by names such as "grid.rows" and "surfaces[0].height"; a time or duration is whole
        nanoseconds, complex samples are complex numbers. An empty list is an empty array.
    """
    names = [name for name in fields_of_message(message) if name not in without]
    return dict(entry for name in names for entry in _entries(name, getattr(message, name), message))


def content_hash(fields: Mapping[str, NDArray[Any]]) -> bytes:
    """SHA-256 of names and values; it does not depend on the padding of a serialized message, nor on a NaN's bits."""
    digest = hashlib.sha256()
    for name, values in fields.items():
        digest.update(f"{name} {values.dtype.str} {values.size}\n".encode())
        digest.update(np.ascontiguousarray(_canonical(values)).tobytes())
    return digest.digest()


def _canonical(values: NDArray[Any]) -> NDArray[Any]:
    """The values with one NaN in place of all others, and without negative zeros."""
    if values.dtype.kind not in "fc":
        return values
    return np.where(np.isnan(values), values.dtype.type(np.nan), values) + values.dtype.type(0)


def _entries(name: str, value: Any, holder: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    if getattr(value, "__msgtype__", "") in TIMES:
        yield name, np.array([value.sec * 10**9 + value.nanosec], np.int64)
    elif fields_of_message(value):
        for inner, values in fields_of(value).items():
            yield f"{name}.{inner}", values
    elif isinstance(value, list) and value and fields_of_message(value[0]):
        for number, element in enumerate(value):
            yield from _entries(f"{name}[{number}]", element, holder)
    elif name == "samples":
        yield name, _samples(value, NUMBERS_OF_SAMPLES.get(getattr(holder, "encoding", "")))
    elif isinstance(value, np.ndarray | list):
        yield name, np.asarray(value)
    else:
        yield name, np.array([value])


def _samples(data: Any, numbers: str | None) -> NDArray[Any]:
    """Samples as complex numbers; the numbers as they are where there are not whole samples."""
    values = np.asarray(data)
    if numbers and values.nbytes % np.dtype(numbers).itemsize == 0:
        values = np.frombuffer(data, numbers)
    if values.dtype.kind == "u" or values.size % 2:
        return values
    real, imaginary = values.astype(np.float32).reshape(-1, 2).T
    return (real + 1j * imaginary).astype(np.complex64)
