"""Hosts in one machine: network namespaces, and a network between them that loses and delays packets.

Each host has its own interfaces and its own shared memory. Its network card is a TAP device, and the cable a thread of
the test, for not every kernel can lose packets by itself (tc netem).
"""

from __future__ import annotations

import fcntl
import heapq
import os
import random
import select
import shutil
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import TracebackType
from typing import Any, Self

TUN = "/dev/net/tun"
SET_INTERFACE, TAP_WITHOUT_HEADER = 0x400454CA, 0x1002  # TUNSETIFF; IFF_TAP and IFF_NO_PI (linux/if_tun.h)
LARGEST_FRAME = 2048
MULTICAST = b"\x01"  # the first byte of such an address (01:00:5e:..); broadcast has ff

OWN_MEMORY = "mount -t tmpfs tmpfs /dev/shm && echo ready && exec sleep infinity"
"""What keeps the shared memory of a host: two hosts that share it would pass messages by it."""


class UnavailableError(Exception):
    """There can be no hosts here; says why."""


class Hosts:
    """Hosts on one network, 10.77.0.1, 10.77.0.2 and so on; a context manager.

    Attributes:
        loss: share of the packets that the network loses.
        delay_s: time that it takes to deliver one.
        has_multicast: whether it delivers packets to groups, as many radio links do not.
        lost: packets that it has lost.
        delivered: packets that it has delivered.
    """

    def __init__(self, count: int, loss: float = 0.0, delay_s: float = 0.0) -> None:
        self.loss, self.delay_s = loss, delay_s
        self.has_multicast = True
        self.lost = self.delivered = 0
        self._names = [f"sal{os.getpid()}-{number}" for number in range(1, count + 1)]
        self._cards: list[int] = []
        self._keepers: list[subprocess.Popen[str]] = []
        self._random = random.Random(1)  # noqa: S311 (no secret)
        self._stack = ExitStack()
        self._ended = threading.Event()

    def start(self, host: int, *command: Any, **options: Any) -> subprocess.Popen[str]:
        """Start a program on a host, 0 is the first; options are those of Popen."""
        enter = ["nsenter", f"--target={self._keepers[host].pid}", "--mount", "--net"]
        return subprocess.Popen([*enter, *map(str, command)], text=True, **options)  # noqa: S603 (of the tests)

    def __enter__(self) -> Self:
        if os.geteuid() != 0:
            raise UnavailableError("network namespaces need root")
        if missing := [tool for tool in ("ip", "nsenter", "unshare") if shutil.which(tool) is None]:
            raise UnavailableError(f"{missing[0]} is not installed (Debian packages iproute2, util-linux)")
        with ExitStack() as stack:
            for number, name in enumerate(self._names, start=1):
                _ip("netns", "add", name)
                stack.callback(_ip, "netns", "delete", name)
                card = self._add_card(name)
                stack.callback(os.close, card)
                _ip("-n", name, "address", "add", f"10.77.0.{number}/24", "dev", "sal0")
                for device in ("lo", "sal0"):
                    _ip("-n", name, "link", "set", device, "up")
                self._cards.append(card)
                self._keepers.append(stack.enter_context(_kept_memory(name)))
            cable = threading.Thread(target=self._carry, daemon=True)
            cable.start()
            stack.callback(cable.join)
            stack.callback(self._ended.set)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _add_card(self, name: str) -> int:
        """A network card sal0 of a host; the file at whose other end the cable is."""
        device = f"{name}t"[-15:]
        try:
            card = os.open(TUN, os.O_RDWR)
            fcntl.ioctl(card, SET_INTERFACE, struct.pack("16sH22x", device.encode(), TAP_WITHOUT_HEADER))
        except OSError as error:
            raise UnavailableError(f"{TUN} cannot be used: {error.strerror}") from error
        _ip("link", "set", device, "netns", name, "name", "sal0")
        return card

    def _carry(self) -> None:
        """Carry every packet to all other hosts, in order, until the end."""
        waiting: list[tuple[float, int, int, bytes]] = []
        number = 0
        while not self._ended.is_set():
            pause = max(0.0, waiting[0][0] - time.monotonic()) if waiting else 0.1
            for card in select.select(self._cards, [], [], min(pause, 0.1))[0]:
                packet = os.read(card, LARGEST_FRAME)
                if packet[:1] == MULTICAST and not self.has_multicast:
                    continue
                for other in self._cards:
                    if other == card:
                        continue
                    if self._random.random() < self.loss:
                        self.lost += 1
                        continue
                    number += 1
                    heapq.heappush(waiting, (time.monotonic() + self.delay_s, number, other, packet))
            while waiting and waiting[0][0] <= time.monotonic():
                *_, other, packet = heapq.heappop(waiting)
                os.write(other, packet)
                self.delivered += 1


@contextmanager
def _kept_memory(name: str) -> Iterator[subprocess.Popen[str]]:
    """A process in a network namespace, whose mount namespace has a shared memory of its own."""
    command = ["ip", "netns", "exec", name, "unshare", "--mount", "sh", "-c", OWN_MEMORY]
    keeper = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)  # noqa: S603
    try:
        if keeper.stdout is None or keeper.stdout.readline() != "ready\n":
            raise UnavailableError(f"mount namespaces: {keeper.communicate()[1].strip()}")
        yield keeper
    finally:
        keeper.kill()
        keeper.communicate()


def _ip(*arguments: str) -> None:
    """Have iproute2 do something.

    Raises:
        UnavailableError: it cannot.
    """
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)  # noqa: S603, S607
    if done.returncode:
        raise UnavailableError(f"`ip {' '.join(arguments)}` fails: {done.stderr.strip()}")
