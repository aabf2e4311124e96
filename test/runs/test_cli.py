"""The command line: what cannot be used ends it with status 2 and one sentence."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sal_height.cli import main


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "--preset", "no_such"], "sal_spotlight"),
        (["run", "--scene", "no_such.tif"], "no_such.tif"),
        (["run", "--dwells", "0"], "dwells"),
        (["run", "--cnr-db", "nan"], "cnr_db"),
        (["run", "--cnr-db", "500"], "cnr_db"),
        (["run", "--preset", "small", "--looks", "99x2"], "fit"),
        (["run", "--param", "nobody.x=1"], "nobody"),
        (["run", "--param", "ml_height.loks=1"], "loks"),
        (["run", "--preset", "small", "--param", "ml_height.objective=best"], "normalised, numerator"),
        (["run", "--preset", "xband_relief", "--dwells", "500"], "terrain"),
        (["replay", "no_such_bag"], "no_such_bag"),
        (["salvage", "no_such_bag"], "no_such_bag"),
        (["import-gotcha", "no_such.mat"], "no_such.mat"),
    ],
)
def test_what_cannot_be_used_is_named_in_one_sentence(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    complaint = capsys.readouterr().err.splitlines()[-1]
    assert complaint.startswith("sal-height: ")
    assert said in complaint
    assert "Traceback" not in complaint


@pytest.mark.parametrize("words", [["run", "--looks", "2"], ["run", "--seed", "-1"], ["run", "--param", "x"], []])
def test_malformed_options_end_with_status_2(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    assert "error:" in capsys.readouterr().err


def test_an_output_folder_in_use_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert main(["run", "--preset", "small", "--out", str(tmp_path)]) == 2
    assert "not empty" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_options_change_the_preset(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["--dwells", "1", "--cnr-db", "12", "--looks", "4x1", "--seed", "9"]
    assert main(["run", "--preset", "small", *words, "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    assert (report["dwells"], report["cnr_db"], report["looks"], report["seed"]) == (1, 12.0, [4, 1], 9)


def test_help_shows_how(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert end.value.code == 0
    assert "sal-height replay" in capsys.readouterr().out
