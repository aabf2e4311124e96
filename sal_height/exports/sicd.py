"""Complex images of a bag as SICD (NGA.STND.0024, version 1.3.0): a NITF file for each dwell and channel.

The phase. In a `ComplexImage` the pixel at p shows a point at T with the phase 4 pi (R(p) - R(T)) / wavelength, that
of T relative to p. SICD wants the phase history itself: at the spatial frequencies (Krow, Kcol), a point at (x, y) from
the scene centre point S has the phase Sgn 2 pi (Krow x + Kcol y), and an image has KCtr at the frequency 0 of its DFT.
Every pixel is therefore multiplied by exp(-j 4 pi (R(p) - R(S)) / wavelength). Then T has the phase
-4 pi (R(T) - R(S)) / wavelength. Near S this is Sgn 2 pi (KCtr_row x + KCtr_col y), with Sgn = -1, and KCtr the
component of 2 / wavelength times the line of sight to S along rows or columns. The response of a point is centred on
frequency 0 everywhere in the image, so that DeltaKCOAPoly is 0 and left out. The ranges are those of
`geometry.ranges_of_phase`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import speed_of_light

from sal_height import __version__, messages
from sal_height.bag.namespace import open_bag
from sal_height.errors import UserError
from sal_height.exports.heights import origin_in
from sal_height.extras import import_extra
from sal_height.geometry import ApertureState, Grid, Origin, aperture_at, look_direction, ranges_of_phase
from sal_height.io import bag_name, new_folder, writing_whole
from sal_height.numeric import C64, F64, broadening, window
from sal_height.runs.chain.recorded_images import recorded_slc
from sal_height.sensor import Sensor

VERSION = "urn:SICD:1.3.0"

SIGN = -1
"""Sign of the exponent of the DFT from an image to its spatial frequencies: phases fall with range."""

WINDOWS: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "rectangular": ("UNIFORM", {}),
    "taylor": ("TAYLOR", {"NBAR": "5", "SLL": "-35.0"}),
    "hamming": ("HAMMING", {"COEFFICIENT": "0.54"}),
}
"""Names of windows in SICD, and their parameters, by our names."""

WINDOW_NODES, WEIGHTS = 1025, 129
"""Number of weights of a window that is interpolated, and of its values in a file."""


def write_sicd(bag: Path, folder: Path, origin: Origin | None = None) -> int:
    """Write every complex image of a bag as folder/dwell_00000_channel_00.nitf, and so on; returns their number.

    Images of topics in a namespace are in a folder of its name. A pixel without data (NaN) is 0.

    Args:
        bag: folder or file, with slc and sensor_info.
        folder: folder of the files, new or empty.
        origin: origin of the map frame on the earth; None: that in the bag.

    Raises:
        UserError: the package sarkit is not installed, the bag has no images or does not state the origin of its
            map, two images have one dwell and channel, or a file cannot be written.
    """
    sicd = import_extra("sarkit.sicd", f"Writing {folder}")
    place = origin or origin_in(open_bag(bag, None, ["slc"]))
    if place is None:
        raise UserError(
            f"Bag {bag} does not say where on the earth the origin of its map is, which SICD needs; give it with "
            "--origin LAT,LON,H."
        )
    count = 0
    for topic, message, _, grid, sensor in recorded_slc(bag):
        if not count:
            new_folder(folder)
        image = PlacedImage.of_message(message, grid, sensor, place)
        within = folder.joinpath(*topic.strip("/").split("/")[:-1])
        within.mkdir(parents=True, exist_ok=True)
        path = within / f"dwell_{message.dwell:05d}_channel_{message.channel:02d}.nitf"
        if path.exists():
            raise UserError(
                f"Bag {bag} has two images of dwell {message.dwell}, channel {message.channel} on {topic}; cut the bag "
                "with sal-height bag cut."
            )
        _write(sicd, path, image, f"{bag_name(bag)} {path.stem}")
        count += 1
    if not count:
        raise UserError(
            f"Bag {bag} has no complex images, and no phase history that gives some; record one of the topics slc and "
            "phase_history."
        )
    return count


@dataclass(frozen=True, eq=False)
class PlacedImage:
    """An image on the earth, with rows and columns as SICD has them.

    Attributes:
        message: message of the image, a ComplexImage.
        samples: samples of its pixels, complex64, shape (rows, cols), with the phases of SICD.
        grid: grid of the pixels, whose normal, row_direction x col_direction, points away from the earth.
        aperture: state of the antenna in mid-aperture.
        sensor: sensor of the image.
        origin: origin of the map.
    """

    message: Any
    samples: C64
    grid: Grid
    aperture: ApertureState
    sensor: Sensor
    origin: Origin

    @classmethod
    def of_message(cls, message: Any, grid: Grid, sensor: Sensor, origin: Origin) -> PlacedImage:
        """The image of a ComplexImage that `check_slc` has passed; columns of a sensor looking left are reversed."""
        aperture = messages.aperture_from_message(message.aperture)
        samples = messages.complex_view(message.samples, grid.shape)
        if np.cross(grid.row_direction, grid.col_direction)[2] < 0:
            grid = replace(grid, origin=grid.points(0, grid.cols - 1), col_direction=-grid.col_direction)
            samples = samples[:, ::-1]
        ranges = ranges_of_phase(grid, aperture)
        away = ranges - ranges[_middle(grid)[0], -1 if aperture.sliding else _middle(grid)[1]]
        turned = samples * np.exp(SIGN * 4j * np.pi / sensor.wavelength * away)
        return cls(message, np.nan_to_num(turned.astype(np.complex64)), grid, aperture, sensor, origin)

    @property
    def centre(self) -> F64:
        """The scene centre point, that of the middle pixel, in map, m."""
        return self.grid.points(*_middle(self.grid))

    @cached_property
    def geodetic(self) -> list[float]:
        """Latitude and longitude (degrees) and height (m) of the scene centre point."""
        latitude, longitude, height = self.origin.to_geodetic(self.centre)
        return [math.degrees(latitude), math.degrees(longitude), float(height)]

    def in_space(self, vectors: F64) -> F64:
        """Earth-centred, earth-fixed components of vectors in map axes, shape (..., 3)."""
        return vectors @ self.origin.axes

    @property
    def speed(self) -> float:
        """Speed of the antenna, m/s."""
        return float(np.linalg.norm(self.aperture.velocity))

    @property
    def aperture_time(self) -> float:
        """Time that the antenna takes for a synthetic aperture, s."""
        return self.aperture.length / self.speed

    @cached_property
    def sight(self) -> tuple[F64, float]:
        """Unit vector (map) from the middle of the aperture of the scene centre point to it, and its range, m."""
        way = self.centre - aperture_at(self.centre, self.aperture).position
        slant_range = float(np.linalg.norm(way))
        return way / slant_range, slant_range

    @property
    def passing(self) -> F64:
        """Time (s) by which the middle of the aperture moves on per metre of pixel position, (3,); 0: it stays."""
        forward = self.aperture.forward
        return self.aperture.sliding * forward / (self.aperture.velocity @ forward)

    @cached_property
    def reference_time(self) -> float:
        """Time at which the antenna is at the position of the aperture, s after the first pulse of the image."""
        return self.aperture_time / 2 - float(self._delays.min())

    @property
    def duration(self) -> float:
        """Time from the first pulse of the image to the last one, s."""
        return self.aperture_time + float(np.ptp(self._delays))

    @property
    def _delays(self) -> F64:
        """Middles of the apertures of the corners, s after the time of the antenna's state."""
        rows, cols = self.grid.shape
        corners = self.grid.points([0, 0, rows - 1, rows - 1], [0, cols - 1, 0, cols - 1])
        return np.asarray((corners - self.aperture.position) @ self.passing)


