"""Focused single-look images of several channels become a bag of `sensor_info` and `slc`.

Heights follow from the covariance of the channels of a pixel over the looks. A phase that
all channels of a pixel share cancels in it, so that heights do not depend on how an image processor counts the phase of
range. The phase in a bag is that of `ComplexImage` nevertheless, for all that interpolates images.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from annotated_types import Ge, MinLen
from pydantic_core import PydanticCustomError
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from sal_height import messages
from sal_height.array_files import IMAGES as IMAGE_FILES
from sal_height.array_files import NITF
from sal_height.bag import qos
from sal_height.bag.described import IMAGES
from sal_height.bag.files import PARAMETERS
from sal_height.bag.topics import FIX_TYPE, IMAGE_TYPE, SENSOR_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.configuration import Float, Int, StrictKeys, read_yaml, validated
from sal_height.engine.image_items import AIR_REMOVED
from sal_height.engine.provenance import Provenance
from sal_height.errors import UserError
from sal_height.geometry import ApertureState, Grid, Origin, ranges_of_phase
from sal_height.imaging import UNKNOWN_AIR, VACUUM, CorrectionSettings, Slc
from sal_height.imports.collection import Description, Positive
from sal_height.imports.sicd import SicdImage, read_sicd
from sal_height.messages.products import provenance_to_message
from sal_height.messages.types import ComplexImage, Header
from sal_height.numeric import C64, F64
from sal_height.pipeline.instrument import with_instrument
from sal_height.response.image import AXES
from sal_height.runs.responses.images import images_of
from sal_height.sensor import Sensor
from sal_height.topics import MAP_ORIGIN
from sal_height.topics import SENSOR_INFO as INFO

Vector = tuple[Float, Float, Float]
WindowName = Literal["rectangular", "taylor", "hamming"]
Load = Callable[[], C64]

STATED = (
    *("images", "azimuth_axis", "phase", "mode", "look_side", "carrier_hz", "wavelength_m", "bandwidth_hz"),
    *("waveform", "chirp_rate_hz_per_s", "pulse_duration_s", "sampling_rate_hz"),
)
"""Keys of a description that SICD files replace."""

WINDOW_KEYS = ("range_window", "azimuth_window")

SENSOR_INFO, SLC = f"/{INFO}", f"/{IMAGES}"


@dataclass(frozen=True)
class ImagePlace(StrictKeys):
    """Pixel grid and aperture of a dwell's images; vectors are in map."""

    origin_m: Vector
    row_direction: Vector
    col_direction: Vector
    row_spacing_m: Positive
    col_spacing_m: Positive
    antenna_m: Vector
    velocity_mps: Vector
    aperture_length_m: Positive
    attitude: tuple[Float, Float, Float, Float] | None = None
    stamp_ns: Annotated[Int, Ge(0)] | None = None

    def __post_init__(self) -> None:
        unit_tolerance = 0.01  # greatest difference of the norm of a direction or an attitude from 1
        for name in ("row_direction", "col_direction", "attitude"):
            numbers = getattr(self, name)
            if numbers is not None and not abs(math.hypot(*numbers) - 1) <= unit_tolerance:
                raise PydanticCustomError("unit", f"{name} must have the norm 1")
        if not any(self.velocity_mps[:2]):
            raise PydanticCustomError("velocity", "velocity_mps must be that of a flight, not 0 along the ground")

    def grid(self, rows: int, cols: int) -> Grid:
        """The grid of rows x cols pixels."""
        directions = np.array(self.row_direction), np.array(self.col_direction)
        return Grid(np.array(self.origin_m), *directions, self.row_spacing_m, self.col_spacing_m, rows, cols)

    def aperture(self, *, sliding: bool) -> ApertureState:
        """State of the antenna in mid-aperture; its covariance is not known."""
        velocity = np.array(self.velocity_mps)
        rotation = _level(velocity) if self.attitude is None else Rotation.from_quat(self.attitude).as_matrix()
        position = np.array(self.antenna_m)
        return ApertureState(position, velocity, rotation, self.aperture_length_m, np.zeros((6, 6)), sliding)


