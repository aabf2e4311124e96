"""The verdict on a bag, and what is shown of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sal_height.bag.compare import CHANGED, EQUAL, WITHIN, TopicComparison, compare_bags
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import Tolerance, Tolerances
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.messages import serialize
from sal_height.messages.types import (
    DiagnosticArray,
    DiagnosticStatus,
    HeightImage,
    KeyValue,
    PointCloud2,
    Surface,
    TFMessage,
)
from sal_height.runs.replay.difference_picture import worst_pair
from sal_height.runs.replay.judge import PICTURE, as_json, draw_worst_dwell, topics_to_compare, verdict_of

ROWS, COLS = 8, 6


def write(folder: Path, heights: dict[int, np.ndarray], latency_ms: float = 5.0, *, views: bool = False) -> BagReader:
    """A bag with an image of each dwell, and with what a node says before and after them; with topics for viewers."""
    with BagWriter(folder) as bag:
        bag.add_topic("/ml/height", HEIGHT_TYPE)
        bag.add_topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        if views:
            bag.add_topic("/ml/points", PointCloud2.__msgtype__)
            bag.add_topic("/tf", TFMessage.__msgtype__)
        for dwell, values in heights.items():
            message = HeightImage(dwell=dwell, validity=np.zeros(values.size, np.uint8))
            message.grid.rows, message.grid.cols = values.shape
            message.surfaces = [Surface(height=values.ravel().astype(np.float32))]
            bag.write("/ml/height", serialize(message), dwell, dwell)
        for time, latency in ((0, 1.0), (99, latency_ms)):
            values = [KeyValue(key=f"latency_{name}_ms", value=str(latency)) for name in ("p50", "p95")]
            status = DiagnosticStatus(name="ml_height", values=values)
            bag.write("/diagnostics", serialize(DiagnosticArray(status=[status])), time, time)
    return BagReader(folder)


def judged(golden: BagReader, made: BagReader, folder: Path) -> dict[str, TopicComparison]:
    compared = compare_bags(golden, made)
    draw_worst_dwell(golden, made, compared, folder)
    return compared


def dwells(number: int) -> dict[int, np.ndarray]:
    return {dwell: np.random.default_rng(dwell).normal(size=(ROWS, COLS)) for dwell in range(number)}


def test_the_worst_dwell_is_drawn(tmp_path: Path) -> None:
    """One pixel changes in dwell 1, three in dwell 2, of which one loses its height."""
    changed = dwells(3)
    changed[1][0, 0] += 1
    changed[2][3, :3] += 1
    changed[2][3, 1] = np.nan
    golden, made = write(tmp_path / "golden", dwells(3)), write(tmp_path / "made", changed)
    compared = judged(golden, made, tmp_path)
    assert (verdict_of(compared), compared["/ml/height"].worst) == (CHANGED, 2)
    with Image.open(tmp_path / PICTURE) as picture:
        magenta = (np.asarray(picture.convert("RGB")) == (255, 0, 255)).all(axis=2)
    assert np.count_nonzero(magenta) > 500  # the lost pixel


def test_of_dwells_of_one_number_the_pair_of_one_stamp_is_drawn_that_differs() -> None:
    flat, high = np.zeros((ROWS, COLS)), np.ones((ROWS, COLS))
    golden, made = worst_pair({5: flat, 6: high, 7: flat}, {7: high, 6: high, 8: flat})
    assert (golden.max(), made.max()) == (0.0, 1.0)
    golden, made = worst_pair({1: high}, {2: flat, 3: high})
    assert (golden.max(), made.max()) == (1.0, 0.0)


def test_images_of_another_shape_are_drawn_side_by_side(tmp_path: Path) -> None:
    golden, made = write(tmp_path / "golden", dwells(1)), write(tmp_path / "made", {0: np.zeros((ROWS - 1, COLS))})
    assert verdict_of(judged(golden, made, tmp_path)) == CHANGED
    assert (tmp_path / PICTURE).is_file()


def test_equal_bags_need_no_picture(tmp_path: Path) -> None:
    golden, made = write(tmp_path / "golden", dwells(2)), write(tmp_path / "made", dwells(2), latency_ms=7.0)
    compared = judged(golden, made, tmp_path)
    assert not (tmp_path / PICTURE).exists()
    said = as_json(golden, made, compared, Tolerances({"*": Tolerance(sigma=2)}))
    assert (said["verdict"], said["golden"], said["tolerances"]) == (EQUAL, "golden", {"*": {"sigma": 2}})
    assert said["latency_p50_ms"] == {"ml_height": {"golden": 5.0, "made": 7.0}}
    topic = said["topics"]["/ml/height"]
    assert topic["validity"] == {"OK": {"OK": 2 * ROWS * COLS}}
    assert topic["sha256"]["golden"] == topic["sha256"]["made"] != ""


def test_the_verdict_is_the_worst_of_all_topics() -> None:
    equal, changed = TopicComparison(matched=1), TopicComparison(matched=1, missing=1)
    assert verdict_of({"/a": equal}) == EQUAL
    assert verdict_of({"/a": equal, "/b": changed}) == CHANGED
    assert verdict_of({}) == CHANGED
    assert WITHIN not in {verdict_of({"/a": changed}), verdict_of({"/a": equal})}


def test_topics_are_those_named_or_all_that_can_be_the_same_twice(tmp_path: Path) -> None:
    golden, made = write(tmp_path / "golden", dwells(1)), write(tmp_path / "made", dwells(1))
    assert topics_to_compare(golden, made, []) == ["/ml/height"]
    assert topics_to_compare(golden, made, ["diagnostics"]) == ["/diagnostics"]
    with_points = write(tmp_path / "with_points", dwells(1), views=True)
    assert topics_to_compare(golden, with_points, []) == ["/ml/height"]
    assert topics_to_compare(with_points, with_points, []) == ["/ml/height", "/ml/points", "/tf"]
    with pytest.raises(UserError, match="Neither bag has topic /slc; they have /ml/height, /diagnostics"):
        topics_to_compare(golden, made, ["slc"])
