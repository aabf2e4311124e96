"""Parts of a bag: some of its dwells, cut out or chosen, and replays that begin with its images or heights."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from helpers import assert_one_sentence, few

from sal_height.bag.compare import EQUAL, compare_bags
from sal_height.bag.copies import Range, cut
from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.graph.plan import Execution
from sal_height.runs.chain.entry import Part
from sal_height.runs.replay.bag_replay import Replay
from sal_height.runs.truth.simulate import fly
from sal_height.simulation.preset import Preset

SEED, DWELLS = 5, 5
ESTIMATED, TRACKED = {"/ml/height", "/monopulse/height"}, "/tracked/height"


@pytest.fixture(scope="module")
def flown(two_dwells: Preset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of a run of five dwells, with their images."""
    out = tmp_path_factory.mktemp("runs") / "flown"
    fly(dataclasses.replace(two_dwells, dwells=DWELLS), SEED, out, {}, Execution(record=["slc"]))
    return out


def summary(result: Replay) -> dict[str, tuple[int, int, int, bool]]:
    compared = result.compared.items()
    return {topic: (one.matched, one.missing, one.extra, one.verdict == EQUAL) for topic, one in compared}


def counts(bag: Path) -> dict[str, int]:
    """Messages by topic, without diagnostics and what is for viewers."""
    left_out = ("/diagnostics", "/image", "/points", "/tf", "/tf_static")
    return {name: topic.count for name, topic in BagReader(bag).topics.items() if not name.endswith(left_out)}


def test_heights_of_images_are_those_of_the_phase_history(flown: Path, tmp_path: Path, replay: Any) -> None:
    result = replay(flown / "bag", tmp_path / "out", {}, part=Part("slc"))
    assert summary(result) == dict.fromkeys({*ESTIMATED, TRACKED}, (DWELLS, 0, 0, True))
    assert "sar_compression" not in result.outcome.stages
    heights = {**dict.fromkeys([*ESTIMATED, TRACKED], DWELLS), "/losses": 0}
    assert counts(tmp_path / "out" / "bag") == {"/sensor_info": 1, "/slc": 8 * DWELLS, **heights}
    again = replay(tmp_path / "out" / "bag", tmp_path / "again", {}, part=Part("slc", first=1, last=1))
    assert {topic: summary(again)[topic] for topic in ESTIMATED} == dict.fromkeys(ESTIMATED, (1, 0, 0, True))


def test_from_heights_tracker_and_mapper_work_alone(flown: Path, tmp_path: Path, replay: Any) -> None:
    result = replay(flown / "bag", tmp_path / "out", {}, part=Part("heights"))
    assert summary(result) == {TRACKED: (DWELLS, 0, 0, True)}
    assert set(result.outcome.stages) == {"player", "relief_tracker", "relief_mapper"}
    assert result.shortfalls(changed=False) == []
    assert counts(tmp_path / "out" / "bag") == {"/ml/height": DWELLS, TRACKED: DWELLS, "/losses": 0}
    with rasterio.open(flown / "relief_map.tif") as ours, rasterio.open(tmp_path / "out" / "relief_map.tif") as theirs:
        assert np.array_equal(ours.read(), theirs.read(), equal_nan=True)
    values = {"relief_tracker": {"estimator": "monopulse"}}
    both = replay(flown / "bag", tmp_path / "both", values, part=Part("heights", first=2))
    assert counts(tmp_path / "both" / "bag") == {"/ml/height": 3, "/monopulse/height": 3, TRACKED: 3, "/losses": 0}
    assert both.outcome.dwells == 3


@pytest.mark.parametrize(
    ("part", "dwells"),
    [
        (Part(first=1, last=3), [1, 2, 3]),
        (Part(last=0), [0]),
        (Part(first=4), [4]),
        (Part(start_s=1.5, end_s=3.5), [2, 3]),
        (Part(start_s=1.0, end_s=1.0), [1]),
        (Part(first=3, end_s=3.0), [3]),
    ],
    ids=str,
)
def test_only_dwells_of_the_range_are_played_and_compared(
    part: Part, dwells: list[int], flown: Path, tmp_path: Path, replay: Any
) -> None:
    """Times are in dwell intervals here; odometry comes from around these dwells only."""
    reader = BagReader(flown / "bag")
    images = [reader.decode(m.type_name, m.cdr) for m in reader.messages(["/ml/height"])]
    interval_s = (images[1].header.stamp.nanosec - images[0].header.stamp.nanosec) % 1_000_000_000 * 1e-9
    scaled = dataclasses.replace(part, start_s=part.start_s * interval_s, end_s=part.end_s * interval_s)
    result = replay(flown / "bag", tmp_path / "out", {}, part=scaled)
    assert {topic: summary(result)[topic] for topic in ESTIMATED} == dict.fromkeys(ESTIMATED, (len(dwells), 0, 0, True))
    tracked = {TRACKED: (len(dwells), 0, 0, True)} if dwells[0] == 0 else {}  # else they need the dwells before
    assert {topic: one for topic, one in summary(result).items() if topic == TRACKED} == tracked
    assert result.shortfalls(changed=False) == []
    assert result.outcome.dwells == len(dwells)
    made = BagReader(tmp_path / "out" / "bag")
    assert [made.decode(m.type_name, m.cdr).dwell for m in made.messages(["/ml/height"])] == dwells
    assert counts(tmp_path / "out" / "bag")["/phase_history"] == 8 * len(dwells)