@dataclass(frozen=True, kw_only=True)
class ImagesDescription(Description):
    """A sensor and its images; keys are in docs/import.md."""

    images: Annotated[tuple[ImagePlace, ...], MinLen(1)]
    range_window: WindowName = "rectangular"
    azimuth_window: WindowName = "rectangular"
    azimuth_axis: Literal[0, 1] = 1
    phase: Literal["absolute", "relative"] = "absolute"
    air_delay: Literal["", "removed", "left"] = ""

    @property
    def wavelength(self) -> float:
        """Wavelength of the carrier, m."""
        return self.wavelength_m or speed_of_light / (self.carrier_hz or 1.0)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.elevation_boresights_rad)

    def sensor_of(self, rows: int, cols: int) -> Sensor:
        """The sensor whose images have rows x cols pixels.

        Pulses and their samples are not in the images; the bag has as many as there are columns and rows.

        Raises:
            UserError: a value that no sensor has.
        """
        pulses, first = max(2, cols), self.images[0]
        frequency = pulses * float(np.linalg.norm(first.velocity_mps)) / first.aperture_length_m
        plain = replace(self, waveform="spectrum", chirp_rate_hz_per_s=0.0, pulse_duration_s=0.0, sampling_rate_hz=0.0)
        return plain.sensor(pulses, max(2, rows), frequency)


@dataclass(frozen=True, eq=False)
class DescribedImages:
    """Images and their description.

    Attributes:
        described: sensor, grids and apertures.
        loads: functions that read the images: of the channels of the first dwell, then of the next.
        noise_power: noise power of a pixel in each image; 0: not known.
    """

    described: ImagesDescription
    loads: Sequence[Load]
    noise_power: Sequence[float]

    @classmethod
    def of_arrays(cls, path: Path, content: Any, files: Sequence[Path]) -> Self:
        """Images in files of arrays, one or several in each.

        Raises:
            UserError: the description is wrong, a file cannot be read, or their number does not fit.
        """
        described = validated(ImagesDescription, content, f"Sensor {path}")
        for file in files:
            if file.suffix.lower() not in IMAGE_FILES:
                raise UserError(f"File {file} is not an image; images are read from {', '.join(IMAGE_FILES)}.")
        images = [image for file in files for image in images_of(file, None, None, described.azimuth_axis)]
        pixels = [image.pixels if image.axes == AXES else image.pixels.T for image in images]
        loads = [partial(np.ascontiguousarray, one, np.complex64) for one in pixels]
        needed = described.channels * len(described.images)
        if len(loads) != needed:
            raise UserError(
                f"There are {len(loads)} images in {len(files)} files; {described.channels} channels and "
                f"{len(described.images)} entries of images in {path} need {needed}."
            )
        return cls(described, loads, [*(described.noise_power or (0.0,) * described.channels)] * len(described.images))

    @classmethod
    def of_sicd(cls, path: Path, content: Any, files: Sequence[Path]) -> Self:
        """Images in SICD files, one in each.

        Raises:
            UserError: the description is wrong, a file cannot be read, channels of a dwell or files of the sensor
                differ, or the number of files does not fit.
        """
        given = {key: value for key, value in content.items() if value is not None} if isinstance(content, dict) else {}
        if there := [key for key in STATED if key in given]:
            raise UserError(f"Sensor {path} has the key {there[0]}, which SICD files state themselves; remove it.")
        images = [read_sicd(file) for file in files]
        stated = {"origin": _origin_at(images[0])} | _sensor_in(images) | given
        of_images = {key: stated.pop(key) for key in (*WINDOW_KEYS, "air_delay") if key in stated}
        known = validated(Description, stated, f"Sensor {path}")
        channels = len(known.elevation_boresights_rad)
        if len(images) % channels:
            raise UserError(
                f"There are {len(images)} SICD files for the {channels} channels of {path}; give those of whole "
                f"dwells: {channels} for each, in the order of the channels."
            )
        middle = (known.elevation_boresights_rad[0] + known.elevation_boresights_rad[-1]) / 2
        dwells = [images[begin : begin + channels] for begin in range(0, len(images), channels)]
        origin = known.place or Origin(0.0, 0.0, 0.0)  # it is stated here, if not by the description
        places = [_common_place(dwell, origin, middle) for dwell in dwells]
        described_powers = known.noise_power or (0.0,) * channels
        if len(described_powers) != channels:
            raise UserError(f"Sensor {path}: noise_power has {len(described_powers)} numbers for {channels} channels.")
        powers = [one.noise_power or described_powers[number % channels] for number, one in enumerate(images)]
        whole = stated | of_images | {"images": places, "noise_power": tuple(powers[:channels])}
        described = validated(ImagesDescription, whole, f"Sensor {path}")
        return cls(described, [one.pixels for one in images], powers)

    def dwell(self, number: int) -> C64:
        """The samples of a dwell as they are in the files, complex64, shape (channels, rows, cols).

        Raises:
            UserError: they cannot be read, or the channels have different shapes.
        """
        channels = self.described.channels
        pixels = [load() for load in self.loads[number * channels : (number + 1) * channels]]
        if len(shapes := {one.shape for one in pixels}) > 1:
            raise UserError(
                f"Dwell {number} has images of the shapes {', '.join(map(str, sorted(shapes)))}; all channels must "
                "have the same."
            )
        return np.stack(pixels)

    def slc(self, number: int, samples: C64) -> Slc:
        """The images of a dwell with the phases of `ComplexImage`.

        Unless the delay of the air is taken out of their ranges, it is an uncertainty of the aperture.

        Args:
            number: number of the dwell.
            samples: samples from `dwell`.
        """
        described, channels = self.described, self.described.channels
        place = described.images[number]
        grid, aperture = place.grid(*samples.shape[1:]), place.aperture(sliding=described.mode == "stripmap")
        if described.phase == "absolute":
            turn = np.exp(4j * np.pi / described.wavelength * ranges_of_phase(grid, aperture))
            samples = samples * turn.astype(np.complex64)
        powers = np.array(self.noise_power[number * channels : (number + 1) * channels])
        unknown = np.full(channels, np.nan)
        return Slc(samples, grid, aperture, powers, unknown, described.azimuth_window, described.range_window)


