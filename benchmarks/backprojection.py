"""Backprojection: pixels and pulses per second, and how near it comes to the direct sum in float64."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.fft

from benchmarks.cases import Case, spotlight
from benchmarks.row import Row, medians, sized
from sal_height.imaging import backproject
from sal_height.numeric import C128

DETECTORS, PULSES, FREQUENCIES = sized((16, 128, 256), (2, 32, 64))
ROWS, COLS = sized((200, 1024), (20, 64))

NUMPY_OVERSAMPLING = 8
"""Of the range profiles between which NumPy interpolates linearly."""


def throughput() -> Iterator[Row]:
    """One detector, against vectorised NumPy; and all in one run against one run for each."""
    case = spotlight(DETECTORS, PULSES, FREQUENCIES, ROWS, COLS)
    single, together, separate, plain = medians(
        lambda: case.detector(0).form(backproject),
        lambda: case.form(backproject),
        lambda: [case.detector(index).form(backproject) for index in range(DETECTORS)],
        lambda: numpy_backprojection(case.detector(0), NUMPY_PULSES),
    )
    size = f"{ROWS} × {COLS} pixels, {PULSES} pulses of {FREQUENCIES} frequencies"
    mega = ROWS * COLS * PULSES / 1e6
    slow = mega * NUMPY_PULSES / PULSES / plain
    yield Row("backprojection, one detector", mega / single, "Mpixel·pulse/s", ">= 400", size)
    yield Row(
        "backprojection, one detector, times NumPy's speed",
        mega / single / slow,
        "1",
        ">= 7",
        f"vectorised NumPy (FFT, linear interpolation): {slow:.1f} Mpixel·pulse/s",
    )
    yield Row(
        f"backprojection, {DETECTORS} detectors",
        mega * DETECTORS / together,
        "Mpixel·pulse·detector/s",
        ">= 2800",
        "seven times what is asked of one detector",
    )
    yield Row(
        f"backprojection, {DETECTORS} detectors, times the throughput",
        separate / together,
        "1",
        ">= 4",
        f"{DETECTORS} runs of one detector: {1e3 * separate:.0f} ms against {1e3 * together:.0f} ms; "
        "the limit is the geometry's share of a single run, as each detector adds 18 multiply-adds",
    )


NUMPY_PULSES = 16
"""That NumPy is given: its time is proportional to their number."""


def numpy_backprojection(case: Case, pulses: int) -> C128:
    """Image of the first detector from the first few pulses, as one writes it in NumPy: all pixels at once."""
    frequencies = case.history.samples.shape[2]
    dense = NUMPY_OVERSAMPLING * frequencies
    pixels, image = case.grid.pixels(), np.zeros(case.grid.shape, dtype=np.complex128)
    weights = case.processing.range_weights(frequencies)
    middle = frequencies // 2
    for pulse in range(pulses):
        spectrum = case.history.samples[0, pulse] * weights
        padded = np.zeros(dense, dtype=np.complex128)
        padded[: frequencies - middle], padded[dense - middle :] = spectrum[middle:], spectrum[:middle]
        profile = scipy.fft.fftshift(scipy.fft.ifft(padded))
        delay = np.linalg.norm(pixels - case.antenna[pulse], axis=-1) - case.history.reference_range[pulse]
        cells = (np.arange(dense) - dense // 2) * (case.sensor.range_window / dense)
        image += np.interp(delay, cells, profile) * np.exp(1j * case.sensor.centre_wavenumber * delay)
    return image


def accuracy() -> Iterator[Row]:
    """Signal over error of the images against the sum over all samples in float64, at random pixels."""
    case = spotlight(DETECTORS, PULSES, FREQUENCIES, ROWS, COLS)
    rng = np.random.default_rng(3)
    rows, cols = rng.integers(0, ROWS, 300), rng.integers(0, COLS, 300)
    delay = np.linalg.norm(case.grid.points(rows, cols)[:, None] - case.antenna, axis=-1) - case.history.reference_range
    steps = np.arange(FREQUENCIES) - FREQUENCIES // 2
    wavenumber = case.sensor.centre_wavenumber + case.sensor.wavenumber_step * steps
    weights = np.outer(case.processing.azimuth_weights(PULSES), case.processing.range_weights(FREQUENCIES))
    exact = np.stack(
        [
            np.einsum("mpf,pf->m", case.history.samples, weights * np.exp(1j * wavenumber * point[:, None]))
            for point in delay
        ],
        axis=-1,
    ) / (PULSES * FREQUENCIES)
    image = case.form(backproject)[:, rows, cols]
    finite = np.isfinite(image)
    error = np.sum(np.abs(image - exact)[finite] ** 2) / np.sum(np.abs(exact)[finite] ** 2)
    yield Row(
        "backprojection in float32, signal over error",
        -10 * float(np.log10(error)),
        "dB",
        ">= 60",
        f"direct sum in float64 at {finite.sum()} values",
    )
