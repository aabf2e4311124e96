"""Processor time and memory of this process and of those that it has started, from /proc."""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

PROC = Path("/proc")
TICKS_HZ = os.sysconf("SC_CLK_TCK")
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")

OWN = "live"
"""Name of this process among those it has started."""


@dataclass(frozen=True)
class Sample:
    """Resources that processes have used up to a moment.

    Attributes:
        at_s: the moment, s of the monotonic clock.
        cpu_s: processor time by name of the process (its first 15 letters), s.
        resident: resident memory by name of the process, bytes.
    """

    at_s: float
    cpu_s: dict[str, float]
    resident: dict[str, int]


@dataclass(frozen=True)
class Usage:
    """Resources that processes have used while they were watched."""

    samples: list[Sample] = field(default_factory=list)

    def take(self) -> None:
        """Take note of this process and of all that it has started."""
        own, cpu_s, resident = os.getpid(), {}, {}
        for folder in _family():
            try:
                _, used_s = _parent_and_cpu(folder)
                name = (folder / "comm").read_text(encoding="utf-8", errors="replace").strip()
                pages = int((folder / "statm").read_text(encoding="ascii").split()[1])
            except OSError:  # it has ended meanwhile
                continue
            name = OWN if int(folder.name) == own else name
            cpu_s[name], resident[name] = used_s, pages * PAGE_BYTES
        self.samples.append(Sample(time.monotonic(), cpu_s, resident))

    @property
    def seconds(self) -> float:
        """From the first sample to the last."""
        return self.samples[-1].at_s - self.samples[0].at_s

    @property
    def cpu_per_second(self) -> dict[str, float]:
        """Processor seconds in a second by name of the process, from the first sample to the last."""
        first, last = self.samples[0].cpu_s, self.samples[-1].cpu_s
        return {name: (used - first.get(name, 0.0)) / self.seconds for name, used in last.items()}


def memory_bytes() -> int:
    """Memory of this process and of all that it has started, what they share counted once (Pss), bytes."""
    kilobytes = 0
    for folder in _family():
        with suppress(OSError):  # it has ended meanwhile
            lines = (folder / "smaps_rollup").read_text(encoding="ascii").splitlines()
            kilobytes += next(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return 1024 * kilobytes


def thread_cpu_s() -> dict[str, float]:
    """Processor time of every Python thread of this process by its name, s."""
    used = {}
    for thread in threading.enumerate():
        folder = PROC / "self" / "task" / str(thread.native_id)
        if folder.exists():
            used[thread.name] = _parent_and_cpu(folder)[1]
    return used


def _family() -> list[Path]:
    """Folders of this process and of all that it has started, or that these have."""
    parents = {}
    for folder in PROC.iterdir():
        with suppress(OSError, IndexError):  # it has ended meanwhile
            if folder.name.isdecimal():
                parents[int(folder.name)] = _parent_and_cpu(folder)[0]
    family = {os.getpid()}
    for process in sorted(parents):
        ancestor = process
        while ancestor in parents and ancestor not in family:
            ancestor = parents[ancestor]
        if ancestor in family:
            family.add(process)
    return [PROC / str(process) for process in family]


def _parent_and_cpu(folder: Path) -> tuple[int, float]:
    """Parent of a process, and its processor time, s (proc_pid_stat(5): fields 4, 14 and 15)."""
    fields = (folder / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    return int(fields[1]), (int(fields[11]) + int(fields[12])) / TICKS_HZ
