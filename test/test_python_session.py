"""Names with which a session in Python begins, and their types for those who use the package."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tutorial_helpers import run_page

import sal_height

ROOT = Path(__file__).parents[1]

SCRIPT = """
from sal_height.imaging import ImageSettings
from sal_height.pipeline import Compressor
from sal_height.simulation import flight_of, load_preset

flight = flight_of(load_preset("small"), seed=1)
reveal_type(Compressor().add(flight.phase_history(0), flight.track(0), flight.sensor, ImageSettings()))
load_preset(3)
"""


def test_a_session_is_offered_two_dozen_names_at_most_that_explain_themselves() -> None:
    names = [name for name in dir(sal_height) if not name.startswith("_")]
    assert {"load_preset", "flight_of", "Compressor", "heights", "open_heights"} <= set(names)
    assert len(names) <= 24
    for name in names:
        value = getattr(sal_height, name)
        assert name == "ESTIMATORS" or len(value.__doc__) > 20, name
    with pytest.raises(AttributeError, match="has no attribute 'hights'"):
        getattr(sal_height, "hights")  # noqa: B009 (a name that no type checker accepts)


def test_every_package_says_what_it_offers() -> None:
    packages = [path.parent for path in sorted((ROOT / "sal_height").glob("*/__init__.py"))]
    faces = {path.name: importlib.import_module(f"sal_height.{path.name}") for path in packages}
    without = [name for name, face in faces.items() if not hasattr(face, "__all__")]
    assert without == ["bag", "budget", "engine", "figures", "graph", "nodes", "runs", "view", "workers"]
    assert [
        f"{name}.{one}"
        for name, face in faces.items()
        for one in getattr(face, "__all__", ())
        if not hasattr(face, one)
    ] == []


def test_the_import_of_the_package_brings_nothing_slow() -> None:
    code = "import sal_height, sys; print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout  # noqa: S603
    assert not {"numpy", "scipy", "numba", "pydantic", "rclpy"} & set(said.split())


def test_the_page_of_a_session_runs_and_has_the_example_of_the_docstring(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import matplotlib.pyplot as plt

    monkeypatch.chdir(ROOT)
    plt.switch_backend("agg")
    names = run_page(ROOT / "docs" / "python_session.md", capsys)
    plt.close("all")
    assert isinstance(names["field"], sal_height.HeightField)
    example = [line[4:] for line in (sal_height.__doc__ or "").splitlines() if line.startswith("    ")]
    page = (ROOT / "docs" / "python_session.md").read_text(encoding="utf-8").splitlines()
    assert set(example) <= set(page)


@pytest.mark.thorough
def test_a_type_checker_finds_the_types_of_an_installed_package(tmp_path: Path) -> None:
    """By the marker py.typed, as the package is on the path of the interpreter, not among the checked sources."""
    (tmp_path / "script.py").write_text(SCRIPT)
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "script.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert re.search(r'Revealed type is "sal_height\.imaging\.focus\.Slc \| None"', checked.stdout), checked.stdout
    assert 'Argument 1 to "load_preset" has incompatible type "int"' in checked.stdout
    assert "missing library stubs" not in checked.stdout
