"""Compensated phase history data (CPHD, NGA.STND.0068) of one channel becomes a bag of one dwell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import fft
from scipy.constants import speed_of_light

from sal_height.errors import UserError
from sal_height.geometry import Origin
from sal_height.imaging import UNKNOWN_AIR, VACUUM
from sal_height.imports.collection import write_collection
from sal_height.imports.followed_point import Pulses, collection_of, following_sensor
from sal_height.imports.sarkit_files import (
    check_parameters,
    check_plain,
    check_single,
    chosen_channel,
    first_word,
    has_signal,
    opened,
    origin_of,
    scaled_samples,
    time_ns,
)
from sal_height.numeric import C64, F64, blocks, chirp_z, outer_phasors

GEOMETRY = ("TxTime", "TxPos", "TxVel", "RcvTime", "RcvPos", "RcvVel", "SRPPos", "SC0", "SCSS")
"""Parameters of each pulse that are read; AmpSF and SIGNAL if they are there."""

NEEDED = {"FX": GEOMETRY, "TOA": (*GEOMETRY, "FX1", "FX2")}
"""Parameters that are read of samples over frequency, and of those over time of arrival."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Samples over frequency: a point of amplitude A whose echo is late by d contributes A exp(-j 2 pi f d).

    Attributes:
        samples: samples over frequency, complex64, shape (pulses, frequencies).
        first: frequency of the first sample, Hz.
        step: frequency step between samples, Hz.
    """

    samples: C64
    first: float
    step: float

    @property
    def count(self) -> int:
        """Number of frequencies."""
        return int(self.samples.shape[1])

    @property
    def middle(self) -> float:
        """The frequency in the middle, Hz."""
        return self.first + (self.count - 1) / 2 * self.step


def from_frequencies(samples: C64, first: F64, step: F64) -> Spectrum:
    """Samples at the frequencies that all pulses have: as they are, or interpolated where pulses differ.

    The samples of a pulse are values of a trigonometric polynomial, whose coefficients are echoes at as many delays.

    Args:
        samples: samples of the pulses, complex64, shape (pulses, samples).
        first: frequency of the first sample of each pulse, Hz, shape (pulses,).
        step: frequency step between its samples, Hz, shape (pulses,).

    Raises:
        UserError: the pulses have fewer than two frequencies in common.
    """
    count = samples.shape[1]
    widest, highest = float(step.max()), float(first.max())
    # Delays reach to half of the unambiguous delay of a pulse's samples.
    off = np.abs(first - highest).max() + (count - 1) * np.abs(step - widest).max()
    # Cycles of phase by which frequencies of pulses may differ at the edge of the swath before they are
    # interpolated.
    same_frequency = 1e-3
    if off / (2 * widest) <= same_frequency:
        return Spectrum(samples, highest, widest)
    last = float((first + (count - 1) * step).min())
    kept = int((last - highest) / widest * (1 + 1e-12)) + 1
    _check_common(kept, highest, last)
    spacing = 1 / (count * step)
    delays = fft.fftshift(fft.ifft(samples), axes=-1)
    return Spectrum(_at(delays, -(count // 2) * spacing, spacing, highest - first, widest, kept), highest, widest)


def from_arrival_times(samples: C64, first: F64, step: F64, band: F64) -> Spectrum:
    """Samples over frequency of samples over the time of arrival.

    With the middle f_C of the band, a point of amplitude A whose echo is late by d has a main lobe at the time d with
    the peak A exp(-j 2 pi f_C d) (NGA.STND.0068, Global/SGN of -1), which is the mean of its spectrum over the band,
    A exp(-j 2 pi f d), times exp(j 2 pi (f - f_C) t). The inverse is B times the sum over the samples of
    s(t) exp(-j 2 pi (f - f_C) t) times their spacing, B being the width of the band.

    Args:
        samples: samples of the pulses, complex64, shape (pulses, samples).
        first: time of the first sample of each pulse after the echo from the reference point, s, shape (pulses,).
        step: time between its samples, s, shape (pulses,).
        band: least and greatest frequency of each pulse, Hz, shape (2, pulses).

    Returns:
        The samples at the frequencies that all pulses have, with the largest step that keeps all times unambiguous.

    Raises:
        UserError: the pulses have fewer than two of these frequencies in common.
    """
    low, high = float(band[0].max()), float(band[1].min())
    reach = float(np.maximum(np.abs(first), np.abs(first + samples.shape[1] * step)).max())
    spacing = 1 / (2 * reach)
    kept = int(max(high - low, 0.0) / spacing * (1 + 1e-9))
    _check_common(kept, low, high)
    begin = (low + high) / 2 - (kept - 1) / 2 * spacing
    sums = _at(samples, first, step, begin - band.mean(axis=0), spacing, kept)
    sums *= ((band[1] - band[0]) * step).astype(np.float32)[:, None]
    return Spectrum(sums, begin, spacing)


def _check_common(count: int, low: float, high: float) -> None:
    """Check that pulses have frequencies in common.

    Raises:
        UserError: they have fewer than two.
    """
    if count < 2:
        raise UserError(
            f"The pulses of the file have {max(count, 0)} frequencies in common, from {low:.6g} to {high:.6g} Hz; two "
            "or more are needed."
        )


def _at(samples: C64, first: F64, spacing: F64, offset: F64, step: float, count: int) -> C64:
    """The sums of samples at the delays t, s, times exp(-j 2 pi f t), at `count` frequencies f.

    Args:
        samples: samples of the pulses, complex64, shape (pulses, samples).
        first: first delay of each pulse, s, shape (pulses,).
        spacing: spacing of its delays, s, shape (pulses,).
        offset: first frequency of each pulse, Hz, shape (pulses,).
        step: step between frequencies, Hz.
        count: number of frequencies.
    """
    inputs = samples.shape[1]
    result = np.empty((len(samples), count), np.complex64)
    places, frequencies = np.arange(inputs, dtype=np.float64), step * np.arange(count, dtype=np.float64)
    pulses_at_once = 256  # pulses transformed at a time, so that the factors of the transforms stay small
    for pulses in blocks(len(samples), pulses_at_once):
        ramps = outer_phasors(-2 * np.pi * offset[pulses] * spacing[pulses], places)
        sums = chirp_z(-2 * np.pi * step * spacing[pulses], inputs, 0.0, count, 0.0).times(ramps)
        sums.fill_rows(np.ascontiguousarray(samples[pulses]), result[pulses])
        result[pulses] *= outer_phasors(-2 * np.pi * first[pulses], frequencies)
        result[pulses] *= np.exp(-2j * np.pi * first[pulses] * offset[pulses])[:, None]
    return result


def import_cphd(path: Path, out: Path, channel: str = "") -> int:
    """Write a bag with a channel of a CPHD file as one dwell; returns the number of pulses.

    The map's origin is the image area reference point, with heights above WGS 84. The antenna is as wide as the pulses
    sample, its boresight turned to the stabilisation reference point. The bag has the parameters that focus the scene,
    in vacuum if the ranges to that point contain the delay of the air (TDTropoSRP); otherwise that is uncertain.

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
    is_corrected = "TDTropoSRP" in parameters.dtype.names and np.any(parameters["TDTropoSRP"])
    air = VACUUM if is_corrected else UNKNOWN_AIR
    write_collection(collection_of(pulses, spectrum.samples[None], sensor, origin, window, air), out)
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
    kind = tree.findtext("{*}CollectionID/{*}CollectType", "MONOSTATIC")
    check_plain(path, kind, tree.findtext("{*}Data/{*}SignalCompressionID"))
    if tree.findtext("{*}Global/{*}SGN") not in {"-1", "+1", "1"}:
        raise UserError(
            f"File {path} has the sign {tree.findtext('{*}Global/{*}SGN')} (Global/SGN); it must be -1 or +1."
        )


def _with_signal(path: Path, samples: Any, parameters: Any, needed: tuple[str, ...]) -> tuple[Any, Any]:
    """Samples and parameters of the pulses that have a signal.

    Raises:
        UserError: parameters are missing or not finite, or there are fewer than two pulses.
    """
    kept = has_signal(parameters)
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
