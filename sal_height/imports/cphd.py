"""Compensated phase history data (CPHD, NGA.STND.0068) of one channel becomes a bag of one dwell."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import speed_of_light

from sal_height.errors import UserError
from sal_height.geometry import Origin
from sal_height.imports.collection import Collection, write_collection
from sal_height.imports.receiver import boresight_to, focusing, side_of, states_towards
from sal_height.numeric import C64, F64
from sal_height.sensor import PhaseHistory, Sensor

NEEDED = ("TxTime", "TxPos", "TxVel", "RcvTime", "RcvPos", "RcvVel", "SRPPos", "SC0", "SCSS")
"""Parameters of each pulse that are read; AmpSF and SIGNAL if they are there."""

SAME_FREQUENCY = 1e-3
"""Cycles of phase by which frequencies of pulses may differ at the edge of the swath before they are interpolated."""

WIDEST_BEAM = 0.1
"""Greatest beamwidth in the sensor info, rad. Files need not state the antenna; it is as wide as pulses sample."""

STEPS_IN_ANTENNA = 2.1
"""Length of the antenna over the distance between pulses, along the track; below 2, they do not sample its beam."""

SHARE_OF_WINDOW = 0.2
"""Slant range that the beam meets on level ground, in beamwidths, over that which frequencies tell apart."""

OVERSAMPLED = 1.2
"""Resolution of the image over the spacing of its pixels."""

LARGEST_SIDE = 2000.0
"""Greatest side of the square that is imaged, m."""


@dataclass(frozen=True, eq=False)
class Pulses:
    """The pulses of a channel, in the axes of the map.

    Attributes:
        seconds: times at which the echo from the reference point was half-way, s after the begin of the collection.
        antenna: positions half-way between transmitter and receiver, m, shape (pulses, 3).
        velocity: the same, m/s.
        reference: stabilisation reference points, m, shape (pulses, 3).
        reference_range: half the way from the transmitter over that point to the receiver, m, shape (pulses,).
        first_frequency: of the samples, Hz, shape (pulses,).
        step: between the samples, Hz, shape (pulses,).
        samples: complex64, shape (pulses, samples), with the phase -2 pi f (delay - that of the reference point).
    """

    seconds: F64
    antenna: F64
    velocity: F64
    reference: F64
    reference_range: F64
    first_frequency: F64
    step: F64
    samples: C64


def import_cphd(path: Path, out: Path, channel: str = "") -> int:
    """Write a bag with a channel of a CPHD file as one dwell; returns the number of pulses.

    The map's origin is the image area reference point, with heights above WGS 84. The antenna is as wide as the pulses
    sample, its boresight turned to the stabilisation reference point. The bag has the parameters that focus the scene.

    Args:
        path: of the file: CPHD 1, domain FX, one platform.
        out: folder of the bag, new or empty.
        channel: its identifier; empty: the reference channel.

    Raises:
        UserError: the package sarkit is not installed, the file is none that can be read, or the bag cannot be written.
    """
    cphd = _sarkit(path)
    _check_version(path)
    try:
        with path.open("rb") as file, cphd.Reader(file) as reader:
            tree = reader.metadata.xmltree
            _check_kind(path, tree)
            chosen = _channel(path, tree, channel)
            samples, parameters = reader.read_channel(chosen)
    except UserError:
        raise
    except Exception as error:  # lxml, numpy and sarkit each have their own for a damaged file
        said = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"File {path} is not a readable CPHD file: {said}.") from error
    origin = _origin(path, tree)
    pulses = _evened(_pulses(path, tree, samples, parameters, origin))
    sensor = _sensor(tree, chosen, pulses)
    start_ns = _start_ns(path, tree)
    stamps = start_ns + np.rint(pulses.seconds * 1e9).astype(np.int64)
    states = states_towards(stamps, pulses.antenna, pulses.velocity, pulses.reference, sensor.look_side)
    times = (stamps - stamps[0]) * 1e-9
    history = PhaseHistory(int(stamps[0]), times, pulses.reference_range, pulses.samples[None])
    write_collection(Collection(sensor, [history], states, origin, _image(sensor, pulses)), out)
    return len(times)


def _check_version(path: Path) -> None:
    """Check that a file is CPHD of a version that is known.

    Raises:
        UserError: it is not.
    """
    try:
        with path.open("rb") as file:
            first = file.readline(64)
    except OSError as error:
        raise UserError(f"File {path} cannot be read: {error.strerror}.") from error
    if not first.startswith(b"CPHD/"):
        raise UserError(f"File {path} is not CPHD: it does not begin with the word CPHD/ and a version.")
    if not first.startswith(b"CPHD/1."):
        version = first[5:].strip().decode("ascii", "replace")
        raise UserError(f"File {path} is CPHD of version {version}; versions 1.0 and 1.1 are read.")


def _check_kind(path: Path, tree: Any) -> None:
    """Check that the phase history is of frequencies, and of one platform.

    Raises:
        UserError: it is not.
    """
    domain = tree.findtext("{*}Global/{*}DomainType")
    if domain != "FX":
        raise UserError(
            f"File {path} has phase history in the domain {domain}; FX (fast-time frequencies) is read; transform it "
            "with the software of its maker."
        )
    if (kind := tree.findtext("{*}CollectionID/{*}CollectType")) not in {"MONOSTATIC", None}:
        raise UserError(f"File {path} is of the type {kind}; collections of one platform (MONOSTATIC) are read.")
    if tree.findtext("{*}Global/{*}SGN") not in {"-1", "+1", "1"}:
        raise UserError(
            f"File {path} has the sign {tree.findtext('{*}Global/{*}SGN')} (Global/SGN); it must be -1 or +1."
        )


def _channel(path: Path, tree: Any, wanted: str) -> str:
    """The identifier of the channel that is read.

    Raises:
        UserError: there is none of that name.
    """
    there = [one.text for one in tree.findall("{*}Data/{*}Channel/{*}Identifier")]
    chosen = wanted or tree.findtext("{*}Channel/{*}RefChId") or (there[0] if there else "")
    if chosen not in there:
        raise UserError(f"File {path} has no channel {chosen!r}; there are {', '.join(map(str, there)) or 'none'}.")
    return chosen


def _origin(path: Path, tree: Any) -> Origin:
    """The image area reference point.

    Raises:
        UserError: it is missing.
    """
    place = [tree.findtext(f"{{*}}SceneCoordinates/{{*}}IARP/{{*}}LLH/{{*}}{name}") for name in ("Lat", "Lon", "HAE")]
    try:
        latitude, longitude, height = (float(number) for number in place)
    except (TypeError, ValueError) as error:
        raise UserError(f"File {path} has no image area reference point (SceneCoordinates/IARP/LLH).") from error
    return Origin(math.radians(latitude), math.radians(longitude), height)


def _start_ns(path: Path, tree: Any) -> int:
    """Begin of the collection, ns since 1970.

    Raises:
        UserError: it is missing.
    """
    text = tree.findtext("{*}Global/{*}Timeline/{*}CollectionStart") or ""
    try:
        begin = datetime.fromisoformat(text)
    except ValueError as error:
        raise UserError(f"File {path} has {text!r} for CollectionStart, which is no time.") from error
    since = (begin if begin.tzinfo else begin.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000


def _pulses(path: Path, tree: Any, samples: Any, parameters: Any, origin: Origin) -> Pulses:
    """The pulses of a channel, those without signal left out.

    Raises:
        UserError: parameters are missing or not finite, or there are fewer than two pulses.
    """
    names = parameters.dtype.names
    if missing := [name for name in NEEDED if name not in names]:
        raise UserError(f"File {path} lacks {', '.join(missing)} among the parameters of its pulses (PVP).")
    heard = parameters["SIGNAL"] > 0 if "SIGNAL" in names else np.ones(len(parameters), np.bool_)
    if not heard.all():
        samples, parameters = samples[heard], parameters[heard]
    if len(parameters) < 2 or samples.shape[1] < 2:
        raise UserError(f"File {path} has {len(parameters)} pulses with a signal; two or more are needed.")
    for name in NEEDED:
        if not np.all(np.isfinite(parameters[name])):
            raise UserError(f"File {path} has values of {name} among the parameters of its pulses that are not finite.")
    if not np.all(parameters["SCSS"] > 0):
        raise UserError(f"File {path} has steps of frequency (SCSS) that are not greater than 0.")
    if samples.dtype.names:  # whole numbers
        samples = samples["real"] + 1j * samples["imag"].astype(np.float32)
    if "AmpSF" in names:
        samples = samples.astype(np.complex64, copy=False) * parameters["AmpSF"].astype(np.float32)[:, None]
    sign = int(tree.findtext("{*}Global/{*}SGN"))
    samples = np.ascontiguousarray(samples if sign < 0 else np.conj(samples), dtype=np.complex64)
    transmitter, receiver, reference = (parameters[name] for name in ("TxPos", "RcvPos", "SRPPos"))
    way = np.linalg.norm(transmitter - reference, axis=-1) + np.linalg.norm(receiver - reference, axis=-1)
    turn = origin.axes
    return Pulses(
        seconds=(parameters["TxTime"] + parameters["RcvTime"]) / 2,
        antenna=origin.from_space((transmitter + receiver) / 2),
        velocity=(parameters["TxVel"] + parameters["RcvVel"]) / 2 @ turn.T,
        reference=origin.from_space(reference),
        reference_range=way / 2,
        first_frequency=np.asarray(parameters["SC0"], dtype=np.float64),
        step=np.asarray(parameters["SCSS"], dtype=np.float64),
        samples=samples,
    )


def _evened(pulses: Pulses) -> Pulses:
    """The pulses with the same frequencies: the samples where they are, or interpolated to those that all have.

    Samples of a pulse are values of a trigonometric polynomial, which is evaluated at other frequencies by a chirp-z
    transform (Rabiner, Schafer and Rader, Bell Syst. Tech. J. 48, 1969).
    """
    from scipy.signal import czt  # noqa: PLC0415 (brings scipy.stats)

    count = pulses.samples.shape[1]
    step, first = float(pulses.step.max()), float(pulses.first_frequency.max())
    last = float((pulses.first_frequency + (count - 1) * pulses.step).min())
    # Delays reach to half of what the samples of a pulse tell apart.
    off = np.abs(pulses.first_frequency - first).max() + (count - 1) * np.abs(pulses.step - step).max()
    if off / (2 * step) <= SAME_FREQUENCY:
        return pulses
    kept = int((last - first) / step * (1 + 1e-12)) + 1
    evened = np.empty((len(pulses.samples), kept), np.complex64)
    for number, spectrum in enumerate(np.fft.fft(pulses.samples.astype(np.complex128), axis=-1)):
        begin = (first - pulses.first_frequency[number]) / pulses.step[number]
        each = step / pulses.step[number]
        delays = np.fft.fftshift(spectrum) / count
        lowest = -(count // 2)
        turned = delays * np.exp(2j * np.pi * (lowest + np.arange(count)) * begin / count)
        values = czt(turned, m=kept, w=np.exp(2j * np.pi * each / count), a=1.0)
        evened[number] = values * np.exp(2j * np.pi * lowest * each * np.arange(kept) / count)
    same = np.ones(len(evened))
    return replace(pulses, first_frequency=first * same, step=step * same, samples=evened)


def _sensor(tree: Any, channel: str, pulses: Pulses) -> Sensor:
    """One receiver with its boresight on the reference point, seen from the middle of the track."""
    middle, count = len(pulses.seconds) // 2, pulses.samples.shape[1]
    step = float(pulses.step.mean())
    wavelength = speed_of_light / (float(pulses.first_frequency.mean()) + (count - 1) / 2 * step)
    antenna, reference = pulses.antenna[middle], pulses.reference[middle]
    elevation = boresight_to(antenna, reference)
    pulse_step = float(np.linalg.norm(pulses.antenna[-1] - pulses.antenna[0])) / (len(pulses.seconds) - 1)
    along = min(wavelength / (STEPS_IN_ANTENNA * pulse_step), WIDEST_BEAM)
    window = speed_of_light / (2 * step)
    upwards = min(SHARE_OF_WINDOW * window / (float(pulses.reference_range[middle]) * math.tan(elevation)), WIDEST_BEAM)
    name = tree.findtext("{*}CollectionID/{*}CoreName") or "cphd"
    return Sensor(
        name=f"{name} {channel}",
        look_side=side_of(antenna, pulses.velocity[middle], reference),
        wavelength=wavelength,
        bandwidth=step * count,
        sample_count=count,
        pulse_count=len(pulses.seconds),
        pulse_repetition_frequency=(len(pulses.seconds) - 1) / float(pulses.seconds[-1] - pulses.seconds[0]),
        elevation_diameter=wavelength / upwards,
        azimuth_diameter=wavelength / along,
        pattern="sinc",
        elevation_boresights=(elevation,),
        noise_power=(0.0,),
    )


def _image(sensor: Sensor, pulses: Pulses) -> dict[str, dict[str, Any]]:
    """Parameters that focus what the frequencies tell apart on the ground."""
    middle = len(pulses.seconds) // 2
    range_ = float(pulses.reference_range[middle])
    slope = math.sin(sensor.elevation_boresights[0])
    side = min(speed_of_light / (2 * float(pulses.step.mean())) / slope / 2, LARGEST_SIDE)
    resolution = speed_of_light / (2 * sensor.bandwidth) / slope
    return focusing(sensor, pulses.antenna, range_, side, resolution / OVERSAMPLED)


def _sarkit(path: Path) -> Any:
    """Return the part of the package for CPHD, which is an extra.

    Raises:
        UserError: it is not installed.
    """
    try:
        from sarkit import cphd  # noqa: PLC0415 (an extra)
    except ImportError as error:
        raise UserError(f"Reading {path} needs sarkit; install it with: pip install 'sal_height[formats]'.") from error
    return cphd
