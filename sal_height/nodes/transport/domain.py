"""ROS domains for graphs that bring all their nodes with them."""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Literal, TypeAlias

from sal_height.errors import UserError

DOMAINS = range(1, 101)
"""Domains to choose from: 0 is everybody's default, and above 100 the ports are among those that Linux hands out."""

PARTICIPANTS = 100
"""Participants of a domain whose ports are looked at, of the 120 that it has ports for."""

_next = itertools.count(os.getpid())  # where to look first: each process, and each of its runs, at another place

DomainChoice: TypeAlias = int | Literal["free", "environment"]
"""A domain by its number, a free one, or the one that the environment variables of ROS state."""


def first_port(domain: int) -> int:
    """The lowest UDP port of a domain (DDS-RTPS 2.2, section 9.6.1.1, with the default parameters)."""
    return 7400 + 250 * domain


@contextmanager
def free_domain() -> Iterator[int]:
    """A domain that nobody on this machine uses, kept from other callers until the context ends.

    It is kept by a TCP port of the same number as the domain's first UDP port: the system frees that with the process,
    whoever it belongs to. A domain in which somebody else has a node is recognised by the UDP port of that node's
    participant: Fast DDS numbers participants through all domains of a process, so that the first of a domain may have
    any of the lower numbers.

    Raises:
        UserError: all domains are in use.
    """
    for _ in DOMAINS:
        domain = DOMAINS[next(_next) % len(DOMAINS)]
        with ExitStack() as held:
            try:
                _bind(held, socket.SOCK_STREAM, "127.0.0.1", first_port(domain))
                with ExitStack() as probe:
                    for participant in range(PARTICIPANTS):
                        _bind(probe, socket.SOCK_DGRAM, "", first_port(domain) + 10 + 2 * participant)
            except OSError:
                continue
            yield domain
            return
    raise UserError(f"All ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are in use; wait until another run has ended.")


@contextmanager
def ros_domain(choice: DomainChoice) -> Iterator[None]:
    """Nodes that are made or started inside are in the domain chosen.

    Unless the environment decides, they find and are found by nodes of this machine only.

    Raises:
        UserError: no domain is free.
    """
    if choice == "environment":
        yield
        return
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain()) if choice == "free" else choice
        changes = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": ""}
        before = {name: os.environ.get(name) for name in changes}
        stack.callback(_restore, before)
        os.environ.update(changes)
        yield


def _bind(stack: ExitStack, kind: socket.SocketKind, address: str, port: int) -> None:
    """Keep a port until the stack is closed.

    Raises:
        OSError: somebody has it.
    """
    stack.enter_context(socket.socket(socket.AF_INET, kind)).bind((address, port))


def _restore(variables: dict[str, str | None]) -> None:
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
