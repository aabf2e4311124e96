"""Imports: a file of compensated phase history becomes a bag, beside a plain copy of as many bytes."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import speed_of_light

from benchmarks.row import Row, load, medians, sized
from sal_height.geometry import Origin
from sal_height.imports import import_cphd

PULSES, SAMPLES = sized((4096, 8192), (16, 64))
ORIGIN = Origin(np.radians(48.1), np.radians(11.3), 560.0)
CARRIER, BANDWIDTH, RANGE = 9.6e9, 600e6, 10_000.0

PARAMETERS = np.dtype(
    [
        ("TxTime", "f8"),
        *((name, "f8", 3) for name in ("TxPos", "TxVel")),
        ("RcvTime", "f8"),
        *((name, "f8", 3) for name in ("RcvPos", "RcvVel", "SRPPos")),
        *((name, "f8") for name in ("AmpSF", "SC0", "SCSS")),
    ]
)


def imports() -> Iterator[Row]:
    """The bytes of a CPHD file per second, until those of the bag are on the disk, over those of a plain copy.

    The copy reads the whole file into memory and writes as many bytes. Both read from the page cache, and both have
    written when the operating system says that the bytes are on the disk (fsync).
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        file = folder / "flight.cphd"
        _write_cphd(file)
        copy_s, import_s = medians(
            _until_on_disk(folder / "copy", lambda out: (out / "copy").write_bytes(file.read_bytes())),
            _until_on_disk(folder / "bag", lambda out: import_cphd(file, out)),
            repeats=sized(9, 1),
        )
        megabytes = 1e-6 * file.stat().st_size
        yield Row(
            "CPHD import over a plain copy",
            copy_s / import_s,
            "1",
            ">= 0.5",
            f"{megabytes:.0f} MB, {PULSES} pulses of {SAMPLES} samples, to the disk: copy "
            f"{megabytes / copy_s:.0f} MB/s, import {megabytes / import_s:.0f} MB/s; {load()}",
        )


def _until_on_disk(out: Path, write: Callable[[Path], object]) -> Callable[[], None]:
    """A function that writes a folder again, and waits until its files are on the disk."""

    def measured() -> None:
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        write(out)
        for path in out.iterdir():
            with path.open("rb") as file:
                os.fsync(file.fileno())

    return measured


def _write_cphd(path: Path) -> None:
    """Write a file of noise, of a sensor that flies past a point."""
    from lxml import etree  # type: ignore[import-untyped]  # noqa: PLC0415 (an extra, as sarkit is)
    from sarkit import cphd  # noqa: PLC0415

    root = etree.fromstring(_xml(_metadata()))
    rng = np.random.default_rng(1)
    samples = rng.standard_normal((PULSES, 2 * SAMPLES), np.float32).view(np.complex64)
    with path.open("wb") as file, cphd.Writer(file, cphd.Metadata(xmltree=root.getroottree())) as writer:
        writer.write_signal("VV", samples)
        writer.write_pvp("VV", _parameters())


def _parameters() -> np.ndarray:
    """Parameters of the pulses: a flight to the east, south of the origin, with a pulse every 0.1 m."""
    pulses = np.zeros(PULSES, PARAMETERS)
    pulses["TxTime"] = 1e-3 * np.arange(PULSES)
    pulses["RcvTime"] = pulses["TxTime"] + 2 * RANGE / speed_of_light
    in_space = np.array(ORIGIN.from_space(np.zeros(3))) @ -ORIGIN.axes
    east, north, up = ORIGIN.axes
    begin = in_space + RANGE * (0.6 * up - 0.8 * north)
    for side in ("Tx", "Rcv"):
        pulses[f"{side}Vel"] = 100.0 * east
        pulses[f"{side}Pos"] = begin + pulses[f"{side}Time"][:, None] * 100.0 * east
    pulses["SRPPos"], pulses["AmpSF"] = in_space, 1.0
    pulses["SCSS"], pulses["SC0"] = BANDWIDTH / SAMPLES, CARRIER - BANDWIDTH / 2
    return pulses


def _metadata() -> dict[str, Any]:
    """Metadata that the file must have, element by element."""
    layout, words = {}, 0
    for name in PARAMETERS.names or ():
        size = PARAMETERS[name].itemsize // 8
        layout[name] = {"Offset": words, "Size": size, "Format": {1: "F8", 3: "X=F8;Y=F8;Z=F8;"}[size]}
        words += size
    place = {"Lat": np.degrees(ORIGIN.latitude), "Lon": np.degrees(ORIGIN.longitude), "HAE": ORIGIN.height}
    sizes = {"NumVectors": PULSES, "NumSamples": SAMPLES, "SignalArrayByteOffset": 0, "PVPArrayByteOffset": 0}
    return {
        "CollectionID": {"CoreName": "noise", "Classification": "UNCLASSIFIED", "ReleaseInfo": "UNRESTRICTED"},
        "Global": {"DomainType": "FX", "SGN": "-1", "Timeline": {"CollectionStart": "2026-03-01T10:00:00Z"}},
        "SceneCoordinates": {"IARP": {"LLH": place}},
        "Data": {
            "SignalArrayFormat": "CF8",
            "NumBytesPVP": PARAMETERS.itemsize,
            "Channel": {"Identifier": "VV", **sizes},
        },
        "Channel": {"RefChId": "VV"},
        "PVP": layout,
    }


def _xml(metadata: Mapping[str, Any]) -> str:
    """The metadata as text."""

    def text(content: Any) -> str:
        if not isinstance(content, Mapping):
            return str(content)
        return "".join(f"<{name}>{text(value)}</{name}>" for name, value in content.items())

    return f'<CPHD xmlns="http://api.nsgreg.nga.mil/schema/cphd/1.1.0">{text(metadata)}</CPHD>'