def _middle(grid: Grid) -> tuple[int, int]:
    """Row and column of the scene centre point."""
    return grid.rows // 2, grid.cols // 2


def _write(sicd: Any, path: Path, image: PlacedImage, name: str) -> None:
    """Write a file of an image called `name`."""
    security = sicd.NitfSecurityFields(clas="U")
    title = name.encode("ascii", "replace").decode()[:80]
    metadata = sicd.NitfMetadata(
        xmltree=metadata_of(sicd, image, name),
        file_header_part=sicd.NitfFileHeaderPart(ostaid="sal_height", ftitle=title, security=security),
        im_subheader_part=sicd.NitfImSubheaderPart(isorce="sal_height", security=security),
        de_subheader_part=sicd.NitfDeSubheaderPart(security=security),
    )
    with writing_whole(path) as file, sicd.NitfWriter(file, metadata) as writer:
        writer.write_image(image.samples)


def metadata_of(sicd: Any, image: PlacedImage, name: str) -> Any:
    """The metadata of an image, an lxml tree.

    Raises:
        UserError: the antenna sees no ground at a corner of the image.
    """
    from sarkit import wgs84  # noqa: PLC0415 (an extra)

    etree: Any = import_module("lxml.etree")  # which has no types
    tree = etree.ElementTree(etree.Element(f"{{{VERSION}}}SICD", nsmap={None: VERSION}))
    root = sicd.ElementWrapper(tree.getroot())
    message = image.message
    root["CollectionInfo"] = {
        "CollectorName": image.sensor.name,
        "CoreName": name,
        "CollectType": "MONOSTATIC",
        "RadarMode": {"ModeType": "STRIPMAP" if image.aperture.sliding else "SPOTLIGHT"},
        "Classification": "UNCLASSIFIED",
        "Parameter": [("dwell", str(message.dwell)), ("channel", str(message.channel))],
    }
    root["ImageCreation"] = {"Application": f"sal_height {__version__}"}
    rows, cols = image.grid.shape
    root["ImageData"] = {
        "PixelType": "RE32F_IM32F",
        "NumRows": rows,
        "NumCols": cols,
        "FirstRow": 0,
        "FirstCol": 0,
        "FullImage": {"NumRows": rows, "NumCols": cols},
        "SCPPixel": _middle(image.grid),
    }
    centre = wgs84.geodetic_to_cartesian(image.geodetic)
    root["GeoData"] = {"EarthModel": "WGS_84", "SCP": {"ECF": centre, "LLH": image.geodetic}}
    root["Grid"] = _grid(image)
    root["Timeline"] = _timeline(image)
    root["Position"] = {"ARPPoly": _positions(image, centre)}
    root["RadarCollection"], root["ImageFormation"] = _collection(image), _formation(image)
    root["SCPCOA"] = sicd.compute_scp_coa(tree)
    if message.noise_power > 0:
        level = 10 * math.log10(message.noise_power)
        root["Radiometric"] = {"NoiseLevel": {"NoiseLevelType": "ABSOLUTE", "NoisePoly": [[level]]}}
    root["Antenna"] = _antenna(image)
    root["GeoData"]["ImageCorners"] = _corners(sicd, tree, image)
    return tree


