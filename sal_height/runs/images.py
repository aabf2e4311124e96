"""Images to be measured: those of an array file, and those of a bag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.geometry import Grid, without_range_phase
from sal_height.numeric import Complex
from sal_height.sensor import Sensor

IMAGE_TYPE = "sal_height_msgs/msg/ComplexImage"
SENSOR_TYPE = "sal_height_msgs/msg/SensorInfo"

AXES = ("range", "azimuth")
"""Directions of rows and columns."""


@dataclass(frozen=True)
class Image:
    """An image to be measured.

    Attributes:
        pixels: complex, shape (rows, cols).
        path: of the file or the bag it is in.
        axes: directions of rows and columns.
        topic: in the bag; None: not from a bag.
        dwell: number of the dwell; None: not from a bag.
        detector: number of the detector; None: from an array of one image.
        grid: where the pixels lie; None: not known.
    """

    pixels: Complex
    path: Path
    axes: tuple[str, str] = AXES
    topic: str | None = None
    dwell: int | None = None
    detector: int | None = None
    grid: Grid | None = None

    @property
    def name(self) -> str:
        """Name for people."""
        return image_name(str(self.path), self.topic, self.dwell, self.detector)


def image_name(path: str, topic: str | None, dwell: int | None, detector: int | None) -> str:
    """Name of an image for people, of what is known of it."""
    parts = {"topic": topic, "dwell": dwell, "detector": detector}
    return ", ".join([path, *(f"{key} {value}" for key, value in parts.items() if value is not None)])


def images_of(path: Path, dwell: int | None, detector: int | None, azimuth_axis: int) -> Iterator[Image]:
    """The images of a file or bag that are of the dwell and detector; None: of any.

    Raises:
        UserError: it cannot be read, or there is no such image.
    """
    if path.suffix in {".npy", ".npz"}:
        images = _array_images(path, azimuth_axis)
    elif path.is_file() and path.suffix != ".mcap":
        raise UserError(f"File {path} is no image; allowed are .npy and .npz files and bags (a folder or its .mcap).")
    else:
        images = _bag_images(path)
    dwells, detectors = set(), set()
    found = False
    for image in images:
        dwells.add(image.dwell)
        detectors.add(image.detector)
        if dwell in {None, image.dwell} and detector in {None, image.detector}:
            found = True
            yield image
    if not dwells:
        raise UserError(
            f"Bag {path} has no {IMAGE_TYPE}; sal-height irf --help says how to record those that a replay makes."
        )
    if not found:
        raise UserError(
            f"Of the dwell and detector asked for, {path} has no image; it has {_span('dwell', dwells)} and "
            f"{_span('detector', detectors)}."
        )


def _span(what: str, numbers: set[int | None]) -> str:
    known = [number for number in numbers if number is not None]
    if not known:
        return f"no {what} numbers"
    return f"{what} {min(known)}" if len(known) == 1 else f"{what}s {min(known)} to {max(known)}"


def _array_images(path: Path, azimuth_axis: int) -> Iterator[Image]:
    """The image of a .npy or .npz file, or one per detector.

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
        raise UserError(f"File {path} has {len(usable)} complex arrays; it must have one (in it: {there}).")
    (array,) = usable
    if array.ndim not in {2, 3} or not array.size:
        raise UserError(
            f"File {path} has an array of shape {array.shape}; it must be (rows, cols) or (detectors, rows, cols), and "
            "not empty."
        )
    axes = AXES if azimuth_axis == 1 else AXES[::-1]
    if array.ndim == 2:
        yield Image(array, path, axes)
    else:
        yield from (Image(pixels, path, axes, detector=detector) for detector, pixels in enumerate(array))


def _bag_images(path: Path) -> Iterator[Image]:
    for topic, message, pixels, grid in recorded_slc(path):
        yield Image(pixels, path, AXES, topic, message.dwell, message.detector, grid)


def recorded_slc(bag: Path) -> Iterator[tuple[str, Any, Complex, Grid]]:
    """Topic, message, pixels without the phase of range, and grid of each ComplexImage of a bag, in recorded order.

    Raises:
        UserError: the bag cannot be read, holds an image that is not whole, or not the sensor info of one.
    """
    reader = BagReader(bag)
    sensors: dict[str, Sensor] = {}
    for recorded in reader.messages(_topics(reader, SENSOR_TYPE)):
        message = reader.decode(recorded.type_name, recorded.cdr)
        sensors[message.config_hash] = messages.sensor_from_message(message)
    for recorded in reader.messages(_topics(reader, IMAGE_TYPE)):
        message = reader.decode(recorded.type_name, recorded.cdr)
        sensor = sensors.get(message.provenance.config_hash)
        if sensor is None:
            raise UserError(
                f"Bag {bag} has an image of sensor {message.provenance.config_hash!r} but not its sensor_info; "
                "record topic sensor_info with the images."
            )
        try:
            messages.check_slc(message, sensor)
        except UserError as error:
            raise UserError(f"Bag {bag}: {error}") from error
        grid, aperture = messages.grid_from_message(message.grid), messages.aperture_from_message(message.aperture)
        stored = messages.complex_view(message.samples, grid.shape)
        yield recorded.topic, message, without_range_phase(stored, grid, aperture, sensor.wavelength), grid


def _topics(reader: BagReader, type_name: str) -> list[str]:
    return [topic.name for topic in reader.topics.values() if topic.type_name == type_name]
