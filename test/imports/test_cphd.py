"""CPHD files written by other software: a target focuses where it stands on the earth, whatever their conventions."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import lxml.etree
import numpy as np
import pytest
import sarkit.cphd
from helpers import assert_one_sentence
from pyproj import Transformer
from scipy.constants import speed_of_light

from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.imports.cphd import import_cphd
from sal_height.runs.replay import replay

NAMESPACE = "http://api.nsgreg.nga.mil/schema/cphd/1.1.0"
LATITUDE, LONGITUDE, HEIGHT = 48.1, 11.3, 560.0
CARRIER, BANDWIDTH, SAMPLES, PULSES = 9.6e9, 150e6, 240, 255
RANGE, ELEVATION, SPEED, PULSE_STEP = 10_000.0, math.radians(50), 100.0, 0.5
TARGET = np.array([30.0, -20.0, 0.0])
"""East, north and up of the image area reference point, m."""

PVP = np.dtype(
    [
        *((name, "f8") for name in ("TxTime",)),
        *((name, "f8", 3) for name in ("TxPos", "TxVel")),
        ("RcvTime", "f8"),
        *((name, "f8", 3) for name in ("RcvPos", "RcvVel", "SRPPos")),
        *((name, "f8") for name in ("AmpSF", "SC0", "SCSS")),
        ("SIGNAL", "i8"),
    ]
)


def to_space(positions: np.ndarray) -> np.ndarray:
    """Earth-centred, earth-fixed coordinates of positions in the map, by PROJ."""
    back = Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lat_0={LATITUDE} +lon_0={LONGITUDE} +h_0={HEIGHT}"
    )
    return np.stack(back.transform(*np.moveaxis(positions, -1, 0)), axis=-1)


def collected(sign: int, wander_hz: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Parameters of the pulses, and their samples: those of a target, by the way there and back between two times.

    The aircraft flies east, south of the scene, and moves between transmission and reception. The first frequency
    changes from pulse to pulse by up to `wander_hz`.
    """
    pvp = np.zeros(PULSES, PVP)
    number = np.arange(PULSES) - PULSES // 2
    pvp["TxTime"] = 1.0 + number * PULSE_STEP / SPEED
    pvp["RcvTime"] = pvp["TxTime"] + 2 * RANGE / speed_of_light
    begin = np.array([0.0, -RANGE * math.sin(ELEVATION), RANGE * math.cos(ELEVATION)])
    velocity = np.array([SPEED, 0.0, 0.0])
    origin = to_space(np.zeros(3))
    for kind in ("Tx", "Rcv"):
        pvp[f"{kind}Pos"] = to_space(begin + (pvp[f"{kind}Time"] - 1.0)[:, None] * velocity)
        pvp[f"{kind}Vel"] = to_space(velocity) - origin
    pvp["SRPPos"], pvp["AmpSF"], pvp["SIGNAL"] = origin, 1.0, 1
    pvp["SCSS"] = BANDWIDTH / SAMPLES
    pvp["SC0"] = CARRIER - (SAMPLES - 1) / 2 * BANDWIDTH / SAMPLES + wander_hz * np.sin(number)

    def way(point: np.ndarray) -> np.ndarray:
        return sum(np.linalg.norm(pvp[f"{kind}Pos"] - point, axis=-1) for kind in ("Tx", "Rcv"))

    delay = (way(to_space(TARGET)) - way(origin)) / speed_of_light
    frequency = pvp["SC0"][:, None] + pvp["SCSS"][:, None] * np.arange(SAMPLES)
    return pvp, np.exp(2j * np.pi * sign * frequency * delay[:, None]).astype(np.complex64)


