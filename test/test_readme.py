"""The examples in README.md run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"
EXAMPLES = re.findall(r"^```python\n(.*?)^```", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_runs_as_it_stands(example: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(example, str(README), "exec"), {})  # noqa: S102 (our own text)
    assert capsys.readouterr().out


def test_there_is_an_example_of_ten_lines_from_preset_to_heights() -> None:
    (whole,) = [example for example in EXAMPLES if "load_preset" in example and "heights(" in example]
    assert len([line for line in whole.splitlines() if line.strip()]) <= 10