def _grid(image: PlacedImage) -> dict[str, Any]:
    """Element Grid: bands along rows and columns as the line of sight turns along the aperture."""
    sensor, grid, aperture = image.sensor, image.grid, image.aperture
    sight, slant_range = image.sight
    turning = (aperture.direction - (aperture.direction @ sight) * sight) * aperture.length / slant_range
    names = (messages.recorded_window(image.message.provenance, axis) for axis in ("range", "azimuth"))
    axes = (grid.row_direction, grid.row_spacing), (grid.col_direction, grid.col_spacing)
    bands = (
        2 * sensor.bandwidth / speed_of_light * abs(sight @ grid.row_direction),
        2 / sensor.wavelength * abs(turning @ grid.col_direction),
    )
    row, col = (
        _direction(image, direction, spacing, float(band), name)
        for (direction, spacing), band, name in zip(axes, bands, names, strict=True)
    )
    at_centre = image.reference_time + float((image.centre - aperture.position) @ image.passing)
    times = [[at_centre]]
    if aperture.sliding:
        times = [
            [at_centre, float(grid.col_direction @ image.passing)],
            [float(grid.row_direction @ image.passing), 0.0],
        ]
    return {"ImagePlane": _plane(image), "Type": "PLANE", "TimeCOAPoly": times, "Row": row, "Col": col}


def _plane(image: PlacedImage) -> str:
    """SICD's name of the plane of the image."""
    row, normal = image.grid.row_direction, np.cross(image.grid.row_direction, image.grid.col_direction)
    # Greatest sine of the angle between an axis of the image and the line of sight, or the vertical, along which it is.
    axis_tolerance = 1e-3
    if np.linalg.norm(np.cross(row, image.sight[0])) < axis_tolerance:
        return "SLANT"
    return "GROUND" if np.linalg.norm(np.cross(normal, [0.0, 0.0, 1.0])) < axis_tolerance else "OTHER"


def _direction(image: PlacedImage, direction: F64, spacing: float, band: float, name: str) -> dict[str, Any]:
    """Element Row or Col.

    Pixels contain no more than the band 1 / spacing. Where they are farther apart than the band needs, as pixels at the
    resolution of a weighted band are, its edges alias into 1 / spacing, which is stated as the band of the response.
    """
    covered = min(band, 1 / spacing)
    weights = window(name, WINDOW_NODES)
    uniform_width = 0.8859  # width at half power of the response to an unweighted band, times the band
    width = uniform_width / band * (1.0 if name == "rectangular" else broadening(weights))
    element = {
        "UVectECF": image.in_space(direction),
        "SS": spacing,
        "ImpRespWid": width,
        "Sgn": SIGN,
        "ImpRespBW": covered,
        "KCtr": 2 / image.sensor.wavelength * float(image.sight[0] @ direction),
        "DeltaK1": -covered / 2,
        "DeltaK2": covered / 2,
    }
    named, parameters = WINDOWS[name]
    same_band = 1e-4  # relative difference of two bands that are the same
    if name == "rectangular" and covered < band * (1 - same_band):
        return element  # a band that is cut has not the response of an even one
    element["WgtType"] = {"WindowName": named, "Parameter": list(parameters.items())}
    if name != "rectangular":
        frequency, nodes = (
            np.linspace(-reach, reach, n) for reach, n in ((covered / 2, WEIGHTS), (band / 2, WINDOW_NODES))
        )
        element["WgtFunct"] = np.interp(frequency, nodes, weights / weights.max())
    return element


