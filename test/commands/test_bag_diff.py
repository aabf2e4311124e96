"""`sal-height bag diff`: what differs between two bags, and the exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rewritten_bag import rewritten

from sal_height.bag.reader import BagMessage
from sal_height.commands import main
from sal_height.messages import deserialize, serialize
from sal_height.messages.types import HeightImage

BAG = Path(__file__).parents[2] / "bags" / "version_3"


def moved(folder: Path, metres: float) -> Path:
    """A copy of the bag whose first height of ml in each dwell lies higher."""

    def higher(message: BagMessage, _: int) -> BagMessage:
        if message.topic != "/ml/height":
            return message
        image = deserialize(message.cdr, HeightImage)
        place = next(n for n, validity in enumerate(image.validity) if validity == HeightImage.OK)
        image.surfaces[0].height = image.surfaces[0].height.copy()
        image.surfaces[0].height[place] += metres
        return message._replace(cdr=serialize(image))

    return rewritten(BAG, folder, higher)


def diff(tmp_path: Path, other: Path, *words: str) -> int:
    return main(["bag", "diff", str(BAG), str(other), "--out", str(tmp_path / "out"), *words])


def test_a_bag_is_equal_to_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert diff(tmp_path, BAG) == 0
    assert f"equal; see {tmp_path / 'out'}\n" in capsys.readouterr().out
    said = json.loads((tmp_path / "out" / "diff.json").read_text())
    assert {topic: one["verdict"] for topic, one in said["topics"].items()} == dict.fromkeys(
        ["/sensor_info", "/platform/odometry", "/phase_history", "/monopulse/height", "/ml/height", "/tracked/height"],
        "equal",
    )
    assert not (tmp_path / "out" / "comparison.png").exists()


@pytest.mark.parametrize(("metres", "status", "verdict"), [(1e-6, 0, "within tolerance"), (0.1, 1, "changed")])
def test_a_height_that_moved_is_found(
    metres: float, status: int, verdict: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert diff(tmp_path, moved(tmp_path / "moved", metres)) == status
    said = json.loads((tmp_path / "out" / "diff.json").read_text())
    assert {topic for topic, one in said["topics"].items() if one["verdict"] != "equal"} == {"/ml/height"}
    assert said["verdict"] == said["topics"]["/ml/height"]["verdict"] == verdict
    assert ("surfaces[0].height is " in capsys.readouterr().out) == bool(status)
    assert (tmp_path / "out" / "comparison.png").is_file()


def test_only_the_topics_that_are_named_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = moved(tmp_path / "moved", 0.1)
    assert diff(tmp_path, other, "--topic", "monopulse/height") == 0
    assert main(["bag", "diff", str(BAG), str(other), "--topic", "slc", "--out", str(tmp_path / "none")]) == 2
    assert "Neither bag has topic /slc" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