def import_slc(description: Path, files: Sequence[Path], out: Path) -> int:
    """Write a bag with focused images and the description of their sensor; returns the number of dwells.

    Args:
        description: YAML file of the sensor.
        files: image files, dwell by dwell and channel by channel: SICD, each with an image of one channel, or arrays
            (`array_files`), with one or several.
        out: folder of the bag, new or empty.

    Raises:
        UserError: a file cannot be read, parts are missing or do not fit each other, or the bag cannot be written.
    """
    content = read_yaml(description, f"Sensor {description}", f"File {description} cannot be read.")
    if any(file.suffix.lower() in NITF for file in files):
        images = DescribedImages.of_sicd(description, content, files)
    else:
        images = DescribedImages.of_arrays(description, content, files)
    write_images(images, out)
    return len(images.described.images)


def write_images(images: DescribedImages, out: Path) -> None:
    """Write a bag of images and the description of their sensor.

    Raises:
        UserError: images cannot be read, have no possible geometry or no known noise, or the bag cannot be written.
    """
    described = images.described
    if described.channels > 1 and not all(power > 0 for power in images.noise_power):
        raise UserError(
            "The noise power of a pixel is not known in every image; heights need it: state noise_power, one number "
            f"for each of the {described.channels} channels."
        )
    first = images.dwell(0)
    sensor = described.sensor_of(*first.shape[1:])
    made = {"range_window": described.range_window, "azimuth_window": described.azimuth_window}
    provenance = provenance_to_message(Provenance(config_hash=sensor.config_hash).derived("sar_compression", made))
    # Time from an image to the next where a description does not state their times, ns.
    dwell_ns = 1_000_000_000
    stamps_ns = [
        number * dwell_ns if one.stamp_ns is None else one.stamp_ns for number, one in enumerate(described.images)
    ]
    if any(later <= earlier for earlier, later in pairwise(stamps_ns)):
        raise UserError("The images have times that do not increase from dwell to dwell; give them in that order.")

    # Errors that whoever formed the images may have left in them.
    left = CorrectionSettings(air=VACUUM if described.air_delay == AIR_REMOVED else UNKNOWN_AIR)

    def recorded(number: int, samples: C64) -> list[bytes]:
        """CDR bytes of the images of a dwell, once they are checked."""
        labels = ComplexImage(dwell=number, header=Header(stamp=messages.to_stamp(stamps_ns[number])))
        slc = with_instrument(images.slc(number, samples), sensor, left)
        made = messages.slc_to_messages(slc, labels, provenance)
        for image in made:
            image.air_delay = described.air_delay
            messages.check_slc(image, sensor)
        return [messages.serialize(image) for image in made]

    checked = recorded(0, first)
    del first
    start = messages.to_stamp(stamps_ns[0])
    with BagWriter(out, {PARAMETERS: json.dumps(described.processing)}) as bag:

        def write(topic: str, cdr: bytes, stamp_ns: int) -> None:
            bag.write(topic, cdr, stamp_ns, stamp_ns)

        bag.add_topic(SENSOR_INFO, SENSOR_TYPE, [qos.LATCHED])
        bag.add_topic(SLC, IMAGE_TYPE, [qos.FRAMES])
        write(SENSOR_INFO, messages.serialize(messages.sensor_to_message(sensor, start)), stamps_ns[0])
        if described.place:
            bag.add_topic(f"/{MAP_ORIGIN}", FIX_TYPE, [qos.LATCHED])
            origin = messages.origin_to_message(described.place, start, messages.MAP_FRAME)
            write(f"/{MAP_ORIGIN}", messages.serialize(origin), stamps_ns[0])
        for number, stamp_ns in enumerate(stamps_ns):
            for cdr in recorded(number, images.dwell(number)) if number else checked:
                write(SLC, cdr, stamp_ns)


