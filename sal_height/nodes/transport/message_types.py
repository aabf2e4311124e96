"""The classes of rclpy that stand for the types of topics, and plain messages on its publishers and subscriptions."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from sal_height.errors import UserError
from sal_height.messages import serialize
from sal_height.messages.codec import SHIPPED, BrokenMessage
from sal_height.messages.definition import ARRAY, LIST, NO_FIELD, TEXT, Field, shipped_definition

NAMES = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}
"""Names that rclpy has for numbers, where they are others."""

OURS = "sal_height_msgs"
"""Package of our messages."""


@functools.cache
def message_class(type_name: str) -> type[Any]:
    """Class of rclpy of a message type such as ``std_msgs/msg/Header``.

    Raises:
        UserError: the type is not installed, or with other fields than this package knows.
    """
    package, _, name = type_name.split("/") if type_name.count("/") == 2 else ("", "", "")
    try:
        found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError, TypeError):
        raise UserError(
            f"Message type {type_name} is not installed in this environment; install or source a package "
            f"{package or type_name} that has it."
        ) from None
    if shipped_definition(type_name) and not _has_known_fields(type_name, found):
        raise UserError(
            f"Message type {type_name} is installed with other fields than sal_height has; install the version of "
            f"package {package} that belongs to it."
        )
    return found


def class_of(kind: type[Any]) -> type[Any]:
    """Class of rclpy for the type of plain messages; errors as of `message_class`.

    Raises:
        ModuleNotFoundError: the package of our messages is not installed, which no node can do without.
    """
    if kind.__msgtype__.startswith(f"{OURS}/"):
        importlib.import_module(OURS)
    return message_class(kind.__msgtype__)


def publish(publisher: Publisher, message: Any) -> None:
    """Publish a plain message, or the bytes of a serialized one."""
    publisher.publish(message if isinstance(message, bytes) else serialize(message))


def subscribe(
    node: Node, kind: type[Any], topic: str, callback: Callable[[Any], None], qos: QoSProfile | int
) -> Subscription:
    """Have `callback` accept the plain messages of a topic; bytes that cannot be decoded are passed over."""
    read = SHIPPED.reader(kind.__msgtype__)

    def take(cdr: bytes) -> None:
        try:
            message = read(cdr)
        except BrokenMessage:
            return
        callback(message)

    return node.create_subscription(class_of(kind), topic, take, qos, raw=True)


def _has_known_fields(type_name: str, installed: type[Any]) -> bool:
    """True if a class of rclpy has the fields of the shipped type, and so have the messages in it."""
    fields = [field for field in SHIPPED.layout(type_name).fields if field is not NO_FIELD]
    ours = [(field.name, _rclpy_type(field)) for field in fields]
    if ours != list(installed.get_fields_and_field_types().items()):
        return False
    return all(bool(message_class(field.kind)) for field in fields if field.is_message)


def _rclpy_type(field: Field) -> str:
    """The type of a field as rclpy writes it."""
    name = field.kind.replace("/msg/", "/") if field.is_message else NAMES.get(field.kind, field.kind)
    if field.kind == TEXT and field.longest:
        name = f"string<{field.longest}>"
    if field.form == LIST:
        return f"sequence<{name}, {field.size}>" if field.size else f"sequence<{name}>"
    return f"{name}[{field.size}]" if field.form == ARRAY else name