def xml_of(pvp: np.ndarray, sign: int, signal_format: str, channels: tuple[str, ...], **changes: str) -> Any:
    """The metadata that is needed to read the arrays."""
    offset, parameters = 0, ""
    for name in pvp.dtype.names:
        kind, _ = pvp.dtype.fields[name][:2]
        size = kind.itemsize // 8
        text = {1: "I8" if kind == np.dtype("i8") else "F8", 3: "X=F8;Y=F8;Z=F8;"}[size]
        parameters += f"<{name}><Offset>{offset}</Offset><Size>{size}</Size><Format>{text}</Format></{name}>"
        offset += size
    each = {"CF8": 8, "CI4": 4}[signal_format] * PULSES * SAMPLES
    data = "".join(
        f"<Channel><Identifier>{name}</Identifier><NumVectors>{PULSES}</NumVectors><NumSamples>{SAMPLES}</NumSamples>"
        f"<SignalArrayByteOffset>{each * place}</SignalArrayByteOffset>"
        f"<PVPArrayByteOffset>{pvp.nbytes * place}</PVPArrayByteOffset></Channel>"
        for place, name in enumerate(channels)
    )
    values = {
        "domain": "FX",
        "start": "2026-03-01T10:00:00.5Z",
        "collect": "MONOSTATIC",
        "latitude": str(LATITUDE),
        "reference": channels[0],
        **changes,
    }
    return lxml.etree.fromstring(
        f'<CPHD xmlns="{NAMESPACE}"><CollectionID><CoreName>test</CoreName>'
        f"<CollectType>{values['collect']}</CollectType>"
        "<Classification>UNCLASSIFIED</Classification><ReleaseInfo>UNRESTRICTED</ReleaseInfo></CollectionID>"
        f"<Global><DomainType>{values['domain']}</DomainType><SGN>{sign:+d}</SGN>"
        f"<Timeline><CollectionStart>{values['start']}</CollectionStart></Timeline></Global>"
        f"<SceneCoordinates><IARP><LLH><Lat>{values['latitude']}</Lat><Lon>{LONGITUDE}</Lon><HAE>{HEIGHT}</HAE></LLH>"
        f"</IARP></SceneCoordinates><Data><SignalArrayFormat>{signal_format}</SignalArrayFormat>"
        f"<NumBytesPVP>{pvp.dtype.itemsize}</NumBytesPVP>{data}</Data>"
        f"<Channel><RefChId>{values['reference']}</RefChId></Channel><PVP>{parameters}</PVP></CPHD>"
    ).getroottree()


def write_cphd(
    path: Path,
    sign: int = -1,
    signal_format: str = "CF8",
    wander_hz: float = 0.0,
    channels: tuple[str, ...] = ("VV",),
    silent: int = 0,
    **changes: str,
) -> Path:
    """A file by sarkit: the target in the first channel, nothing in others, and some pulses without a signal."""
    pvp, samples = collected(sign, wander_hz)
    if silent:
        pvp["SIGNAL"][-silent:] = 0
        samples[-silent:] = 1000.0
    if signal_format == "CI4":
        pvp["AmpSF"] = 1 / 2000
        whole = np.empty(samples.shape, [("real", "i2"), ("imag", "i2")])
        whole["real"], whole["imag"] = np.rint(2000 * samples.real), np.rint(2000 * samples.imag)
        samples = whole
    metadata = sarkit.cphd.Metadata(xmltree=xml_of(pvp, sign, signal_format, channels, **changes))
    with path.open("wb") as file, sarkit.cphd.Writer(file, metadata) as writer:
        for place, name in enumerate(channels):
            writer.write_signal(name, samples if place == 0 else np.zeros_like(samples))
            writer.write_pvp(name, pvp)
    return path


def focused(path: Path, folder: Path, channel: str = "") -> dict[str, Any]:
    """Measures of the brightest target of the image."""
    import_cphd(path, folder / "bag", channel)
    replay(folder / "bag", folder / "out", {})
    (image,) = json.loads((folder / "out" / "report.json").read_text())["images"]
    return dict(image)


