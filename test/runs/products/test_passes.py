"""`sal-height passes`: from bags of one pass each to a report, a picture and heights that can be exported."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
from pass_scenes import SMALL, flown, reflectors

from sal_height.commands._program import main
from sal_height.errors import UserError
from sal_height.exports import RecordedHeights, write_las
from sal_height.imports.collection import Collection, write_collection
from sal_height.imports.followed_point import focusing, states_towards
from sal_height.passes import Pass, ReferencePoint
from sal_height.runs.products.passes import heights_of_bags

WANTED = {"side_m": 16.0, "lowest_m": -1.0, "highest_m": 4.5, "position_sigma_m": 0.03}


def recorded(one: Pass, folder: Path) -> Path:
    """The bag of a pass."""
    stamps = np.rint(one.history.pulse_times * 1e9).astype(np.int64)
    velocity = np.asarray(np.gradient(one.antenna, stamps * 1e-9, axis=0))
    states = states_towards(stamps, one.antenna, velocity, np.zeros(3), one.sensor.look_side)
    image = focusing(one.sensor, one.antenna, SMALL.distance, 6.0, 0.2, "none")
    write_collection(Collection(one.sensor, [one.history], states, parameters=image), folder)
    return folder


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return reflectors(np.random.default_rng(11), 20)


@pytest.fixture(scope="module")
def bags(points: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Five of the passes over the points, the last of which sees other ground."""
    rng = np.random.default_rng(21)
    folder = tmp_path_factory.mktemp("passes")
    passes = flown(rng, points, phases=rng.uniform(-np.pi, np.pi, 8), offsets=rng.normal(0, 0.03, (8, 3)))
    chosen = [passes[number] for number in (0, 2, 4, 5, 7)]
    chosen[4] = chosen[4].moved(np.array([25.0, 0.0, 0.0]))
    return [recorded(one, folder / one.sensor.name) for one in chosen]


def test_bags_become_heights(bags: list[Path], points: np.ndarray, tmp_path: Path) -> None:
    references = [ReferencePoint(place, ties=number < 3) for number, place in enumerate(points[:8])]
    nowhere = ReferencePoint(np.array([2.0, 7.5, 30.0]))
    _, warnings = heights_of_bags(
        bags, tmp_path / "out", wanted=WANTED, references=[*references, nowhere], centre=(0.0, 0.0)
    )
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert report["passes_given"] == 5
    assert [one["name"] for one in report["passes"]] == ["pass_1", "pass_3", "pass_5", "pass_6"]
    assert any("Pass pass_8 is left out: the middle of the scene is" in sentence for sentence in warnings)
    assert any("reference point at 2, 7.5, 30 m is visible" in sentence for sentence in warnings)
    assert report["tie"]["common_offset"] == "reference points"
    compared = [one for one in report["references"] if one["found"]]
    assert len(compared) >= 7
    assert report["reference_height_errors"]["rms_m"] < 0.03
    for one in compared:
        assert abs(one["error_height_m"]) < 5 * one["sigma_m"]
    assert (tmp_path / "out" / "passes.png").stat().st_size > 10_000
    heights = RecordedHeights.of_bag(tmp_path / "out" / "bag")
    assert write_las(heights, tmp_path / "points.las") == len(report["points"]) >= 18
    assert np.sort(laspy.read(tmp_path / "points.las").z) == pytest.approx(
        np.sort([one["height_m"] for one in report["points"]]), abs=2e-3
    )


def test_the_command_says_what_it_did(
    bags: list[Path], points: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = ",".join(f"{value:.4f}" for value in points[1])
    wanted = [word for name, value in WANTED.items() for word in ("--set", f"{name}={value}")]
    arguments = [
        "passes",
        *map(str, bags),
        *wanted,
        "--compare",
        place,
        "--centre",
        "0,0",
        "--out",
        str(tmp_path / "o"),
    ]
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    assert "points with a height, sigma" in out
    assert "pass_6" in out
    assert "a common offset of all heights is not determined" in err


def test_what_cannot_be_used_is_one_sentence(bags: list[Path], tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"^1 pass was given; heights need 3 or more"):
        heights_of_bags(bags[:1], tmp_path / "one", wanted=WANTED)
    assert json.loads((tmp_path / "one" / "report.json").read_text(encoding="utf-8"))["failed"].startswith(
        "1 pass was given"
    )
    with pytest.raises(UserError, match="is named twice"):
        heights_of_bags([bags[0], bags[1], bags[0]], tmp_path / "twice", wanted=WANTED)
    with pytest.raises(UserError, match="is 'music'; of passes allowed are ml, capon"):
        heights_of_bags(bags, tmp_path / "music", "music", wanted=WANTED)
    with pytest.raises(UserError, match="both must be 1"):
        heights_of_bags(bags, tmp_path / "looks", wanted={**WANTED, "range_looks": 2})
    with pytest.raises(UserError, match="side_n"):
        heights_of_bags(bags, tmp_path / "name", wanted={"side_n": 2.0})


@pytest.mark.parametrize("option", [("--tie", "nan,0,0"), ("--compare", "0,0,-2e6"), ("--centre", "0,inf")])
def test_places_that_are_nowhere_are_refused(
    option: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["passes", "bag", *option, "--out", str(tmp_path / "out")]) == 2
    assert f"Option {option[0]} is {option[1]!r}; numbers must be at most 1e+06 m." in capsys.readouterr().err
