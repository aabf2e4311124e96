"""docs/parameters.md says what the settings models of the nodes say."""

from __future__ import annotations

import runpy
from pathlib import Path

TOOL = Path(__file__).parents[1] / "tools" / "parameter_tables.py"


def test_tables_of_parameters_are_up_to_date() -> None:
    tool = runpy.run_path(str(TOOL))
    written = tool["DOCUMENT"].read_text(encoding="utf-8")
    assert written == tool["document"](), (
        "docs/parameters.md is out of date: .venv/bin/python tools/parameter_tables.py"
    )
