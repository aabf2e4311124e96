"""Checks that the middleware of this process can still be reached by shared memory.

Fast DDS receives through files of shared memory, called ports. If a process stands still for seconds (a debugger, a
machine that pauses), others take its ports for dead and make them again; when it goes on, it does the same, and now and
then the two end up with different files of one name. Nothing arrives then, and no error is reported. With the settings
of `middleware` it has not been seen; programs with other settings may be about.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

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
