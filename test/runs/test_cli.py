"""Commands with a graph: what cannot be used ends them with status 2 and one sentence."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from blank_pictures import blank_pictures

from sal_height.commands import main
from sal_height.commands._options import output_folder
from sal_height.graph.catalogue import check_parameters
from sal_height.io import bag_name


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
        (
            ["run", "--param", "ml_height.range_looks=[1,"],
            "Node ml_height: Parameter range_looks is '[1,'",
        ),
        (["run", "--param", "ml_height.range_looks=[1,a]"], "it must be a whole number from 1"),
        (["run", "--param", "ml_height.range_looks=true"], "it must be a whole number from 1"),
        (["run", "--param", "ml_height.range_looks=0"], "it must be a whole number from 1"),
        (["run", "--param", "ml_height.min_cnr_db="], "it must be a number from -60 to 100"),
        (["run", "--param", "ml_height.min_cnr_db=.nan"], "it must be a number from -60 to 100"),
        (["run", "--param", "ml_height.min_cnr_db=2020-01-01"], "Node ml_height: Parameter min_cnr_db"),
        (["run", "--param", "ml_height.min_cnr_db=2020-13-01"], "Node ml_height: Parameter min_cnr_db"),
        (["run", "--param", "ml_height.objective={a: 1}"], "normalised, numerator"),
        (["run", "--preset", "xband_relief", "--dwells", "500"], "terrain"),
        (["replay", "no_such_bag"], "no_such_bag"),
        (["salvage", "no_such_bag"], "no_such_bag"),
        (["import", "gotcha", "no_such.mat"], "no_such.mat"),
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


@pytest.fixture(scope="module")
def beside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a run with options had to choose its output folder beside one that is in use."""
    folder = tmp_path_factory.mktemp("beside")
    words = ["--dwells", "1", "--cnr-db", "12", "--looks", "4x1", "--seed", "9"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("out/small").mkdir(parents=True)
        Path("out/small/mine.txt").write_text("mine")
        with blank_pictures():
            assert main(["run", "--preset", "small", *words]) == 0
    return folder


def test_options_change_the_preset(beside: Path) -> None:
    report = json.loads((beside / "out" / "small_2" / "report.json").read_text())
    assert (report["dwells"], report["cnr_db"], report["looks"], report["seed"]) == (1, 12.0, [4, 1], 9)


def test_a_whole_number_is_taken_for_a_float() -> None:
    checked = check_parameters({"ml_height": {"min_cnr_db": 3, "range_looks": 4, "objective": "numerator"}})
    assert checked == {"ml_height": {"min_cnr_db": 3.0, "range_looks": 4, "objective": "numerator"}}
    assert type(checked["ml_height"]["min_cnr_db"]) is float


def test_a_run_without_a_valid_height_ends_with_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--dwells", "1", "--param", "ml_height.min_cnr_db=100", "--param", "monopulse.min_cnr_db=100"]
    assert main(["run", "--preset", "small", *words, "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "No valid height" in said.err
    assert "height.png" not in said.out
    assert not (tmp_path / "out" / "height.png").exists()


@pytest.mark.usefixtures("blank_pictures")
def test_without_out_the_next_free_folder_is_taken(
    beside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert output_folder(None, "small") == Path("out/small")
    monkeypatch.chdir(beside)
    assert Path("out/small_2/height.png").is_file()
    assert main(["replay", "out/small_2/bag/bag_0.mcap"]) == 0
    assert Path("out/replay_small_2/report.json").is_file()
    assert "out/replay_small_2/report.json" in capsys.readouterr().out


@pytest.mark.usefixtures("blank_pictures")
def test_dropped_messages_end_a_run_with_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A range window of which no pixel is left after looks: monopulse is right, and ml has no image."""
    words = ["--dwells", "1", "--param", "ml_height.range_looks=512"]
    assert main(["run", "--preset", "small", *words, "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "sal-height: Node ml_height dropped 8 messages (cannot be processed).\n" in said.err
    rows = {line.split()[0]: line.split()[1:3] for line in said.out.splitlines()}
    assert rows["monopulse"] == ["1", "0"]
    assert rows["ml"] == ["0", "8"]
    assert json.loads((tmp_path / "out" / "report.json").read_text())["losses"][0] in said.err


def test_one_domain_is_chosen_in_one_way(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--domain", "7", "--join", "--out", str(tmp_path / "out")]) == 2
    assert "--join and --domain exclude each other" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("bag", "name"),
    [("trip/bag", "trip"), ("trip/bag/", "trip"), ("trip/bag/bag_0.mcap", "trip"), ("trip/", "trip"), ("a.mcap", "x")],
)
def test_a_replay_is_named_after_its_bag(bag: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x").mkdir()
    monkeypatch.chdir(tmp_path / "x")
    assert bag_name(Path(bag)) == name
