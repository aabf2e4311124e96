"""Heights tracked along range and along the flight."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.ground import PIXELS
from benchmarks.row import Row, medians, sized
from benchmarks.sizes import APERTURE, heights_of_street
from sal_height.relief import MeasuredHeights, PriorEstimate, ReliefPrior, smoothed, smoothed_columns, track

ROWS, COLS = sized((1024, 1024), (64, 64))
SPACINGS = (0.5, 0.5)
PRIOR = ReliefPrior(20.0, 1.0)

FIELD_ROWS, FIELD_COLS = sized((256, 256), (16, 16))
"""Of the image that is tracked along the flight, too."""

DWELLS = sized(20, 2)
"""Dwells of sal_spotlight after which the time of one is taken."""


def throughput() -> Iterator[Row]:
    """Filter and smoother over heights as messages hold them, over a plain copy of heights and sigmas."""
    rng = np.random.default_rng(4)
    height = rng.standard_normal((ROWS, COLS), dtype=np.float32)
    sigma = np.ones_like(height)
    there = np.zeros_like(height), np.zeros_like(sigma)

    def copy() -> None:
        np.copyto(there[0], height)
        np.copyto(there[1], sigma)

    tracking, copying = medians(lambda: smoothed_columns(MeasuredHeights(height, sigma, SPACINGS), PRIOR), copy)
    yield Row(
        "relief tracked along range, over a copy",
        tracking / copying,
        "1",
        "<= 15",
        f"{ROWS} × {COLS} cells, filter and smoother: {1e3 * tracking:.1f} ms; one plain copy of heights and sigmas to "
        f"memory at hand: {1e3 * copying:.2f} ms",
    )
    part = np.s_[:FIELD_ROWS, :FIELD_COLS]
    (field,) = medians(lambda: smoothed(MeasuredHeights(height[part], sigma[part], SPACINGS), PRIOR))
    yield Row(
        "relief tracked along the flight, too",
        FIELD_ROWS * FIELD_COLS / 1e6 / field,
        "Mpixel/s",
        ">= 0.5",
        f"{FIELD_ROWS} × {FIELD_COLS} cells: {1e3 * field:.0f} ms",
    )
    yield from _one_dwell(rng, MeasuredHeights(height, sigma, SPACINGS))


def _one_dwell(rng: np.random.Generator, large: MeasuredHeights) -> Iterator[Row]:
    """A dwell like those of sal_spotlight, its prior brought up to date; and per pixel beside a large image."""
    before = PriorEstimate()
    fields = [heights_of_street(*PIXELS, number, rng) for number in range(DWELLS)]
    for field in fields[:-1]:
        *_, before = track(field, APERTURE, before)

    def smooth_large() -> None:
        if found := before.after(large):
            smoothed(large, found[0])

    dwell, million = medians(lambda: track(fields[-1], APERTURE, before), smooth_large)
    pixels, cells = fields[-1].validity.size, large.height.size
    yield Row(
        "relief tracked, a dwell of sal_spotlight",
        1e3 * dwell,
        "ms",
        "<= 5",
        f"{pixels} pixels, with the prior estimated from it and from those before",
    )
    yield Row(
        "relief tracked, a large image",
        1e6 * million / cells,
        "us/pixel",
        "<= 2",
        f"{cells} pixels, with the prior: {million:.1f} s; a pixel of the dwell above: {1e6 * dwell / pixels:.1f} us",
    )
