"""Peak memory of a compression, measured in a process of its own: `python -m benchmarks.memory FORMER` prints it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.array_estimator import azimuth_looks, beams_of
from benchmarks.cases import Case, spotlight, stripmap
from benchmarks.row import Row, sized
from sal_height.elevation import MlSettings, ml_elevation
from sal_height.imaging import FORMERS
from sal_height.numeric import C64

DETECTORS, PULSES, FREQUENCIES, ROWS, COLS = sized((16, 512, 1024, 1024, 512), (4, 512, 64, 64, 64))

ARRAY = "array"
"""Instead of the name of a former: the array estimate."""


def peak_memory() -> Iterator[Row]:
    """Phase history and all that its compression adds to the resident memory, image included, over the history."""
    for former in FORMERS:
        command = [sys.executable, "-m", "benchmarks.memory", former]
        result = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603 (our own module)
        history, growth = map(int, result.stdout.split())
        yield Row(
            f"{former}, peak memory",
            (history + growth) / history,
            "1",
            "<= 3",
            f"phase history of {history / 1e6:.0f} MB; growth of the resident memory (VmHWM) {growth / 1e6:.0f} MB",
        )


def array_memory() -> Iterator[Row]:
    """Images and all that estimating their elevations adds to the resident memory, over the images."""
    command = [sys.executable, "-m", "benchmarks.memory", ARRAY]
    result = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603 (our own module)
    images, growth = map(int, result.stdout.split())
    yield Row(
        "array estimate with sigma and validity, peak memory",
        (images + growth) / images,
        "1",
        "<= 2",
        f"images of {images / 1e6:.0f} MB, 4 looks; growth of the resident memory (VmHWM) {growth / 1e6:.0f} MB",
    )


def _case(former: str, detectors: int, pulses: int, frequencies: int, rows: int) -> Case:
    if former == "range_doppler":
        return stripmap(detectors, pulses, frequencies, rows)
    return spotlight(detectors, pulses, frequencies, rows, COLS)


def _measure_array() -> None:
    """Print the bytes of images, and those by which the peak of their estimate lies above what was resident before."""
    beams, settings = beams_of("jinc"), MlSettings(layover=False)

    def estimate(slc: C64) -> None:
        ml_elevation(azimuth_looks(slc, 4), beams, settings)

    rng = np.random.default_rng(1)
    slc = rng.standard_normal((DETECTORS, ROWS, 2 * COLS), dtype=np.float32).view(np.complex64)
    estimate(slc[:, :16].copy())  # so that code and libraries are loaded
    before = resident("VmRSS")
    estimate(slc)
    sys.stdout.write(f"{slc.nbytes} {resident('VmHWM') - before}\n")


def _measure(former: str) -> None:
    """Print the bytes of the phase history, and those by which the peak lies above what was resident before."""
    _case(former, 2, PULSES, 64, 64).form(FORMERS[former].form)  # so that code and libraries are loaded
    case = _case(former, DETECTORS, PULSES, FREQUENCIES, ROWS)
    before = resident("VmRSS")
    case.form(FORMERS[former].form)
    sys.stdout.write(f"{case.history.samples.nbytes} {resident('VmHWM') - before}\n")


def resident(key: str) -> int:
    """Resident memory of this process, bytes: VmRSS now, VmHWM at its highest (ru_maxrss knows the parent's, too)."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(f"{key}:"))


if __name__ == "__main__":
    if sys.argv[1] == ARRAY:
        _measure_array()
    else:
        _measure(sys.argv[1])
