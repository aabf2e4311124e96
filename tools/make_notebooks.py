"""Run the notebooks of examples/notebooks and write each with its results as .ipynb and .html into a folder.

The last picture of each is the .png beside it. A notebook ends with SystemExit where it lacks data; its sentence is
printed, and it is left out.
"""

from __future__ import annotations

import argparse
import sys
from base64 import b64decode
from pathlib import Path
from typing import Any

import jupytext
from nbconvert import HTMLExporter
from nbconvert.preprocessors import CellExecutionError, ExecutePreprocessor
from traitlets.config import Config

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "examples" / "notebooks"

LOCAL = Config({"KernelManager": {"transport": "ipc"}})
"""Sockets of this machine between notebook and kernel, no network."""

TIMEOUT = 600
"""Longest time of a cell, s."""


def make(source: Path, out: Path) -> str:
    """Run a notebook and write it; returns the sentence with which it ended early, or where its results are.

    Raises:
        CellExecutionError: a cell raised.
    """
    notebook = jupytext.read(source)
    try:
        # Paths in notebooks are those from the root of the repository.
        ExecutePreprocessor(timeout=TIMEOUT, config=LOCAL).preprocess(notebook, {"metadata": {"path": str(ROOT)}})
    except CellExecutionError as error:
        if error.ename == "SystemExit":
            return f"{source.name} is left out: {error.evalue}"
        raise
    path = out / f"{source.stem}.ipynb"
    jupytext.write(notebook, path)
    page, _ = HTMLExporter().from_notebook_node(notebook, {"metadata": {"name": source.stem}})
    path.with_suffix(".html").write_text(page, encoding="utf-8")
    if picture := last_picture(notebook):
        path.with_suffix(".png").write_bytes(picture)
    return f"{source.name}: {path} and .html"


def last_picture(notebook: Any) -> bytes:
    """The last picture of an executed notebook, as PNG; empty: it has none."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    pictures = [output["data"]["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    return b64decode(pictures[-1]) if pictures else b""


def main() -> None:
    """Make all notebooks; ends with the error of the first cell that raised."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="folder for the results; existing files are replaced")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for source in sorted(SOURCES.glob("*.py")):
        try:
            sys.stdout.write(make(source, out) + "\n")
        except CellExecutionError as error:
            sys.exit(f"{source.name}: {error}")


if __name__ == "__main__":
    main()
