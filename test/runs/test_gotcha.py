"""Import of AFRL Gotcha: files that cannot be used are refused by name, in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence
from scipy.io import savemat

from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.runs.gotcha import import_gotcha

PULSES, FREQUENCIES = 5, 16
STEP = 1.5e6


def write_mat(path: Path, **changes: Any) -> Path:
    """A file in the format of Gotcha, with other values of some fields."""
    rng = np.random.default_rng(1)
    azimuth = np.radians(np.linspace(0, 0.04, PULSES))[None]
    values = {
        "fp": rng.standard_normal((FREQUENCIES, PULSES)) + 1j * rng.standard_normal((FREQUENCIES, PULSES)),
        "freq": (9.3e9 + STEP * np.arange(FREQUENCIES))[:, None].astype(np.float32),
        "x": 7000 * np.cos(azimuth),
        "y": 7000 * np.sin(azimuth),
        "z": np.full((1, PULSES), 7000.0),
        "r0": np.full((1, PULSES), 9900.0),
    }
    savemat(path, {"data": values | changes})
    return path


def with_nan(shape: tuple[int, ...]) -> Any:
    values = np.ones(shape)
    values.flat[-1] = np.nan
    return values


def bent(deviation: float) -> Any:
    """Frequencies, the fourth of them off by a part of a step."""
    return 9.3e9 + STEP * (np.arange(FREQUENCIES) + deviation * (np.arange(FREQUENCIES) == 3))


def test_whole_file_becomes_a_bag(tmp_path: Path) -> None:
    path = write_mat(tmp_path / "a.mat", freq=bent(0.009))
    assert import_gotcha([path], tmp_path / "bag") == PULSES
    assert len(list(BagReader(tmp_path / "bag").messages(["/phase_history"]))) == 1


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({name: np.ones((1, 1)) for name in ("x", "y", "z", "r0")} | {"fp": np.ones((FREQUENCIES, 1))}, "1 antenna"),
        ({"freq": [9e9], "fp": np.ones((1, PULSES))}, "1 frequencies"),
        ({"fp": np.ones((FREQUENCIES, PULSES - 1))}, ".fp of shape (16, 4); it must be (16, 5)"),
        ({"fp": np.ones((PULSES, FREQUENCIES))}, ".fp of shape (5, 16); it must be (16, 5)"),
        ({"y": np.ones((1, PULSES - 1))}, "4 values of .y; they must be 5"),
        ({"r0": np.ones((1, PULSES + 1))}, "6 values of .r0; they must be 5"),
        ({"fp": with_nan((FREQUENCIES, PULSES))}, "values of .fp that are not finite"),
        ({"freq": with_nan((FREQUENCIES, 1))}, "values of .freq that are not finite"),
        ({"x": with_nan((1, PULSES))}, "values of .x that are not finite"),
        ({"r0": np.full((1, PULSES), np.inf)}, "values of .r0 that are not finite"),
        ({"freq": bent(0.011)}, "uneven .freq"),
        ({"freq": bent(0.0)[::-1]}, "uneven .freq"),
        ({"freq": np.full(FREQUENCIES, 9e9)}, "uneven .freq"),
        ({"freq": bent(0.0) - 9.3e9}, "uneven .freq"),
        ({"x": ["a"] * PULSES}, "is not AFRL Gotcha phase history"),
    ],
)
def test_useless_file_is_refused_by_name(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    good, bad = write_mat(tmp_path / "good.mat"), write_mat(tmp_path / "bad.mat", **changes)
    for files in ([bad], [good, bad]):
        with pytest.raises(UserError) as refusal:
            import_gotcha(files, tmp_path / "bag")
        assert_one_sentence(str(refusal.value), f"File {bad} ", said)
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize("size", [0, 1, 127, 128, 400], ids=str)
def test_file_that_was_cut_off_is_refused_by_name(tmp_path: Path, size: int) -> None:
    path = write_mat(tmp_path / "cut.mat")
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(UserError) as refusal:
        import_gotcha([path], tmp_path / "bag")
    assert_one_sentence(str(refusal.value), f"File {path} is not AFRL Gotcha phase history")


def test_pulses_less_than_a_nanosecond_apart_are_refused(tmp_path: Path) -> None:
    path = write_mat(tmp_path / "a.mat", x=np.full((1, PULSES), 7e3), y=np.arange(PULSES) * 1e-9)
    with pytest.raises(UserError) as refusal:
        import_gotcha([path], tmp_path / "bag")
    assert_one_sentence(str(refusal.value), "same antenna position")
