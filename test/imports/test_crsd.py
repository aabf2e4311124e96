"""CRSD files written by other software: a target focuses where it stands on the earth, whatever their conventions."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown_target import CARRIER, ELEVATION, RANGE, SPEED, TARGET
from helpers import assert_one_sentence
from sarkit.verification import CrsdConsistency
from scipy.constants import speed_of_light
from written_crsd import BANDWIDTH, BEAM_OFFSETS, OFF_CARRIER, PULSE_STEP, PULSES, SAMPLES, write_beams, write_crsd

from sal_height.bag.reader import BagReader
from sal_height.commands import main
from sal_height.imports.crsd import import_crsd
from sal_height.messages import field_from_message
from sal_height.runs.replay.bag_replay import replay

pytestmark = pytest.mark.filterwarnings("ignore:(open|read)_text is:DeprecationWarning")  # of sarkit, which opens so

KINDS: dict[str, dict[str, Any]] = {
    "rising": {},
    "falling, early vectors, whole numbers": {"falling": True, "early_s": 0.2e-6, "signal_format": "CI4"},
    "vectors of noise, two channels": {"silent": 20, "channels": ("HH", "HV")},
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_files_are_what_the_standard_says(kind: str, tmp_path: Path) -> None:
    """So says the checker of sarkit: geometry, waveform, times, sizes and the schema fit each other."""
    path = write_crsd(tmp_path / "a.crsd", **KINDS[kind])
    with path.open("rb") as file:
        checker = CrsdConsistency.from_file(file, thorough=True)
        checker.check()
    assert not checker.failures()
    assert len(checker.passes()) > 80


@pytest.mark.parametrize("kind", KINDS)
def test_a_target_focuses_where_it_stands(kind: str, tmp_path: Path) -> None:
    """To 5 mm, and as sharp as theory says: .886 c / 2 B across, .886 lambda R / 2 L along.

    Echoes have a phase of their own in each pulse and each vector, and a carrier that is not the frequency of the
    receiver: one of them left in defocuses the target or moves it by 80 m.
    """
    import_crsd(write_crsd(tmp_path / "a.crsd", **KINDS[kind]), tmp_path / "bag")
    replay(tmp_path / "bag", tmp_path / "out", {})
    (image,) = json.loads((tmp_path / "out" / "report.json").read_text())["images"]
    place = np.array(image["brightest_east_north_up_m"])
    np.testing.assert_allclose(place[:2], TARGET[:2], rtol=0, atol=0.005)
    across = 0.886 * speed_of_light / (2 * BANDWIDTH) / math.sin(ELEVATION)
    along = 0.886 * speed_of_light / CARRIER * RANGE / (2 * PULSE_STEP * (PULSES - KINDS[kind].get("silent", 0)))
    assert image["row_width_3db_m"] == pytest.approx(across, rel=0.03)
    assert image["col_width_3db_m"] == pytest.approx(along, rel=0.03)


def read(bag: Path, topic: str) -> Any:
    """The only message of a topic."""
    reader = BagReader(bag)
    (message,) = (reader.decode(one.type_name, one.cdr) for one in reader.messages([topic]))
    return message


def test_echoes_are_compressed_to_the_amplitude_and_the_phase_of_the_target(tmp_path: Path) -> None:
    """The samples are exp(-j 4 pi f (R - r)), with the reference point at r; their mean in phase is 1 to 1 %.

    The Fresnel ripples of the band are symmetrical, so that they keep the phase of the mean.
    """
    assert import_crsd(write_crsd(tmp_path / "a.crsd"), tmp_path / "bag") == PULSES
    sensor, frame = read(tmp_path / "bag", "/sensor_info"), read(tmp_path / "bag", "/phase_history")
    waveform, count = sensor.waveform, frame.sample_count
    assert waveform.kind == "spectrum"
    assert speed_of_light / waveform.wavelength == pytest.approx(CARRIER + OFF_CARRIER, rel=1e-12)
    assert waveform.bandwidth == pytest.approx(BANDWIDTH, rel=0.01)
    f = CARRIER + OFF_CARRIER + (np.arange(count) - (count - 1) / 2) * waveform.bandwidth / count
    samples = np.frombuffer(bytes(frame.samples), "<c8").reshape(PULSES, count)
    middle = PULSES // 2
    begin = np.array([0.0, -RANGE * math.sin(ELEVATION), RANGE * math.cos(ELEVATION)])
    begin[0] += SPEED * RANGE / speed_of_light  # half-way between pulse and echo
    expected = np.exp(-4j * np.pi * f / speed_of_light * (np.linalg.norm(begin - TARGET) - np.linalg.norm(begin)))
    mean = np.mean(samples[middle] * expected.conj())
    assert abs(mean) == pytest.approx(1.0, abs=0.01)
    assert abs(np.angle(mean)) < 0.02
    reader = BagReader(tmp_path / "bag")
    states = [reader.decode(one.type_name, one.cdr) for one in reader.messages(["/platform/odometry"])]
    # The vector begins 3 us before the echo, in which the receiver flies 0.3 mm.
    assert states[middle].pose.pose.position.x == pytest.approx(begin[0], abs=1e-5)
    stamp_s = frame.header.stamp.sec + frame.header.stamp.nanosec * 1e-9
    first_s = 0.5 + 1.0 - PULSES // 2 * PULSE_STEP / SPEED + RANGE / speed_of_light
    assert stamp_s == pytest.approx(1772359200 + first_s, abs=1e-6)


def test_the_channel_that_is_named_is_read(tmp_path: Path) -> None:
    path = write_crsd(tmp_path / "a.crsd", channels=("HH", "HV"))
    import_crsd(path, tmp_path / "bag", "HV")
    samples = np.frombuffer(bytes(read(tmp_path / "bag", "/phase_history").samples), "<c8")
    assert np.sqrt(np.mean(np.abs(samples) ** 2)) == pytest.approx(0.5, rel=0.02)


def told(path: Path, folder: Path, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What the command says of a file that it refuses, with the exit status 2 and without a bag."""
    assert main(["import", "crsd", str(path), "--out", str(folder / "bag"), *words]) == 2
    assert not (folder / "bag").exists()
    return capsys.readouterr().err.strip().removeprefix("sal-height: ")


