"""The estimate of the ground, brought up to date with a dwell like those of sal_spotlight."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.row import Row, medians, sized
from benchmarks.sizes import APERTURE, COLS, ROWS, SPACINGS, heights_of_street
from sal_height.relief import GroundMap, fine_cell_size

PIXELS = ROWS // 2, COLS // 2
"""Height pixels of a dwell of sal_spotlight."""

DWELLS = sized(16, 2)


def throughput() -> Iterator[Row]:
    """Dwells entered one by one, with the estimate at the end; and all dwells estimated at once."""
    rng = np.random.default_rng(1)
    fields = [heights_of_street(*PIXELS, number, rng) for number in range(DWELLS)]

    def mapped() -> GroundMap:
        ground = GroundMap(fine_cell_size(fields[0].grid), max(SPACINGS), 10**6)
        for field in fields:
            ground.add(field, APERTURE)
        ground.estimate()
        return ground

    one_by_one, whole = medians(mapped, mapped().settle)
    estimate = mapped().estimate()
    cells = 0 if estimate is None else estimate.height.size
    yield Row(
        "ground, a dwell of sal_spotlight",
        1e3 * one_by_one / DWELLS,
        "ms",
        "<= 10",
        f"{PIXELS[0]} × {PIXELS[1]} pixels, kerb and car; of {DWELLS} dwells and the estimate at the end",
    )
    yield Row("ground, all at once", cells / 1e6 / whole, "Mcell/s", ">= 0.2", f"{cells} cells: {1e3 * whole:.0f} ms")
