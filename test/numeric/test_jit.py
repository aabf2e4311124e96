"""Compiled loops: what they may not contain."""

from __future__ import annotations

import ast
from pathlib import Path

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
