"""Files of the middleware that killed processes leave in shared memory.

Fast DDS makes files there, and with each a second one that its process keeps locked as long as it lives: segments, from
which others read what it sends, and ports, through which it receives.
"""

from __future__ import annotations

import fcntl
import os
import re
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 (where Linux has it)

SEGMENT, LOCK = "fastrtps_", "_el"
"""Start of the names of files in shared memory, and end of that of the file that goes with each."""

YOUNG_S = 10.0
"""A segment younger than this is never taken for one that was left."""

FORGOTTEN_S = 15.0
"""Time, s, after which a port found dead is used by nobody: others look twice, 5 s apart, before they give it up."""

_PORT = re.compile(rf"{SEGMENT}port\d+")

_AVOIDED: list[int] = []
"""Descriptors of the locks of dead ports that this process keeps."""


def remove_orphans() -> None:
    """Remove the segments of processes that were killed: 64 MB of each would stay until the machine restarts."""
    for lock in SHARED_MEMORY.glob(f"{SEGMENT}*{LOCK}"):
        name = lock.name.removesuffix(LOCK)
        if _PORT.fullmatch(name):
            continue  # whoever looks for dead ports meanwhile would take one that is locked for a port in use
        with suppress(OSError), _locked(lock, fcntl.LOCK_EX):
            if time.time() - lock.stat().st_mtime >= YOUNG_S:
                _remove(name)


def avoid_dead_ports() -> None:
    """Have this process receive through other ports than those of processes that were killed not long ago.

    For seconds, others do not know that they are dead, and send through them to nobody; who takes such a port makes its
    files again and receives nothing meanwhile. Fast DDS leaves out locked ports: each dead one is locked as long as
    this process lives, and together with the others that avoid it, which may end earlier. One that was found dead long
    enough ago is removed: its lock's file is not empty since then.
    """
    before = _AVOIDED.copy()
    _AVOIDED.clear()
    for lock in SHARED_MEMORY.glob(f"{SEGMENT}port*{LOCK}"):
        name = lock.name.removesuffix(LOCK)
        with suppress(OSError), _locked(lock, fcntl.LOCK_SH) as descriptor:
            known = os.fstat(descriptor)
            if known.st_size and time.time() - known.st_mtime > FORGOTTEN_S:
                _remove(name)
                continue
            if not known.st_size:
                os.write(descriptor, b"dead")
            _AVOIDED.append(os.dup(descriptor))
    for descriptor in before:
        os.close(descriptor)


def is_avoided(descriptor: Path) -> bool:
    """True if the lock at `descriptor`, in /proc, is that of a port that a process avoids, not of one of its own.

    Fast DDS has those of its own open for reading only.
    """
    return bool(descriptor.lstat().st_mode & stat.S_IWUSR)


@contextmanager
def _locked(file: Path, kind: int) -> Iterator[int]:
    """A descriptor of a file that is locked until it is closed, which is the caller's to copy.

    Args:
        file: The file.
        kind: LOCK_EX of fcntl, or LOCK_SH to share the lock with others that do.

    Raises:
        OSError: another process has locked it, or it is gone.
    """
    descriptor = os.open(file, os.O_RDWR)
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
        if not os.path.samestat(os.fstat(descriptor), file.stat()):
            raise FileNotFoundError(file)  # it has been made again meanwhile
        yield descriptor
    finally:
        os.close(descriptor)


def _remove(name: str) -> None:
    """Remove a file and the one that goes with it."""
    (SHARED_MEMORY / name).unlink(missing_ok=True)
    (SHARED_MEMORY / f"{name}{LOCK}").unlink(missing_ok=True)
