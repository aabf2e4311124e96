"""The benchmarks run and write their results, whatever kind of number a measurement yields."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import few

from benchmarks.__main__ import GROUPS
from benchmarks.row import Row

ROOT = Path(__file__).parents[1]


def run_benchmarks(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks", *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(  # noqa: S603 (our own code)
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=3600
    )


@pytest.mark.parametrize("kind", [float, np.float64, np.float32])
@pytest.mark.parametrize(
    ("target", "value", "ok"),
    [
        ("<= 2", 1.5, True),
        ("<= 2", 2.0, True),
        ("<= 2", 2.5, False),
        (">= 2", 1.5, False),
        (">= 2", 2.5, True),
        (">= 2", np.nan, False),
        ("<= 2", np.nan, False),
    ],
)
def test_a_row_of_any_kind_of_number_can_be_kept(kind: type, target: str, value: float, ok: bool) -> None:
    kept = json.loads(json.dumps(Row("name", kind(value), "s", target, "on nothing").as_json()))
    assert kept["ok"] is ok
    assert kept["value"] == pytest.approx(value, nan_ok=True)
    assert (kept["name"], kept["unit"], kept["target"], kept["reference"]) == ("name", "s", target, "on nothing")


@pytest.mark.parametrize("groups", few(1, [["backprojection"], list(GROUPS)]), ids=["one", "every"])
def test_a_row_of_every_group_can_be_measured(groups: list[str], tmp_path: Path) -> None:
    """At sizes so small that the numbers mean nothing."""
    result = run_benchmarks("--quick", *groups, "--out", str(tmp_path / "bench.json"))
    assert result.returncode == 0, result.stdout + result.stderr
    rows = json.loads((tmp_path / "bench.json").read_text())
    assert [row["group"] for row in rows] == groups
    assert all(np.isfinite(row["value"]) and row["ok"] in {True, False} for row in rows)


BROKEN = """
import sys
from benchmarks import __main__ as program, backprojection
from benchmarks.row import Row

def measure():
    yield Row("first", 1.0, "s", "<= 2", "")
    raise RuntimeError("broken")

backprojection.throughput = measure
backprojection.accuracy = lambda: iter([Row("later", 3.0, "s", "<= 2", "")])
sys.exit(program.app(["*backprojection", *sys.argv[1:]], result_action="return_value"))
"""


def test_rows_are_kept_as_they_come_though_a_group_fails(tmp_path: Path) -> None:
    command = [sys.executable, "-c", BROKEN, "--out", str(tmp_path / "bench.json")]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=600)  # noqa: S603 (our own code)
    assert result.returncode == 1, result.stderr
    rows = json.loads((tmp_path / "bench.json").read_text())
    assert [(row["group"], row["name"], row["ok"]) for row in rows] == [
        ("backprojection", "first", True),
        ("accuracy-backprojection", "later", False),
    ]
    assert "RuntimeError: broken" in result.stdout
    assert result.stdout.splitlines()[-1] == "FAILED: backprojection"


def test_groups_are_listed_and_unknown_ones_refused() -> None:
    assert run_benchmarks("--list").stdout.split() == list(GROUPS)
    assert run_benchmarks("--list", "accuracy-*").stdout.split() == [n for n in GROUPS if n.startswith("accuracy-")]
    refused = run_benchmarks("layover", "nothing")
    assert refused.returncode == 2
    assert refused.stderr == "There is no group nothing; --list shows all groups.\n"
