"""Where the parameters of a replay come from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from helpers import assert_one_sentence
from written_bag import calibration, changed, frame, heights, key, told, written

from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.graph.plan import DwellChanges
from sal_height.runs.chain.entry import WHOLE, ReplayNodes
from sal_height.runs.chain.replay_parameters import ReplayPlan, processing_of

STAGES = ["sar_compression", "ml_height", "relief_tracker"]
CHAIN = ReplayNodes("phase_history", ["ml_height"], STAGES, 1, ["/phase_history"])


def processing(reader: BagReader, given: Any = None) -> ReplayPlan:
    return processing_of(reader, CHAIN, WHOLE, {"relief_tracker": {"estimator": "capon"}}, given or {})


def test_every_value_has_a_source(tmp_path: Path) -> None:
    custom = {"parameters": json.dumps({"ml_height": {"range_looks": 4, "azimuth_looks": 4}})}
    made = {"range_looks": 4, "azimuth_looks": 1, "min_cnr_db": 17.0}
    reader = written(tmp_path / "bag", [frame(0), heights(0, ml_height=made)], custom)
    found = processing(reader, {"ml_height": {"objective": "numerator"}})
    assert found.values == {
        "ml_height": {"range_looks": 4, "azimuth_looks": 1, "min_cnr_db": 17.0, "objective": "numerator"},
        "relief_tracker": {"estimator": "capon"},
    }
    sources = found.sources["ml_height"]
    assert sources["range_looks"] == "custom data of the bag"
    assert sources["azimuth_looks"] == "provenance"  # somebody set it before the first dwell
    assert sources["min_cnr_db"] == "provenance"  # may have been the default of that time
    assert sources["layover"] == "default"  # which nothing states
    assert sources["objective"] == "command line"
    assert found.sources["relief_tracker"]["estimator"] == "chosen by the replay"
    assert set(found.sources["sar_compression"].values()) == {"default"}
    assert (found.changes, found.warnings) == ([], [])


def test_numbers_without_a_point_are_numbers(tmp_path: Path) -> None:
    """JSON writes 1e-05, which YAML takes for a text."""
    custom = {"parameters": json.dumps({"sar_compression": {"odometry_delay_sigma_s": 1e-5}})}
    found = processing(written(tmp_path / "bag", [frame(0)], custom))
    assert found.values["sar_compression"] == {"odometry_delay_sigma_s": 1e-5}


def test_without_custom_data_heights_and_nodes_say_it(tmp_path: Path) -> None:
    told_before = told("ml_height", min_cnr_db=17.0, range_looks=3)
    found = processing(written(tmp_path / "bag", [told_before, frame(0), heights(0, ml_height={"range_looks": 4})]))
    assert found.values["ml_height"] == {"min_cnr_db": 17.0, "range_looks": 4}
    assert found.sources["ml_height"]["min_cnr_db"] == "parameter event"
    assert found.sources["ml_height"]["range_looks"] == "provenance"


def test_changes_are_scheduled_but_for_what_the_user_sets_and_for_nodes_that_are_not_there(
    tmp_path: Path,
) -> None:
    said = [
        told("ml_height", range_looks=3),
        frame(0),
        changed("ml_height", range_looks=2, azimuth_looks=2),
        changed("monopulse", range_looks=2),
        frame(1),
    ]
    reader = written(tmp_path / "bag", said)
    assert processing(reader).changes == [DwellChanges(key(1), {"ml_height": {"range_looks": 2, "azimuth_looks": 2}})]
    given = processing(reader, {"ml_height": {"range_looks": 5}})
    assert given.changes == [DwellChanges(key(1), {"ml_height": {"azimuth_looks": 2}})]
    assert given.values["ml_height"]["range_looks"] == 5


def test_what_cannot_be_done_again_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    stage = {"sar_compression": {"calibration": "topic"}, "ml_height": {"of_yesterday": 1}}
    said = [
        told("sar_compression", map_frame="map"),
        *(frame(0), heights(0, "lost", **stage)),
        told("sar_compression", map_frame="world"),
        *(frame(1), heights(1, "lost", **stage)),
        frame(2),
    ]
    found = processing(written(tmp_path / "bag", said))
    gone, restarted, lost = found.warnings
    assert_one_sentence(gone, "ml_height", "of_yesterday", "provenance")
    assert_one_sentence(restarted, "sar_compression", "map_frame='world'", "dwell 1")
    assert_one_sentence(lost, "'lost'", "dwell 0", "/calibration")
    assert [text.endswith(end) for text, end in zip(caplog.messages, found.warnings, strict=True)] == [True] * 3
    assert found.changes == []


def test_a_value_that_is_not_allowed_today_is_refused(tmp_path: Path) -> None:
    said = [told("ml_height", range_looks=3), frame(0), changed("ml_height", range_looks=0), frame(1)]
    with pytest.raises(UserError, match=r"^Node ml_height: Parameter range_looks is 0; it must be"):
        processing(written(tmp_path / "bag", said))


@pytest.mark.parametrize(
    ("flown", "given", "applied", "played"),
    [
        ("topic", None, "topic", True),
        ("gone.npz", None, "topic", True),  # the bag has what the file had
        ("gone.npz", "mine.npz", "mine.npz", False),
        ("topic", "", "", False),
    ],
)
def test_the_calibration_of_the_bag_is_applied_unless_the_user_has_another(
    flown: str, given: str | None, applied: str, played: bool, tmp_path: Path
) -> None:
    image = heights(0, "first", sar_compression={"calibration": flown})
    reader = written(tmp_path / "bag", [calibration("first"), frame(0), image])
    found = processing(reader, None if given is None else {"sar_compression": {"calibration": given}})
    assert found.values["sar_compression"]["calibration"] == applied
    assert found.plays_calibrations is played
    assert found.changes == ([DwellChanges(key(0), {}, ("first",))] if played else [])


def test_calibrations_that_nobody_applied_in_flight_are_applied_if_the_user_wants_it(tmp_path: Path) -> None:
    """Each from the dwell on before which it came; they are left out otherwise."""
    said = [calibration("one"), frame(0), heights(0), calibration("two"), frame(1), heights(1), frame(2), heights(2)]
    reader = written(tmp_path / "bag", said)
    assert processing(reader).changes == []
    wanted = processing(reader, {"sar_compression": {"calibration": "topic"}})
    assert wanted.changes == [DwellChanges(key(0), {}, ("one",)), DwellChanges(key(1), {}, ("two",))]
