"""Complex images as SICD: sarkit's check of the standard and its projection find them right, and the target in them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence, direct_history, make_aperture
from pyproj import Transformer
from sarkit import sicd
from sarkit.sicd import projection
from sarkit.verification import SicdConsistency

from sal_height import messages
from sal_height.bag.qos import LATCHED
from sal_height.bag.topics import IMAGE_TYPE, SENSOR_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.exports import write_sicd
from sal_height.geometry import Grid, Origin, Trajectory, aperture_at
from sal_height.imaging import ImageSettings, Slc, focus_dwell
from sal_height.imports import level_states
from sal_height.messages import serialize
from sal_height.messages.types import ComplexImage, Header, Provenance
from sal_height.response import measure_brightest
from sal_height.runs.responses.images import images_of
from sal_height.sensor import PhaseHistory, Sensor

pytestmark = pytest.mark.filterwarnings("ignore:(read|open)_text is deprecated:DeprecationWarning")  # in sarkit

ORIGIN = Origin(math.radians(48.1), math.radians(11.3), 560.0)
RANGE, SPEED, ANGLE, PULSES, FREQUENCY = 5000.0, 100.0, math.pi / 4, 256, 250.0
TARGET = np.array([1.2, -0.9, 0.0])
"""East, north and up of the map's origin, m: some pixels from the middle of the images."""

STAMP_NS = 1_700_000_000_123_456_789
PLANES: dict[str, dict[str, Any]] = {
    "slant": {"rows": 40, "cols": 40, "range_window": "rectangular", "azimuth_window": "rectangular"},
    "ground": {"image_plane": "ground", "ground_spacing_m": 0.5, "rows": 60, "cols": 50, "range_window": "rectangular"},
}


def radar(look_side: int) -> Sensor:
    """Two beams in X band."""
    return Sensor(
        name="radar",
        look_side=look_side,
        wavelength=0.03,
        bandwidth=200e6,
        sample_count=512,
        pulse_count=PULSES,
        pulse_repetition_frequency=FREQUENCY,
        elevation_diameter=0.3,
        azimuth_diameter=1.0,
        pattern="sinc",
        elevation_boresights=(ANGLE - 0.03, ANGLE + 0.03),
        noise_power=(1e-4, 1e-4),
    )


def focused(look_side: int, plane: str) -> tuple[Slc, Sensor, dict[str, str]]:
    """Images of a target of amplitude 1, seen from an aircraft that flies north-east, and the windows they have."""
    sensor, settings = radar(look_side), ImageSettings(air="none", **PLANES[plane])
    along, seconds = np.array([0.8, 0.6, 0.0]), np.arange(-1, PULSES + 1) / FREQUENCY
    across = look_side * np.array([along[1], -along[0], 0.0])
    abeam = RANGE * (-math.sin(ANGLE) * across + math.cos(ANGLE) * np.array([0.0, 0.0, 1.0]))
    positions = abeam + (seconds - seconds.mean())[:, None] * SPEED * along
    stamps_ns = STAMP_NS + np.rint(seconds * 1e9).astype(np.int64)
    reference = np.full(PULSES, RANGE)
    samples = direct_history(sensor, TARGET[None], [[1.0], [0.8]], positions[1:-1], reference)
    history = PhaseHistory(STAMP_NS, seconds[1:-1], reference, samples.astype(np.complex64))
    slc = focus_dwell(history, Trajectory(level_states(stamps_ns, positions)), sensor, settings)
    return slc, sensor, {"range_window": settings.range_window, "azimuth_window": settings.azimuth_window}


