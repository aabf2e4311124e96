"""Processor time and memory of a process, as the account of a node states them."""

from __future__ import annotations

import os
import re
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

_RESIDENT = re.compile(r"(RssAnon|RssFile):\s+(\d+) kB")


def process_numbers() -> dict[str, Any]:
    """Processor time, s, number, and memory, MB (Linux), of this process, as fields of an account.

    Memory is what is resident without shared memory: most of that is the messages of other processes.
    """
    numbers: dict[str, Any] = {"cpu_s": round(time.process_time(), 3), "pid": os.getpid()}
    with suppress(OSError):
        status = Path("/proc/self/status").read_text(encoding="utf-8")
        resident = {name: int(kilobytes) for name, kilobytes in _RESIDENT.findall(status)}
        numbers["memory_mb"] = round(sum(resident.values()) * 1024 / 1e6, 1)
    return numbers
