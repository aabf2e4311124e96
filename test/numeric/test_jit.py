"""Compiled loops: what they may not contain."""

from __future__ import annotations

import ast
import logging
import math
from pathlib import Path

import pytest
from numba import njit

import sal_height.runs.ensemble  # noqa: F401 (has all functions)
from sal_height.numeric import jit

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


def test_whoever_waits_for_the_compiler_is_told_once_in_a_while(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A function from the cache is none of those."""
    caplog.set_level(logging.WARNING, jit.__name__)
    monkeypatch.setattr(jit.PROGRESS, "_told_at", -math.inf)
    assert jit.PROGRESS.functions > 50
    before = jit.PROGRESS.done
    for number in range(2):
        function = njit(lambda x, number=number: x + number)
        assert function(1.0) == function(2.0) - 1.0
    assert jit.PROGRESS.done == before + 2
    (said,) = caplog.messages
    assert said.startswith(f"Compiling for this processor, once: {before} functions done, ")
