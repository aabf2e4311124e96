"""An image to be measured, with its origin, geometry and noise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sal_height.geometry import Grid
from sal_height.numeric import Complex
from sal_height.response import ShapedNoise

AXES = ("range", "azimuth")
"""Directions of rows and columns."""


@dataclass(frozen=True, eq=False)
class Image:
    """An image to be measured.

    Attributes:
        pixels: complex pixels, shape (rows, cols).
        path: file or bag that contains the image.
        axes: directions of rows and columns.
        topic: topic in the bag; None if not from a bag.
        dwell: number of the dwell; None if not from a bag.
        channel: number of the channel; None if from an array of one image.
        grid: positions of the pixels; None if unknown.
        noise_power: E|n|^2 of the receiver noise in a pixel; None if unknown.
        noise_shape: covariance of that noise between pixels, by the processor; None if unknown.
    """

    pixels: Complex
    path: Path
    axes: tuple[str, str] = AXES
    topic: str | None = None
    dwell: int | None = None
    channel: int | None = None
    grid: Grid | None = None
    noise_power: float | None = None
    noise_shape: ShapedNoise | None = None

    @property
    def name(self) -> str:
        """Name for people."""
        return image_name(str(self.path), self.topic, self.dwell, self.channel)


def image_name(path: str, topic: str | None, dwell: int | None, channel: int | None) -> str:
    """Name of an image in messages, from all that is known about it."""
    parts = {"topic": topic, "dwell": dwell, "channel": channel}
    return ", ".join([path, *(f"{key} {value}" for key, value in parts.items() if value is not None)])
