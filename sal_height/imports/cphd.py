"""Compensated phase history data (CPHD, NGA.STND.0068) of one channel becomes a bag of one dwell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import speed_of_light

from sal_height.errors import UserError
from sal_height.geometry import Origin
from sal_height.imports.collection import write_collection
from sal_height.imports.common_frequencies import Spectrum, from_arrival_times, from_frequencies
from sal_height.imports.followed_point import Pulses, collection_of, following_sensor
from sal_height.imports.sarkit_files import (
    check_parameters,
    check_single,
    chosen_channel,
    first_word,
    heard,
    opened,
    origin_of,
    scaled_samples,
    time_ns,
)
from sal_height.numeric import C64

GEOMETRY = ("TxTime", "TxPos", "TxVel", "RcvTime", "RcvPos", "RcvVel", "SRPPos", "SC0", "SCSS")
"""Parameters of each pulse that are read; AmpSF and SIGNAL if they are there."""

NEEDED = {"FX": GEOMETRY, "TOA": (*GEOMETRY, "FX1", "FX2")}
"""Parameters that are read of samples over frequency, and of those over time of arrival."""


def import_cphd(path: Path, out: Path, channel: str = "") -> int:
    """Write a bag with a channel of a CPHD file as one dwell; returns the number of pulses.

    The map's origin is the image area reference point, with heights above WGS 84. The antenna is as wide as the pulses
    sample, its boresight turned to the stabilisation reference point. The bag has the parameters that focus the scene.

    Args:
        path: CPHD 1 file, domain FX or TOA, of one platform.
        out: folder of the bag, new or empty.
        channel: identifier of the channel; empty: the reference channel.

    Raises:
        UserError: the package sarkit is not installed, the file cannot be read, or the bag cannot be written.
    """
    _check_version(path)
    with opened(path, "cphd") as reader:
        tree = reader.metadata.xmltree
        _check_kind(path, tree)
        there = [one.text or "" for one in tree.findall("{*}Data/{*}Channel/{*}Identifier")]
        chosen = chosen_channel(path, there, tree.findtext("{*}Channel/{*}RefChId"), channel)
        samples, parameters = reader.read_channel(chosen)
    domain = tree.findtext("{*}Global/{*}DomainType")
    samples, parameters = _with_signal(path, samples, parameters, NEEDED[domain])
    origin = origin_of(path, tree)
    spectrum = _spectrum(domain, _with_negative_sign(tree, scaled_samples(path, samples, parameters)), parameters)
    pulses = _pulses(time_ns(path, tree, "Global", "Timeline", "CollectionStart"), parameters, origin)
    window = speed_of_light / (2 * spectrum.step)
    name = tree.findtext("{*}CollectionID/{*}CoreName") or "cphd"
    fast_time = {
        "wavelength": speed_of_light / spectrum.middle,
        "bandwidth": spectrum.count * spectrum.step,
        "sample_count": spectrum.count,
    }
    sensor = following_sensor(f"{name} {chosen}", pulses, fast_time, window)
    write_collection(collection_of(pulses, spectrum.samples[None], sensor, origin, window), out)
    return len(pulses.antenna)


def _check_version(path: Path) -> None:
    """Check that a file is CPHD of a version that is known.

    Raises:
        UserError: it is not.
    """
    kind, version = first_word(path)
    if kind != "CPHD":
        raise UserError(f"File {path} is not CPHD: it does not begin with the word CPHD/ and a version.")
    if not version.startswith("1."):
        raise UserError(f"File {path} is CPHD of version {version}; versions 1.0 and 1.1 are read.")


def _check_kind(path: Path, tree: Any) -> None:
    """Check that the phase history is of a known domain and sign, of one collection, and of one platform.

    Raises:
        UserError: it is not.
    """
    check_single(path, tree, "CollectionID")
    domain = tree.findtext("{*}Global/{*}DomainType")
    if domain not in NEEDED:
        raise UserError(
            f"File {path} has phase history in the domain {domain}; FX (fast-time frequencies) and TOA (time of "
            "arrival) are read."
        )
    if (kind := tree.findtext("{*}CollectionID/{*}CollectType")) not in {"MONOSTATIC", None}:
        raise UserError(f"File {path} is of the type {kind}; collections of one platform (MONOSTATIC) are read.")
    if tree.findtext("{*}Global/{*}SGN") not in {"-1", "+1", "1"}:
        raise UserError(
            f"File {path} has the sign {tree.findtext('{*}Global/{*}SGN')} (Global/SGN); it must be -1 or +1."
        )
    if (compression := tree.findtext("{*}Data/{*}SignalCompressionID")) is not None:
        raise UserError(f"File {path} has compressed samples ({compression}); samples without compression are read.")


def _with_signal(path: Path, samples: Any, parameters: Any, needed: tuple[str, ...]) -> tuple[Any, Any]:
    """Samples and parameters of the pulses that have a signal.

    Raises:
        UserError: parameters are missing or not finite, or there are fewer than two pulses.
    """
    kept = heard(parameters)
    if not kept.all():
        samples, parameters = samples[kept], parameters[kept]
    if min(samples.shape) < 2:
        raise UserError(
            f"File {path} has {samples.shape[0]} pulses with a signal, of {samples.shape[1]} samples; two or more of "
            "each are needed."
        )
    check_parameters(path, parameters, needed, "PVP")
    if not np.all(parameters["SCSS"] > 0):
        raise UserError(f"File {path} has steps between samples (SCSS) that are not greater than 0.")
    return samples, parameters


def _with_negative_sign(tree: Any, samples: C64) -> C64:
    """Samples whose phase falls with the delay (SGN of -1): as they are, or conjugated in place."""
    if int(tree.findtext("{*}Global/{*}SGN")) > 0:
        np.conj(samples, out=samples)
    return samples


def _spectrum(domain: str, samples: C64, parameters: Any) -> Spectrum:
    """Samples over the frequencies that all pulses have.

    Raises:
        UserError: there are fewer than two.
    """
    first, step = (np.asarray(parameters[name], dtype=np.float64) for name in ("SC0", "SCSS"))
    if domain == "FX":
        return from_frequencies(samples, first, step)
    band = np.array([parameters["FX1"], parameters["FX2"]], dtype=np.float64)
    return from_arrival_times(samples, first, step, band)


def _pulses(start_ns: int, parameters: Any, origin: Origin) -> Pulses:
    """Times and antenna positions of the pulses, in the axes of the map.

    Args:
        start_ns: start of the collection, ns since 1970.
        parameters: parameters of the pulses.
        origin: origin of the map.
    """
    transmitter, receiver, reference = (parameters[name] for name in ("TxPos", "RcvPos", "SRPPos"))
    way = np.linalg.norm(transmitter - reference, axis=-1) + np.linalg.norm(receiver - reference, axis=-1)
    seconds = (parameters["TxTime"] + parameters["RcvTime"]) / 2
    return Pulses(
        stamps_ns=start_ns + np.rint(seconds * 1e9).astype(np.int64),
        antenna=origin.from_space((transmitter + receiver) / 2),
        velocity=(parameters["TxVel"] + parameters["RcvVel"]) / 2 @ origin.axes.T,
        reference=origin.from_space(reference),
        reference_range=way / 2,
    )
