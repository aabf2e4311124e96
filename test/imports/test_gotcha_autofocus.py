"""Real data through the nodes: Gotcha with an injected phase error, with autofocus and without."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from phase_errors import residual_phase
from scipy.io import loadmat, savemat

from sal_height.bag.reader import BagReader
from sal_height.imports.gotcha import FIELDS, import_gotcha
from sal_height.runs.replay import replay

CYCLES = 3.0
"""Quadratic phase error at both ends of the aperture, in cycles."""


def quadratic(pulses: int) -> np.ndarray:
    """The phase error of every pulse, rad."""
    return 2 * np.pi * CYCLES * np.linspace(-1, 1, pulses) ** 2


@pytest.fixture(scope="module")
def bags(shared_data: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The three files as a bag, as they are and with the phase error."""
    folder = tmp_path_factory.mktemp("gotcha")
    files = sorted(shared_data("afrl_gotcha").glob("*.mat"))
    parts = [{name: loadmat(path)["data"][0][0][name] for name in FIELDS} for path in files]
    error = quadratic(sum(part["fp"].shape[1] for part in parts))
    begin = 0
    blurred = []
    for path, part in zip(files, parts, strict=True):
        pulses = part["fp"].shape[1]
        part["fp"] = part["fp"] * np.exp(1j * error[begin : begin + pulses])
        begin += pulses
        blurred.append(folder / path.name)
        savemat(blurred[-1], {"data": part})
    import_gotcha(files, folder / "clean")
    import_gotcha(blurred, folder / "blurred")
    return {name: folder / name for name in ("clean", "blurred")}


def focus(bag: Path, out: Path, autofocus: str) -> float:
    """Peak over median of the image that the nodes make, dB."""
    replay(bag, out, {"sar_compression": {"autofocus": autofocus}})
    (image,) = json.loads((out / "report.json").read_text())["images"]
    return float(image["peak_over_median_db"])


def test_autofocus_takes_a_three_cycle_quadratic_off(bags: dict[str, Path], tmp_path: Path) -> None:
    """Without it the error costs more than 10 dB; with it less than 1 dB of the clean image is missing."""
    clean = focus(bags["clean"], tmp_path / "clean", autofocus="never")
    assert clean == pytest.approx(48.84, abs=0.1)
    assert focus(bags["blurred"], tmp_path / "blurred", autofocus="never") < clean - 10
    assert focus(bags["blurred"], tmp_path / "focused", autofocus="always") > clean - 1
    assert focus(bags["clean"], tmp_path / "clean_focused", autofocus="always") > clean - 0.1
    reader = BagReader(tmp_path / "focused" / "bag")
    (message,) = reader.messages(["/slc"])
    phase = np.array(reader.decode(message.type_name, message.cdr).provenance.autofocus_phase)
    found = residual_phase(phase, quadratic(len(phase)))
    assert np.sqrt(np.mean(found**2)) < 0.3  # the recording itself has an error of .2 rad
