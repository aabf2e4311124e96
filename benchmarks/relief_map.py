"""Dwells entered into a relief map: time, and memory over many; `python -m benchmarks.relief_map` prints the latter."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.cases import spotlight
from benchmarks.memory import resident
from benchmarks.row import Row, medians, sized
from sal_height import messages
from sal_height.geometry import ApertureState, above_place
from sal_height.messages.types import ComplexImage, Header, HeightImage, Provenance
from sal_height.relief import HeightField, ReliefMap, Surface, circle_covariance

SIDE = sized(512, 32)
DWELLS, WARM_UP = sized((1000, 50), (3, 1))
"""Dwells of the test of memory, and those after which everything that is allocated once is there."""


def throughput() -> Iterator[Row]:
    """A dwell from its message to the map, cells as large as pixels; and the map's memory over many such dwells."""
    image = height_image()
    relief_map = ReliefMap(_cell_size(image), 10**7)
    first = image.surfaces[0]
    inputs = [np.asarray(values) for values in (first.height, first.sigma, first.east, first.north)]
    copies = [np.empty_like(values) for values in inputs]

    def copy() -> None:
        for values, place in zip(inputs, copies, strict=True):
            np.copyto(place, values)

    seconds, plain = medians(lambda: _enter(relief_map, image), copy)
    yield Row(
        f"relief map, a dwell of {SIDE} × {SIDE}",
        1e3 * seconds,
        "ms",
        "<= 100",
        f"{seconds / plain:.0f} plain copies of height, sigma and place ({1e3 * plain:.2f} ms)",
    )
    command = [sys.executable, "-m", "benchmarks.relief_map"]
    result = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603 (our own module)
    before, after = map(int, result.stdout.split())
    yield Row(
        f"relief map, growth of memory over {DWELLS} dwells",
        (after - before) / 1e6,
        "MB",
        "<= 1",
        f"resident memory (VmRSS) after the first {WARM_UP} {before / 1e6:.0f} MB, the same area again and again",
    )


def _enter(relief_map: ReliefMap, image: HeightImage) -> None:
    """The work of the node on a message."""
    relief_map.add(messages.field_from_message(image))


def height_image() -> HeightImage:
    """Level ground at 0.1 m, seen by a lidar with errors of 0.1 m whose pose is known to 0.1 m."""
    grid = replace(spotlight(1, 512, 64, SIDE, SIDE).grid, row_spacing=0.12, col_spacing=0.17)
    ground = replace(grid, row_direction=np.array([0.0, np.sign(grid.row_direction[1]), 0.0]))
    aperture = ApertureState(
        position=grid.origin - 5000 * grid.row_direction,
        velocity=np.array([50.0, 0.0, 0.0]),
        rotation=np.eye(3),
        length=0.64,
        covariance=np.diag([0.1**2] * 3 + [1e-5**2] * 3),
    )
    height = np.random.default_rng(1).normal(0.1, 0.1, ground.shape)
    positions = ground.pixels()
    positions[..., 2] = above_place(positions[..., 0], positions[..., 1], height)[..., 2]
    own = circle_covariance(np.full(ground.shape, 0.1), positions, aperture)
    surface = Surface.seen_from(aperture, positions, own, np.full(ground.shape, 20.0))
    field = HeightField(ground, np.zeros(ground.shape, np.uint8), (surface,))
    slc = ComplexImage(header=Header(frame_id=messages.MAP_FRAME))
    return messages.height_to_message(field, aperture, (2, 2), "ml", slc, Provenance())


def _cell_size(image: HeightImage) -> float:
    """With which each cell holds about one pixel."""
    return float(np.sqrt(image.grid.row_spacing * image.grid.col_spacing))


def _measure() -> None:
    """Print the bytes that are resident after the first dwells and after all."""
    image = height_image()
    relief_map = ReliefMap(_cell_size(image), 10**7)
    for _ in range(WARM_UP):
        _enter(relief_map, image)
    before = resident("VmRSS")
    for _ in range(DWELLS - WARM_UP):
        _enter(relief_map, image)
    sys.stdout.write(f"{before} {resident('VmRSS')}\n")


if __name__ == "__main__":
    _measure()
