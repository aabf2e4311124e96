"""Programs of nodes in processes of their own, forked from one that has imported everything once."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import sys
import tempfile
from pathlib import Path

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    ["sal_height.nodes.processing", "sal_height.nodes.recording.recorder", "sal_height.nodes.live_host"]
)

RECORDER = "sal_height.nodes.recording.recorder"
PROCESSING = "sal_height.nodes.processing"


def _run(module: str, words: list[str], domain_id: int, errors: str) -> None:
    os.environ["ROS_DOMAIN_ID"] = str(domain_id)
    os.dup2(os.open(errors, os.O_WRONLY), 2)
    sys.argv = words
    sys.exit(importlib.import_module(module).main())


class Program:
    """A program that runs, with what tests use of `subprocess.Popen`."""

    def __init__(self, module: str, *words: str, domain_id: int) -> None:
        """Start `main` of a module with a command line, whose first word is the name of the program."""
        handle, name = tempfile.mkstemp(suffix=".stderr")
        os.close(handle)
        self._errors = Path(name)
        self._process = FORKS.Process(target=_run, args=(module, list(words), domain_id, name), daemon=True)
        self._process.start()

    @property
    def returncode(self) -> int | None:
        """The exit status; negative: the signal that ended it; None: it runs."""
        return self._process.exitcode

    @property
    def pid(self) -> int:
        """The number of the process."""
        assert self._process.pid
        return self._process.pid

    def poll(self) -> int | None:
        return self.returncode

    def send_signal(self, number: signal.Signals) -> None:
        os.kill(self.pid, number)

    def terminate(self) -> None:
        self._process.terminate()

    def kill(self) -> None:
        self._process.kill()

    def communicate(self, timeout: float = 120.0) -> tuple[None, str]:
        """Wait for its end; what it has written to stderr comes second."""
        self._process.join(timeout)
        assert self.returncode is not None, "the program does not end"
        said = self._errors.read_text()
        self._errors.unlink(missing_ok=True)
        return None, said
