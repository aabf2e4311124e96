"""What a process takes: processor time and memory, as the account of a node shows them."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

from sal_height.nodes.account import CPU, MEMORY, PID


def process_numbers() -> dict[str, float]:
    """Processor time, s, number, and resident memory, MB (Linux), of this process, by name."""
    numbers: dict[str, float] = {CPU: round(time.process_time(), 3), PID: os.getpid()}
    with suppress(OSError):
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        numbers[MEMORY] = round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)
    return numbers
