"""Threads: as many as the process may use, on every operating system."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sal_height.numeric import in_parallel, jit


@pytest.mark.parametrize(
    ("quota", "expected"),
    [("max 100000\n", 8), ("250000 100000\n", 2), ("50000 100000\n", 1), ("9900000 100000\n", 8), ("", 8), (None, 8)],
)
def test_processors_are_those_of_affinity_and_of_the_container(
    quota: str | None, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if quota is not None:
        (tmp_path / "cpu.max").write_text(quota)
    monkeypatch.setattr(jit, "CPU_QUOTA", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(8)))
    assert jit.available_processors() == expected


def test_it_can_be_imported_where_there_is_no_affinity() -> None:
    """On macOS and Windows."""
    code = "import os; del os.sched_getaffinity; from sal_height.numeric import WORKERS; print(WORKERS)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)  # noqa: S603 (our own code)
    assert result.returncode == 0, result.stderr
    assert int(result.stdout) >= 1


@pytest.mark.parametrize("count", [0, 1, 2, 7, 1000])
@pytest.mark.parametrize("least", [1, 5, 10_000])
def test_every_item_is_worked_on_once(count: int, least: int) -> None:
    done = np.zeros(count, int)

    def work(part: slice) -> None:
        done[part] += 1

    in_parallel(work, count, least)
    assert np.all(done == 1)


PACKAGE = Path(jit.__file__).parents[1]


def compiled_functions() -> list[ast.FunctionDef]:
    """All functions of the package that numba compiles."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))]
    functions = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    return [
        function
        for function in functions
        if any(isinstance(mark, ast.Name) and mark.id in {"compiled", "inlined"} for mark in function.decorator_list)
    ]


def test_compiled_functions_do_without_infinity_and_nan() -> None:
    """They are compiled for finite numbers; comparing with others, or asking for them, is undefined there."""
    functions = compiled_functions()
    assert len(functions) > 20
    forbidden = {"inf", "nan", "isnan", "isinf", "isfinite"}
    used = {
        f"{function.name}: {node.attr}"
        for function in functions
        for node in ast.walk(function)
        if isinstance(node, ast.Attribute) and node.attr in forbidden
    }
    assert not used
