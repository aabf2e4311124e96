"""Malformed and hostile messages, made of good ones with a seeded generator."""

from __future__ import annotations

import copy
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from sal_height.messages import deserialize, serialize
from sal_height.messages.plain import fields_of_message

FLOATS = (float("nan"), float("inf"), float("-inf"), 0.0, -0.0, -1.0, 1e-300, 1e300, -1e300, 1e9, 3.4e38)
TEXTS = ("", "x", "\x00", "Grüße 高", "a" * 10_000, "{", "map", "base_link", "../../etc/passwd", "%s%n")
BROKEN_BYTES = 0.2
"""Share of messages whose bytes are spoilt, instead of fields."""


def hostile(good: Any, count: int, rng: np.random.Generator) -> Iterator[bytes]:
    """So many serialized messages, each made of a good one: one to three fields spoilt, or its bytes."""
    sound, kind = serialize(good), type(good)
    for _ in range(count):
        if rng.random() < BROKEN_BYTES:
            yield _broken(sound, rng)
            continue
        message = deserialize(sound, kind)
        for _ in range(rng.integers(1, 4)):
            _spoil(message, rng)
        try:
            yield serialize(message)
        except (ValueError, OverflowError, struct.error):  # a list too long for its type, a number out of range
            yield _broken(sound, rng)


def feed(node: Node, topic: str, cdr: bytes) -> bool:
    """Hand a serialized message to the subscriptions of a node as its executor does; whether it takes bytes."""
    for subscription in node.subscriptions:
        if subscription.topic_name == topic:
            if subscription.raw:
                subscription.callback(cdr, {})
                continue
            try:
                message = deserialize_message(cdr, subscription.msg_type)
            except Exception:  # noqa: BLE001 (the middleware refuses it before any node sees it)
                return False
            subscription.callback(message)
    return True


def _broken(cdr: bytes, rng: np.random.Generator) -> bytes:
    """Bytes cut off, appended or changed."""
    kind = rng.integers(3)
    if kind == 0:
        return cdr[: rng.integers(len(cdr))]
    if kind == 1:
        return cdr + rng.bytes(int(rng.integers(1, 64)))
    changed = bytearray(cdr)
    for place in rng.integers(len(changed), size=rng.integers(1, 9)):
        changed[place] = rng.integers(256)
    return bytes(changed)


def _spoil(message: Any, rng: np.random.Generator) -> None:
    """Give one field of a message, or of a message in it, a value that nobody expects."""
    name = str(rng.choice([*fields_of_message(message)]))
    value = getattr(message, name)
    if fields_of_message(value):
        _spoil(value, rng)
    elif isinstance(value, list) and value and fields_of_message(value[0]):
        _spoil_list(value, rng)
    else:
        setattr(message, name, _other(value, rng))


def _spoil_list(values: list[Any], rng: np.random.Generator) -> None:
    kind = rng.integers(3)
    if kind == 0:
        _spoil(values[rng.integers(len(values))], rng)
    elif kind == 1:
        values.pop()
    else:
        values.append(copy.deepcopy(values[0]))


def _other(value: Any, rng: np.random.Generator) -> Any:
    """A value of the same type."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, float):
        return float(rng.choice([*FLOATS, value * (1 + 1e-3 * rng.standard_normal()), -value]))
    if isinstance(value, int):
        return int(rng.choice([0, 1, 2, 255, 65_535, 2**31 - 1, value + 1, max(value - 1, 0)]))
    if isinstance(value, str):
        return str(rng.choice(TEXTS))
    if isinstance(value, list):
        return [*value, *value[:1]] if rng.random() < 0.5 else value[:-1]
    return _other_array(value, rng)


def _other_array(value: Any, rng: np.random.Generator) -> Any:
    """An array that is longer or shorter, or of which some elements are others."""
    numbers = np.array(value)
    kind = rng.integers(4)
    if kind == 0 or not len(numbers):
        return numbers[: len(numbers) // 2]
    if kind == 1:
        return np.concatenate([numbers, numbers[:1]])
    places = rng.integers(len(numbers), size=rng.integers(1, 4))
    floating = np.issubdtype(numbers.dtype, np.floating)
    with np.errstate(over="ignore"):
        numbers[places] = rng.choice(FLOATS) if floating else rng.integers(128)
    return numbers
