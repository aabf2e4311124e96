"""CRSD files written by other software: a target focuses where it stands on the earth, whatever their conventions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown_target import CARRIER, ELEVATION, RANGE, SPEED, TARGET
from helpers import assert_one_sentence, few
from phase_history_files import assert_focused, complaint, only
from sarkit.verification import CrsdConsistency
from scipy.constants import speed_of_light
from written_crsd import (
    BANDWIDTH,
    BEAM_OFFSETS,
    CONVENTIONS,
    OFF_CARRIER,
    PULSE_STEP,
    PULSES,
    write_beams,
    write_crsd,
)

from sal_height.bag.reader import BagReader
from sal_height.engine.registry import STAGES
from sal_height.imports.crsd import import_crsd
from sal_height.messages import field_from_message
from sal_height.runs.replay.bag_replay import replay
from sal_height.sensor import AS_DESCRIBED
from sal_height.settings import settings_of

pytestmark = pytest.mark.filterwarnings("ignore:(open|read)_text is:DeprecationWarning")  # of sarkit, which opens so


@pytest.mark.parametrize("kind", CONVENTIONS)
def test_a_target_focuses_where_it_stands(kind: str, tmp_path: Path) -> None:
    """Echoes have a phase of their own in each pulse and each vector, and a carrier that is not that of the receiver.

    One of them left in defocuses the target or moves it by 80 m.
    """
    import_crsd(write_crsd(tmp_path / "a.crsd", **CONVENTIONS[kind]), tmp_path / "bag")
    length = PULSE_STEP * (PULSES - CONVENTIONS[kind].get("silent", 0))
    assert_focused(tmp_path / "bag", tmp_path / "out", BANDWIDTH, length)


def test_echoes_are_compressed_to_the_amplitude_and_the_phase_of_the_target(tmp_path: Path) -> None:
    """The samples are exp(-j 4 pi f (R - r)), with the reference point at r; their mean in phase is 1 to 1 %.

    The Fresnel ripples of the band are symmetrical, so that they keep the phase of the mean.
    """
    assert import_crsd(write_crsd(tmp_path / "a.crsd"), tmp_path / "bag") == PULSES
    sensor, frame = only(tmp_path / "bag", "/sensor_info"), only(tmp_path / "bag", "/phase_history")
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
    samples = np.frombuffer(bytes(only(tmp_path / "bag", "/phase_history").samples), "<c8")
    assert np.sqrt(np.mean(np.abs(samples) ** 2)) == pytest.approx(0.5, rel=0.02)


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
    assert_one_sentence(complaint("crsd", write_crsd(tmp_path / "a.crsd", **written), capsys), words)


def test_a_channel_that_is_not_there_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = complaint("crsd", write_crsd(tmp_path / "a.crsd"), capsys, "--channel", "VV")
    assert_one_sentence(said, "has no channel 'VV'; there are HH")


AS_DESCRIBED_EXACTLY: dict[str, dict[str, Any]] = {
    node: {name: 0.0 for name, one in settings_of(STAGES[node].settings).items() if one.default == AS_DESCRIBED}
    for node in ("sar_compression", "ml_height")
}
"""Of a file that is written as it states; it cannot state how well its sensor is known."""

AS_DESCRIBED_EXACTLY["sar_compression"]["air"] = "none"


@pytest.mark.parametrize("height", few(1, [12.0, 0.0]))
def test_beams_of_one_antenna_become_channels_which_give_the_height(height: float, tmp_path: Path) -> None:
    """To 3.5 of the sigmas that are stated, of 7 cm each; the file has the upper beam first."""
    path = write_beams(tmp_path / "a.crsd", np.array([*TARGET[:2], height]))
    with path.open("rb") as file:
        checker = CrsdConsistency.from_file(file, thorough=True)
        checker.check()
    assert not checker.failures()
    import_crsd(path, tmp_path / "bag")
    sensor = only(tmp_path / "bag", "/sensor_info")
    np.testing.assert_allclose(sensor.beams.elevation_boresights, ELEVATION + np.array(BEAM_OFFSETS), atol=1e-6)
    replay(tmp_path / "bag", tmp_path / "out", AS_DESCRIBED_EXACTLY)
    surface = field_from_message(only(tmp_path / "out" / "bag", "/ml/height")).first
    best = np.unravel_index(np.nanargmin(surface.sigma), surface.sigma.shape)
    assert 0.04 < surface.sigma[best] < 0.1
    assert abs(surface.height[best] - height) < 3.5 * surface.sigma[best]
    np.testing.assert_allclose(surface.positions[best][:2], TARGET[:2], rtol=0, atol=1.0)


def test_channels_with_one_boresight_are_no_beams(tmp_path: Path) -> None:
    """Without --channel, the reference channel is read of them."""
    import_crsd(write_crsd(tmp_path / "a.crsd", channels=("HH", "HV")), tmp_path / "bag")
    sensor = only(tmp_path / "bag", "/sensor_info")
    assert (sensor.name, len(sensor.beams.elevation_boresights)) == ("sensor HH", 1)
