"""Complex images of a bag, without the phase of range."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import IMAGE_TYPE, SENSOR_TYPE
from sal_height.errors import UserError
from sal_height.geometry import Grid, without_range_phase
from sal_height.imaging import azimuth_resolution
from sal_height.numeric import WINDOWS, Complex, window
from sal_height.response import ShapedNoise
from sal_height.runs.images import AXES, Image
from sal_height.sensor import Sensor, processed_angle

WINDOW_NODES = 1025
"""Weights of a window of which the shape of noise is computed."""


def bag_images(path: Path) -> Iterator[Image]:
    """Every ComplexImage of a bag as an image to be measured, in recorded order."""
    for topic, message, pixels, grid, sensor in recorded_slc(path):
        power, shape = message.noise_power or None, _noise_shape(message, grid, sensor)
        yield Image(pixels, path, AXES, topic, message.dwell, message.channel, grid, power, shape)


def recorded_slc(bag: Path) -> Iterator[tuple[str, Any, Complex, Grid, Sensor]]:
    """Read topic, message, pixels without the phase of range, grid and sensor of each ComplexImage of a bag.

    Raises:
        UserError: the bag cannot be read, an image in it is damaged, or its sensor_info is missing.
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
        yield recorded.topic, message, without_range_phase(stored, grid, aperture, sensor.wavelength), grid, sensor


def _noise_shape(message: Any, grid: Grid, sensor: Sensor) -> ShapedNoise | None:
    """How the compression has shaped receiver noise; None if the image does not tell, or receivers were equalised."""
    made = messages.stages_of(message.provenance.parameters).get("sar_compression", {})
    names = [made.get(name) for name in ("range_window", "azimuth_window")]
    if message.provenance.calibration_id or not set(names) <= set(WINDOWS):
        return None
    aperture = messages.aperture_from_message(message.aperture)
    if sensor.mode == "stripmap":
        width = sensor.wavelength / (2 * processed_angle(sensor))
    else:
        slant_range = float(np.linalg.norm(grid.points(grid.rows / 2, grid.cols / 2) - aperture.position))
        width = azimuth_resolution(sensor, aperture, slant_range)
    steps = grid.row_spacing / sensor.range_resolution, grid.col_spacing / width
    weights = [window(str(name), WINDOW_NODES) for name in names]
    return ShapedNoise.weighted(weights[0], weights[1], steps)


def _topics(reader: BagReader, type_name: str) -> list[str]:
    return [topic.name for topic in reader.topics.values() if topic.type_name == type_name]
