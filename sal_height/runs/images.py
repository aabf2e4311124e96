"""Images to be measured: those of array files here, those of bags in `recorded_images`, which needs ROS."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sal_height.errors import UserError
from sal_height.geometry import Grid
from sal_height.numeric import Complex
from sal_height.response import ShapedNoise

AXES = ("range", "azimuth")
"""Directions of rows and columns."""


@dataclass(frozen=True, eq=False)
class Image:
    """An image to be measured.

    Attributes:
        pixels: complex, shape (rows, cols).
        path: file or bag that holds the image.
        axes: directions of rows and columns.
        topic: topic in the bag; None if not from a bag.
        dwell: number of the dwell; None if not from a bag.
        channel: number of the channel; None if from an array of one image.
        grid: positions of the pixels; None if unknown.
        noise_power: E|n|^2 of the receiver noise in a pixel; None if unknown.
        noise_shape: how the processor has shaped that noise; None if unknown.
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
    """Name of an image for people, from whatever is known about it."""
    parts = {"topic": topic, "dwell": dwell, "channel": channel}
    return ", ".join([path, *(f"{key} {value}" for key, value in parts.items() if value is not None)])


def images_of(path: Path, dwell: int | None, channel: int | None, azimuth_axis: int) -> Iterator[Image]:
    """Read the images of a file or bag, optionally only those of one dwell or one channel.

    Args:
        path: .npy or .npz file, folder of a bag, or its .mcap file.
        dwell: number of the dwell; None for all.
        channel: number of the channel; None for all.
        azimuth_axis: along-track axis (0 or 1) of arrays in .npy and .npz files.

    Raises:
        UserError: the file cannot be read, or holds no such image.
    """
    dwells, channels = set(), set()
    found = False
    for image in _all_images(path, azimuth_axis):
        dwells.add(image.dwell)
        channels.add(image.channel)
        if dwell in {None, image.dwell} and channel in {None, image.channel}:
            found = True
            yield image
    if not dwells:
        raise UserError(f"Bag {path} holds no images; sal-height irf --help says how to record them during a replay.")
    if not found:
        raise UserError(
            f"File {path} has no image of the requested dwell and channel; it has {_span('dwell', dwells)} and "
            f"{_span('channel', channels)}."
        )


def _all_images(path: Path, azimuth_axis: int) -> Iterator[Image]:
    if path.suffix in {".npy", ".npz"}:
        return _array_images(path, azimuth_axis)
    if path.is_file() and path.suffix != ".mcap":
        raise UserError(
            f"File {path} is not an image; allowed are .npy and .npz files and bags (a folder or its .mcap)."
        )
    from sal_height.runs.recorded_images import bag_images  # noqa: PLC0415 (array files can be measured without ROS)

    return bag_images(path)


def _span(what: str, numbers: set[int | None]) -> str:
    known = [number for number in numbers if number is not None]
    if not known:
        return f"no {what} numbers"
    return f"{what} {min(known)}" if len(known) == 1 else f"{what}s {min(known)} to {max(known)}"


def _array_images(path: Path, azimuth_axis: int) -> Iterator[Image]:
    """The image of a .npy or .npz file, or one per channel.

    Raises:
        UserError: the file cannot be read, or does not hold a single complex array of a fitting shape.
    """
    try:
        with path.open("rb") as stream:
            loaded = np.load(stream, allow_pickle=False)
            arrays = dict(loaded) if isinstance(loaded, np.lib.npyio.NpzFile) else {"": loaded}
    except OSError as error:
        raise UserError(f"File {path} cannot be read: {error.strerror or error}.") from error
    except Exception as error:  # numpy, zipfile and zlib each have their own for a damaged file
        raise UserError(f"File {path} is not a whole .npy or .npz file: {' '.join(str(error).split())}.") from error
    usable = [array for array in arrays.values() if np.iscomplexobj(array)]
    if len(usable) != 1:
        there = ", ".join(f"{name} of {a.dtype}".strip() for name, a in arrays.items()) or "nothing"
        raise UserError(f"File {path} has {len(usable)} complex arrays; it must have one (it holds: {there}).")
    (array,) = usable
    if array.ndim not in {2, 3} or not array.size:
        raise UserError(
            f"File {path} has an array of shape {array.shape}; it must be (rows, cols) or (channels, rows, cols), and "
            "not empty."
        )
    axes = AXES if azimuth_axis == 1 else AXES[::-1]
    if array.ndim == 2:
        yield Image(array, path, axes)
    else:
        yield from (Image(pixels, path, axes, channel=channel) for channel, pixels in enumerate(array))
