"""`sal-height movers`: from a bag to a report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence
from rewritten_bag import rewritten

from sal_height.bag.reader import BagMessage, BagReader
from sal_height.errors import UserError
from sal_height.messages import deserialize, serialize
from sal_height.messages.types import Odometry
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.runs.products.movers import find_in_bag, movers_table
from sal_height.runs.truth.simulate import fly
from sal_height.simulation.preset import TargetSettings, load_preset


def report_of(folder: Path) -> dict[str, Any]:
    report: dict[str, Any] = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return report


def without_covariance(one: BagMessage, _number: int) -> BagMessage:
    """The message; odometry with covariances that are not finite."""
    if one.topic != "/platform/odometry":
        return one
    state = deserialize(one.cdr, Odometry)
    state.pose.covariance = np.full(36, np.nan)
    return one._replace(cdr=serialize(state))


def recorded(folder: Path, preset: str, **changes: object) -> Path:
    """The bag of a short flight."""
    return record_sensor(replace(load_preset(preset), **changes), 3, folder)  # type: ignore[arg-type]


def test_a_mover_is_in_the_report(tmp_path: Path) -> None:
    target = TargetSettings(0.4, 1.0, 1.0, 30.0, radial_velocity_mps=0.005)
    bag = recorded(tmp_path / "bag", "sal_stripmap", targets=(target,), dwells=4)
    found, _ = find_in_bag(bag, tmp_path / "out", wanted={"false_alarm_rate": 1e-3})
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    (one,) = report["movers"]
    assert one["east_m"] == pytest.approx(0.4, abs=0.03)
    assert one["north_m"] == pytest.approx(1.0, abs=0.03)
    assert one["height_m"] == pytest.approx(1.0, abs=0.03)
    assert one["radial_velocity_mps"] == pytest.approx(0.005, abs=4 * one["radial_velocity_sigma_mps"])
    assert report["images"] == found["images"] == 2
    assert report["expected_false_alarms_at_most"] == pytest.approx(1e-3 * report["candidates"])
    assert f"{1e3 * one['radial_velocity_mps']:.2f}" in movers_table(found)


def test_a_mover_over_spotlight_dwells_is_in_the_report(tmp_path: Path) -> None:
    """The images have a column for each Doppler frequency, though the flight's have 12."""
    target = TargetSettings(0.1, 0.5, 0.8, 30.0, radial_velocity_mps=8.003)
    bag = recorded(tmp_path / "bag", "small", targets=(target,), dwells=5)
    found, _ = find_in_bag(bag, tmp_path / "out")
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    (one,) = report["movers"]
    assert one["dwell"] == 2
    assert one["east_m"] == pytest.approx(0.1, abs=0.03)
    assert one["height_m"] == pytest.approx(0.8, abs=0.03)
    assert one["walk_velocity_mps"] == pytest.approx(8.003, abs=4 * one["walk_velocity_sigma_mps"])
    assert one["found_by_walk"]
    assert report["images"] == found["images"] == 5


def test_a_bag_whose_dwells_tell_no_movers_is_refused_and_of_what_is_dim_a_sentence_tells(tmp_path: Path) -> None:
    bag = recorded(tmp_path / "bag", "small", dwells=1)
    with pytest.raises(UserError, match="overlaps with none"):
        find_in_bag(bag, tmp_path / "out")
    dim = recorded(tmp_path / "two", "small", dwells=2)
    told, warnings = find_in_bag(dim, tmp_path / "dim", wanted={"prominence_db": 60.0})
    assert told["candidates"] == 0
    assert_one_sentence(warnings[-1], "60 dB", "prominence_db")
    with pytest.raises(UserError, match=r"12 columns; .* 48 columns"):
        find_in_bag(bag, tmp_path / "narrow", given={"sar_compression": {"cols": 12}})


