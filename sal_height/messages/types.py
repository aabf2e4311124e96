"""The classes of shipped message types by their names without the package, such as ``Header``.

They are made when they are first needed, and have keyword arguments for all fields. The defaults are 0 for numbers,
empty texts and lists, and new nested messages.
"""

from __future__ import annotations

from typing import Any

from sal_height.messages.codec import SHIPPED
from sal_height.messages.definition import shipped_texts

_TYPE_NAMES = {type_name.rpartition("/")[2]: type_name for type_name in shipped_texts()}


def __getattr__(name: str) -> Any:
    if name not in _TYPE_NAMES:
        raise AttributeError(f"no message type {name} is shipped")
    return SHIPPED.message_class(_TYPE_NAMES[name])


def __dir__() -> list[str]:
    return sorted(_TYPE_NAMES)