def _level(velocity: F64) -> F64:
    """Matrix that turns the axes of an antenna whose x axis is along its velocity, without roll, into map axes."""
    forward = velocity / np.linalg.norm(velocity)
    left = np.cross([0.0, 0.0, 1.0], forward)
    left /= np.linalg.norm(left)
    return np.column_stack([forward, left, np.cross(forward, left)])


def _origin_at(image: SicdImage) -> dict[str, float]:
    """The scene centre point as a description has it: latitude and longitude in degrees, height in m."""
    from sarkit import wgs84  # noqa: PLC0415 (an extra)

    names = "latitude_deg", "longitude_deg", "height_m"
    return dict(zip(names, wgs84.cartesian_to_geodetic(image.centre).tolist(), strict=True))


def _sensor_in(images: Sequence[SicdImage]) -> dict[str, Any]:
    """Keys of a description that all files state, with their values.

    Raises:
        UserError: files differ.
    """
    first, *others = ({**one.sensor, **one.windows} for one in images)
    for image, other in zip(images[1:], others, strict=True):
        for key in {**first, **other}:
            if first.get(key) != other.get(key):
                raise UserError(
                    f"File {image.path} has the {key} {other.get(key)} and {images[0].path} {first.get(key)}; all "
                    "images must be of one sensor and processing."
                )
    return first


def _common_place(dwell: Sequence[SicdImage], origin: Origin, middle_of_beams: float) -> dict[str, Any]:
    """The images of a dwell by the keys of `ImagePlace`.

    Raises:
        UserError: they differ.
    """
    first, *others = (image.described(origin, middle_of_beams) for image in dwell)
    for image, other in zip(dwell[1:], others, strict=True):
        for key, value in first.items():
            if other.get(key) != value:
                raise UserError(
                    f"File {image.path} has another {key} than {dwell[0].path}; channels of a dwell must have the same "
                    "pixels, aperture and time."
                )
    return first
