"""Write a picture of what `sal-height view --web` shows in Debian's Chromium.

tools/view_picture.py BAG FILE.png shows a bag, tools/view_picture.py --live FILE.png a graph that runs meanwhile. It
needs the Debian packages chromium and chromium-driver, and the extra `view`.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

SIZE = 1600, 1000
DEADLINE_S = 120.0
LOOK_S = 1.0
COLOURS = 500
"""A page with more colours than that shows data: the empty viewer has some 150."""

LIVE_S = 20.0
"""Time that a live graph is looked at after its first data are seen: its page never stands still."""

DOMAIN = "86"
GRAPH = ("live", "--preset", "sal_spotlight", "--rate", "0.02", "--domain", DOMAIN)
"""A graph that one processor keeps up with, while the other draws."""

OPTIONS = (
    *("--headless=new", "--no-sandbox", "--hide-scrollbars", f"--window-size={SIZE[0]},{SIZE[1]}"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
    *("--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"),
    "--disable-sync",
)
"""WebGL is drawn by the processor, and the browser asks nobody for anything."""


def missing() -> str:
    """Programs that are needed and not installed; empty: none."""
    programs = [name for name in ("chromium", "chromedriver") if not shutil.which(name)]
    try:
        import rerun  # noqa: F401, PLC0415 (slow)
    except ModuleNotFoundError:
        programs.append("rerun-sdk")
    return ", ".join(programs)


@contextlib.contextmanager
def served(words: list[str]) -> Iterator[str]:
    """The address of the page that `sal-height view ... --web` serves while the context lasts."""
    command = [sys.executable, "-m", "sal_height", "view", *words, "--web"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as view:  # noqa: S603 (our own program)
        try:
            address = re.search(r"http://\S+", view.stdout.readline() if view.stdout else "")
            if not address:
                sys.exit("The page is not served; the message above says why.")
            yield address[0]
        finally:
            view.send_signal(signal.SIGINT)
            view.communicate(timeout=DEADLINE_S)


@contextlib.contextmanager
def live_graph() -> Iterator[None]:
    """A live graph while the context lasts."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "sal_height", *GRAPH, "--out", f"{folder}/live"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(command, **quiet) as graph:  # noqa: S603 (our own program)
            try:
                yield
            finally:
                graph.send_signal(signal.SIGINT)
                graph.wait(DEADLINE_S)


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """A function that sends commands of WebDriver (W3C) to a browser, and returns what they say."""
    with contextlib.ExitStack() as stack:
        profile = stack.enter_context(tempfile.TemporaryDirectory())
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        driver = subprocess.Popen(  # noqa: S603
            ["chromedriver", f"--port={port}"],  # noqa: S607 (Debian's)
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        stack.callback(driver.wait)
        stack.callback(driver.terminate)

        def ask(method: str, path: str, body: dict[str, Any] | None = None) -> Any:
            data = None if body is None else json.dumps(body).encode()
            request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", data, method=method)
            with urllib.request.urlopen(request, timeout=DEADLINE_S) as answer:  # noqa: S310 (this machine)
                return json.load(answer)["value"]

        deadline = time.monotonic() + DEADLINE_S
        while True:
            try:
                ask("GET", "/status")
                break
            except (urllib.error.URLError, ConnectionError):
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.05)
        options = {"goog:chromeOptions": {"args": [*OPTIONS, f"--user-data-dir={profile}"]}}
        session = ask("POST", "/session", {"capabilities": {"alwaysMatch": options}})["sessionId"]
        stack.callback(ask, "DELETE", f"/session/{session}")
        yield lambda method, path, body=None: ask(method, f"/session/{session}{path}", body)


def picture_of(address: str, longest_s: float = DEADLINE_S) -> Image.Image:
    """Picture of the viewer's page in a browser once it does not change any more, or `longest_s` after its first data.

    Without any data, it is what the page shows after DEADLINE_S.
    """
    with browser() as ask:
        ask("POST", "/url", {"url": f"{address}&renderer=webgl&hide_welcome_screen"})
        deadline, before, has_data = time.monotonic() + DEADLINE_S, np.empty(0), False
        while True:
            time.sleep(LOOK_S)
            try:
                image = Image.open(io.BytesIO(base64.b64decode(ask("GET", "/screenshot")))).convert("RGB")
            except urllib.error.HTTPError:  # the page is too busy to be drawn
                if time.monotonic() > deadline:
                    raise
                continue
            now = np.asarray(image)
            still = before.shape == now.shape and np.abs(now.astype(int) - before).mean() < 0.05
            if not has_data and colours(image) > COLOURS:
                has_data, deadline = True, min(deadline, time.monotonic() + longest_s)
            if (still and has_data) or time.monotonic() > deadline:
                return image
            before = now


def colours(image: Image.Image) -> int:
    """Number of different colours."""
    return len(np.unique(np.asarray(image).reshape(-1, 3), axis=0))


def main() -> int:
    """Write the picture."""
    *words, file = sys.argv[1:]
    if lacking := missing():
        sys.exit(f"Not installed, but needed: {lacking}.")
    if words == ["--live"]:
        with live_graph(), served(["--domain", DOMAIN]) as address:
            image = picture_of(address, LIVE_S)
    else:
        with served(words) as address:
            image = picture_of(address)
    image.quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(Path(file), optimize=True)
    sys.stdout.write(f"{file}: {colours(image)} colours\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
