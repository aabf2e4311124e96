"""ROS domains for graphs that bring all their nodes with them, and checks of their ports."""

from __future__ import annotations

import itertools
import os
import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Literal, TypeAlias

from sal_height.errors import UserError
from sal_height.nodes.transport.leftovers import LOCK, SEGMENT, SHARED_MEMORY, is_avoided

LOOK_S = 1.0
"""Period at which a process looks after its ports."""

LOOKS = 3
"""Looks in a row at which a port must be lost: one that is being made again is found again."""

LOST = (
    "{} of shared memory, through which messages of other processes arrive, is lost, as when this one was stopped for "
    "seconds (Ctrl-Z); nothing is received any more."
)

OURS = Path("/proc/self")
_PORT_LOCK = re.compile(rf"{SHARED_MEMORY}/({SEGMENT}port\d+){LOCK}( \(deleted\))?")
_MAPPED = re.compile(r"\S+ \S+ \S+ \S+ (\d+) +(\S+)")

DOMAINS = range(1, 101)
"""Domains to choose from: 0 is everybody's default, and above 100 the ports are among those that Linux hands out."""

_next = itertools.count(os.getpid())  # where to look first: each process, and each of its runs, at another place

DomainChoice: TypeAlias = int | Literal["free", "environment"]
"""A domain by its number, a free one, or the one that the environment variables of ROS state."""


class Ports:
    """The ports of this process, which other processes find by their names."""

    def __init__(self) -> None:
        self._lost: dict[str, int] = {}
        self._found: set[tuple[str, int]] = set()

    def lost(self) -> list[str]:
        """Look at the ports; those that were found lost at LOOKS looks in a row, by name."""
        ports = {name: _inode(name) for name in ports_read()}
        if not set(ports.items()) <= self._found:  # the list of what is mapped is long
            self._found = _mapped()
        lost = [name for name, inode in ports.items() if (name, inode) not in self._found]
        self._lost = {name: self._lost.get(name, 0) + 1 for name in lost}
        return [name for name, looks in self._lost.items() if looks >= LOOKS]


def ports_read(process: Path = OURS) -> set[str]:
    """Names of the ports that a process reads: it has a lock on the file that goes with each."""
    names: set[str] = set()
    if not (process.is_dir() and SHARED_MEMORY.is_dir()):
        return names
    for descriptor in (process / "fd").iterdir():
        with suppress(OSError):  # it was closed meanwhile
            if (found := _PORT_LOCK.fullmatch(str(descriptor.readlink()))) and not is_avoided(descriptor):
                names.add(found[1])
    return names


def _inode(name: str) -> int:
    """Number of the file of a port, as other processes find it; 0: no file."""
    with suppress(OSError):
        return (SHARED_MEMORY / name).stat().st_ino
    return 0


def _mapped() -> set[tuple[str, int]]:
    """Name and file number of every port that this process has in its memory."""
    found = _MAPPED.findall((OURS / "maps").read_text(encoding="utf-8"))
    return {(Path(path).name, int(inode)) for inode, path in found if path.startswith(f"{SHARED_MEMORY}/{SEGMENT}")}


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
    participants = 100  # participants of a domain whose ports are looked at, of the 120 that it has ports for
    for _ in DOMAINS:
        domain = DOMAINS[next(_next) % len(DOMAINS)]
        with ExitStack() as held:
            try:
                _bind(held, socket.SOCK_STREAM, "127.0.0.1", first_port(domain))
                with ExitStack() as probe:
                    for participant in range(participants):
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