def _timeline(image: PlacedImage) -> dict[str, Any]:
    """Element Timeline, with even pulses."""
    begin = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(
        microseconds=messages.to_ns(image.message.header.stamp) // 1000
    )
    pulses = max(2, round(image.duration * image.sensor.pulse_repetition_frequency))
    interval = {
        "@index": 1,
        "TStart": 0.0,
        "TEnd": image.duration,
        "IPPStart": 0,
        "IPPEnd": pulses - 1,
        "IPPPoly": [0.0, pulses / image.duration],
    }
    return {"CollectStart": begin, "CollectDuration": image.duration, "IPP": {"@size": 1, "Set": [interval]}}


def _positions(image: PlacedImage, centre: F64) -> F64:
    """Coefficients of the positions of the antenna over time, earth-centred, earth-fixed, m: a straight track."""
    aperture, velocity = image.aperture, image.in_space(image.aperture.velocity)
    return np.stack(
        [centre + image.in_space(aperture.position - image.centre) - image.reference_time * velocity, velocity]
    )


def _collection(image: PlacedImage) -> dict[str, Any]:
    """Element RadarCollection."""
    first, last = _frequencies(image.sensor)
    channels = [{"@index": number + 1, "TxRcvPolarization": "UNKNOWN"} for number in range(image.sensor.detector_count)]
    return {
        "TxFrequency": {"Min": first, "Max": last},
        "TxPolarization": "UNKNOWN",
        "RcvChannels": {"@size": len(channels), "ChanParameters": channels},
    }


def _formation(image: PlacedImage) -> dict[str, Any]:
    """Element ImageFormation."""
    first, last = _frequencies(image.sensor)
    return {
        "RcvChanProc": {"NumChanProc": 1, "ChanIndex": [image.message.channel + 1]},
        "TxRcvPolarizationProc": "UNKNOWN",
        "TStartProc": 0.0,
        "TEndProc": image.duration,
        "TxFrequencyProc": {"MinProc": first, "MaxProc": last},
        "ImageFormAlgo": "OTHER",
        "STBeamComp": "NO",
        "ImageBeamComp": "NO",
        "AzAutofocus": "GLOBAL" if len(image.message.provenance.autofocus_phase) else "NO",
        "RgAutofocus": "NO",
    }


def _frequencies(sensor: Sensor) -> tuple[float, float]:
    """Edges of the band, Hz."""
    carrier = speed_of_light / sensor.wavelength
    return carrier - sensor.bandwidth / 2, carrier + sensor.bandwidth / 2


def _antenna(image: PlacedImage) -> dict[str, Any]:
    """Element Antenna: x is the forward axis, z points to the middle of all beams; gains are not known: 0 dB."""
    first, last = image.sensor.beams.span
    boresight = image.aperture.rotation @ look_direction((first + last) / 2, 0.0, image.sensor.look_side)
    forward = image.aperture.forward
    flat = {"GainPoly": [[0.0]], "PhasePoly": [[0.0]]}
    return {
        "TwoWay": {
            "XAxisPoly": image.in_space(forward)[None],
            "YAxisPoly": image.in_space(np.cross(boresight, forward))[None],
            "FreqZero": speed_of_light / image.sensor.wavelength,
            "Array": flat,
        }
    }


def _corners(sicd: Any, tree: Any, image: PlacedImage) -> F64:
    """Latitudes and longitudes (degrees) of the corners on level ground at the height of the centre, shape (4, 2).

    Raises:
        UserError: the antenna sees no ground there.
    """
    from sarkit import wgs84  # noqa: PLC0415 (an extra)
    from sarkit.sicd import projection  # noqa: PLC0415

    rows, cols = image.grid.shape
    corners = np.array([[0, 0], [0, cols - 1], [rows - 1, cols - 1], [rows - 1, 0]])
    known = projection.MetadataParams.from_xml(tree)
    seen: Any = projection.compute_projection_sets(known, sicd.rowcol_to_xrowycol(tree, corners))
    up = wgs84.up(image.geodetic)
    ground = projection.r_rdot_to_ground_plane_mono(known.LOOK, seen, known.SCP, up)
    if not np.all(np.isfinite(ground)):
        raise UserError(
            f"The image of dwell {image.message.dwell}, channel {image.message.channel} has corners at which its "
            "antenna sees no ground; SICD needs images of the ground."
        )
    return wgs84.cartesian_to_geodetic(ground)[:, :2]
