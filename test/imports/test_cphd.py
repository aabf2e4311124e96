"""CPHD files written by other software: a target focuses where it stands on the earth, whatever their conventions."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown_target import CARRIER, ELEVATION, HEIGHT, LATITUDE, LONGITUDE, RANGE, SPEED, TARGET
from helpers import assert_one_sentence
from sarkit.verification import CphdConsistency
from scipy.constants import speed_of_light
from written_cphd import BANDWIDTH, PULSE_STEP, PULSES, write_cphd

from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.imports.cphd import import_cphd
from sal_height.runs.replay.bag_replay import replay

pytestmark = pytest.mark.filterwarnings(
    "ignore:(open|read)_text is:DeprecationWarning"
)  # of sarkit, which opens its types so

KINDS: dict[str, dict[str, Any]] = {
    "FX": {},
    "FX, plus, whole numbers": {"sign": +1, "signal_format": "CI4"},
    "FX, wandering frequencies": {"wander_hz": 300e3},
    "FX, silent pulses": {"silent": 20},
    "TOA": {"domain": "TOA"},
    "TOA, plus, whole numbers, wandering": {"domain": "TOA", "sign": +1, "signal_format": "CI4", "wander_hz": 300e3},
}


def focused(path: Path, folder: Path) -> dict[str, Any]:
    """Measures of the brightest target of the image."""
    import_cphd(path, folder / "bag")
    replay(folder / "bag", folder / "out", {})
    (image,) = json.loads((folder / "out" / "report.json").read_text())["images"]
    return dict(image)


def samples_in(bag: Path) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) of the samples of a bag, and the samples, (pulses, frequencies)."""
    reader = BagReader(bag)
    (sensor,) = (reader.decode(one.type_name, one.cdr) for one in reader.messages(["/sensor_info"]))
    (frame,) = (reader.decode(one.type_name, one.cdr) for one in reader.messages(["/phase_history"]))
    waveform, count = sensor.waveform, frame.sample_count
    offset = (np.arange(count) - (count - 1) / 2) * waveform.bandwidth / count
    samples = np.frombuffer(bytes(frame.samples), "<c8").reshape(frame.pulse_count, count)
    return speed_of_light / waveform.wavelength + offset, samples


@pytest.mark.parametrize("kind", KINDS)
def test_the_files_are_what_the_standard_says(kind: str, tmp_path: Path) -> None:
    """So says the checker of sarkit: geometry, frequencies, times of arrival, sizes and the schema fit each other."""
    path = write_cphd(tmp_path / "a.cphd", **KINDS[kind])
    with path.open("rb") as file:
        checker = CphdConsistency.from_file(file, thorough=True)
        checker.check()
    assert not checker.failures()
    assert len(checker.passes()) > 50


@pytest.mark.parametrize("kind", KINDS)
def test_a_target_focuses_where_it_stands(kind: str, tmp_path: Path) -> None:
    """To 5 mm, and as sharp as theory says: .886 c / 2 B across, .886 lambda R / 2 L along.

    A wrong sign puts it at the mirror image, 100 m away; frequencies taken for those of the first pulse defocus it.
    """
    image = focused(write_cphd(tmp_path / "a.cphd", **KINDS[kind]), tmp_path)
    place = np.array(image["brightest_east_north_up_m"])
    np.testing.assert_allclose(place[:2], TARGET[:2], rtol=0, atol=0.005)
    across = 0.886 * speed_of_light / (2 * BANDWIDTH) / math.sin(ELEVATION)
    along = 0.886 * speed_of_light / CARRIER * RANGE / (2 * PULSE_STEP * (PULSES - KINDS[kind].get("silent", 0)))
    assert image["row_width_3db_m"] == pytest.approx(across, rel=0.03)
    assert image["col_width_3db_m"] == pytest.approx(along, rel=0.03)


@pytest.mark.parametrize("sign", [-1, +1])
@pytest.mark.parametrize("wander_hz", [0.0, 300e3])
def test_times_of_arrival_become_the_frequencies_that_they_were_made_of(
    sign: int, wander_hz: float, tmp_path: Path
) -> None:
    """The samples are those of the same target over frequency; its peak, the sum of them in phase, is as high to 0.2 %.

    A record of 1.6 us holds all but the ends of the sinc, which leaves a ripple of 1 % rms, most of it at the edges of
    the band. Times off by half a sample would turn the phase at the edges by 72 degrees.
    """
    for domain in ("FX", "TOA"):
        path = write_cphd(tmp_path / f"{domain}.cphd", domain, sign, wander_hz=wander_hz)
        import_cphd(path, tmp_path / domain)
    (f, expected), (f_toa, found) = (samples_in(tmp_path / domain) for domain in ("FX", "TOA"))
    if wander_hz:  # bands that all pulses share, which begin at other frequencies
        assert abs(f_toa.mean() - f.mean()) < BANDWIDTH / 240
        assert np.abs(np.abs(found[:, 20:-20]) - 1).max() < 0.02
        return
    np.testing.assert_allclose(f_toa, f, rtol=1e-12)
    assert np.sqrt(np.mean(np.abs(found - expected) ** 2)) < 0.02
    assert np.abs(np.mean(found * expected.conj())) == pytest.approx(1.0, abs=0.002)


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
    _, samples = samples_in(tmp_path / "bag")
    assert not np.any(samples)
    with pytest.raises(UserError) as refused:
        import_cphd(path, tmp_path / "other", "HH")
    assert_one_sentence(str(refused.value), "has no channel 'HH'; there are VV, VH")


