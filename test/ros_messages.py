"""Plain messages beside those of rclpy, and bytes that are spoiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sal_height.messages import serialize
from sal_height.messages.codec import SHIPPED
from sal_height.messages.definition import ARRAY, LIST, SINGLE, TEXT, Field, shipped_definition
from sal_height.messages.plain import DTYPES, is_same
from sal_height.nodes.transport.message_types import message_class


def of_rclpy(message: Any) -> bytes:
    """The bytes that rclpy makes of a message that says the same."""
    return serialize_message(read_by_rclpy(serialize(message), message.__msgtype__))


def read_by_rclpy(cdr: bytes, type_name: str) -> Any:
    """rclpy's message of the bytes; RuntimeError: they are none."""
    return deserialize_message(cdr, message_class(type_name))


def in_other_byte_order(message: Any) -> bytes:
    """The bytes of a message with the most significant ones first, as rosbags writes them."""
    definition = shipped_definition(message.__msgtype__)
    assert definition
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition.text, message.__msgtype__))
    return bytes(store.serialize_cdr(message, message.__msgtype__, little_endian=False))


def assert_same_as_rclpy(message: Any, other: Any) -> None:
    """A plain message says what one of rclpy does."""
    for field in SHIPPED.layout(message.__msgtype__).fields:
        ours, theirs = getattr(message, field.name), getattr(other, field.name)
        if field.is_message and field.form == SINGLE:
            assert_same_as_rclpy(ours, theirs)
        elif field.is_message:
            assert len(ours) == len(theirs)
            for one, another in zip(ours, theirs, strict=True):
                assert_same_as_rclpy(one, another)
        else:
            assert is_same(ours, _plain(theirs, field)), field


def _plain(value: Any, field: Field) -> Any:
    """A value of rclpy, which has a byte as bytes, and lists of numbers in several ways."""
    if field.kind == "byte":
        return value[0] if field.form == SINGLE else np.frombuffer(b"".join(value), np.uint8)
    return value if field.form == SINGLE or field.kind == TEXT else np.array(value, DTYPES[field.kind])


def random_message(type_name: str, rng: np.random.Generator) -> Any:
    """A message of a type with some value in every field; lists have up to four elements, texts up to eight letters."""
    message = SHIPPED.message_class(type_name)()
    for field in SHIPPED.layout(type_name).fields:
        if field.form == SINGLE:
            value = _random(field, rng)
        else:
            count = field.size if field.form == ARRAY else int(rng.integers((field.size or 4) + 1))
            values = [_random(field, rng) for _ in range(count)]
            value = values if field.is_message or field.kind == TEXT else np.array(values, DTYPES[field.kind])
        assert field.form != LIST or field.kind not in DTYPES or value.dtype == DTYPES[field.kind]
        setattr(message, field.name, value)
    return message


def _random(field: Field, rng: np.random.Generator) -> Any:
    if field.is_message:
        return random_message(field.kind, rng)
    if field.kind == TEXT:
        return "".join(rng.choice(list("abcü高 "), rng.integers(9)))
    if field.kind == "bool":
        return bool(rng.integers(2))
    if field.kind.startswith("float"):
        return float(rng.standard_normal(dtype=np.float32))
    limits = np.iinfo(DTYPES[field.kind])
    most = 127 if field.kind == "byte" else limits.max  # rosbags writes no greater ones
    return int(rng.integers(limits.min, most, endpoint=True, dtype=DTYPES[field.kind]))


def spoiled(whole: np.ndarray, number: int, rng: np.random.Generator) -> bytes:
    """Bytes of a message, a third of them cut off somewhere, others changed at places or in a whole number."""
    changed = whole[: rng.integers(len(whole) + 1) if number % 3 == 0 else None].copy()
    if len(changed) and number % 3 != 1:
        changed[rng.integers(len(changed), size=2)] = rng.integers(4 if number % 2 else 256, size=2)
    elif len(changed) > 4:
        changed[4 * rng.integers(1, len(changed) // 4) + np.arange(4)] = (rng.integers(256), 0, 0, 0)
    return changed.tobytes()
