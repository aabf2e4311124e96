"""Focused images become a bag that gives the heights that their own bag gives; what does not fit is refused."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import rasterio
import yaml
from helpers import circular, make_aperture, make_sensor, refused
from lxml import etree
from sarkit import sicd

from sal_height import messages
from sal_height.bag.qos import LATCHED
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import IMAGE_TYPE, SENSOR_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.exports import write_sicd
from sal_height.geometry import Grid, Origin, aperture_at, look_direction
from sal_height.graph.plan import Execution
from sal_height.imaging import Slc
from sal_height.imports import import_slc
from sal_height.messages import serialize
from sal_height.messages.types import ComplexImage, Header, Provenance
from sal_height.runs.chain.entry import Part
from sal_height.runs.live.sensor_bag import record_sensor
from sal_height.runs.replay.bag_replay import replay
from sal_height.sensor import Sensor
from sal_height.simulation import load_preset
from sal_height.simulation.uncertainty_settings import AS_SIMULATED

pytestmark = [
    pytest.mark.filterwarnings("ignore:(read|open)_text is deprecated:DeprecationWarning"),  # in sarkit
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),  # of images that are written here
]

ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 560.0)
PLACE = {"latitude_deg": 48.1, "longitude_deg": 11.3, "height_m": 560.0}
DWELLS, SEED = 2, 3


def decoded(bag: Path, topic: str) -> list[Any]:
    """Messages of a topic in the order of dwells and channels."""
    reader = BagReader(bag)
    found = [reader.decode(one.type_name, one.cdr) for one in reader.messages([topic])]
    return sorted(found, key=lambda one: (getattr(one, "dwell", 0), getattr(one, "channel", 0)))


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bag of a flight of the preset small, with images and heights."""
    folder = tmp_path_factory.mktemp("flown")
    record_sensor(replace(load_preset("small"), dwells=DWELLS), SEED, folder / "sensor")
    replay(folder / "sensor", folder / "out", {}, Execution(record=["slc"]), estimators=["ml"], jobs=1)
    return folder / "out" / "bag"


def beams_of(bag: Path) -> dict[str, Any]:
    """What a description says of the beams of a bag's sensor, and of the looks of its heights."""
    (info,) = decoded(bag, "/sensor_info")
    sensor = messages.sensor_from_message(info)
    return {
        "name": "mine",
        "elevation_diameter_m": sensor.elevation_diameter,
        "azimuth_diameter_m": sensor.azimuth_diameter,
        "pattern": sensor.pattern,
        "elevation_boresights_rad": list(sensor.elevation_boresights),
        "uncertainty": asdict(AS_SIMULATED),
        "processing": {"ml_height": {"range_looks": 2, "azimuth_looks": 2}},
    }