TWO_CARRIERS = CARRIER + np.where(np.arange(PULSES) % 2, 0.0, 5e6)


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ({"changes": {"SARInfo/CollectType": "BISTATIC"}}, "of the type BISTATIC; collections of one platform"),
        ({"changes": {"TxSequence/TxWFType": "LFM w XM"}}, "the transmitted waveform LFM w XM; linear FM (LFM) is"),
        ({"changes": {"TxSequence/TxWFType": "XM"}}, "the transmitted waveform XM; linear FM (LFM) is read"),
        ({"changes": {"Global/CollectionRefTime": "noon"}}, "'noon' for CollectionRefTime, which is no time"),
        ({"changes": {"Channel/Parameters/Fs": "fast"}}, "has 'fast' for Fs; it must be a finite number"),
        (
            {"parameters": {"FxFreq0": TWO_CARRIERS}},
            "pulses of different waveforms: carriers from 9.6e+09 to 9.605e+09",
        ),
        ({"changes": {"Channel/Parameters/Fs": "0"}}, "has 0 for Fs; it must be greater than 0"),
        ({"parameters": {"FICRate": 1e12}}, "a receiver whose band follows the frequency of the echo"),
        ({"parameters": {"TxPos": np.nan}}, "values of TxPos among the parameters of its pulses (PPP) that are not"),
        ({"parameters": {"SIGNAL": 0}}, "has 0 vectors with the echo of a pulse, of 1200 samples; two or more"),
        (
            {"parameters": {"TxPulseIndex": PULSES}},
            "the echo of pulse 255; its sequence has 255 pulses, counted from 0",
        ),
        ({"early_s": 20e-6}, "off the reference point of the channel (RcvRefPoint); whole echoes"),
        ({"parameters": {"FxRate": 0.0}}, "Sensor bandwidth is 0.0; it must be finite and greater than 0"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_not_supported_is_told(
    written: dict[str, Any], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_one_sentence(told(write_crsd(tmp_path / "a.crsd", **written), tmp_path, capsys), words)


def test_a_channel_that_is_not_there_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = told(write_crsd(tmp_path / "a.crsd"), tmp_path, capsys, "--channel", "VV")
    assert_one_sentence(said, "has no channel 'VV'; there are HH")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"nothing", "is not CRSD"),
        (b"CRSD/1.0.0\n\f\n", "is not CRSD: it does not begin with the word CRSDsar/"),
        (b"CRSDrcv/1.0\n\f\n", "is CRSDrcv, one way only"),
        (b"CRSDsar/1.1\n\f\n", "is CRSD of version 1.1; version 1.0 is read"),
        (b"CRSDsar/1.0\nXML_BLOCK_SIZE := 5\n\f\n", "not a readable CRSD file"),
    ],
)
def test_files_that_are_none_or_of_other_versions_are_refused(
    content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.crsd").write_bytes(content)
    assert_one_sentence(told(tmp_path / "a.crsd", tmp_path, capsys), "a.crsd", words)


@pytest.mark.parametrize("kept", [-1000, 40_000, 2000, 100])
def test_a_file_that_is_cut_off_is_refused(kept: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Among the samples, the parameters, the metadata, and the header."""
    path = write_crsd(tmp_path / "a.crsd")
    path.write_bytes(path.read_bytes()[:kept])
    assert_one_sentence(told(path, tmp_path, capsys), "not a readable CRSD file")


def test_samples_in_little_endian_order_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_crsd(tmp_path / "a.crsd")
    content = bytearray(path.read_bytes())
    size = PULSES * SAMPLES * 8
    content[-size:] = np.frombuffer(content[-size:], ">f4").astype("<f4").tobytes()
    path.write_bytes(content)
    assert_one_sentence(told(path, tmp_path, capsys), "NaN or infinite; all must be finite, and stored in big-endian")


@pytest.mark.parametrize("height", [0.0, 12.0])
def test_beams_of_one_antenna_become_channels_which_give_the_height(height: float, tmp_path: Path) -> None:
    """To 3.5 of the sigmas that are stated, of 7 cm each; the file has the upper beam first."""
    path = write_beams(tmp_path / "a.crsd", np.array([*TARGET[:2], height]))
    with path.open("rb") as file:
        checker = CrsdConsistency.from_file(file, thorough=True)
        checker.check()
    assert not checker.failures()
    import_crsd(path, tmp_path / "bag")
    sensor = read(tmp_path / "bag", "/sensor_info")
    np.testing.assert_allclose(sensor.beams.elevation_boresights, ELEVATION + np.array(BEAM_OFFSETS), atol=1e-6)
    replay(tmp_path / "bag", tmp_path / "out", {})
    surface = field_from_message(read(tmp_path / "out" / "bag", "/ml/height")).first
    best = np.unravel_index(np.nanargmin(surface.sigma), surface.sigma.shape)
    assert 0.04 < surface.sigma[best] < 0.1
    assert abs(surface.height[best] - height) < 3.5 * surface.sigma[best]
    np.testing.assert_allclose(surface.positions[best][:2], TARGET[:2], rtol=0, atol=1.0)


def test_channels_with_one_boresight_are_no_beams(tmp_path: Path) -> None:
    """Without --channel, the reference channel is read of them."""
    import_crsd(write_crsd(tmp_path / "a.crsd", channels=("HH", "HV")), tmp_path / "bag")
    sensor = read(tmp_path / "bag", "/sensor_info")
    assert (sensor.name, len(sensor.beams.elevation_boresights)) == ("sensor HH", 1)
