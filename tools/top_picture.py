"""Write a picture of `sal-height top` beside a small live graph: tools/top_picture.py FILE.svg.

The sensor is that of the preset `small`, twenty times slower than it is, so that any machine keeps up with it.
"""

from __future__ import annotations

import io
import math
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from sal_height.graph.watch import AccountBook, watch
from sal_height.runs.live.live_table import node_table

DOMAIN = "87"
RATE = "0.05"
LINE = 84
"""Characters in a line of the table."""

SETTLED_S = 12.0
"""Time after which rates, which are those of the last ten seconds, tell of a graph that runs and no longer starts."""

DEADLINE_S = 180.0

FROM_ELSEWHERE = re.compile(r"<!--.*?-->\s*|@font-face\s*{[^}]*}\s*", re.DOTALL)
"""Font that Rich has viewers fetch from other hosts, in whose place they have another one."""


def watched() -> AccountBook:
    """Accounts of the nodes of a live graph once all that have a latency have published it for SETTLED_S."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["live", "--preset", "small", "--rate", RATE, "--domain", DOMAIN, "--out", f"{folder}/live"]
        with subprocess.Popen(  # noqa: S603 (our own program)
            [sys.executable, "-m", "sal_height", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as program:
            try:
                return watch(int(DOMAIN), DEADLINE_S, _until_settled())
            finally:
                program.terminate()
                program.wait(DEADLINE_S)


def _until_settled() -> Callable[[AccountBook], None]:
    """A function that interrupts the watching once heights have come for SETTLED_S."""
    since: list[float] = []

    def look(book: AccountBook) -> None:
        if any(math.isfinite(one.account.latency_p50_ms) and "height" in name for name, one in book.entries.items()):
            since.append(time.monotonic())
        if since and since[-1] - since[0] > SETTLED_S:
            raise KeyboardInterrupt

    return look


def main() -> int:
    """Write the picture."""
    (file,) = sys.argv[1:]
    book = watched()
    if not book.entries:
        sys.exit("No node has published /diagnostics; the graph did not start.")
    console = Console(record=True, width=LINE, file=io.StringIO(), force_terminal=True)
    console.print(node_table(book, time.monotonic(), "nodes"))
    # The identity is that of the styles in the file, which else would be another every time.
    drawn = console.export_svg(title="sal-height top", unique_id="top")
    Path(file).write_text(FROM_ELSEWHERE.sub("", drawn), encoding="utf-8")
    sys.stdout.write(f"{file}: {len(book.entries)} nodes\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
