"""Imports of CPHD and CRSD files: messages of refusals, messages of bags, and images of the target."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown_target import CARRIER, ELEVATION, RANGE, TARGET
from scipy.constants import speed_of_light

from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.runs.replay.bag_replay import replay


def complaint(name: str, path: Path, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The message of `sal-height import` on a file that it refuses, with the exit status 2 and without a bag."""
    bag = path.parent / "refused"
    assert main(["import", name, str(path), "--out", str(bag), *words]) == 2
    assert not bag.exists()
    return capsys.readouterr().err.strip().removeprefix("sal-height: ")


def only(bag: Path, topic: str) -> Any:
    """The only message of a topic."""
    reader = BagReader(bag)
    (message,) = (reader.decode(one.type_name, one.cdr) for one in reader.messages([topic]))
    return message


def assert_focused(bag: Path, out: Path, bandwidth: float, length: float) -> None:
    """The target of a bag is where it stands to 5 mm, and as sharp as theory says.

    That is .886 c / 2 B across, .886 lambda R / 2 L along, for the bandwidth B (Hz) and the aperture's length L (m).
    """
    replay(bag, out, {})
    (image,) = json.loads((out / "report.json").read_text())["images"]
    np.testing.assert_allclose(np.array(image["brightest_east_north_up_m"])[:2], TARGET[:2], rtol=0, atol=0.005)
    across = 0.886 * speed_of_light / (2 * bandwidth) / math.sin(ELEVATION)
    along = 0.886 * speed_of_light / CARRIER * RANGE / (2 * length)
    assert image["row_width_3db_m"] == pytest.approx(across, rel=0.03)
    assert image["col_width_3db_m"] == pytest.approx(along, rel=0.03)
