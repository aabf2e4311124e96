"""Compensated radar signal data (CRSD, NGA.STND.0080) of a linear FM radar becomes a bag of one dwell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import speed_of_light

from sal_height.beams import BeamTable
from sal_height.errors import UserError
from sal_height.geometry import Origin
from sal_height.imaging import UNKNOWN_AIR
from sal_height.imports.collection import write_collection
from sal_height.imports.followed_point import Pulses, collection_of, following_sensor
from sal_height.imports.sarkit_files import (
    check_parameters,
    check_plain,
    check_single,
    chosen_channel,
    first_word,
    number_in,
    opened,
    origin_of,
    positive_number,
    scaled_samples,
    time_ns,
)
from sal_height.numeric import C64, F64, outer_phasors
from sal_height.sensor import PhaseHistory, Sensor, range_compressed

GRID = ("X0", "Y0", "XSS", "YSS")
"""Elements that state the first direction cosines of a pattern and the steps between them."""

QUANTITIES = ("Gain", "Phase")
"""Quantities in an array of gains (dB) and phases (cycles)."""

OF_VECTORS = ("RcvStart", "RcvPos", "RcvVel", "RefPhi0", "RefFreq", "DFIC0", "FICRate", "SIGNAL", "TxPulseIndex")
"""Parameters of each received vector that are read; AmpSF if it is there."""

OF_PULSES = ("TxTime", "TxPos", "TxVel", "TXmt", "PhiX0", "FxFreq0", "FxRate")
"""Parameters of each transmitted pulse that are read."""


@dataclass(frozen=True, eq=False)
class Beam:
    """The beam of a channel.

    Attributes:
        channel: identifier of the channel.
        boresight: angle from nadir, rad.
        width: beamwidth between the angles of half the power, rad.
        table: table of the amplitude over elevation.
    """

    channel: str
    boresight: float
    width: float
    table: BeamTable


def beams_of(reader: Any, channels: Sequence[str], origin: Origin) -> list[Beam]:
    """The beams of channels, by increasing boresight; empty if the channels are not beams of one antenna.

    They are if they receive the same pulses at the same times and positions, with boresights at different elevations in
    their electrical steering (RcvEB) and real patterns that are known around them.

    Args:
        reader: sarkit's reader of the file.
        channels: identifiers of the channels.
        origin: origin of the map.
    """
    tree, vectors = reader.metadata.xmltree, {name: reader.read_pvps(name) for name in channels}
    described = {name: tree.find(f"{{*}}Channel/{{*}}Parameters[{{*}}Identifier='{name}']") for name in channels}
    if len(channels) < 2 or not all(_receive_together(vectors, described, name) for name in channels[1:]):
        return []
    beams = [_beam(reader, name, described[name], vectors[name], origin) for name in channels]
    found = sorted((beam for beam in beams if beam), key=lambda beam: beam.boresight)
    # Least difference of the boresights of two beams, rad; those of channels of one beam differ by rounding.
    least_pitch = 1e-4
    apart = all(second.boresight - first.boresight > least_pitch for first, second in pairwise(found))
    return found if len(found) == len(channels) and apart else []


def _receive_together(vectors: dict[str, Any], described: dict[str, Any], name: str) -> bool:
    """True if a channel receives the pulses of the first one, at the same times and positions, in the same band."""
    first = next(iter(vectors))
    same = ("RcvAPCId", "Fs", "SARImage/{*}TxId", *(f"RcvRefPoint/{{*}}ECF/{{*}}{axis}" for axis in "XYZ"))
    if any(described[name].findtext(f"{{*}}{path}") != described[first].findtext(f"{{*}}{path}") for path in same):
        return False
    return vectors[name].shape == vectors[first].shape and all(
        np.array_equal(vectors[name][key], vectors[first][key])
        for key in ("RcvStart", "RcvPos", "RefFreq", "SIGNAL", "TxPulseIndex")
    )


def _beam(reader: Any, name: str, described: Any, vectors: Any, origin: Origin) -> Beam | None:
    """The beam of a channel at its reference vector; None if its pattern has phases or does not fall by half."""
    vector = vectors[int(described.findtext("{*}RefVectorIndex"))]
    point = np.array([float(described.findtext(f"{{*}}RcvRefPoint/{{*}}ECF/{{*}}{axis}")) for axis in "XYZ"])
    x, y, steering = vector["RcvACX"], vector["RcvACY"], vector["RcvEB"]
    ahead = origin.axes @ np.array([x, y, np.cross(x, y)]).T @ [*steering, np.sqrt(1 - steering @ steering)]
    towards = origin.axes @ (point - vector["RcvPos"])
    towards[2] = 0.0
    towards /= np.linalg.norm(towards)
    boresight = float(np.arctan2(ahead @ towards, -ahead[2]))

    def pattern(offsets: F64) -> tuple[F64, F64]:
        angles = boresight + offsets
        directions = np.sin(angles)[:, None] * towards - np.cos(angles)[:, None] * np.array([0.0, 0.0, 1.0])
        cosines = directions @ origin.axes @ np.array([x, y]).T
        return _pattern(reader, described.findtext("{*}RcvAPATId"), cosines, steering)

    directions = 4001
    offsets = np.linspace(-0.5, 0.5, directions)  # rad from the boresight at which the extent is searched
    gain, phase = pattern(offsets)
    lowest_db = -40.0  # gain against that of the boresight below which a pattern ends
    lobe = _around_middle(gain >= lowest_db)
    half = offsets[_around_middle(gain >= -10 * np.log10(2))]
    if len(half) == directions or len(half) < 2 or np.any(np.abs(phase[lobe] - phase[directions // 2]) > 1e-3):
        return None
    nodes = np.linspace(offsets[lobe][0], offsets[lobe][-1], 129)
    amplitude = 10 ** (pattern(nodes)[0] / 20)
    table = BeamTable(tuple(nodes.tolist()), (0.0,), tuple(amplitude.tolist()), (0.0,) * len(nodes))
    return Beam(name, boresight, float(half[-1] - half[0]), table)


def _pattern(reader: Any, identifier: str, cosines: F64, steering: F64) -> tuple[F64, F64]:
    """Gain (dB) and phase (cycles) of an antenna pattern at direction cosines, (n, 2); NaN where it is not known.

    The pattern of the array is one of the offsets from the electrical boresight, that of its elements one of direction.
    """
    antenna = f"{{*}}Antenna/{{*}}AntPattern[{{*}}Identifier='{identifier}']"
    parts = (("ArrayGPId", cosines - steering), ("ElemGPId", cosines))
    named = [(reader.metadata.xmltree.findtext(f"{antenna}/{{*}}{part}"), places) for part, places in parts]
    gain, phase = (sum(_stated(reader, name, quantity, places) for name, places in named) for quantity in QUANTITIES)
    return np.asarray(gain), np.asarray(phase)


def _stated(reader: Any, name: str, quantity: str, places: F64) -> F64:
    """A quantity of an array of gains and phases at positions in it, (n, 2); NaN beyond it."""
    from sarkit.crsd import interpolate_support_array  # noqa: PLC0415 (an extra)

    described = reader.metadata.xmltree.find(f"{{*}}SupportArray/{{*}}GainPhaseArray[{{*}}Identifier='{name}']")
    first_x, first_y, step_x, step_y = (float(described.findtext(f"{{*}}{key}")) for key in GRID)
    values = reader.read_support_array(name, masked=False)[quantity].astype(np.float64)
    x, y = places[:, 0], places[:, 1]
    return np.asarray(interpolate_support_array(x, y, first_x, first_y, step_x, step_y, values)[0])


def _around_middle(holds: Any) -> slice:
    """The contiguous indices around the middle one where a condition is true."""
    middle, misses = len(holds) // 2, np.flatnonzero(~holds)
    before, after = misses[misses < middle], misses[misses >= middle]
    return slice(int(before[-1]) + 1 if before.size else 0, int(after[0]) if after.size else len(holds))


@dataclass(frozen=True, eq=False)
class Echoes:
    """Signals that a channel has received.

    Attributes:
        channel: identifier of the channel.
        samples: samples at complex baseband, complex64, shape (pulses, samples).
        vectors: parameters of each received vector, shape (pulses,).
        pulses: parameters of the transmitted pulse of each vector, shape (pulses,).
        rate: sampling rate, Hz.
        noise_power: noise power of a sample, if noise were as strong outside the receiver's band as inside.
        point: reference point, earth-centred, earth-fixed, m, shape (3,).
    """

    channel: str
    samples: C64
    vectors: Any
    pulses: Any
    rate: float
    noise_power: float
    point: F64

    @property
    def middle_delay(self) -> F64:
        """Time from the middle of each pulse to the middle of its vector, s, shape (pulses,)."""
        start, sent = self.vectors["RcvStart"], self.pulses["TxTime"]
        wait = (start["Int"] - sent["Int"]) + (start["Frac"] - sent["Frac"])
        return np.asarray(wait + (self.samples.shape[1] - 1) / (2 * self.rate), dtype=np.float64)


def import_crsd(path: Path, out: Path, channel: str = "") -> int:
    """Write a bag with channels of a CRSD file as one dwell; returns the number of pulses.

    Echoes are compressed in range, and their phase referred to the reference point of the channel, which is the middle
    of the image. The map's origin is the image area reference point, with heights above WGS 84. Channels that are beams
    of one antenna are read together. The antenna of a single one is as wide as the pulses sample, its boresight turned
    to the reference point. The bag has the parameters that focus the scene.

    Args:
        path: CRSDsar 1.0 file of one platform, which transmits a linear FM.
        out: folder of the bag, new or empty.
        channel: identifier of the only channel to read; empty: all, if they are beams of one antenna, else the
            reference channel.

    Raises:
        UserError: the package sarkit is not installed, the file cannot be read, or the bag cannot be written.
    """
    _check_version(path)
    with opened(path, "crsd") as reader:
        tree = reader.metadata.xmltree
        _check_kind(path, tree)
        there = [one.text or "" for one in tree.findall("{*}Data/{*}Receive/{*}Channel/{*}ChId")]
        chosen = chosen_channel(path, there, tree.findtext("{*}Channel/{*}RefChId"), channel)
        origin = origin_of(path, tree)
        beams = [] if channel else beams_of(reader, there, origin)
        of_channels = [_read(path, reader, name) for name in [beam.channel for beam in beams] or [chosen]]
    echoes = of_channels[0]
    chirp = _chirp(path, echoes)
    pulses = _pulses(time_ns(path, tree, "Global", "CollectionRefTime"), echoes, origin)
    window = _window(path, echoes, pulses)
    name = tree.findtext("{*}TransmitInfo/{*}SensorName") or "crsd"
    channels = ", ".join(one.channel for one in of_channels)
    noise = tuple(one.noise_power for one in of_channels)
    of_chirps = _with_beams(following_sensor(f"{name} {channels}", pulses, chirp, window), beams, noise)
    chirps = np.stack([_chirps(one) for one in of_channels])
    raw = PhaseHistory(int(pulses.stamps_ns[0]), pulses.seconds, pulses.reference_range, chirps)
    compressed, sensor = range_compressed(raw, of_chirps)
    spectra = _referred(compressed.samples, sensor, echoes, pulses)
    sensor = replace(sensor, config_hash="")
    write_collection(collection_of(pulses, spectra, sensor, origin, window, UNKNOWN_AIR), out)
    return len(pulses.antenna)


def _check_version(path: Path) -> None:
    """Check that a file is CRSD of a kind and version that are known.

    Raises:
        UserError: it is not.
    """
    kind, version = first_word(path)
    if kind in {"CRSDtx", "CRSDrcv"}:
        raise UserError(f"File {path} is {kind}, one way only; CRSDsar, with pulses and their echoes, is read.")
    if kind != "CRSDsar":
        raise UserError(f"File {path} is not CRSD: it does not begin with the word CRSDsar/ and a version.")
    if version != "1.0":
        raise UserError(f"File {path} is CRSD of version {version}; version 1.0 is read.")


def _check_kind(path: Path, tree: Any) -> None:
    """Check that a file is of one collection and one platform, which transmits a linear FM, without compression.

    Raises:
        UserError: it is not.
    """
    check_single(path, tree, "ProductInfo")
    compression = tree.findtext("{*}Data/{*}Receive/{*}SignalCompression/{*}Identifier")
    check_plain(path, tree.findtext("{*}SARInfo/{*}CollectType"), compression)
    if (waveform := tree.findtext("{*}TxSequence/{*}TxWFType")) != "LFM":
        raise UserError(f"File {path} has the transmitted waveform {waveform}; linear FM (LFM) is read.")


def _read(path: Path, reader: Any, channel: str) -> Echoes:
    """The echoes of a channel that are undisturbed.

    Raises:
        UserError: parameters are missing or not finite, there are fewer than two echoes, their pulses are missing, or
            the receiver follows the frequency of the echo.
    """
    tree = reader.metadata.xmltree
    described = tree.find(f"{{*}}Channel/{{*}}Parameters[{{*}}Identifier='{channel}']")
    if described is None:
        raise UserError(f"File {path} does not describe channel {channel!r} (Channel/Parameters).")
    point = described.find("{*}RcvRefPoint/{*}ECF")
    samples, vectors = reader.read_channel(channel)
    pulses = reader.read_ppps(described.findtext("{*}SARImage/{*}TxId"))
    check_parameters(path, vectors, OF_VECTORS, "PVP")
    check_parameters(path, pulses, OF_PULSES, "PPP")
    if np.any(vectors["FICRate"] != 0) or np.any(vectors["DFIC0"] != 0):
        raise UserError(
            f"File {path} is of a receiver whose band follows the frequency of the echo (FICRate, DFIC0); receivers of "
            "a constant band are read."
        )
    of_pulse = vectors["TxPulseIndex"]
    undisturbed = 1  # value of SIGNAL of a vector that contains the undisturbed echo of a pulse
    kept = (vectors["SIGNAL"] == undisturbed) & (of_pulse >= 0)
    if np.count_nonzero(kept) < 2 or samples.shape[1] < 2:
        raise UserError(
            f"Channel {channel!r} of {path} has {np.count_nonzero(kept)} vectors with the echo of a pulse, of "
            f"{samples.shape[1]} samples; two or more of each are needed."
        )
    if of_pulse[kept].max() >= len(pulses):
        raise UserError(
            f"Channel {channel!r} of {path} has the echo of pulse {of_pulse[kept].max()}; its sequence has "
            f"{len(pulses)} pulses, counted from 0."
        )
    if not kept.all():
        samples, vectors = samples[kept], vectors[kept]
    return Echoes(
        channel=channel,
        samples=scaled_samples(path, samples, vectors),
        vectors=vectors,
        pulses=pulses[vectors["TxPulseIndex"]],
        rate=positive_number(path, described, "Fs"),
        noise_power=number_in(path, described, "PNCRSD") / positive_number(path, described, "BNCRSD"),
        point=np.array([number_in(path, point, name) for name in "XYZ"]),
    )


def _chirp(path: Path, echoes: Echoes) -> dict[str, Any]:
    """Fields of a sensor that describe the chirps, which are those of all pulses.

    Raises:
        UserError: pulses differ in their waveform.
    """
    rate, duration, carrier = (np.asarray(echoes.pulses[name], np.float64) for name in ("FxRate", "TXmt", "FxFreq0"))
    lasts = echoes.samples.shape[1] / echoes.rate
    phase = np.ptp(rate) * duration.max() ** 2 / 8 + np.ptp(duration) * np.abs(rate).max() * duration.max() / 4
    same_phase = 1e-3  # cycles by which the phases of pulses of one waveform may differ
    if phase + np.ptp(carrier) * lasts / 2 > same_phase:
        raise UserError(
            f"File {path} has pulses of different waveforms: carriers from {carrier.min():.9g} to {carrier.max():.9g} "
            f"Hz, rates from {rate.min():.6g} to {rate.max():.6g} Hz/s and durations from {duration.min():.6g} to "
            f"{duration.max():.6g} s; pulses of one waveform are read."
        )
    return {
        "wavelength": speed_of_light / float(carrier[0]),
        "bandwidth": float(abs(rate[0]) * duration[0]),
        "sample_count": echoes.samples.shape[1],
        "waveform": "chirp",
        "chirp_rate": float(rate[0]),
        "pulse_duration": float(duration[0]),
        "sampling_rate": echoes.rate,
    }


def _with_beams(sensor: Sensor, beams: Sequence[Beam], noise_power: tuple[float, ...]) -> Sensor:
    """The sensor with a receiver for each beam, or the one that it has, and their noise powers."""
    if not beams:
        return replace(sensor, noise_power=noise_power, config_hash="")
    return replace(
        sensor,
        elevation_diameter=sensor.wavelength / max(beam.width for beam in beams),
        elevation_boresights=tuple(beam.boresight for beam in beams),
        pattern="table",
        beam_tables=tuple(beam.table for beam in beams),
        noise_power=noise_power,
        config_hash="",
    )


def _pulses(reference_ns: int, echoes: Echoes, origin: Origin) -> Pulses:
    """Times and antenna positions of the pulses, in the axes of the map.

    Files state where the receiver was at the first sample of a vector; here it moves on until the echo from the
    reference point arrives.

    Args:
        reference_ns: time from which the file counts, ns since 1970.
        echoes: echoes of the pulses.
        origin: origin of the map.
    """
    sent, start, point = echoes.pulses["TxTime"], echoes.vectors["RcvStart"], echoes.point
    transmitter, receiver = echoes.pulses["TxPos"], echoes.vectors["RcvPos"]
    outward = np.linalg.norm(transmitter - point, axis=-1)
    delay = (outward + np.linalg.norm(receiver - point, axis=-1)) / speed_of_light
    after_start = delay - (start["Int"] - sent["Int"]) - (start["Frac"] - sent["Frac"])
    receiver = receiver + after_start[:, None] * echoes.vectors["RcvVel"]
    half_way_ns = np.rint((sent["Frac"] + delay / 2) * 1e9).astype(np.int64)
    middle = (transmitter + receiver) / 2
    return Pulses(
        stamps_ns=reference_ns + sent["Int"].astype(np.int64) * 1_000_000_000 + half_way_ns,
        antenna=origin.from_space(middle),
        velocity=(echoes.pulses["TxVel"] + echoes.vectors["RcvVel"]) / 2 @ origin.axes.T,
        reference=np.broadcast_to(origin.from_space(point), middle.shape),
        reference_range=(outward + np.linalg.norm(receiver - point, axis=-1)) / 2,
    )


def _window(path: Path, echoes: Echoes, pulses: Pulses) -> float:
    """Slant range around the reference point from which whole echoes are in all vectors, m.

    Raises:
        UserError: no range has whole echoes in all vectors.
    """
    lasts = echoes.samples.shape[1] / echoes.rate - float(echoes.pulses["TXmt"][0])
    off = float(np.abs(speed_of_light / 2 * echoes.middle_delay - pulses.reference_range).max())
    if (window := speed_of_light / 2 * lasts - 2 * off) <= 0:
        raise UserError(
            f"File {path} has vectors whose middle is up to {off:.6g} m in slant range off the reference point of the "
            f"channel (RcvRefPoint); whole echoes are in them from up to {max(speed_of_light / 4 * lasts, 0):.6g} m."
        )
    return window


def _chirps(echoes: Echoes) -> C64:
    """The echoes as the waveform "chirp" has them, see sal_height_msgs/ChannelFrame.

    With the time t after the middle of the pulse, the transmitted signal is exp(j 2 pi (PhiX0 + FxFreq0 t + FxRate t^2
    / 2)), and that of the receiver, by which echoes are brought to baseband, exp(j 2 pi (RefPhi0 + RefFreq t')) at the
    time t' after the first sample. An echo of the delay d is brought from this to s(t - d) exp(-j 2 pi FxFreq0 (d -
    d_m)), d_m being that of the middle of the vector.
    """
    count, vectors, pulses = echoes.samples.shape[1], echoes.vectors, echoes.pulses
    after_middle = (np.arange(count) - (count - 1) / 2) / echoes.rate
    phase = pulses["PhiX0"]["Frac"] - vectors["RefPhi0"]["Frac"] + vectors["RefFreq"] * after_middle[0]
    offset = np.asarray(pulses["FxFreq0"] - vectors["RefFreq"], dtype=np.float64)
    chirps = echoes.samples * outer_phasors(-2 * np.pi * offset, after_middle)
    chirps *= np.exp(-2j * np.pi * phase).astype(np.complex64)[:, None]
    return np.asarray(chirps, dtype=np.complex64)


def _referred(spectra: C64, sensor: Sensor, echoes: Echoes, pulses: Pulses) -> C64:
    """Spectra whose phase refers to the middle of the vectors, referred to the reference point, in place.

    Args:
        spectra: spectra of the echoes, complex64, shape (channels, pulses, frequencies).
        sensor: sensor that describes the spectra.
        echoes: echoes of the spectra.
        pulses: pulses with the range of the reference point.
    """
    frequencies = speed_of_light / sensor.wavelength + sensor.frequency_step * (
        np.arange(sensor.sample_count) - (sensor.sample_count - 1) / 2
    )
    late = echoes.middle_delay - 2 * pulses.reference_range / speed_of_light
    spectra *= outer_phasors(-2 * np.pi * late, frequencies)
    return spectra
