"""Texts that users see are plain English: none of the private words that CONTRIBUTING.md lists first."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]

PRIVATE = re.compile(
    r"\b(tells?|told|untold|hears?|heard|listens?|anew|so many|(is|are) none\b(?! of)|besides|lies off|lay off)\b",
    re.IGNORECASE,
)
"""Words for which the field has better ones: publish, report, receive, again, N, invalid, in addition, misaligned."""

MODULES = sorted((ROOT / "sal_height").rglob("*.py"))
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", *(ROOT / "msg_defs" / "msg").glob("*.msg")])


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def texts_of(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of each literal with a space that is no docstring: messages, help, labels of pictures."""
    documentation = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        is_text = isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documentation
        if is_text and " " in str(node.value).strip() and not re.search(r"^[\w ]*\(| else ", str(node.value)):
            yield node.lineno, str(node.value)


def test_messages_and_help_use_no_private_words() -> None:
    found = [
        (path.name, line, text) for path in MODULES for line, text in texts_of(tree_of(path)) if PRIVATE.search(text)
    ]
    assert not found


def test_documents_use_no_private_words() -> None:
    """Among them the reference, which has the help of all commands."""
    lines = [(path, *one) for path in PAGES for one in enumerate(path.read_text().splitlines(), start=1)]
    assert not [(path.name, number, line) for path, number, line in lines if PRIVATE.search(line)]


def classes_and_docstrings() -> Iterator[tuple[str, str, str]]:
    """Module, name (empty if it is no class) and docstring of each module, class and function."""
    for path in MODULES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
                name = node.name if isinstance(node, ast.ClassDef) else ""
                yield str(path.relative_to(ROOT)), name, ast.get_docstring(node) or ""


def test_no_two_classes_have_one_name() -> None:
    modules: dict[str, list[str]] = {}
    for module, name, _ in classes_and_docstrings():
        if name and not name.startswith("_"):
            modules.setdefault(name, []).append(module)
    assert not {name: places for name, places in modules.items() if len(places) > 1}


def test_docstrings_say_what_a_thing_is() -> None:
    """Not: what it does, who does it, or whether something is so."""
    question = re.compile(r"(What|Who|Where|Whether|How)\b")
    assert not [(module, text[:80]) for module, _, text in classes_and_docstrings() if question.match(text)]


def test_private_words_are_found_and_docstrings_are_left_out() -> None:
    source = (
        'def f():\n    """What is told."""\n    return f"Nobody tells {f}; {f} is none of these, and {f} is none."\n'
    )
    assert [text for _, text in texts_of(ast.parse(source)) if PRIVATE.search(text)] == ["Nobody tells ", " is none."]
