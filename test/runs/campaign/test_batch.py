"""Campaigns on the workers of Dask."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster
from helpers import assert_one_sentence, few
from PIL import Image
from pyarrow.parquet import read_table

from sal_height.bag.compare import EQUAL, compare_bags
from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.runs.campaign import batch
from sal_height.runs.campaign.batch import CAMPAIGN, DONE, PICTURE, SUMMARY, Campaign, Workers, run_campaign

HEIGHTS = ["/ml/height", "/monopulse/height", "/tracked/height"]
DEADLINE_S = 600.0


@pytest.fixture(scope="module")
def cluster() -> Iterator[Workers]:
    """A cluster of one worker, as somebody has it running."""
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", processes=False) as running:
        yield Workers(scheduler=running.scheduler_address)


def damaged(bag: Path, folder: Path) -> Path:
    """A copy of a bag without its end."""
    shutil.copytree(bag, folder)
    (file,) = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:5000])
    return folder


def has_members(group: int) -> bool:
    """Whether there are processes in a group."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def verdicts(golden: Path, made: Path) -> set[str]:
    return {one.verdict for one in compare_bags(BagReader(golden), BagReader(made), topics=HEIGHTS).values()}


def test_bags_are_processed_and_one_that_cannot_be_does_not_stop_the_others(
    recorded: Path, tmp_path: Path, cluster: Workers
) -> None:
    bags = [recorded / "bag", damaged(recorded / "bag", tmp_path / "cut"), recorded / "bag"]
    rows = run_campaign(Campaign(bags), tmp_path / "out", cluster)
    assert_one_sentence(rows[1]["failure"], "cut off", str(tmp_path / "cut"))
    for row, name in ((rows[0], "recorded"), (rows[2], "recorded_2")):
        assert (row["failure"], row["dwells"], row["dropped"], row["images"]) == ("", 2, 0, 6)
        assert row["against_recorded"] == EQUAL
        assert verdicts(recorded / "bag", tmp_path / "out" / name / "bag") == {EQUAL}
    report = json.loads((recorded / "report.json").read_text())
    assert rows[0]["ml_s68_m"] == pytest.approx(report["estimators"]["ml"]["s68_m"])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [CAMPAIGN, "recorded", "recorded_2", SUMMARY]

    table = read_table(tmp_path / "out" / SUMMARY)
    assert table["bag"].to_pylist() == [str(bag) for bag in bags]
    assert table["ml_s68_m"].to_pylist() == [rows[0]["ml_s68_m"], None, rows[2]["ml_s68_m"]]
    assert [bool(failure) for failure in table["failure"].to_pylist()] == [False, True, False]


def test_settings_are_compared(recorded: Path, tmp_path: Path, cluster: Workers, capsys: Any) -> None:
    words = ["batch", str(recorded / "bag"), "--out", str(tmp_path / "out"), "--scheduler", cluster.scheduler]
    words += ["--param", "ml_height.range_looks=1,2", "--param", "relief_tracker.estimator=ml,monopulse"]
    words += ["--param", "monopulse.azimuth_looks=3"]
    assert main(words) == 0
    rows = read_table(tmp_path / "out" / SUMMARY).to_pylist()
    found = [(row["ml_height.range_looks"], row["relief_tracker.estimator"]) for row in rows]
    assert found == [(1, "ml"), (1, "monopulse"), (2, "ml"), (2, "monopulse")]
    first, second, third, _ = rows
    assert first["ml_s68_m"] == second["ml_s68_m"] != third["ml_s68_m"]
    assert first["tracked_s68_m"] != second["tracked_s68_m"]
    with Image.open(tmp_path / "out" / PICTURE) as picture:
        assert picture.width > 500
    assert "ml_height.range_looks" in capsys.readouterr().out


def runs_on(program: subprocess.Popen[Any]) -> bool:
    """Whether a program runs for a moment more, in which it has the processors for itself."""
    try:
        program.wait(0.02)
    except subprocess.TimeoutExpired:
        return True
    return False


@pytest.mark.parametrize(("number", "status"), few(1, [(signal.SIGINT, 130), (signal.SIGKILL, -9)]))
def test_a_campaign_goes_on_where_it_was_ended(
    number: signal.Signals, status: int, recorded: Path, tmp_path: Path, cluster: Workers
) -> None:
    """Its workers end, too, as by a terminal; no bag is processed twice, and the heights are the same."""
    out = tmp_path / "out"
    bags = [shutil.copytree(recorded, tmp_path / f"flight_{number}") / "bag" for number in range(3)]
    words = ["batch", *map(str, bags), "--out", str(out), "--dwells", "1"]
    program = subprocess.Popen(  # noqa: S603 (our own program)
        [sys.executable, "-m", "sal_height", *words, "--workers", "1"],
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + DEADLINE_S
    while not (found := list(out.glob(f"flight_?/{DONE}"))) and time.monotonic() < deadline:
        assert runs_on(program)
    os.killpg(program.pid, number)
    said, log = program.communicate(timeout=DEADLINE_S)
    interrupted = f"interrupted; the same command goes on with {out}\n" if number == signal.SIGINT else ""
    assert (program.returncode, said) == (status, interrupted)
    assert "Traceback" not in log
    never = threading.Event()
    while has_members(program.pid):
        assert time.monotonic() < deadline
        never.wait(0.05)
    done = {file: file.stat().st_mtime_ns for file in found}
    assert 0 < len(done) < 3
    assert not (out / SUMMARY).exists()
    assert main([*words, "--scheduler", cluster.scheduler]) == 0
    assert {file: file.stat().st_mtime_ns for file in done} == done
    rows = read_table(out / SUMMARY).to_pylist()
    assert [(row["failure"], row["against_recorded"]) for row in rows] == [("", EQUAL)] * 3
    left = {path.name for path in out.iterdir()}
    assert left == {"flight_0", "flight_1", "flight_2", CAMPAIGN, SUMMARY}
    assert main([*words, "--scheduler", cluster.scheduler]) == 0  # there is nothing left to do


def test_what_is_in_the_way_is_refused(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "CONNECT_S", 0.5)
    campaign, out = Campaign([recorded / "bag"]), tmp_path / "out"
    out.mkdir()
    (out / "file").write_text("")
    with pytest.raises(UserError) as error:
        run_campaign(campaign, out, Workers())
    assert_one_sentence(str(error.value), str(out), "--out")
    (out / "file").unlink()
    (out / CAMPAIGN).write_text(json.dumps({**campaign.as_json(), "estimators": ["ml"]}))
    with pytest.raises(UserError, match="contains another campaign"):
        run_campaign(campaign, out, Workers())
    wrong = Campaign([recorded / "bag"], varied={"ml_height.range_looks": [1, -1]})
    with pytest.raises(UserError, match="range_looks"):
        run_campaign(wrong, tmp_path / "new", Workers())
    for product, remedy in {"adjusted": "sal-height adjust", "movers": "sal-height movers"}.items():
        with pytest.raises(UserError, match=remedy):
            run_campaign(Campaign([recorded / "bag"], estimators=("ml", product)), tmp_path / "new", Workers())
    with pytest.raises(UserError, match=r"^Bag nobag does not exist"):
        run_campaign(Campaign([recorded / "bag", Path("nobag")]), tmp_path / "new", Workers())
    assert not (tmp_path / "new").exists()
    with pytest.raises(UserError, match=r"no Dask scheduler at 'tcp://127\.0\.0\.1:1'"):
        run_campaign(campaign, tmp_path / "new", Workers(scheduler="tcp://127.0.0.1:1"))
