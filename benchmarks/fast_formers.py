"""The fast image formers against the FFT passes that they contain, and against backprojection."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy.fft

from benchmarks.cases import Case, spotlight, stripmap, with_targets
from benchmarks.row import Row, medians, sized
from sal_height.imaging import FormImages, backproject
from sal_height.imaging.formers import range_doppler, specan
from sal_height.numeric import WORKERS, ChirpZ

DETECTORS, PULSES, FREQUENCIES = sized((16, 512, 1024), (1, 512, 128))
ROWS, COLS = sized((1024, 512), (64, 64))


@dataclass(frozen=True)
class Pass:
    """One FFT of a whole array of complex64, zero-padding included, with nothing before or after.

    Attributes:
        shape: shape of the array.
        axis: that is transformed.
        count: number of such passes.
    """

    shape: tuple[int, ...]
    axis: int
    count: int = 1

    def __str__(self) -> str:
        return f"{self.count} × {list(self.shape)} axis {self.axis}"

    def prepared(self) -> Callable[[], object]:
        """The pass in place on an array of zeros: that takes as long as with any other numbers, and never overflows."""
        data = np.zeros(self.shape, dtype=np.complex64)
        return lambda: scipy.fft.fft(data, axis=self.axis, overwrite_x=True, workers=WORKERS)


def against_fft() -> Iterator[Row]:
    """Whole compression of a dwell over the time of its FFT passes.

    What a pass is: every FFT that the former makes of the samples, at its true length (with the zeros that a chirp
    z-transform or a linear convolution needs), as one transform of a whole array of all detectors, along the axis in
    which the data lie: [detector][pulse][frequency] or [detector][row][column]. The FFTs of filters do not count; what
    it takes to make the filters counts as part of the compression. Both sides use scipy.
    """
    case = spotlight(DETECTORS, PULSES, FREQUENCIES, ROWS, COLS)
    yield _compare("specan", specan.focus_spotlight, case, specan_passes(case))
    case = stripmap(DETECTORS, PULSES, FREQUENCIES, ROWS)
    yield _compare("range_doppler", range_doppler.focus_stripmap, case, range_doppler_passes(case))


def specan_passes(case: Case) -> list[Pass]:
    """Chirp z-transforms of pulses to rows, and of rows to columns: forward and backward each."""
    by_range, by_azimuth = specan.transforms(case.history, case.antenna, case.sensor, case.processing, case.grid)
    detectors, pulses, _ = case.history.samples.shape
    return [
        Pass((detectors, pulses, by_range.length), 2, count=2),
        Pass((detectors, case.grid.rows, by_azimuth.length), 2, count=2),
    ]


def range_doppler_passes(case: Case) -> list[Pass]:
    """Pulses to Doppler; chirp z-transform of frequencies to rows, forward and backward; Doppler to columns.

    Few frequencies and rows are transformed by products with matrices instead.
    """
    filters = range_doppler.filters_of(case.history, case.antenna, case.sensor, case.processing, case.grid)
    detectors, _, frequencies = case.history.samples.shape
    length = filters.azimuth.shape[1]
    to_rows = filters.range
    return [
        Pass((detectors, length, frequencies), 1),
        *([Pass((detectors, length, to_rows.length), 2, count=2)] if isinstance(to_rows, ChirpZ) else []),
        Pass((detectors, case.grid.rows, length // filters.fold), 2),
    ]


def _compare(name: str, former: FormImages, case: Case, passes: list[Pass]) -> Row:
    """The former and all passes in turn."""
    whole, *times = medians(lambda: case.form(former), *(one.prepared() for one in passes))
    bare = sum(one.count * time for one, time in zip(passes, times, strict=True))
    parts = "; ".join(f"{one} {1e3 * time:.0f} ms" for one, time in zip(passes, times, strict=True))
    return Row(
        f"{name}, {DETECTORS} × {PULSES} × {FREQUENCIES}, whole compression",
        whole / bare,
        "1",
        "<= 1.5",
        f"{1e3 * whole:.0f} ms over {1e3 * bare:.0f} ms of bare FFTs: {parts}",
    )


def against_backprojection() -> Iterator[Row]:
    """Error power of the images over that of backprojection's, where both are finite."""
    cases: list[tuple[str, FormImages, Case]] = [
        ("specan", specan.focus_spotlight, spotlight(1, PULSES, FREQUENCIES, ROWS, 64)),
        ("range_doppler", range_doppler.focus_stripmap, with_targets(stripmap(1, PULSES, FREQUENCIES // 4, 200))),
    ]
    for name, former, case in cases:
        fast, exact = case.form(former), case.form(backproject)
        finite = np.isfinite(fast) & np.isfinite(exact)
        error = np.sum(np.abs(fast - exact)[finite] ** 2) / np.sum(np.abs(exact)[finite] ** 2)
        yield Row(
            f"{name}, error power",
            10 * float(np.log10(error)),
            "dB",
            "<= -40",
            f"backprojection at {np.mean(finite):.0%} of {case.grid.rows} × {case.grid.cols} pixels",
        )
