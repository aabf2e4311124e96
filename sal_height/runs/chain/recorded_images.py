"""Complex images of a bag, without the phase of range: those recorded in it, or else those of its phase history."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import FRAME_TYPE, IMAGE_TYPE, SENSOR_TYPE
from sal_height.engine.compression import SLC_PORT
from sal_height.engine.results import Product
from sal_height.errors import UserError
from sal_height.geometry import Grid, without_range_phase
from sal_height.imaging import azimuth_resolution
from sal_height.messages.kinds import kind_of
from sal_height.numeric import WINDOWS, Complex, window
from sal_height.response import ShapedNoise
from sal_height.response.image import AXES, Image
from sal_height.runs.chain.chain_runs import COMPRESSION, BagRun, plan
from sal_height.sensor import Sensor, processed_angle
from sal_height.topics import SLC

_LOG = logging.getLogger(__name__)


def bag_images(path: Path, jobs: int = 1) -> Iterator[Image]:
    """Every ComplexImage of a bag as an image to be measured, in recorded order; arguments as of `recorded_slc`."""
    for topic, message, pixels, grid, sensor in recorded_slc(path, jobs):
        power, shape = message.noise_power or None, _noise_shape(message, grid, sensor)
        yield Image(pixels, path, AXES, topic, message.dwell, message.channel, grid, power, shape)


def recorded_slc(bag: Path, jobs: int = 1) -> Iterator[tuple[str, Any, Complex, Grid, Sensor]]:
    """Read topic, message, pixels without the phase of range, grid and sensor of each ComplexImage of a bag.

    Of a bag with phase history and without images these are made as in flight, by calls.

    Args:
        bag: path of the bag.
        jobs: number of dwells of which images are made side by side, if the bag has no images.

    Raises:
        UserError: the bag cannot be read, an image in it is damaged, or its sensor_info is missing.
    """
    reader = BagReader(bag)
    sensors: dict[str, Sensor] = {}
    for recorded in reader.messages(_topics(reader, SENSOR_TYPE)):
        message = reader.decode(recorded.type_name, recorded.cdr)
        sensors[message.config_hash] = messages.sensor_from_message(message)
    for topic, cdr in _serialized_images(reader, bag, jobs):
        message = reader.decode(IMAGE_TYPE, cdr)
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
        yield topic, message, without_range_phase(stored, grid, aperture, sensor.wavelength), grid, sensor


def _serialized_images(reader: BagReader, bag: Path, jobs: int) -> Iterator[tuple[str, bytes]]:
    """Topic and bytes of each image in a bag, or of each that is made of its phase history."""
    images = [topic for topic in _topics(reader, IMAGE_TYPE) if reader.topics[topic].count]
    if images or not any(reader.topics[topic].count for topic in _topics(reader, FRAME_TYPE)):
        yield from ((recorded.topic, recorded.cdr) for recorded in reader.messages(images))
        return
    scheme = plan(bag, {}, for_heights=False)
    run = BagRun(scheme, [COMPRESSION], jobs=jobs)
    write = kind_of(SLC_PORT).write
    for made in run.results("images"):
        if isinstance(made.result, Product) and made.result.port == SLC:
            yield from ((f"/{SLC}", cdr) for cdr in write(made.result.item, run.settings[COMPRESSION]))
    for sentence in [*scheme.warnings, *run.losses.described(len(scheme.frames))]:
        _LOG.warning(sentence)


def _noise_shape(message: Any, grid: Grid, sensor: Sensor) -> ShapedNoise | None:
    """Shape of receiver noise after compression; None if the image does not state it, or receivers were equalised."""
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
    nodes = 1025  # weights of a window of which the shape of noise is computed
    weights = [window(str(name), nodes) for name in names]
    return ShapedNoise.weighted(weights[0], weights[1], steps)


def _topics(reader: BagReader, type_name: str) -> list[str]:
    return [topic.name for topic in reader.topics.values() if topic.type_name == type_name]
