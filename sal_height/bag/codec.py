"""Messages to CDR bytes and back by the text of their definition, for bags.

rclpy's own serializer leaves padding uninitialised and may append bytes that belong to no field (it keeps the size that
it had estimated), which other readers refuse. Here equal messages give equal bytes, and nothing follows the last field.
"""

from __future__ import annotations

import array
import functools
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from sal_height.bag.definitions import Definition, installed_definition


def serialized(message: Any) -> bytes:
    """CDR bytes of a message of an installed type: zeros as padding, nothing after the last field."""
    type_name = _type_name(message)
    store = typestore(type_name, installed_definition(type_name))
    return bytes(store.serialize_cdr(_plain(message, store), type_name))


@functools.cache
def typestore(type_name: str, definition: Definition) -> Typestore:
    """The types that a definition describes, `type_name` and those that it contains."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition.text, type_name))
    return store


def _type_name(message: Any) -> str:
    package, kind, *_ = type(message).__module__.split(".")
    return f"{package}/{kind}/{type(message).__name__}"


def _plain(message: Any, store: Typestore) -> Any:
    """The message as the class that the store has for its type."""
    kinds = message.get_fields_and_field_types()
    values = {name: _value(getattr(message, name), kind, store) for name, kind in kinds.items()}
    return store.types[_type_name(message)](**values)


def _value(value: Any, kind: str, store: Typestore) -> Any:
    """The value of a field of that kind, with arrays of numbers as NumPy has them."""
    if hasattr(value, "get_fields_and_field_types"):
        return _plain(value, store)
    if isinstance(value, array.array):
        return np.frombuffer(value, value.typecode) if value else np.empty(0, value.typecode)
    if kind.startswith("sequence<octet"):
        return np.frombuffer(b"".join(value), np.uint8)
    if kind.startswith("sequence<boolean"):
        return np.array(value, dtype=np.bool_)
    if isinstance(value, list):
        return [_value(one, "", store) for one in value]
    return value
