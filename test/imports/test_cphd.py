"""CPHD files written by other software: a target focuses where it stands on the earth, whatever their conventions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown_target import CARRIER, HEIGHT, LATITUDE, LONGITUDE, RANGE, SPEED
from helpers import assert_one_sentence, refused
from phase_history_files import assert_focused, complaint, only
from scipy.constants import speed_of_light
from written_cphd import BANDWIDTH, CONVENTIONS, PULSE_STEP, PULSES, write_cphd

from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.imports.cphd import import_cphd
from sal_height.runs.chain.recorded_parameters import recorded_parameters

pytestmark = pytest.mark.filterwarnings(
    "ignore:(open|read)_text is:DeprecationWarning"
)  # of sarkit, which opens its types so


def samples_in(bag: Path) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) of the samples of a bag, and the samples, (pulses, frequencies)."""
    sensor, frame = only(bag, "/sensor_info"), only(bag, "/phase_history")
    waveform, count = sensor.waveform, frame.sample_count
    offset = (np.arange(count) - (count - 1) / 2) * waveform.bandwidth / count
    samples = np.frombuffer(bytes(frame.samples), "<c8").reshape(frame.pulse_count, count)
    return speed_of_light / waveform.wavelength + offset, samples


@pytest.mark.parametrize("kind", CONVENTIONS)
def test_a_target_focuses_where_it_stands(kind: str, tmp_path: Path) -> None:
    """A wrong sign puts it at the mirror image, 100 m away; frequencies as of the first pulse defocus it."""
    import_cphd(write_cphd(tmp_path / "a.cphd", **CONVENTIONS[kind]), tmp_path / "bag")
    length = PULSE_STEP * (PULSES - CONVENTIONS[kind].get("silent", 0))
    assert_focused(tmp_path / "bag", tmp_path / "out", BANDWIDTH, length)


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
    origin = only(tmp_path / "bag", "/map_origin")
    assert (origin.latitude, origin.longitude, origin.altitude) == pytest.approx((LATITUDE, LONGITUDE, HEIGHT))
    frame = only(tmp_path / "bag", "/phase_history")
    first_s = 0.5 + 1.0 - PULSES // 2 * PULSE_STEP / SPEED + RANGE / speed_of_light
    assert frame.header.stamp.sec + frame.header.stamp.nanosec * 1e-9 == pytest.approx(1772359200 + first_s, abs=1e-6)


@pytest.mark.parametrize(("seconds", "air"), [(0.0, "unknown"), (1.5e-8, "none")])
def test_ranges_that_contain_the_delay_of_the_air_are_in_vacuum(seconds: float, air: str, tmp_path: Path) -> None:
    """Where the file says that it is in the time of the reference point; else the delay is uncertain."""
    import_cphd(write_cphd(tmp_path / "a.cphd", parameters={"TDTropoSRP": seconds}), tmp_path / "bag")
    assert recorded_parameters(BagReader(tmp_path / "bag"))["sar_compression"]["air"] == air


def test_the_channel_that_is_named_is_read(tmp_path: Path) -> None:
    path = write_cphd(tmp_path / "a.cphd", channels=("VV", "VH"))
    import_cphd(path, tmp_path / "bag", "VH")
    _, samples = samples_in(tmp_path / "bag")
    assert not np.any(samples)
    with refused(UserError, "has no channel 'HH'; there are VV, VH"):
        import_cphd(path, tmp_path / "other", "HH")


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
    assert_one_sentence(complaint("cphd", path, capsys), words)


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
    assert_one_sentence(complaint("cphd", path, capsys), "describes 2 collections (CollectionID)")
