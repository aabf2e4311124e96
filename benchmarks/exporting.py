"""Exports of a bag: points per second as LAZ, and the time of a large map."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.relief_map import height_image
from benchmarks.row import Row, load, medians, sized
from sal_height.bag import qos
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.exports import RecordedHeights, write_las
from sal_height.geometry import Origin, Projection
from sal_height.messages import serialize
from sal_height.relief import Relief, write_geotiff

DWELLS, SIDE = sized((16, 4096), (2, 64))
ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 560.0)


def exports() -> Iterator[Row]:
    """A bag of large height images as LAZ in UTM, from its file to the file; and a map as COG."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        cdr = serialize(height_image())
        with BagWriter(folder / "bag", {}) as bag:
            bag.add_topic("/ml/height", HEIGHT_TYPE, [qos.FRAMES])
            for dwell in range(DWELLS):
                bag.write("/ml/height", cdr, dwell, dwell)
        heights = RecordedHeights.of_bag(folder / "bag", origin=ORIGIN)
        count = write_las(heights, folder / "cloud.laz")
        (seconds,) = medians(lambda: write_las(heights, folder / "cloud.laz"), repeats=sized(3, 1))
        yield Row("LAZ export", 1e-6 * count / seconds, "Mpoint/s", ">= 1", f"{count} points of a bag; {load()}")
        noise = np.random.default_rng(1).normal(size=(SIDE, SIDE)).astype(np.float32)
        rows = np.arange(SIDE, dtype=np.float32)[:, None]
        relief = Relief(5e5, 5e6, 1.0, 0.01 * noise + rows, 0.01 + 0 * noise, noise, np.ones((SIDE, SIDE), np.uint32))
        zone = Projection.of("utm", ORIGIN)
        (seconds,) = medians(lambda: write_geotiff(folder / "map.tif", relief, zone, 0, {}), repeats=sized(3, 1))
        yield Row("COG of a map", seconds, "s", "<= 5", f"{SIDE} × {SIDE} cells, four layers; {load()}")