@pytest.mark.parametrize(
    ("sign", "signal_format", "wander_hz", "silent"),
    [(-1, "CF8", 0.0, 0), (+1, "CF8", 0.0, 0), (-1, "CI4", 0.0, 0), (-1, "CF8", 300e3, 0), (+1, "CF8", 0.0, 20)],
    ids=["minus", "plus", "whole numbers", "wandering frequencies", "silent pulses"],
)
def test_a_target_focuses_where_it_stands(
    sign: int, signal_format: str, wander_hz: float, silent: int, tmp_path: Path
) -> None:
    """To 0.4 m, a third of the resolution, and as sharp as theory says: .886 c / 2 B across, .886 lambda R / 2 L along.

    A wrong sign puts it at the mirror image, 100 m away; frequencies taken for those of the first pulse defocus it.
    """
    path = write_cphd(tmp_path / "a.cphd", sign, signal_format, wander_hz, silent=silent)
    image = focused(path, tmp_path)
    place = np.array(image["brightest_east_north_up_m"])
    np.testing.assert_allclose(place[:2], TARGET[:2], rtol=0, atol=0.4)
    across = 0.886 * speed_of_light / (2 * BANDWIDTH) / math.sin(ELEVATION)
    along = 0.886 * speed_of_light / CARRIER * RANGE / (2 * PULSE_STEP * (PULSES - silent))
    assert image["row_width_3db_m"] == pytest.approx(across, rel=0.05)
    assert image["col_width_3db_m"] == pytest.approx(along, rel=0.05)


def test_the_bag_knows_its_place_and_time(tmp_path: Path) -> None:
    assert import_cphd(write_cphd(tmp_path / "a.cphd"), tmp_path / "bag") == PULSES
    reader = BagReader(tmp_path / "bag")
    (origin,) = (reader.decode(one.type_name, one.cdr) for one in reader.messages(["/map_origin"]))
    assert (origin.latitude, origin.longitude, origin.altitude) == pytest.approx((LATITUDE, LONGITUDE, HEIGHT))
    (frame,) = (reader.decode(one.type_name, one.cdr) for one in reader.messages(["/phase_history"]))
    first_s = 0.5 + 1.0 - PULSES // 2 * PULSE_STEP / SPEED + RANGE / speed_of_light
    assert frame.header.stamp.sec + frame.header.stamp.nanosec * 1e-9 == pytest.approx(1772359200 + first_s, abs=1e-6)


def test_the_channel_that_is_named_is_read(tmp_path: Path) -> None:
    path = write_cphd(tmp_path / "a.cphd", channels=("VV", "VH"))
    import_cphd(path, tmp_path / "bag", "VH")
    reader = BagReader(tmp_path / "bag")
    (frame,) = (reader.decode(one.type_name, one.cdr) for one in reader.messages(["/phase_history"]))
    assert not np.any(np.array(frame.samples))
    with pytest.raises(UserError) as refused:
        import_cphd(path, tmp_path / "other", "HH")
    assert_one_sentence(str(refused.value), "has no channel 'HH'; there are VV, VH")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"domain": "TOA"}, "in the domain TOA; FX (fast-time frequencies) is read"),
        ({"collect": "BISTATIC"}, "of the type BISTATIC"),
        ({"latitude": "north"}, "no image area reference point"),
        ({"start": "noon"}, "'noon' for CollectionStart, which is no time"),
    ],
)
def test_what_is_not_supported_is_told(changes: dict[str, str], words: str, tmp_path: Path) -> None:
    path = write_cphd(tmp_path / "a.cphd", **changes)
    with pytest.raises(UserError) as refused:
        import_cphd(path, tmp_path / "bag")
    assert_one_sentence(str(refused.value), str(path), words)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"nothing", "is not CPHD"),
        (b"CPHD/2.0\n\f\n", "is CPHD of version 2.0; versions 1.0 and 1.1 are read"),
        (b"CPHD/1.1.0\nXML_BLOCK_SIZE := 5\n\f\n", "not a readable CPHD file"),
    ],
)
def test_files_that_are_none_or_newer_are_refused(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.cphd").write_bytes(content)
    with pytest.raises(UserError) as refused:
        import_cphd(tmp_path / "a.cphd", tmp_path / "bag")
    assert_one_sentence(str(refused.value), "a.cphd", words)


def test_a_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = write_cphd(tmp_path / "a.cphd")
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(UserError) as refused:
        import_cphd(path, tmp_path / "bag")
    assert_one_sentence(str(refused.value), "not a readable CPHD file")
