"""Images to be measured: those of array files here, those of bags in `recorded_images`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from sal_height.array_files import IMAGES, complex_images
from sal_height.errors import UserError
from sal_height.numeric import Complex
from sal_height.response.image import AXES, Image

NISAR = "/RSLC/"
"""Part of the names of NISAR's single-look images, whose rows are pulses."""


def images_of(path: Path, dwell: int | None, channel: int | None, azimuth_axis: int, jobs: int = 1) -> Iterator[Image]:
    """Read the images of a file or bag, optionally only those of one dwell or one channel.

    Args:
        path: file of arrays (`array_files`), folder of a bag, or its .mcap file.
        dwell: number of the dwell; None for all.
        channel: number of the channel; None for all.
        azimuth_axis: along-track axis (0 or 1) of arrays in files.
        jobs: dwells of a bag without images of which these are made side by side.

    Raises:
        UserError: the file cannot be read, or has no such image.
    """
    dwells, channels = set(), set()
    found = False
    for image in _all_images(path, azimuth_axis, jobs):
        dwells.add(image.dwell)
        channels.add(image.channel)
        if dwell in {None, image.dwell} and channel in {None, image.channel}:
            found = True
            yield image
    if not dwells:
        raise UserError(
            f"Bag {path} contains no images, and no phase history to make them of; record one of the topics slc and "
            "phase_history."
        )
    if not found:
        raise UserError(
            f"File {path} has no image of the requested dwell and channel; it has {_span('dwell', dwells)} and "
            f"{_span('channel', channels)}."
        )


def _all_images(path: Path, azimuth_axis: int, jobs: int) -> Iterator[Image]:
    if path.suffix.lower() in IMAGES:
        return _array_images(path, azimuth_axis)
    if path.is_file() and path.suffix != ".mcap":
        complex_images(path)  # says what it may be
    from sal_height.runs.chain.recorded_images import bag_images  # noqa: PLC0415 (not needed for array files)

    return bag_images(path, jobs)


def _span(what: str, numbers: set[int | None]) -> str:
    known = [number for number in numbers if number is not None]
    if not known:
        return f"no {what} numbers"
    return f"{what} {min(known)}" if len(known) == 1 else f"{what}s {min(known)} to {max(known)}"


def _array_images(path: Path, azimuth_axis: int) -> Iterator[Image]:
    """The images of a file of arrays: one, or one per channel; those of NISAR have columns in range.

    Raises:
        UserError: the file cannot be read, or has no complex arrays of one shape, which fits.
    """
    arrays = complex_images(path)
    if path.suffix.lower() == ".npz" and len(arrays) != 1:
        raise UserError(
            f"File {path} has {len(arrays)} complex arrays; it must have one (it contains: {_named(arrays)})."
        )
    if len({array.shape for array in arrays.values()}) != 1:
        raise UserError(
            f"File {path} has complex arrays of several shapes (it contains: {_named(arrays)}); channels must have one."
        )
    first = next(iter(arrays.values()))
    array = first if len(arrays) == 1 else np.stack(list(arrays.values()))
    if array.ndim not in {2, 3} or not array.size:
        raise UserError(
            f"File {path} has an array of shape {array.shape}; it must be (rows, cols) or (channels, rows, cols), and "
            "not empty."
        )
    is_range_along_rows = azimuth_axis == 0 or any(NISAR in name for name in arrays)
    axes = AXES[::-1] if is_range_along_rows else AXES
    if array.ndim == 2:
        yield Image(array, path, axes)
    else:
        yield from (Image(pixels, path, axes, channel=channel) for channel, pixels in enumerate(array))


def _named(arrays: Mapping[str, Complex]) -> str:
    return ", ".join(f"{name} of {array.dtype} {array.shape}".strip() for name, array in arrays.items())