def write_bag(
    path: Path, slc: Slc, sensor: Sensor, windows: dict[str, str], topic: str = "/slc", times: int = 1
) -> Path:
    """A bag of images, as `sar_compression` publishes them, and of their sensor."""
    stamp = messages.to_stamp(STAMP_NS)
    provenance = Provenance(
        config_hash=sensor.config_hash, parameters=messages.with_stage([], "sar_compression", windows)
    )
    with BagWriter(path, {}) as bag:
        bag.add_topic("/sensor_info", SENSOR_TYPE, [LATCHED])
        bag.add_topic(topic, IMAGE_TYPE, [LATCHED])
        bag.write("/sensor_info", serialize(messages.sensor_to_message(sensor, stamp)), 0, 0)
        labels = ComplexImage(dwell=7, header=Header(stamp=stamp))
        for image in messages.slc_to_messages(slc, labels, provenance) * times:
            bag.write(topic, serialize(image), 1, 1)
    return path


Written = tuple[Slc, Sensor, list[Path], Any]
CASES = [(1, "slant"), (-1, "slant"), (1, "ground"), (-1, "ground")]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{'left' if case[0] < 0 else 'right'}-{case[1]}")
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Written:
    """Images of a target, their files, and the metadata of the first one."""
    folder = tmp_path_factory.mktemp("sicd")
    slc, sensor, windows = focused(*request.param)
    assert write_sicd(write_bag(folder / "bag", slc, sensor, windows), folder / "files", ORIGIN) == 2
    files = sorted((folder / "files").iterdir())
    return slc, sensor, files, read(files[0])[1]


def read(path: Path) -> tuple[Any, Any]:
    """Pixels and metadata of a file, as sarkit reads them."""
    with path.open("rb") as file:
        reader = sicd.NitfReader(file)
        return reader.read_image(), reader.metadata.xmltree


def fails_of(path: Path) -> set[str]:
    """What sarkit's check of the standard finds, errors and warnings."""
    with path.open("rb") as file:
        checked = SicdConsistency.from_file(file)
    checked.check()
    return {
        f"{found['severity']}: {found['details']}"
        for failure in checked.failures().values()
        for found in failure["details"]
        if not found["passed"]
    }


def to_space(places: np.ndarray) -> np.ndarray:
    """Earth-centred, earth-fixed coordinates of places in map, by PROJ."""
    degrees = np.degrees([ORIGIN.latitude, ORIGIN.longitude]).tolist()
    pipeline = "+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lat_0={} +lon_0={} +h_0={}"
    back = Transformer.from_pipeline(pipeline.format(*degrees, ORIGIN.height))
    return np.stack(back.transform(*np.moveaxis(places, -1, 0)), axis=-1)


def test_files_pass_the_check_of_the_standard(written: Written) -> None:
    """Without a warning where pixels are denser than the band needs; those of the slant plane are at the resolution."""
    _, _, files, tree = written
    coarse = {f"Warning: {axis} OSR >= 1.1" for axis in ("Row", "Col")}
    allowed = coarse if tree.findtext("{*}Grid/{*}ImagePlane") == "SLANT" else set()
    assert [path.name for path in files] == ["dwell_00007_channel_00.nitf", "dwell_00007_channel_01.nitf"]
    for path in files:
        assert fails_of(path) == allowed


