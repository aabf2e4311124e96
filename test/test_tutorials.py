"""The pieces of Python in the documents run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from sal_height.bag.reader import BagReader
from sal_height.runs.replay import replay

ROOT = Path(__file__).parents[1]


def blocks(document: str, language: str) -> list[str]:
    """The pieces of a document that are in a language."""
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def test_your_own_sensor_becomes_a_bag_that_can_be_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is in the arrays is noise, of which images can be made."""
    (python,), (description,) = blocks("import.md", "python"), blocks("import.md", "yaml")
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((2, 500, 300)) + 1j * rng.standard_normal((2, 500, 300))
    np.save(tmp_path / "samples.npy", noise.astype(np.complex64))
    (tmp_path / "radar.yaml").write_text(description, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(compile(python, "import.md", "exec"), {})  # noqa: S102 (our own document)
    assert BagReader(tmp_path / "out" / "flight").topics["/phase_history"].count == 2
    values = {"sar_compression": {"rows": 64, "cols": 32}}
    outcome = replay(tmp_path / "out" / "flight", tmp_path / "again", values, estimators=["ml"]).outcome
    assert outcome.stages["sar_compression"].count("processed") == 2, outcome.losses


def test_heights_are_an_xarray_dataset(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    (python,) = blocks("export.md", "python")
    monkeypatch.chdir(ROOT)
    exec(compile(python, "export.md", "exec"), {})  # noqa: S102 (our own document)
    assert 0 < float(capsys.readouterr().out) < 2, "m, of the street"
