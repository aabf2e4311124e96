"""Compiled loops: what they may not contain."""

from __future__ import annotations

import ast
import logging
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import few
from numba import njit

import sal_height.graph.ensemble  # noqa: F401 (has all functions)
from sal_height.numeric import F64, jit

PACKAGE = Path(jit.__file__).parents[1]


@cache
def all_functions() -> list[ast.FunctionDef]:
    """Those of the package."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))]
    return [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def compiled_functions(*marks: str) -> list[ast.FunctionDef]:
    """All functions of the package that have one of these decorators."""
    return [
        function
        for function in all_functions()
        if any(isinstance(mark, ast.Name) and mark.id in marks for mark in function.decorator_list)
    ]


def test_compiled_functions_do_without_infinity_and_nan() -> None:
    """They are compiled for finite numbers; comparing with others, or asking for them, is undefined there."""
    functions = compiled_functions("compiled", "inlined")
    assert len(functions) > 20
    forbidden = {"inf", "nan", "isnan", "isinf", "isfinite"}
    used = {
        f"{function.name}: {node.attr}"
        for function in functions
        for node in ast.walk(function)
        if isinstance(node, ast.Attribute) and node.attr in forbidden
    }
    assert not used


def test_functions_with_nan_do_without_what_all_functions_share() -> None:
    """Numba may have compiled it for finite numbers, for a function that was compiled before."""
    functions = compiled_functions("compiled_with_nan", "inlined")
    assert len(functions) > 20
    nodes = [(function.name, node) for function in functions for node in ast.walk(function)]
    powers = {name for name, node in nodes if isinstance(node, ast.Pow)}
    distances = {name for name, node in nodes if isinstance(node, ast.Attribute) and node.attr == "hypot"}
    assert not powers | distances


def test_nan_stays_nan_beside_functions_without_it() -> None:
    """The functions compiled first are those that share most."""
    assert squares_below(np.array([2.0, 3.0]), 5.0) == 4.0
    assert finite_square(3.0) == 9.0
    assert finite_square(np.inf) == 0.0
    assert finite_square(np.nan) == 0.0


@pytest.mark.parametrize(
    "change", few(1, ["def twice(x):\n    return x + x + 1.0\n", "def twice(x):\n    return x + x\nADDED = 4.0\n"])
)
def test_a_function_is_compiled_again_when_one_of_another_file_has_changed(change: str, tmp_path: Path) -> None:
    """Or when a constant has."""
    of_others, own = tmp_path / "of_others.py", tmp_path / "own.py"
    head = "from sal_height.numeric.jit import compiled, inlined\n"
    between = tmp_path / "between.py"
    between.write_text(f"{head}from of_others import twice\n@compiled\ndef thrice(x):\n    return twice(x) + x\n")
    own.write_text(
        f"{head}from between import thrice\nfrom of_others import ADDED\n"
        "@compiled\ndef result(x):\n    return thrice(x) + ADDED\n"
        "print(result(2.0), sum(result.stats.cache_hits.values()))\n"
    )
    said = []
    for text in ("def twice(x):\n    return x + x\n", "", change):
        if text:
            of_others.write_text(f"{head}ADDED = 3.0\n@inlined\n{text}")
        ended = subprocess.run([sys.executable, own], check=True, capture_output=True, text=True)  # noqa: S603 (ours)
        said.append(ended.stdout)
    assert said == ["9.0 0\n", "9.0 1\n", "10.0 0\n"]


@jit.compiled
def squares_below(numbers: F64, limit: float) -> float:
    total = 0.0
    for i in range(len(numbers)):
        total += numbers[i] ** 2 if numbers[i] < limit / 2 else 0.0
    return total


@jit.compiled_with_nan
def finite_square(number: float) -> float:
    square = jit.squared(number)
    return square if square < np.inf else 0.0


def test_compilation_is_reported_once(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many kernels a process compiles, and nothing where they are cached."""
    caplog.set_level(logging.WARNING, jit.__name__)
    monkeypatch.setattr(jit.NOTICE, "is_given", False)
    for number in range(2):
        function = njit(lambda x, number=number: x + number)
        assert function(1.0) == function(2) - 1
    (said,) = caplog.messages
    assert said.startswith("Compiling kernels for this processor, once: ")


def test_loops_run_as_python_for_whoever_looks_into_them() -> None:
    """NUMBA_DISABLE_JIT is for debuggers and for measuring coverage."""
    program = (
        "import numpy as np; from sal_height.numeric.jit import compiled; print(compiled(lambda x: x + 1)(np.pi) > 4)"
    )
    run = subprocess.run(  # noqa: S603 (our own program)
        [sys.executable, "-c", program],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.stdout == "True\n", run.stderr
