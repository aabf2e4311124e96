"""The process of the Rerun viewer, which listens to programs of this machine only."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Self
from urllib.parse import quote

from sal_height.errors import UserError

LOCAL = "127.0.0.1"

START = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
"""The program rerun, with its exit status, which `python -m rerun_cli` hides."""


class Viewer:
    """A viewer that runs; as a context manager, it ends with the context.

    Attributes:
        address: address at which it receives recordings.
    """

    def __init__(self, options: list[str], port: int, memory_mb: int) -> None:
        """Start it, and wait until it listens.

        Args:
            options: options of the program rerun.
            port: port at which it receives recordings.
            memory_mb: largest memory, beyond which it forgets the oldest data, MB.

        Raises:
            UserError: it does not start.
        """
        self.address = f"rerun+http://{LOCAL}:{port}/proxy"
        limits = [f"{option}={memory_mb}MB" for option in ("--memory-limit", "--server-memory-limit")]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the process lives)
        self._process = subprocess.Popen(  # noqa: S603 (the viewer)
            [sys.executable, "-c", START, "--bind", LOCAL, "--port", str(port), *limits, *options],
            stdin=subprocess.DEVNULL,
            stdout=self._said,
            stderr=self._said,
            start_new_session=True,  # Ctrl-C is for the command; the window may outlive it
        )
        try:
            self._await(port)
        except BaseException:
            self.end()
            raise

    def _await(self, port: int) -> None:
        """Wait until it listens.

        Raises:
            UserError: it does not, or has ended.
        """
        start_s = 30.0  # longest time until a viewer listens
        deadline = time.monotonic() + start_s
        while not _listens(port):
            self.check()
            if time.monotonic() > deadline:
                raise UserError(f"The Rerun viewer was not ready within {start_s:g} s; start it again.")
            time.sleep(0.05)

    def is_open(self) -> bool:
        """True if it has not ended."""
        return self._process.poll() is None

    def check(self) -> None:
        """See that it runs.

        Raises:
            UserError: it has ended by an error.
        """
        if self._process.poll() == -signal.SIGKILL:
            raise UserError("The Rerun viewer was ended, because it took nothing any more or used too much memory.")
        if self._process.poll():
            self._said.seek(0)
            lines = [line for line in self._said.read().decode(errors="replace").splitlines() if line.strip()]
            reason = (
                lines[-1].rpartition(": ")[-1].strip().rstrip(".") if lines else f"status {self._process.returncode}"
            )
            raise UserError(
                f"The Rerun viewer ended ({reason}); where no window can be opened, use --web for a browser or --save "
                "for a file."
            )

    def kill(self) -> None:
        """End it though it does not react."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def end(self) -> None:
        """End it, if it still runs."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGTERM)
        self._process.wait()
        self._said.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()


def open_window(memory_mb: int) -> Viewer:
    """Start the viewer with a window of its own, which outlives the command.

    Raises:
        UserError: it does not start, as where there is no display.
    """
    (port,) = free_ports(1)
    with ExitStack() as stack:
        viewer = stack.enter_context(Viewer(["--hide-welcome-screen", "--expect-data-soon"], port, memory_mb))
        time.sleep(0.5)  # by then one that listens has found out that it cannot open a window
        viewer.check()
        stack.pop_all()
    return viewer


def serve_page(port: int | None, memory_mb: int) -> tuple[Viewer, str]:
    """Serve the viewer as a page for browsers of this machine.

    Args:
        port: port of the page; data are at the next one. None: any that are free.
        memory_mb: size of the drawings that are kept for browsers that connect later, MB.

    Returns:
        The process, and the address of the page.

    Raises:
        UserError: it does not start.
    """
    page, data = free_ports(2) if port is None else (port, port + 1)
    for wanted in (page, data):
        if _listens(wanted):
            raise UserError(f"Port {wanted} is in use by another program; name another with --port.")
    viewer = Viewer(["--serve-web", "--web-viewer-port", str(page)], data, memory_mb)
    return viewer, f"http://{LOCAL}:{page}/?url={quote(viewer.address, safe='')}"


def free_ports(count: int) -> list[int]:
    """A number of free ports of this machine."""
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind((LOCAL, 0))
        return [int(one.getsockname()[1]) for one in sockets]


def _listens(port: int) -> bool:
    """True if a program of this machine listens on a port."""
    with suppress(OSError), socket.create_connection((LOCAL, port), timeout=1.0):
        return True
    return False