def write_description(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def described(images: Sequence[Any], sensor: Sensor) -> dict[str, Any]:
    """What a description says of images, by the messages of one channel in each dwell."""
    places = []
    for image in images:
        grid, aperture = messages.grid_from_message(image.grid), messages.aperture_from_message(image.aperture)
        turn = image.aperture.pose.orientation
        vectors = {
            "origin_m": grid.origin,
            "row_direction": grid.row_direction,
            "col_direction": grid.col_direction,
            "antenna_m": aperture.position,
            "velocity_mps": aperture.velocity,
        }
        places.append(
            {name: vector.tolist() for name, vector in vectors.items()}
            | {"row_spacing_m": grid.row_spacing, "col_spacing_m": grid.col_spacing}
            | {"attitude": [turn.x, turn.y, turn.z, turn.w], "stamp_ns": messages.to_ns(image.header.stamp)}
            | {"aperture_length_m": aperture.length}
        )
    return {
        "look_side": {1: "right", -1: "left"}[sensor.look_side],
        "wavelength_m": sensor.wavelength,
        "bandwidth_hz": sensor.bandwidth,
        "noise_power": [1.0] * sensor.detector_count,
        "images": places,
    }


def samples_of(bag: Path) -> np.ndarray:
    """Samples of all images of a bag, shape (dwells, channels, rows, cols)."""
    images = decoded(bag, "/slc")
    shape = images[0].grid.rows, images[0].grid.cols
    every = np.stack([messages.complex_view(image.samples, shape) for image in images])
    return every.reshape(-1, 1 + max(image.channel for image in images), *shape)


def check_heights(made: Path, flown: Path, tolerance_m: float) -> None:
    """Compare the heights of two bags; which pixels have them, and why others have not, is the same."""
    both = decoded(made, "/ml/height"), decoded(flown, "/ml/height")
    assert [image.dwell for image in both[0]] == [image.dwell for image in both[1]] == list(range(DWELLS))
    for mine, true in zip(*both, strict=True):
        np.testing.assert_array_equal(mine.validity, true.validity)
        for name, limit in (("height", tolerance_m), ("sigma", 10 * tolerance_m)):
            found, wanted = (np.array(getattr(image.surfaces[0], name)) for image in (mine, true))
            assert np.isfinite(wanted).sum() > 50
            np.testing.assert_allclose(found, wanted, rtol=0, atol=limit)


def test_images_come_back_from_sicd_with_their_heights(flown: Path, tmp_path: Path) -> None:
    """Through earth-centred coordinates of 6.4e6 m, and phases by ranges of 5 km in wavelengths of 1.55 um."""
    assert write_sicd(flown, tmp_path / "sicd", ORIGIN) == 8 * DWELLS
    content = beams_of(flown) | {"origin": PLACE, "air_delay": "removed"}
    description = write_description(tmp_path / "beams.yaml", content)
    files = sorted((tmp_path / "sicd").iterdir())
    assert import_slc(description, files, tmp_path / "bag") == DWELLS
    replay(tmp_path / "bag", tmp_path / "out", {}, estimators=["ml"], part=Part("slc"))
    check_heights(tmp_path / "out" / "bag", flown, 1e-5)
    assert [messages.to_ns(one.header.stamp) // 1000 for one in decoded(tmp_path / "bag", "/slc")] == [
        messages.to_ns(one.header.stamp) // 1000 for one in decoded(flown, "/slc")
    ]


def test_images_come_back_from_arrays_with_their_heights(flown: Path, tmp_path: Path) -> None:
    """All channels of a dwell in a file, and the rest of what SICD states in the description."""
    images = decoded(flown, "/slc")
    (info,) = decoded(flown, "/sensor_info")
    sensor = messages.sensor_from_message(info)
    content = beams_of(flown) | described(images[::8], sensor)
    content |= {"air_delay": "removed", "phase": "relative", "range_window": "taylor", "azimuth_window": "taylor"}
    content["noise_power"] = [image.noise_power for image in images[:8]]
    files = [tmp_path / f"{number}.npz" for number in range(DWELLS)]
    for file, samples in zip(files, samples_of(flown), strict=True):
        np.savez(file, samples)
    description = write_description(tmp_path / "mine.yaml", content)
    assert import_slc(description, files, tmp_path / "bag") == DWELLS
    np.testing.assert_array_equal(samples_of(tmp_path / "bag"), samples_of(flown))
    replay(tmp_path / "bag", tmp_path / "out", {}, estimators=["ml"], part=Part("slc"))
    check_heights(tmp_path / "out" / "bag", flown, 1e-5)


@pytest.mark.parametrize("air_delay", ["", "left"])
def test_ranges_that_may_contain_the_delay_of_the_air_are_uncertain_by_all_of_it(
    flown: Path, tmp_path: Path, air_delay: str
) -> None:
    """Of 3.5 km of standard atmosphere, delay and bend together: 0.68 m of height."""
    images = decoded(flown, "/slc")
    (info,) = decoded(flown, "/sensor_info")
    content = beams_of(flown) | described(images[:1], messages.sensor_from_message(info)) | {"air_delay": air_delay}
    content |= {"phase": "relative", "range_window": "taylor", "azimuth_window": "taylor"}
    content["noise_power"] = [image.noise_power for image in images[:8]]
    np.savez(tmp_path / "one.npz", samples_of(flown)[0])
    import_slc(write_description(tmp_path / "mine.yaml", content), [tmp_path / "one.npz"], tmp_path / "bag")
    image = decoded(tmp_path / "bag", "/slc")[0]
    assert image.air_delay == air_delay
    replay(tmp_path / "bag", tmp_path / "out", {}, estimators=["ml"], part=Part("slc"))
    (field,) = decoded(tmp_path / "out" / "bag", "/ml/height")
    assert np.nanmedian(field.surfaces[0].sigma) == pytest.approx(0.682, abs=0.005)


SHAPE = (9, 14)
SENSOR = make_sensor(look_side=-1)


def invented(*, sliding: bool = False, look_side: int = -1) -> Slc:
    """Images of noise, from an antenna that is turned and drifts."""
    angles, velocity = (0.02, -0.01, 0.3), (47.0, 16.0, 0.4)
    aperture = replace(make_aperture(3540.0, angles, velocity, 0.08), sliding=sliding)
    sight = aperture.rotation @ look_direction(math.pi / 4, 0.0, look_side)
    along = aperture.forward - (aperture.forward @ sight) * sight
    along /= np.linalg.norm(along)
    corner = aperture.position + 5000 * sight - 4 * 0.1 * sight - 6.5 * 0.05 * along
    rng = np.random.default_rng(5)
    images = circular(rng, (3, *SHAPE)).astype(np.complex64)
    return Slc(images, Grid(corner, sight, along, 0.1, 0.05, *SHAPE), aperture, np.full(3, 0.25), np.zeros(3))


def write_bag(path: Path, slc: Slc, sensor: Sensor) -> Path:
    """A bag of one dwell of images and their sensor."""
    stamp = messages.to_stamp(10**18)
    windows = {"range_window": "taylor", "azimuth_window": "hamming"}
    provenance = Provenance(
        config_hash=sensor.config_hash, parameters=messages.with_stage([], "sar_compression", windows)
    )
    with BagWriter(path, {}) as bag:
        for topic, kind in (("/sensor_info", SENSOR_TYPE), ("/slc", IMAGE_TYPE)):
            bag.add_topic(topic, kind, [LATCHED])
        bag.write("/sensor_info", serialize(messages.sensor_to_message(sensor, stamp)), 0, 0)
        for image in messages.slc_to_messages(slc, ComplexImage(header=Header(stamp=stamp)), provenance):
            bag.write("/slc", serialize(image), 1, 1)
    return path


def three_beams(**changes: Any) -> dict[str, Any]:
    """The description of SENSOR for SICD files."""
    return {
        "name": "mine",
        "elevation_diameter_m": SENSOR.elevation_diameter,
        "azimuth_diameter_m": SENSOR.azimuth_diameter,
        "pattern": SENSOR.pattern,
        "elevation_boresights_rad": [float(angle) for angle in SENSOR.elevation_boresights],
        "uncertainty": asdict(AS_SIMULATED),
        **changes,
    }


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """SICD files of a spotlight dwell, looking left."""
    folder = tmp_path_factory.mktemp("files")
    write_sicd(write_bag(folder / "bag", invented(), SENSOR), folder / "sicd", ORIGIN)
    return sorted((folder / "sicd").iterdir())


def check_back(bag: Path, slc: Slc, tolerance: float = 1e-3) -> None:
    """Compare grid, aperture and samples of a bag in the map of ORIGIN with those of the images.

    Phases may differ by one that all pixels share.
    """
    images = decoded(bag, "/slc")
    grid, aperture = messages.grid_from_message(images[0].grid), messages.aperture_from_message(images[0].aperture)
    for name in ("origin", "row_direction", "col_direction", "row_spacing", "col_spacing"):
        np.testing.assert_allclose(getattr(grid, name), getattr(slc.grid, name), rtol=0, atol=1e-7)
    assert aperture.sliding == slc.aperture.sliding
    middle = slc.grid.points((SHAPE[0] - 1) / 2, (SHAPE[1] - 1) / 2)
    seen = aperture_at(middle, slc.aperture).position
    np.testing.assert_allclose(aperture.position, seen, rtol=0, atol=1e-7)
    np.testing.assert_allclose(aperture.velocity, slc.aperture.velocity, rtol=0, atol=1e-7)
    np.testing.assert_allclose(aperture.rotation, slc.aperture.rotation, rtol=0, atol=1e-9)
    assert aperture.length == pytest.approx(slc.aperture.length, rel=1e-6)
    turned = samples_of(bag)[0] * np.conj(slc.images)
    turned /= np.exp(1j * np.angle(turned.sum()))
    np.testing.assert_allclose(turned, np.abs(slc.images) ** 2, rtol=0, atol=tolerance)
    assert [image.noise_power for image in images] == pytest.approx([0.25] * 3)
    assert messages.recorded_window(images[0].provenance, "range") == "taylor"
    assert messages.recorded_window(images[0].provenance, "azimuth") == "hamming"


@pytest.mark.parametrize("look_side", [1, -1])
@pytest.mark.parametrize("sliding", [False, True])
def test_grid_aperture_and_attitude_come_back(sliding: bool, look_side: int, tmp_path: Path) -> None:
    """From either side, and from an aperture that slides; the attitude comes from the axes of the antenna."""
    slc = invented(sliding=sliding, look_side=look_side)
    sensor = make_sensor(look_side=look_side, mode="stripmap" if sliding else "spotlight")
    write_sicd(write_bag(tmp_path / "bag", slc, sensor), tmp_path / "sicd", ORIGIN)
    description = write_description(tmp_path / "beams.yaml", three_beams(origin=PLACE))
    assert import_slc(description, sorted((tmp_path / "sicd").iterdir()), tmp_path / "made") == 1
    check_back(tmp_path / "made", slc)
    (info,) = decoded(tmp_path / "made", "/sensor_info")
    made = messages.sensor_from_message(info)
    assert (made.look_side, made.mode) == (look_side, sensor.mode)
    assert made.wavelength == pytest.approx(sensor.wavelength, rel=1e-12)
    assert made.bandwidth == pytest.approx(sensor.bandwidth, rel=1e-6)


def test_the_origin_is_the_scene_centre_point_unless_it_is_stated(files: list[Path], tmp_path: Path) -> None:
    description = write_description(tmp_path / "beams.yaml", three_beams())
    words = ["import", "slc", str(description), *map(str, files), "--out", str(tmp_path / "made")]
    assert main(words) == 0
    (fix,) = decoded(tmp_path / "made", "/map_origin")
    latitude, longitude, height = ORIGIN.to_geodetic(invented().grid.points(4, 6))
    assert math.radians(fix.latitude) == pytest.approx(latitude, abs=1e-12)
    assert math.radians(fix.longitude) == pytest.approx(longitude, abs=1e-12)
    assert fix.altitude == pytest.approx(height, abs=1e-6)
    grid = messages.grid_from_message(decoded(tmp_path / "made", "/slc")[0].grid)
    np.testing.assert_allclose(grid.points(4, 6), 0, atol=1e-6)


Change = Callable[[Any, np.ndarray], np.ndarray]


def rewritten(files: Sequence[Path], folder: Path, change: Change) -> list[Path]:
    """Files with changes to metadata and pixels.

    Args:
        files: to be changed.
        folder: of the new files.
        change: takes the metadata, which it may change, and the pixels, and returns the new pixels.
    """
    folder.mkdir()
    for path in files:
        with path.open("rb") as file:
            reader = sicd.NitfReader(file)
            metadata, pixels = reader.metadata, reader.read_image()
        pixels = change(metadata.xmltree, pixels)
        with (folder / path.name).open("wb") as file, sicd.NitfWriter(file, metadata) as writer:
            writer.write_image(np.ascontiguousarray(pixels))
    return sorted(folder.iterdir())


def put(tree: Any, name: str, value: object) -> None:
    """Set the text of an element."""
    tree.find("/".join(f"{{*}}{part}" for part in name.split("/"))).text = str(value)


def conjugate(tree: Any, pixels: np.ndarray) -> np.ndarray:
    for axis in ("Row", "Col"):
        put(tree, f"Grid/{axis}/Sgn", 1)
    return np.conj(pixels)


def sub_image(tree: Any, pixels: np.ndarray) -> np.ndarray:
    """The same pixels as a part of a larger image."""
    for name, first in (("Row", 100), ("Col", 200)):
        put(tree, f"ImageData/First{name}", first)
        put(tree, f"ImageData/FullImage/Num{name}s", 500)
        put(tree, f"ImageData/SCPPixel/{name}", first + int(tree.findtext(f"{{*}}ImageData/{{*}}SCPPixel/{{*}}{name}")))
    return pixels


@pytest.mark.parametrize("change", [conjugate, sub_image])
def test_other_conventions_give_the_same_images(change: Change, files: list[Path], tmp_path: Path) -> None:
    description = write_description(tmp_path / "beams.yaml", three_beams(origin=PLACE))
    import_slc(description, rewritten(files, tmp_path / "other", change), tmp_path / "made")
    check_back(tmp_path / "made", invented())


def test_what_a_file_does_not_state_is_that_of_the_description(files: list[Path], tmp_path: Path) -> None:
    def change(tree: Any, pixels: np.ndarray) -> np.ndarray:
        tree.getroot().remove(tree.find("{*}Antenna"))
        put(tree, "Grid/Col/WgtType/WindowName", "KAISER")
        put(tree, "Radiometric/NoiseLevel/NoiseLevelType", "RELATIVE")
        pixels[2, 3] = 0
        return pixels

    content = three_beams(origin=PLACE, azimuth_window="hamming", noise_power=[0.5, 0.6, 0.7])
    description = write_description(tmp_path / "beams.yaml", content)
    import_slc(description, rewritten(files, tmp_path / "other", change), tmp_path / "made")
    image, *others = decoded(tmp_path / "made", "/slc")
    assert [one.noise_power for one in (image, *others)] == [0.5, 0.6, 0.7]
    aperture = messages.aperture_from_message(image.aperture)
    np.testing.assert_allclose(aperture.forward, invented().aperture.direction, rtol=0, atol=1e-9)
    assert aperture.rotation[2, 1] == pytest.approx(0, abs=1e-12)
    assert messages.recorded_window(image.provenance, "azimuth") == "hamming"
    missing = np.argwhere(np.isnan(samples_of(tmp_path / "made")[0, 0])).tolist()
    assert missing == [[2, SHAPE[1] - 1 - 3]]  # columns of an antenna that looks left run against the flight in SICD


def write_channels(folder: Path, images: np.ndarray) -> list[Path]:
    paths = [folder / f"{number}.npy" for number in range(len(images))]
    for path, image in zip(paths, images, strict=True):
        np.save(path, image)
    return paths


def write_nisar(folder: Path, images: np.ndarray) -> list[Path]:
    """Three polarisations, pulses first."""
    with h5py.File(folder / "nisar.h5", "w") as file:
        for name, image in zip(("HH", "HV", "VV"), images, strict=True):
            file[f"science/LSAR/RSLC/swaths/frequencyA/{name}"] = image.T
    return [folder / "nisar.h5"]


def write_tiff(folder: Path, images: np.ndarray) -> list[Path]:
    profile = {"driver": "GTiff", "width": SHAPE[1], "height": SHAPE[0], "count": 3, "dtype": "complex64"}
    with rasterio.open(folder / "bands.tif", "w", **profile) as file:
        file.write(images)
    return [folder / "bands.tif"]


def image_content(**changes: Any) -> dict[str, Any]:
    """The description of SENSOR and `invented` images."""
    images = messages.slc_to_messages(invented(), ComplexImage(), Provenance())
    return three_beams() | described(images[:1], SENSOR) | changes


@pytest.mark.parametrize("write", [write_channels, write_nisar, write_tiff])
def test_files_of_arrays_are_turned_to_the_phases_of_a_bag(
    write: Callable[[Path, np.ndarray], list[Path]], tmp_path: Path
) -> None:
    """A point has the phase -4 pi R / wavelength in them, and in the bag that relative to its pixel's."""
    slc = invented()
    ranges = np.linalg.norm(slc.grid.pixels() - slc.aperture.position, axis=-1)
    absolute = slc.images * np.exp(-4j * np.pi / SENSOR.wavelength * ranges)
    paths = write(tmp_path, absolute.astype(np.complex64))
    assert import_slc(write_description(tmp_path / "a.yaml", image_content()), paths, tmp_path / "made") == 1
    np.testing.assert_allclose(samples_of(tmp_path / "made")[0], slc.images, rtol=0, atol=1e-4)
    assert "/map_origin" not in BagReader(tmp_path / "made").topics


def test_arrays_whose_first_axis_is_azimuth_are_transposed(tmp_path: Path) -> None:
    slc = invented()
    np.save(tmp_path / "a.npy", np.ascontiguousarray(np.swapaxes(slc.images, 1, 2)))
    content = image_content(azimuth_axis=0, phase="relative")
    import_slc(write_description(tmp_path / "a.yaml", content), [tmp_path / "a.npy"], tmp_path / "made")
    np.testing.assert_array_equal(samples_of(tmp_path / "made")[0], slc.images)


def without(name: str) -> Change:
    """A file that lacks a part of its metadata."""

    def change(tree: Any, pixels: np.ndarray) -> np.ndarray:
        found = tree.find("/".join(f"{{*}}{part}" for part in name.split("/")))
        found.getparent().remove(found)
        return pixels

    return change


def stating(values: dict[str, object]) -> Change:
    """A file with other values in its metadata."""

    def change(tree: Any, pixels: np.ndarray) -> np.ndarray:
        for name, value in values.items():
            put(tree, name, value)
        return pixels

    return change


AT_SEA = {f"GeoData/SCP/ECF/{axis}": value for axis, value in (("X", 6378137.0), ("Y", 0.0), ("Z", 0.0))}


def between_modes(tree: Any, pixels: np.ndarray) -> np.ndarray:
    """An aperture that slides three times as far as the columns."""
    poly = tree.find("{*}Grid/{*}TimeCOAPoly")
    poly.set("order2", "1")
    slope = etree.SubElement(poly, poly[0].tag, exponent1="0", exponent2="1")
    slope.text = str(-3 / np.linalg.norm(invented().aperture.velocity))
    put(tree, "ImageFormation/TEndProc", 1.0)
    put(tree, "Timeline/CollectDuration", 1.0)
    return pixels


def of_amplitude_and_phase(tree: Any, pixels: np.ndarray) -> np.ndarray:
    put(tree, "ImageData/PixelType", "AMP8I_PHS8I")
    return np.zeros(pixels.shape, sicd.PIXEL_TYPES["AMP8I_PHS8I"]["dtype"])


@pytest.mark.filterwarnings("ignore:<string>:UserWarning")  # metadata that break the schema
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without("Position"), "Position/ARPPoly"),
        (without("GeoData/SCP/ECF/X"), "GeoData/SCP/ECF"),
        (without("Grid/TimeCOAPoly"), "Grid/TimeCOAPoly"),
        (without("SCPCOA"), "SCPCOA/SideOfTrack"),
        (stating(AT_SEA), "latitude and longitude 0"),
        (stating({"CollectionInfo/CollectType": "BISTATIC"}), "two platforms (BISTATIC)"),
        (between_modes, "pixels from those of a plane"),
        (of_amplitude_and_phase, "RE32F_IM32F and RE16I_IM16I are read"),
        (stating({"ImageFormation/TxFrequencyProc/MaxProc": 0.0}), "processed frequencies"),
        (stating({"SCPCOA/SideOfTrack": "B"}), "SideOfTrack 'B'"),
    ],
)
def test_files_that_cannot_be_used_are_refused(change: Change, words: str, files: list[Path], tmp_path: Path) -> None:
    changed = rewritten(files, tmp_path / "other", change)
    with refused(UserError, words):
        import_slc(write_description(tmp_path / "beams.yaml", three_beams()), changed, tmp_path / "made")
    assert not (tmp_path / "made").exists()


