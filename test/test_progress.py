"""Progress in a log, which is no terminal."""

from __future__ import annotations

import pytest

from sal_height import progress


def test_a_log_has_lines_without_carriage_returns(capsys: pytest.CaptureFixture[str]) -> None:
    """The first and the last state, and no others within the time between two lines."""
    with progress.Bar(total=3, unit="dwell", desc="small") as bar:
        for _ in range(3):
            bar.set_postfix_str("dropped 1", refresh=False)
            bar.update()
    first, last = capsys.readouterr().err.splitlines(keepends=True)
    assert first == "small: 0 of 3 dwell after 00:00\n"
    assert last == "small: 3 of 3 dwell after 00:00, dropped 1\n"


def test_states_of_long_work_are_lines(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "LINES_S", 0.0)
    for _ in progress.Bar(range(3), unit="image", desc="irf", leave=False):
        pass
    lines = capsys.readouterr().err.split("\n")
    assert [line.partition(" after")[0] for line in lines if line] == [f"irf: {n} of 3 image" for n in range(4)]


def test_what_is_done_soon_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(progress.Bar("ab", unit="image", delay=100)) == ["a", "b"]
    assert capsys.readouterr().err == ""
