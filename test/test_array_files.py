"""Files of arrays from other programs: what each of them writes comes out as it went in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import lxml.etree
import numpy as np
import pytest
import rasterio
import sarkit.sicd
from helpers import refused
from scipy.io import savemat
from written_arrays import write_hdf5, write_mat73

from sal_height.array_files import complex_images, named_arrays
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.runs.responses.images import images_of

pytestmark = [
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),  # of images that are written here
    pytest.mark.filterwarnings("ignore:<string>:UserWarning"),  # only what readers need is in the metadata
    pytest.mark.filterwarnings("ignore:(read|open)_text is deprecated:DeprecationWarning"),  # in sarkit
]

ROWS, COLS = 40, 30
RNG = np.random.default_rng(1)
IMAGE = (RNG.normal(size=(ROWS, COLS)) + 1j * RNG.normal(size=(ROWS, COLS))).astype(np.complex64)
OTHER = (1j * IMAGE).astype(np.complex64)
POWER = np.arange(24.0).reshape(2, 3, 4)


def write_tiff(path: Path) -> None:
    profile = {"driver": "GTiff", "width": COLS, "height": ROWS, "count": 2, "dtype": "complex64"}
    with rasterio.open(path, "w", **profile) as file:
        file.write(np.stack([IMAGE, OTHER]))


def write_nisar(path: Path, kind: str = "<f4") -> None:
    """Groups, names and numbers as in a single-look product of NISAR."""
    parts = np.dtype([("r", kind), ("i", kind)])
    with h5py.File(path, "w") as file:
        group = file.create_group("science/LSAR/RSLC/swaths/frequencyA")
        for name, image in (("HH", IMAGE), ("HV", OTHER)):
            values = np.empty(image.shape, parts)
            values["r"], values["i"] = image.real, image.imag
            group[name] = values
        group["slantRange"] = np.arange(5.0)


def write_sicd(path: Path, kind: str = "RE32F_IM32F") -> None:
    """By sarkit, with the metadata that it needs for the header."""
    corners = "".join(f'<ICP index="{n}:{name}"><Lat>48</Lat><Lon>11</Lon></ICP>' for n, name in enumerate(CORNERS, 1))
    tree = lxml.etree.fromstring(
        '<SICD xmlns="urn:SICD:1.4.0"><CollectionInfo><CollectorName>a</CollectorName><CoreName>b</CoreName>'
        "<Classification>UNCLASSIFIED</Classification></CollectionInfo><ImageCreation><DateTime>2026-03-01T10:00:00Z"
        f"</DateTime></ImageCreation><ImageData><PixelType>{kind}</PixelType><NumRows>{ROWS}</NumRows>"
        f"<NumCols>{COLS}</NumCols><FirstRow>0</FirstRow><FirstCol>0</FirstCol><SCPPixel><Row>20</Row><Col>15</Col>"
        "</SCPPixel></ImageData><GeoData><SCP><ECF><X>6378137</X><Y>0</Y><Z>0</Z></ECF><LLH><Lat>0</Lat><Lon>0</Lon>"
        f"<HAE>0</HAE></LLH></SCP><ImageCorners>{corners}</ImageCorners></GeoData><Grid><Row><UVectECF><X>0</X><Y>1</Y>"
        "<Z>0</Z></UVectECF><SS>1</SS></Row><Col><UVectECF><X>0</X><Y>0</Y><Z>1</Z></UVectECF><SS>1</SS></Col></Grid>"
        "<SCPCOA><ARPPos><X>7378137</X><Y>-1000000</Y><Z>0</Z></ARPPos><ARPVel><X>0</X><Y>0</Y><Z>7000</Z></ARPVel>"
        "<SideOfTrack>R</SideOfTrack></SCPCOA><Timeline><CollectStart>2026-03-01T10:00:00Z</CollectStart>"
        "</Timeline></SICD>"
    ).getroottree()
    security = sarkit.sicd.NitfSecurityFields(clas="U")
    metadata = sarkit.sicd.NitfMetadata(
        xmltree=tree,
        file_header_part=sarkit.sicd.NitfFileHeaderPart(ostaid="x", security=security),
        im_subheader_part=sarkit.sicd.NitfImSubheaderPart(isorce="x", security=security),
        de_subheader_part=sarkit.sicd.NitfDeSubheaderPart(security=security),
    )
    pixels: Any = IMAGE
    if kind == "RE16I_IM16I":
        pixels = np.empty(IMAGE.shape, sarkit.sicd.PIXEL_TYPES[kind]["dtype"])
        pixels["real"], pixels["imag"] = np.rint(1000 * IMAGE.real), np.rint(1000 * IMAGE.imag)
    with path.open("wb") as file, sarkit.sicd.NitfWriter(file, metadata) as writer:
        writer.write_image(pixels)


CORNERS = ("FRFC", "FRLC", "LRLC", "LRFC")

WRITERS: dict[str, Callable[[Path], Any]] = {
    "a.npy": lambda path: np.save(path, IMAGE),
    "a.npz": lambda path: np.savez(path, image=IMAGE, spacing=0.5),
    "a.mat": lambda path: savemat(path, {"image": IMAGE, "spacing": 0.5}),
    "a.nitf": write_sicd,
}


@pytest.mark.parametrize("name", WRITERS)
def test_the_one_complex_array_is_the_image(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name)
    (image,) = images_of(tmp_path / name, None, None, 1)
    np.testing.assert_array_equal(image.pixels, IMAGE)
    assert image.axes == ("range", "azimuth")


def test_whole_numbers_of_a_sicd_are_complex(tmp_path: Path) -> None:
    write_sicd(tmp_path / "a.nitf", "RE16I_IM16I")
    (pixels,) = complex_images(tmp_path / "a.nitf").values()
    np.testing.assert_allclose(pixels, 1000 * IMAGE, rtol=0, atol=0.71)


@pytest.mark.parametrize(
    ("name", "write", "axes"),
    [
        ("a.tif", write_tiff, ("range", "azimuth")),
        ("a.h5", write_nisar, ("azimuth", "range")),
        ("half.h5", lambda path: write_nisar(path, "<f2"), ("azimuth", "range")),
    ],
)
def test_bands_and_polarisations_are_channels(
    name: str, write: Callable[[Path], None], axes: tuple[str, str], tmp_path: Path
) -> None:
    write(tmp_path / name)
    images = list(images_of(tmp_path / name, None, None, 1))
    assert [image.channel for image in images] == [0, 1]
    tolerance = 0.002 if name == "half.h5" else 0
    for image, expected in zip(images, (IMAGE, OTHER), strict=True):
        np.testing.assert_allclose(image.pixels, expected, rtol=0, atol=tolerance)
        assert image.axes == axes
    (second,) = images_of(tmp_path / name, None, 1, 1)
    assert second.channel == 1


def test_irf_measures_a_geotiff(tmp_path: Path) -> None:
    write_tiff(tmp_path / "a.tif")
    assert main(["irf", str(tmp_path / "a.tif"), "--channel", "0", "--out", str(tmp_path / "out")]) in {0, 1}
    assert (tmp_path / "out" / "irf.json").is_file()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.xyz", b"nothing", "is not an image; images are read from .npy, .npz, .mat, .h5"),
        *((f"a{suffix}", b"nothing", f"is not a whole {suffix} file") for suffix in (".npy", ".mat", ".h5", ".nitf")),
        ("a.tif", b"nothing", "is not a whole .tif file"),
    ],
)
def test_what_is_no_image_is_told_in_one_sentence(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with refused(UserError, name, words):
        list(images_of(tmp_path / name, None, None, 1))


def test_arrays_of_several_shapes_and_none_are_refused(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"one": IMAGE, "other": IMAGE[:5]})
    savemat(tmp_path / "b.mat", {"real": IMAGE.real})
    for name, words in (("a.mat", "complex arrays of several shapes"), ("b.mat", "has 0 complex arrays")):
        with refused(UserError, name, words):
            list(images_of(tmp_path / name, None, None, 1))


@pytest.mark.parametrize(("name", "write"), [("a.h5", write_hdf5), ("a.mat", write_mat73)])
def test_named_arrays_are_as_they_were_written(name: str, write: Callable[..., None], tmp_path: Path) -> None:
    """Complex and real ones, of two and three axes, which MATLAB has in reverse."""
    arrays = {"image": IMAGE, "power": POWER}
    write(tmp_path / name, **arrays)
    found = named_arrays(tmp_path / name)
    assert found.keys() == arrays.keys()
    for key, expected in arrays.items():
        assert found[key].dtype == expected.dtype
        np.testing.assert_array_equal(found[key], expected)


def test_named_arrays_are_not_read_from_images(tmp_path: Path) -> None:
    write_tiff(tmp_path / "a.tif")
    with refused(UserError, "arrays are read from .npz, .mat, .h5 and .hdf5"):
        named_arrays(tmp_path / "a.tif")