def test_a_range_without_dwells_is_refused(flown: Path, tmp_path: Path, replay: Any) -> None:
    for part in (Part(first=5), Part(start_s=1e4), Part(first=3, end_s=0.0)):
        with pytest.raises(UserError) as error:
            replay(flown / "bag", tmp_path / "out", {}, part=part)
        assert_one_sentence(str(error.value), "its 5 dwells have the numbers 0 to 4", "begin from 0 to ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("entry", "given", "estimators", "parts"),
    [
        ("slc", {}, [], ["has no messages on /slc", "--record slc"]),
        ("heights", {}, ["ml"], ["--estimators"]),
        ("heights", {"ml_height": {"range_looks": 1}}, [], ["ml_height", "relief_tracker, relief_mapper"]),
        ("heights", {"relief_tracker": {"estimator": "capon"}}, [], ["capon/height", "/ml/height"]),
    ],
)
def test_what_a_part_lacks_is_told(
    entry: str, given: Any, estimators: list[str], parts: list[str], recorded: Path, tmp_path: Path, replay: Any
) -> None:
    with pytest.raises(UserError) as error:
        replay(recorded / "bag", tmp_path / "out", given, estimators=estimators, part=Part(entry))
    assert_one_sentence(str(error.value), *parts)
    assert not (tmp_path / "out").exists()


def test_a_bag_without_heights_is_not_replayed_from_them(flown: Path, tmp_path: Path, replay: Any) -> None:
    only = replay(flown / "bag", tmp_path / "out", {}, estimators=["monopulse"], part=Part(last=0))
    assert only.outcome.dwells == 1
    with pytest.raises(UserError) as error:
        replay(
            tmp_path / "out" / "bag", tmp_path / "again", {"relief_mapper": {"estimator": "ml"}}, part=Part("heights")
        )
    assert_one_sentence(str(error.value), "ml/height", "/monopulse/height")


def test_the_command_takes_a_part(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], replay_words: list[str]
) -> None:
    options = ["--out", str(tmp_path / "out"), "--dwells", "2:3", "--from", "slc", "--start", "0", "--end", "1e3"]
    main([*replay_words, str(flown / "bag"), *options])
    assert json.loads((tmp_path / "out" / "report.json").read_text())["dwells"] == 2
    for wrong in ("3:2", "3", "a:b", f"0:{2**32}", "-1:2"):
        assert main(["replay", str(flown / "bag"), f"--dwells={wrong}"]) == 2
        assert "FIRST:LAST" in capsys.readouterr().err


@pytest.mark.parametrize("number", few(1, [1, 0]))
def test_a_cut_bag_gives_the_heights_of_its_dwells(number: int, recorded: Path, tmp_path: Path, replay: Any) -> None:
    """Value for value; those of the tracker depend on the dwells before."""
    cut(recorded / "bag", tmp_path / "cut", Range(dwells=(number, number)))
    result = replay(tmp_path / "cut", tmp_path / "replay", {})
    assert not result.outcome.losses
    for topic in ("/ml/height", "/monopulse/height"):
        compared = result.compared[topic]
        assert compared.verdict == EQUAL
        assert (compared.matched, compared.missing, compared.extra) == (1, 0, 0)
        (height,) = BagReader(tmp_path / "cut").messages([topic])
        (replayed,) = BagReader(tmp_path / "replay" / "bag").messages([topic])
        assert height.cdr == [m.cdr for m in BagReader(recorded / "bag").messages([topic])][number]
        assert BagReader(recorded / "bag").decode(replayed.type_name, replayed.cdr).dwell == number
    if number == 0:
        tracked = compare_bags(BagReader(tmp_path / "cut"), BagReader(tmp_path / "replay" / "bag"))["/tracked/height"]
        assert tracked.verdict == EQUAL