def told(path: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What the command says of a file that it refuses, with the exit status 2 and without a bag."""
    assert main(["import", "cphd", str(path), "--out", str(folder / "bag")]) == 2
    assert not (folder / "bag").exists()
    return capsys.readouterr().err.strip()


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ({"changes": {"Global/DomainType": "RX"}}, "in the domain RX; FX (fast-time frequencies) and TOA"),
        ({"changes": {"Global/SGN": "0"}}, "has the sign 0 (Global/SGN); it must be -1 or +1"),
        ({"changes": {"CollectionID/CollectType": "BISTATIC"}}, "of the type BISTATIC"),
        ({"changes": {"SceneCoordinates/IARP/LLH/Lat": "north"}}, "no image area reference point"),
        ({"changes": {"Global/Timeline/CollectionStart": "noon"}}, "'noon' for CollectionStart, which is no time"),
        ({"changes": {"Data/NumCPHDChannels": "1"}, "without": ("SCSS", "RcvPos")}, "lacks RcvPos, SCSS among the"),
        ({"domain": "TOA", "without": ("FX1", "FX2")}, "lacks FX1, FX2 among the parameters of its pulses (PVP)"),
        ({"parameters": {"TxPos": np.nan}}, "values of TxPos among the parameters of its pulses (PVP) that are not"),
        ({"parameters": {"TxTime": 1.0, "RcvTime": 1.1}}, "reach over 0 s and 127 m; they must be taken one after"),
        ({"parameters": {"SCSS": 0.0}}, "steps between samples (SCSS) that are not greater than 0"),
        ({"parameters": {"SIGNAL": 0}}, "has 0 pulses with a signal, of 240 samples; two or more"),
        ({"domain": "TOA", "parameters": {"FX2": CARRIER - BANDWIDTH}}, "have 0 frequencies in common"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_not_supported_is_told(
    written: dict[str, Any], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_cphd(tmp_path / "a.cphd", **written)
    assert_one_sentence(told(path, tmp_path, capsys).removeprefix("sal-height: "), words)


def test_a_file_of_several_collections_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_cphd(tmp_path / "a.cphd")
    xml = b"<CollectionID><CollectorName>sensor</CollectorName></CollectionID>"
    content = path.read_bytes()
    end = content.index(b"</CPHD>")
    size = int(content.split(b"XML_BLOCK_SIZE := ")[1].split(b"\n")[0])
    begin = end + len(b"</CPHD>") - size
    both = content[:end].replace(b"<Global>", xml + b"<Global>") + b"</CPHD>"
    longer = both.replace(b"XML_BLOCK_SIZE := %d\n" % size, b"XML_BLOCK_SIZE := %d\n" % (len(both) - begin))
    path.write_bytes(longer)
    assert_one_sentence(
        told(path, tmp_path, capsys).removeprefix("sal-height: "), "describes 2 collections (CollectionID)"
    )


def test_samples_in_little_endian_order_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The standard has big-endian ones; swapped, some of many look infinite."""
    path = write_cphd(tmp_path / "a.cphd")
    content = bytearray(path.read_bytes())
    size = PULSES * 240 * 8
    content[-size:] = np.frombuffer(content[-size:], ">f4").astype("<f4").tobytes()
    path.write_bytes(content)
    assert_one_sentence(
        told(path, tmp_path, capsys).removeprefix("sal-height: "), "NaN or infinite; all must be finite, and stored in"
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"nothing", "is not CPHD"),
        (b"CPHD/2.0\n\f\n", "is CPHD of version 2.0; versions 1.0 and 1.1 are read"),
        (b"CPHD/0.3\n\f\n", "is CPHD of version 0.3; versions 1.0 and 1.1 are read"),
        (b"CPHD/1.1.0\nXML_BLOCK_SIZE := 5\n\f\n", "not a readable CPHD file"),
    ],
)
def test_files_that_are_none_or_of_other_versions_are_refused(
    content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.cphd").write_bytes(content)
    said = told(tmp_path / "a.cphd", tmp_path, capsys)
    assert_one_sentence(said.removeprefix("sal-height: "), "a.cphd", words)


@pytest.mark.parametrize("kept", [-1000, 20_000, 2000, 100])
def test_a_file_that_is_cut_off_is_refused(kept: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Among the samples, the parameters, the metadata, and the header."""
    path = write_cphd(tmp_path / "a.cphd")
    path.write_bytes(path.read_bytes()[:kept])
    assert_one_sentence(told(path, tmp_path, capsys).removeprefix("sal-height: "), "not a readable CPHD file")