def test_a_target_is_projected_onto_its_place(written: Written) -> None:
    """By range and Doppler of the pixel at which it peaks, onto the plane of its height."""
    slc, _, files, tree = written
    peak = measure_brightest(read(files[0])[0])
    where = sicd.rowcol_to_xrowycol(tree, np.array([peak.row, peak.col]))
    known = projection.MetadataParams.from_xml(tree)
    place, up = to_space(TARGET + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    found = projection.r_rdot_to_ground_plane_mono(
        known.LOOK, projection.compute_projection_sets(known, where[None]), place, up - place
    )
    assert np.linalg.norm(found - place) < 0.02 * min(slc.grid.row_spacing, slc.grid.col_spacing)


def test_phases_are_those_that_the_standard_gives_a_point(written: Written) -> None:
    """DFT of the image at spatial frequencies of the band: Sgn 2 pi (Krow x + Kcol y), by KCtr at its frequency 0."""
    _, _, files, tree = written
    pixels, _ = read(files[0])
    load = sicd.XmlHelper(tree).load
    sign, centre, band = (
        np.array([load(f"{{*}}Grid/{{*}}{axis}/{{*}}{name}") for axis in ("Row", "Col")])
        for name in ("Sgn", "KCtr", "ImpRespBW")
    )
    # Where the image plane meets the range and Doppler of the target, from the scene centre point.
    known = projection.MetadataParams.from_xml(tree)
    target, _, _ = projection.scene_to_image(known, to_space(TARGET))
    x, y = (
        axis_places
        for axis_places in np.moveaxis(
            sicd.rowcol_to_xrowycol(tree, np.stack(np.indices(pixels.shape), axis=-1)), -1, 0
        )
    )
    assert sign.tolist() == [-1, -1]
    for share in ((0.0, 0.0), (0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.0, -0.3), (0.2, -0.2)):
        k = share * band
        spectrum = np.sum(pixels * np.exp(2j * np.pi * sign[0] * (k[0] * x + k[1] * y)))
        expected = sign[0] * 2 * np.pi * ((centre + k) @ target)
        assert abs(np.angle(spectrum * np.exp(-1j * expected))) < 0.1
    assert np.linalg.norm(target) > 0.5  # tens of turns of phase


def test_the_phase_of_a_target_is_that_of_its_range(written: Written) -> None:
    """-4 pi (R - R of the scene centre point) / wavelength, at the pixel at which the target peaks."""
    slc, sensor, files, tree = written
    pixels, _ = read(files[0])
    peak = measure_brightest(pixels)
    spectrum = np.fft.fft2(pixels)
    rows, cols = (np.fft.fftfreq(count) for count in pixels.shape)
    value = np.exp(2j * np.pi * rows * peak.row) @ spectrum @ np.exp(2j * np.pi * cols * peak.col)
    first, *_ = tree.findall("{*}ImageData/{*}SCPPixel")
    at = [int(first.findtext(f"{{*}}{name}")) for name in ("Row", "Col")]
    reversed_col = slc.grid.cols - 1 - at[1] if sensor.look_side < 0 else at[1]
    ranges = [np.linalg.norm(p - slc.aperture.position) for p in (TARGET, slc.grid.points(at[0], reversed_col))]
    expected = -4 * np.pi / sensor.wavelength * (ranges[0] - ranges[1])
    assert abs(np.angle(value * np.exp(-1j * expected))) < 0.1


def test_files_are_read_back_as_they_are(written: Written, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By `images_of`, which irf and psf read with: amplitudes are those of the bag, and the target is as sharp."""
    slc, sensor, files, _ = written
    for channel, path in enumerate(files):
        (image,) = images_of(path, None, None, 1)
        mine = image.pixels[:, ::-1] if sensor.look_side < 0 else image.pixels
        np.testing.assert_allclose(np.abs(mine), np.abs(slc.images[channel]), rtol=1e-5, atol=1e-7)
        np.testing.assert_array_equal(image.pixels, read(path)[0])
    assert main(["irf", str(files[0]), "--out", str(tmp_path)]) == 0
    assert files[0].name in capsys.readouterr().out


def strip(look_side: int) -> Slc:
    """Images of stripmap from an aircraft that drifts: it flies 5 degrees beside the body's forward axis."""
    aperture = make_aperture(RANGE * math.cos(ANGLE), (0.0, 0.0, 0.3), (90.0, 40.0, 0.0), 80.0)
    aperture = replace(aperture, sliding=True)
    sight = aperture.rotation @ [0.0, -look_side * math.sin(ANGLE), -math.cos(ANGLE)]
    corner = aperture.position + (RANGE - 15) * sight - 60.5 * 0.9 * aperture.forward
    grid = Grid(corner, sight, aperture.forward, 0.8, 0.9, 30, 122)
    images = np.ones((2, 30, 122), np.complex64)
    images[:, 3, 4] = np.nan
    return Slc(images, grid, aperture, np.array([0.2, 0.3]), np.zeros(2))


@pytest.mark.parametrize("look_side", [1, -1])
def test_stripmap_images_have_range_and_doppler_of_their_aperture(look_side: int, tmp_path: Path) -> None:
    """At every pixel by SICD's time polynomial, where aperture_at has the antenna; a pixel without data is 0."""
    slc, sensor = strip(look_side), replace(radar(look_side), mode="stripmap", config_hash="")
    write_sicd(write_bag(tmp_path / "bag", slc, sensor, {}, "/a/slc"), tmp_path / "files", ORIGIN)
    path = tmp_path / "files" / "a" / "dwell_00007_channel_01.nitf"
    pixels, tree = read(path)
    assert tree.findtext("{*}CollectionInfo/{*}RadarMode/{*}ModeType") == "STRIPMAP"
    assert not [found for found in fails_of(path) if found.startswith("Error")]
    known = projection.MetadataParams.from_xml(tree)
    where = sicd.rowcol_to_xrowycol(tree, np.stack(np.indices(pixels.shape), axis=-1))
    seen: Any = projection.compute_projection_sets(known, where)
    points = slc.grid.pixels()[:, ::look_side]
    sight = points - aperture_at(points, slc.aperture).position
    ranges = np.linalg.norm(sight, axis=-1)
    np.testing.assert_allclose(seen.R_COA, ranges, rtol=0, atol=1e-6)
    np.testing.assert_allclose(seen.Rdot_COA, -(sight @ slc.aperture.velocity) / ranges, rtol=0, atol=1e-6)
    gap = 117 if look_side < 0 else 4
    assert pixels[3, gap] == 0
    assert np.count_nonzero(pixels) == pixels.size - 1


def test_noise_and_place_in_time_are_stated(written: Written) -> None:
    slc, _, _, tree = written
    load = sicd.XmlHelper(tree).load
    assert 10 ** (load("{*}Radiometric/{*}NoiseLevel/{*}NoisePoly")[0, 0] / 10) == pytest.approx(slc.noise_power[0])
    assert load("{*}Timeline/{*}CollectStart").timestamp() == pytest.approx(STAMP_NS * 1e-9, abs=1e-6)
    assert load("{*}Timeline/{*}CollectDuration") == pytest.approx(PULSES / FREQUENCY)
    np.testing.assert_allclose(load("{*}SCPCOA/{*}ARPPos"), to_space(slc.aperture.position), rtol=0, atol=1e-6)


def test_what_cannot_be_written_is_said_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slc, sensor, windows = focused(1, "slant")
    bag = write_bag(tmp_path / "bag", slc, sensor, windows)
    with pytest.raises(UserError) as refused:
        write_sicd(bag, tmp_path / "files")
    assert_one_sentence(str(refused.value), "--origin")
    assert not (tmp_path / "files").exists()
    twice = write_bag(tmp_path / "twice", slc, sensor, windows, times=2)
    with pytest.raises(UserError) as refused:
        write_sicd(twice, tmp_path / "both", ORIGIN)
    assert_one_sentence(str(refused.value), "two images of dwell 7, channel 0")
    with pytest.raises(UserError) as refused:
        write_sicd(write_bag(tmp_path / "empty", slc, sensor, windows, times=0), tmp_path / "none", ORIGIN)
    assert_one_sentence(str(refused.value), "no complex images", "slc")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    with pytest.raises(UserError) as refused:
        write_sicd(bag, tmp_path / "full", ORIGIN)
    assert_one_sentence(str(refused.value), "not empty")
    assert main(["export", str(bag), "--sicd", str(tmp_path / "sea"), "--origin", "0,0"]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("sal-height: --origin: ")
    assert said.endswith("it must not be at latitude and longitude 0, a position at sea.")