def test_files_that_do_not_belong_together_are_refused(files: list[Path], tmp_path: Path) -> None:
    description = write_description(tmp_path / "beams.yaml", three_beams())
    other = rewritten(files, tmp_path / "later", stating({"Timeline/CollectStart": "2002-01-01T00:00:00Z"}))
    of_other_band = stating({"ImageFormation/TxFrequencyProc/MinProc": 1.934e14})
    band = rewritten(files[2:], tmp_path / "band", of_other_band)
    for chosen, words in (
        (files[:2], "2 SICD files for the 3 channels"),
        ([files[0], other[1], files[2]], "another stamp_ns"),
        ([*other, *files], "do not increase"),
        ([*files[:2], *band], "has the wavelength_m"),
        ([files[0], description, files[2]], "beams.yaml is not a readable SICD file"),
        ([files[0], tmp_path / "none.nitf", files[2]], "none.nitf cannot be read"),
    ):
        with refused(UserError, words):
            import_slc(description, chosen, tmp_path / "made")
    for changes, words in (
        ({"look_side": "left"}, "the key look_side, which SICD files state themselves"),
        ({"noise_power": [1.0, 2.0]}, "noise_power has 2 numbers for 3 channels"),
    ):
        changed = write_description(tmp_path / "changed.yaml", three_beams(**changes))
        with refused(UserError, words):
            import_slc(changed, files, tmp_path / "made")
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"images": []}, "images"),
        ({"images": None}, "images"),
        ({"azimuth_axis": 2}, "azimuth_axis"),
        ({"range_window": "round"}, "range_window"),
        ({"velocity_mps": [0.0, 0.0, 9.0]}, "velocity_mps must be that of a flight"),
        ({"row_direction": [0.0, 1.0, 1.0]}, "row_direction must have the norm 1"),
        ({"attitude": [0.0, 0.0, 0.0, 0.0]}, "attitude must have the norm 1"),
        ({"aperture_length_m": 0.0}, "aperture_length_m"),
        ({"antenna_m": [0.0, 0.0, 1e9]}, "beyond 1e+07 m"),
        ({"noise_power": [1.0]}, "noise_power"),
        ({"noise_power": []}, "state noise_power, one number for each of the 3 channels"),
        ({"noise_power": [1.0, 0.0, 1.0]}, "state noise_power, one number for each of the 3 channels"),
    ],
)
def test_descriptions_that_are_wrong_are_refused(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    content = image_content()
    for key, value in changes.items():
        (content["images"][0] if key in content["images"][0] else content)[key] = value
    paths = write_channels(tmp_path, invented().images)
    with refused(UserError, words):
        import_slc(write_description(tmp_path / "a.yaml", content), paths, tmp_path / "made")
    assert not (tmp_path / "made").exists()


def test_arrays_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    description = write_description(tmp_path / "a.yaml", image_content())
    paths = write_channels(tmp_path, invented().images)
    np.save(tmp_path / "small.npy", invented().images[0, :4])
    (tmp_path / "text.txt").write_text("nothing")
    for chosen, words in (
        (paths[:2], "There are 2 images in 2 files; 3 channels and 1 entries of images"),
        ([*paths[:2], tmp_path / "small.npy"], "images of the shapes (4, 14), (9, 14)"),
        ([*paths[:2], tmp_path / "text.txt"], "text.txt is not an image"),
        ([*paths[:2], tmp_path / "none.npy"], "none.npy cannot be read"),
        ([*paths[:2], tmp_path], "is not an image"),
    ):
        with refused(UserError, words):
            import_slc(description, chosen, tmp_path / "made")
    assert not (tmp_path / "made").exists()
