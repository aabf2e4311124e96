"""Services whose answer may be sent later, while their node goes on to receive messages."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, TypeAlias

from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.node import Node
from std_srvs.srv import Trigger

Said: TypeAlias = tuple[bool, str]
"""The answer of a service of type Trigger: True if it succeeded, and a message."""

FAILED: Said = False, "internal error; the log of the node says more"
"""Answer of a service that has failed for a reason that no caller should cause."""

ENDING: Said = False, "the node is ending"
"""Answer of a service whose work is no longer begun."""


def offer_trigger(node: Node, name: str, answer: Callable[[], Said | Future[Said]]) -> None:
    """Offer a service of type Trigger.

    An executor calls `send_response` of a service as soon as its callback returns; here that waits for the answer, and
    the executor does not. The thread that sets a future also sends it.

    Args:
        node: node that offers it.
        name: name of the service.
        answer: function that returns the answer, or a future of it.
    """

    def respond(_request: Trigger.Request, _response: Trigger.Response) -> Said | Future[Said]:
        return answer()

    service = node.create_service(Trigger, name, respond)
    send_at_once = service.send_response

    def send(answered: Said | Future[Said], header: Any) -> None:
        if isinstance(answered, Future):
            answered.add_done_callback(lambda done: send(done.result(), header))
            return
        success, message = answered
        with suppress(RCLError, InvalidHandle):  # the node may have ended: nobody waits for it any more
            send_at_once(Trigger.Response(success=success, message=message), header)

    service.send_response = send
