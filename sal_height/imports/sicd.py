"""The image in a SICD file (NGA.STND.0024): pixels, grid, aperture, antenna, band and windows."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from sal_height.array_files import complex_images
from sal_height.errors import UserError
from sal_height.extras import import_extra
from sal_height.geometry import ApertureState, Grid, Origin, aperture_at
from sal_height.imports.sarkit_files import since_1970_ns
from sal_height.numeric import C64, F64

WINDOWS: Mapping[str, str] = {"UNIFORM": "rectangular", "TAYLOR": "taylor", "HAMMING": "hamming"}
"""Windows of ours by their names in SICD."""

MOST_BENT = 0.5
"""Greatest difference, in pixels, between range and Doppler in a file and those of a position in its plane."""

SIDES: Mapping[str, int] = {"R": 1, "L": -1}
"""Look sides by their names in SICD."""

AXES = {"range": "Row", "azimuth": "Col"}
"""Elements of the directions of an image."""


class Antenna(NamedTuple):
    """Axes of an antenna as unit vectors, shape (3,).

    Attributes:
        x, y, z: axes of SICD; z is the mechanical boresight.
    """

    x: F64
    y: F64
    z: F64


@dataclass(frozen=True, eq=False)
class SicdImage:
    """The image of a file; vectors are earth-centred, earth-fixed, and columns grow along the flight.

    Attributes:
        path: path of the file.
        centre: scene centre point, m.
        grid: grid of the pixels relative to that point.
        is_reversed: True if columns of the file run against the flight.
        is_conjugate: True if phases in the file grow with range.
        position: antenna position in the middle of the aperture of the middle pixel, relative to `centre`, m.
        velocity: velocity there, m/s.
        aperture_length: length of the synthetic aperture, m.
        sliding: True if the aperture slides along the flight with the columns.
        antenna: axes of the antenna; None: the file does not state them.
        look_side: side of the image, +1 right, -1 left.
        frequencies: first and last processed frequency, Hz.
        windows: windows over the bandwidth and the aperture, by the keys of a description, where the file names a known
            one.
        has_gaps: True if a pixel that is exactly 0 has no data.
        noise_power: noise power E|n|^2 of a pixel; None: not stated.
        stamp_ns: start of the collection, ns since 1970.
    """

    path: Path
    centre: F64
    grid: Grid
    is_reversed: bool
    is_conjugate: bool
    position: F64
    velocity: F64
    aperture_length: float
    sliding: bool
    antenna: Antenna | None
    look_side: int
    frequencies: tuple[float, float]
    windows: Mapping[str, str]
    has_gaps: bool
    noise_power: float | None
    stamp_ns: int

    @property
    def sensor(self) -> dict[str, Any]:
        """Sensor parameters by the keys of a description."""
        first, last = self.frequencies
        return {
            "look_side": {1: "right", -1: "left"}[self.look_side],
            "wavelength_m": 2 * speed_of_light / (first + last),
            "bandwidth_hz": last - first,
            "mode": "stripmap" if self.sliding else "spotlight",
        }

    def pixels(self) -> C64:
        """The samples, complex64, shape (rows, cols), whose phases fall with range; NaN where there are no data.

        Raises:
            UserError: they cannot be read.
        """
        (image,) = complex_images(self.path).values()
        samples = np.asarray(image, dtype=np.complex64)
        if samples.shape != self.grid.shape:
            raise UserError(
                f"File {self.path} has pixels of shape {samples.shape} and states {self.grid.shape} (ImageData)."
            )
        samples = samples[:, ::-1] if self.is_reversed else samples
        if self.has_gaps:
            samples = np.where(samples == 0, np.complex64(complex(np.nan, np.nan)), samples)
        return np.conj(samples) if self.is_conjugate else samples

    def described(self, origin: Origin, middle_of_beams: float) -> dict[str, Any]:
        """The image by the keys of `imports.slc.ImagePlace`.

        Args:
            origin: origin of the map.
            middle_of_beams: elevation of the antenna's boresight in its own axes, rad.
        """
        place, grid, turn = origin.from_space(self.centre), self.grid, origin.axes.T
        described = {
            "origin_m": place + grid.origin @ turn,
            "row_direction": grid.row_direction @ turn,
            "col_direction": grid.col_direction @ turn,
            "antenna_m": place + self.position @ turn,
            "velocity_mps": self.velocity @ turn,
        }
        if self.antenna:
            described["attitude"] = self._attitude(self.antenna, turn, middle_of_beams)
        return {
            **{name: vector.tolist() for name, vector in described.items()},
            "row_spacing_m": grid.row_spacing,
            "col_spacing_m": grid.col_spacing,
            "aperture_length_m": self.aperture_length,
            "stamp_ns": self.stamp_ns,
        }

    def _attitude(self, antenna: Antenna, turn: F64, elevation: float) -> F64:
        """Quaternion that turns the axes of the antenna, forward, left and up, into those of map.

        Forward is that of its axes x and y, or against it, that lies best along the flight; its boresight is at
        `elevation` from nadir. With b = forward x z, left = cos(e) b - s sin(e) z and up = -cos(e) z - s sin(e) b, s
        being the look side, give z = -s sin(e) left - cos(e) up.
        """
        z, forward = antenna.z @ turn, _forward(self) @ turn
        forward = _unit(forward - (forward @ z) * z)
        beside, cosine, sine = np.cross(forward, z), np.cos(elevation), self.look_side * np.sin(elevation)
        left, up = cosine * beside - sine * z, -cosine * z - sine * beside
        return np.asarray(Rotation.from_matrix(np.column_stack([forward, left, up])).as_quat())


def read_sicd(path: Path) -> SicdImage:
    """The image of a SICD file, of one platform, on a grid that lies in a plane.

    Raises:
        UserError: the package sarkit is not installed, the file cannot be read, lacks metadata, is of two platforms, or
            its pixels do not lie in a plane from which they would have the range and Doppler that it states.
    """
    complex_sicd = import_extra("sarkit.sicd", f"Reading {path}")
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # metadata that are not needed here may be wrong
            tree = complex_sicd.NitfReader(file).metadata.xmltree
    except Exception as error:  # sarkit, jbpy and lxml each have their own for a damaged file
        if isinstance(error, OSError) and error.strerror:
            raise UserError(f"File {path} cannot be read: {error.strerror}.") from error
        said = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise UserError(f"File {path} is not a readable SICD file: {said}.") from error
    image = _image(Metadata(path, complex_sicd.XmlHelper(tree)))
    _check_plane(image, tree)
    return image


@dataclass(frozen=True)
class Metadata:
    """The metadata of a file.

    Attributes:
        path: path of the file.
        helper: `sarkit.sicd.XmlHelper` of the metadata.
    """

    path: Path
    helper: Any

    def stated(self, name: str) -> Any:
        """The value of a part, by the names of its elements; None: absent.

        Raises:
            UserError: it cannot be read.
        """
        try:
            return self.helper.load("/".join(f"{{*}}{part}" for part in name.split("/")))
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise UserError(f"File {self.path} has a value of {name} that cannot be read.") from error

    def needed(self, name: str) -> Any:
        """The value of a part.

        Raises:
            UserError: it is missing, cannot be read, or has numbers that are not finite.
        """
        value = self.stated(name)
        if value is None or (isinstance(value, float | np.ndarray) and not np.all(np.isfinite(value))):
            raise UserError(f"File {self.path} has no {name} of finite value; it is needed.")
        return value


class Passage(NamedTuple):
    """Motion of the antenna past an image.

    Attributes:
        position, velocity: antenna state in the middle of the aperture of the middle pixel, m and m/s, shape (3,).
        moved: distance between the middles of the apertures of its corners, m.
    """

    position: F64
    velocity: F64
    moved: float

    @property
    def speed(self) -> float:
        """Speed of the antenna, m/s."""
        return float(np.linalg.norm(self.velocity))


def _image(metadata: Metadata) -> SicdImage:
    """The image that the metadata describe.

    Raises:
        UserError: some of them are missing or impossible, or the collection is of two platforms.
    """
    path, needed = metadata.path, metadata.needed
    if metadata.stated("CollectionInfo/CollectType") == "BISTATIC":
        raise UserError(f"File {path} is of two platforms (BISTATIC); images of one platform (MONOSTATIC) are read.")
    grid = _grid(metadata)
    passage = _passage(metadata, grid)
    length = passage.speed * (needed("ImageFormation/TEndProc") - needed("ImageFormation/TStartProc")) - passage.moved
    if not length > 0:
        raise UserError(
            f"File {path} has a synthetic aperture of {length:.6g} m by the times that were processed "
            "(ImageFormation/TStartProc, TEndProc), its TimeCOAPoly and its ARPPoly; it must be positive."
        )
    first, last = (needed(f"ImageFormation/TxFrequencyProc/{name}") for name in ("MinProc", "MaxProc"))
    if not 0 < first < last:
        raise UserError(f"File {path} has processed frequencies from {first:g} to {last:g} Hz; they must rise.")
    if (side := needed("SCPCOA/SideOfTrack")) not in SIDES:
        raise UserError(f"File {path} has the SideOfTrack {side!r} (SCPCOA); it must be {' or '.join(SIDES)}.")
    is_reversed = float(grid.col_direction @ passage.velocity) < 0
    return SicdImage(
        path=path,
        centre=needed("GeoData/SCP/ECF"),
        grid=_reversed(grid) if is_reversed else grid,
        is_reversed=is_reversed,
        is_conjugate=needed("Grid/Row/Sgn") > 0,
        position=passage.position - needed("GeoData/SCP/ECF"),
        velocity=passage.velocity,
        aperture_length=length,
        sliding=passage.moved > grid.col_spacing / 2,
        antenna=_antenna(metadata),
        look_side=SIDES[side],
        frequencies=(first, last),
        windows=_windows(metadata),
        has_gaps=needed("ImageData/PixelType") == "RE32F_IM32F",
        noise_power=_noise_power(metadata),
        stamp_ns=since_1970_ns(needed("Timeline/CollectStart")),
    )


def _grid(metadata: Metadata) -> Grid:
    """The grid of the pixels in the file, relative to the scene centre point."""
    rows, cols = (metadata.needed(f"ImageData/{name}") for name in ("NumRows", "NumCols"))
    first = np.array([metadata.needed(f"ImageData/{name}") for name in ("FirstRow", "FirstCol")])
    across, along = (metadata.needed(f"Grid/{axis}/SS") for axis in ("Row", "Col"))
    if min(rows, cols, across, along) <= 0:
        raise UserError(
            f"File {metadata.path} has {rows} x {cols} pixels that are {across:g} and {along:g} m apart; all must be "
            "greater than 0."
        )
    directions = [_unit(metadata.needed(f"Grid/{axis}/UVectECF")) for axis in ("Row", "Col")]
    away = first - np.asarray(metadata.needed("ImageData/SCPPixel"))
    origin = away[0] * across * directions[0] + away[1] * along * directions[1]
    return Grid(origin, directions[0], directions[1], across, along, rows, cols)


def _passage(metadata: Metadata, grid: Grid) -> Passage:
    """Motion of the antenna past an image whose grid is that in the file."""
    times, track = metadata.needed("Grid/TimeCOAPoly"), metadata.needed("Position/ARPPoly")
    first, step = metadata.needed("ImageData/SCPPixel"), (grid.row_spacing, grid.col_spacing)
    down, along = (
        (np.array([0, count - 1]) + metadata.needed(f"ImageData/{name}") - centre) * spacing
        for count, name, centre, spacing in zip(grid.shape, ("FirstRow", "FirstCol"), first, step, strict=True)
    )
    corners = np.meshgrid(down, along)
    when = np.polynomial.polynomial.polyval2d(corners[0], corners[1], times)
    middle = np.polynomial.polynomial.polyval2d(down.mean(), along.mean(), times)
    derivative = np.polynomial.polynomial.polyder(track)
    position, velocity = (
        np.asarray(np.polynomial.polynomial.polyval(middle, one), np.float64).reshape(3) for one in (track, derivative)
    )
    return Passage(position, velocity, float(np.ptp(when) * np.linalg.norm(velocity)))


def _antenna(metadata: Metadata) -> Antenna | None:
    """Axes of the antenna at the start of the collection, of the two-way or of the receiving antenna."""
    for which in ("TwoWay", "Rcv"):
        x, y = (metadata.stated(f"Antenna/{which}/{axis}AxisPoly") for axis in "XY")
        if x is not None and y is not None:
            return Antenna(_unit(x[0]), _unit(y[0]), _unit(np.cross(x[0], y[0])))
    return None


def _windows(metadata: Metadata) -> dict[str, str]:
    """Windows by the keys of a description, where they are known here."""
    named = {f"{key}_window": metadata.stated(f"Grid/{axis}/WgtType/WindowName") for key, axis in AXES.items()}
    return {key: WINDOWS[name] for key, name in named.items() if name in WINDOWS}


def _noise_power(metadata: Metadata) -> float | None:
    """Noise power at the scene centre point, if it is stated in units of the pixels."""
    if metadata.stated("Radiometric/NoiseLevel/NoiseLevelType") != "ABSOLUTE":
        return None
    return float(10 ** (metadata.stated("Radiometric/NoiseLevel/NoisePoly")[0, 0] / 10))


def _reversed(grid: Grid) -> Grid:
    """The grid with its columns in reverse order."""
    last = grid.points(0, grid.cols - 1)
    return Grid(last, grid.row_direction, -grid.col_direction, grid.row_spacing, grid.col_spacing, grid.rows, grid.cols)


def _check_plane(image: SicdImage, tree: Any) -> None:
    """Check that corners of the image have range and Doppler of their positions in its plane, as SICD projects them.

    Raises:
        UserError: they differ, as in images whose aperture slides otherwise than in stripmap.
    """
    from sarkit import sicd  # noqa: PLC0415 (an extra)
    from sarkit.sicd import projection  # noqa: PLC0415

    rows, cols = image.grid.shape
    corners = np.array([[0, 0], [0, cols - 1], [rows - 1, 0], [rows - 1, cols - 1]])
    first = [int(tree.findtext(f"{{*}}ImageData/{{*}}{name}")) for name in ("FirstRow", "FirstCol")]
    try:
        known = projection.MetadataParams.from_xml(tree)
        seen: Any = projection.compute_projection_sets(known, sicd.rowcol_to_xrowycol(tree, corners + first))
    except Exception as error:  # whatever sarkit meets in metadata of a type of grid that are incomplete
        raise UserError(
            f"File {image.path} has metadata from which its pixels cannot be projected: {error}."
        ) from error
    corners[:, 1] = cols - 1 - corners[:, 1] if image.is_reversed else corners[:, 1]
    points = image.grid.points(*corners.T)
    forward = _forward(image)
    rotation = np.column_stack([forward, np.zeros((3, 2))])  # of which only forward matters here
    aperture = ApertureState(
        image.position, image.velocity, rotation, image.aperture_length, np.zeros((6, 6)), image.sliding
    )
    sight = points - aperture_at(points, aperture).position
    ranges = np.linalg.norm(sight, axis=-1)
    approach = -sight @ image.velocity / ranges
    speed = np.linalg.norm(image.velocity)
    down = np.abs(seen.R_COA - ranges).max() / image.grid.row_spacing
    along = (np.abs(seen.Rdot_COA - approach) * ranges / speed).max() / image.grid.col_spacing
    if not max(down, along) <= MOST_BENT:
        raise UserError(
            f"File {image.path} has a grid of the type {tree.findtext('{*}Grid/{*}Type')} whose corners are "
            f"{max(down, along):.3g} pixels from those of a plane that is seen from one aperture, or from one that "
            f"slides along the flight; up to {MOST_BENT:g} are allowed: cut the image, or process it to a plane."
        )


def _forward(image: SicdImage) -> F64:
    """Unit vector of the antenna's forward axis; along the flight where the file does not state it."""
    if image.antenna is None:
        return _unit(image.velocity)
    axes = [sign * axis for axis in image.antenna[:2] for sign in (1, -1)]
    return max(axes, key=image.velocity.dot)


def _unit(vector: F64) -> F64:
    return vector / np.linalg.norm(vector)