def test_what_the_compression_warns_of_is_told_once_and_counted(tmp_path: Path) -> None:
    """As the node counts it: odometry in doubt, phase that is not to be trusted, a strip without an image yet."""
    bag = rewritten(recorded(tmp_path / "dwells", "small", dwells=3), tmp_path / "doubted", without_covariance)
    unknown, kind = {"sar_compression": {"odometry_velocity_sigma_mps": -1.0}}, "odometry of unknown accuracy"
    _, warnings = find_in_bag(bag, tmp_path / "odometry", unknown)
    assert report_of(tmp_path / "odometry")["warned"] == {f"sar_compression: {kind}": 3}
    (said,) = [one for one in warnings if "odometry" in one]
    assert said.startswith(f"There is a warning on 3 of 3 dwells (sar_compression: {kind}). Dwell 0: The odometry")
    noisy = recorded(tmp_path / "noisy", "small", dwells=3, cnr_db=-25.0)
    _, warnings = find_in_bag(noisy, tmp_path / "autofocus", {"sar_compression": {"autofocus": "always"}})
    assert report_of(tmp_path / "autofocus")["warned"] == {"sar_compression: autofocus": 3}
    assert sum("warning on 3 of 3 dwells (sar_compression: autofocus)" in one for one in warnings) == 1
    short = replace(load_preset("sal_stripmap").sensor, pulse_count=32)
    strip = recorded(tmp_path / "strip", "sal_stripmap", dwells=2, sensor=short)
    with pytest.raises(
        UserError, match=r"a warning on 1 of 2 dwells \(sar_compression: strip incomplete\). Dwell 0: The f"
    ):
        find_in_bag(strip, tmp_path / "incomplete")
    assert report_of(tmp_path / "incomplete")["warned"] == {"sar_compression: strip incomplete": 1}


def test_how_many_dwells_were_left_out_is_said(tmp_path: Path) -> None:
    """Two for want of a channel, of which one has a frame that cannot be read."""

    def incomplete(one: BagMessage, number: int) -> BagMessage | None:
        if one.topic != "/phase_history" or number not in (1, 9):
            return one
        return one._replace(cdr=one.cdr[:40]) if number == 9 else None

    bag = rewritten(recorded(tmp_path / "whole", "small", dwells=6), tmp_path / "bag", incomplete)
    found, warnings = find_in_bag(bag, tmp_path / "out")
    assert movers_table(found).splitlines()[0].endswith(" of 4 images were looked at; 2 of 6 dwells were left out")
    told = " ".join(warnings)
    assert (
        "2 of 6 dwells were left out (sar_compression: incomplete dwell). Dwell 0: channels [1] did not arrive" in told
    )
    assert (
        "1 message was left out (sar_compression: broken message). A message on phase_history cannot be decoded" in told
    )
    report = report_of(tmp_path / "out")
    assert report["dropped"] == {"sar_compression: broken message": 1, "sar_compression: incomplete dwell": 2}
    assert report["dwells"] == 6
    with pytest.raises(
        UserError, match=r"no image in which .* 4 of 6 dwells were left out \(sar_compression: odometry gap\)"
    ):
        find_in_bag(bag, tmp_path / "none", {"sar_compression": {"max_odometry_gap_s": 1e-6}})
    assert report_of(tmp_path / "none")["dropped"]["sar_compression: odometry gap"] == 4


def test_a_run_records_the_movers_of_its_last_dwells_and_a_replay_repeats_them(tmp_path: Path, replay: Any) -> None:
    """Which the node tells when no more have come for timeout_s."""
    target = TargetSettings(0.1, 0.5, 0.8, 30.0, radial_velocity_mps=8.003)
    preset = replace(load_preset("small"), targets=(target,), dwells=3, estimators=("movers",))
    values = {"sar_compression": {"cols": 48}, "mover_detection": {"timeout_s": 4.0}}
    flown = fly(preset, 3, tmp_path / "run", values)
    assert flown.outcome.losses == []
    again = replay(tmp_path / "run" / "bag", tmp_path / "replay", {}, estimators=["movers"])
    assert again.outcome.losses == []
    clouds = [
        [one.cdr for one in BagReader(tmp_path / folder / "bag").messages() if one.topic == "/movers"]
        for folder in ("run", "replay")
    ]
    assert len(clouds[0]) == 3
    assert clouds[0] == clouds[1]
