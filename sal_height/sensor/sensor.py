"""The sensor: the description that is needed to process its frames, its receivers, and the phase history of a dwell."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy.constants import speed_of_light

from sal_height.beams import Beams, BeamTable, detector_pattern, tabulated_pattern
from sal_height.errors import UserError
from sal_height.geometry import AT_BASE_LINK, Mounting
from sal_height.numeric import C64, C128, F64, Bool, ShortRepr
from sal_height.sensor.uncertainty import NOTHING_STATED, SensorUncertainty

NUFFT_TOLERANCE = 1e-7
"""Relative error of the non-uniform FFTs: less than the rounding of complex64 samples."""

MAX_SHARE = 8e-4
"""Greatest fraction of clipped real and imaginary parts: the distortion of Gaussian samples is then -40 dB.

By Bussgang's theorem, which the tests evaluate."""

MAX_DETECTORS = 128
"""Greatest number of detectors: estimators keep M x M numbers per pixel and direction."""

MODES = ("spotlight", "stripmap")
"""Steering of the antenna: pointed at the scene during a dwell, or fixed to the body."""

WAVEFORMS = ("spectrum", "chirp", "deramped")
"""Kinds of fast-time samples: frequencies, the echo of a linear FM pulse, or that echo mixed with a replica."""


def lit_angle(beams: Beams) -> float:
    """Return the angle along the flight, to each side of the middle of all beams, that main lobes illuminate, rad.

    It is the half-width of the widest main lobe and the `look_ahead_angle`. The pulse repetition frequency that presets
    require samples the Doppler of this angle; echoes from beyond would appear as ambiguities.
    """
    return max(pattern.main_lobe for pattern in beams.patterns) * beams.track_beamwidth + look_ahead_angle(beams)


def lit_doppler(sensor: Sensor, speed: float) -> float:
    """Return the band of Doppler frequencies (Hz) of the main lobes at a speed (m/s); pulses must sample it."""
    return 4 * lit_angle(sensor.beams) * speed / sensor.wavelength


def look_ahead_angle(beams: Beams) -> float:
    """Return the angle by which the beams at the ends of a turned detector axis look ahead and back, rad.

    That is sin(psi) times half the length of the axis, which is turned by psi.
    """
    first, last = beams.span
    return (last - first) / 2 * abs(math.sin(beams.rotation))


def processed_angle(sensor: Sensor) -> float:
    """Return the angle over which a target is processed, rad.

    It is one beamwidth along the flight, for a resolution of half the antenna's size in that direction.
    """
    return sensor.beams.track_beamwidth


def aperture_length(sensor: Sensor, slant_range: float) -> float:
    """Return the length of the synthetic aperture of a target at `slant_range` (m), in m."""
    return processed_angle(sensor) * slant_range


def clipped(samples: C64, full_scale: float) -> C64:
    """Clip the real and imaginary parts of samples at `full_scale`; return them unchanged if it is not known (0)."""
    if not full_scale:
        return samples
    limit = np.float32(full_scale)
    return np.clip(np.ascontiguousarray(samples).view(np.float32), -limit, limit).view(np.complex64)


def saturated_shares(samples: C64, sensor: Sensor) -> F64:
    """Fraction of real and imaginary parts at or beyond full scale in the receivers of each channel, shape (channels,).

    With receivers before the channel matrix, that is inverted first; a channel has the greatest fraction of its
    receivers. NaN where the full scale is not known.

    Args:
        samples: samples of all channels as the sensor delivers them, shape (channels, pulses, samples).
        sensor: sensor that delivers them.
    """
    if not sensor.full_scale:
        return np.full(len(samples), np.nan)
    # A clipped number has this relative error after a channel matrix was inverted in single precision.
    limit = np.float32(sensor.full_scale * (1 - 1e-5))
    if sensor.matrix_in_antenna or not sensor.channel_matrix:
        return _shares(samples, limit)
    receivers = np.tensordot(np.linalg.inv(sensor.mixing).astype(np.complex64), samples, axes=1)
    return np.max(_shares(receivers, limit) * (sensor.mixing != 0), axis=1)


def count_saturated(history: PhaseHistory, sensor: Sensor) -> PhaseHistory:
    """The phase history of a dwell, as the sensor delivers it, with its `saturated_share`."""
    shares = saturated_shares(history.samples, sensor)
    return replace(history, saturated_share=np.repeat(shares[:, None], len(history.pulse_times), axis=1))


def _shares(samples: C64, limit: np.float32) -> F64:
    parts = (np.ascontiguousarray(frame).view(np.float32) for frame in samples)
    return np.array([np.count_nonzero(np.abs(part) >= limit) / part.size for part in parts])


@dataclass(frozen=True)
class Sensor:
    """Description of a multi-detector sensor; the same content as sal_height_msgs/SensorInfo.

    Quantities derived from the fast-time frequencies (`frequency_step` to `range_window`) exist for waveform "spectrum"
    only, and are a ValueError for the others; `spectrum_sensor` gives the corresponding sensor.

    Raises:
        UserError: a value is out of its range.
    """

    name: str  # shown to users
    look_side: int  # +1 looking right of the flight direction, -1 left
    wavelength: float  # of the carrier, m
    bandwidth: float  # of the pulse; with waveform "spectrum", that spanned by the frequency samples, Hz
    sample_count: int  # fast-time samples in a pulse
    pulse_count: int  # pulses in a dwell
    pulse_repetition_frequency: float  # Hz
    elevation_diameter: float  # of the receive antenna along the detector axis, m
    azimuth_diameter: float  # of the receive antenna across the detector axis, m
    pattern: str  # name of the beam pattern that the antenna gives, or "table"
    elevation_boresights: tuple[float, ...]  # rad from nadir of the sensor frame, increasing, one per detector
    noise_power: tuple[float, ...]  # E|n|^2 of a phase-history sample, one per receiver; 0: unknown
    mode: str = "spotlight"  # one of MODES
    waveform: str = "spectrum"  # one of WAVEFORMS; the next three are 0 for "spectrum"
    chirp_rate: float = 0.0  # of the linear FM, Hz/s, negative for a falling one
    pulse_duration: float = 0.0  # of the linear FM, s
    sampling_rate: float = 0.0  # of the fast-time samples, Hz
    detector_size: tuple[float, float] = (0.0, 0.0)  # along and across the detector axis, beamwidths; 0: points
    # Angle of the detector axis, along which boresights are measured, from elevation towards the direction of flight,
    # in the plane across the line of sight, rad.
    detector_rotation: float = 0.0
    # With pattern "table", the measured beam of every detector, or the one common to all.
    beam_tables: tuple[BeamTable, ...] = ()
    # Channels from detectors: a row per channel, a column per detector; empty: identity. A diagonal matrix contains the
    # detectors' complex calibration constants; [[1, 1], [-1, 1]] / sqrt(2) is a lossless sum-difference hybrid (relief
    # paper, eqs. 2 and 3).
    channel_matrix: tuple[tuple[complex, ...], ...] = ()
    # Whether the channels are formed before the receivers, so that noise_power is of the channels; else it is of the
    # detectors, and the channels' noise is correlated (`noise_covariance`).
    matrix_in_antenna: bool = True
    full_scale: float = 0.0  # where receivers clip real and imaginary part, in the unit of the samples; 0: not known
    mounting: Mounting = AT_BASE_LINK  # position and attitude of the antenna on the platform
    # Uncertainty of the beams: rms error of the complex amplitude of each beam over its greatest one, in addition to
    # that of a calibration.
    beam_uncertainty: float = 0.0
    uncertainty: SensorUncertainty = NOTHING_STATED  # of the rest of the description, but for the mounting
    # Slant ranges (m) over which a channel does not receive: (channel, first range, last range).
    blanked_ranges: tuple[tuple[int, float, float], ...] = ()
    calibration_id: str = ""  # calibration already applied by the sensor; empty: none
    config_hash: str = ""  # identity; empty: the first 16 hexadecimal digits of the SHA-256 of the rest

    def __post_init__(self) -> None:
        longest = 256  # characters, as these texts are part of every product and of diagnostics
        for name in ("name", "calibration_id", "config_hash"):
            self._require(len(getattr(self, name)) <= longest, name, f"it must have {longest} characters or fewer")
        self._require(self.look_side in (-1, 1), "look_side", "allowed are +1 (right) and -1 (left)")
        for name, allowed in (("mode", MODES), ("waveform", WAVEFORMS)):
            self._require(getattr(self, name) in allowed, name, f"allowed are {', '.join(allowed)}")
        for name in ("wavelength", "bandwidth", "pulse_repetition_frequency", "elevation_diameter", "azimuth_diameter"):
            self._require(0 < getattr(self, name) < np.inf, name, "it must be finite and greater than 0")
        highest = 2 * speed_of_light / self.wavelength
        self._require(self.bandwidth < highest, "bandwidth", "in Hz, it must be less than twice the carrier frequency")
        for name in ("sample_count", "pulse_count"):
            self._require(getattr(self, name) >= 2, name, "it must be 2 or more")
        self._require(0 <= self.full_scale < np.inf, "full_scale", "it must be finite and 0 or more")
        self._require(0 <= self.beam_uncertainty < 1, "beam_uncertainty", "it must be 0 or more and less than 1")
        self._check_detectors()
        self._check_beams()
        self._check_channels()
        self._check_blanked_ranges()
        self._check_waveform()
        if not self.config_hash:
            object.__setattr__(self, "config_hash", _digest(asdict(self)))

    def __hash__(self) -> int:
        """Hash of the config_hash, which is equal for equal sensors; all fields would take too long for every dwell."""
        return hash(self.config_hash)

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        """Function and arguments that make the sensor in another process, as one object with one set of tables."""
        return _sensor_of, tuple(getattr(self, one.name) for one in fields(self))

    @property
    def digest(self) -> str:
        """The config_hash of the description without a given one, to compare two descriptions."""
        return replace(self, config_hash="").config_hash

    def _require(self, holds: bool, name: str, allowed: str) -> None:
        """Refuse the value of a field unless it `holds` what is `allowed`."""
        if not holds:
            raise UserError(f"Sensor {name} is {getattr(self, name)!r}; {allowed}.")

    def _check_detectors(self) -> None:
        count, boresights = self.detector_count, np.array(self.elevation_boresights)
        self._require(
            bool(count and boresights[0] > 0 and boresights[-1] < np.pi / 2 and np.all(np.diff(boresights) > 0)),
            "elevation_boresights",
            "it must be one or more increasing angles between 0 (nadir) and pi/2 rad",
        )
        if count > MAX_DETECTORS:
            raise UserError(f"Sensor has {count} detectors; at most {MAX_DETECTORS} are allowed.")
        self._require(
            len(self.noise_power) == count and all(0 <= power < np.inf for power in self.noise_power),
            "noise_power",
            f"it must be {count} finite numbers of 0 or more, one per detector",
        )

    def _check_beams(self) -> None:
        self._require(abs(self.detector_rotation) <= np.pi / 2, "detector_rotation", "allowed are -pi/2 to pi/2 rad")
        tables = len(self.beam_tables)
        if (self.pattern == "table") != bool(tables):
            raise UserError(
                f"Sensor pattern is {self.pattern!r} with {tables} beam tables; tables go with the pattern 'table' and "
                "with no other."
            )
        if tables not in (0, 1, self.detector_count):
            raise UserError(
                f"Sensor has {tables} beam tables for {self.detector_count} detectors; give one for each, or one for "
                "all."
            )
        self.beams.domain(0.0)  # refuses beams that do not overlap

    def _check_channels(self) -> None:
        if not self.channel_matrix:
            return
        count = self.detector_count
        if {len(self.channel_matrix), *map(len, self.channel_matrix)} != {count}:
            raise UserError(
                f"Sensor channel_matrix has rows of {[len(row) for row in self.channel_matrix]} entries; it must have "
                f"{count} of {count}, one row per channel and one column per detector, or none."
            )
        if not np.all(np.isfinite(self.mixing)):
            raise UserError("Sensor channel_matrix has NaN or infinite entries; all must be finite.")
        condition = np.linalg.cond(self.mixing)
        if not condition <= 1e6:  # beyond it, single-precision channels lose some beams to rounding
            raise UserError(
                f"Sensor channel_matrix has the condition number {condition:.3g}; to be inverted it must have 1e+06 or "
                "less."
            )

    def _check_blanked_ranges(self) -> None:
        for channel, first, last in self.blanked_ranges:
            if not (0 <= channel < self.detector_count and 0 <= first <= last < np.inf):
                raise UserError(
                    f"Sensor blanked_ranges has channel {channel} from {first:g} to {last:g} m; allowed are channels 0 "
                    f"to {self.detector_count - 1} and finite ranges of 0 or more in increasing order."
                )

    def _check_waveform(self) -> None:
        keys = ("chirp_rate", "pulse_duration", "sampling_rate")
        given = f"with waveform {self.waveform!r} it must be"
        if self.waveform == "spectrum":
            for name in keys:
                self._require(getattr(self, name) == 0, name, f"{given} 0")
            return
        rate, duration, sampling = abs(self.chirp_rate), self.pulse_duration, self.sampling_rate
        self._require(0 < rate < np.inf, "chirp_rate", f"{given} finite and not 0")
        for name in keys[1:]:
            self._require(0 < getattr(self, name) < np.inf, name, f"{given} finite and greater than 0")
        swept = rate * duration
        self._require(
            abs(swept / self.bandwidth - 1) <= 0.01,
            "bandwidth",
            f"it must be |chirp_rate| * pulse_duration = {swept:g} Hz within 1 %",
        )
        # A matched filter needs the band and two resolution cells next to the pulse; a deramped pulse, three samples
        # and the delays that its sampling rate resolves.
        chirp = self.waveform == "chirp"
        least, window = (self.bandwidth, 2 / self.bandwidth) if chirp else (3 / duration, sampling / rate)
        self._require(sampling >= least, "sampling_rate", f"it must be {least:g} Hz or more")
        samples = (duration + window) * sampling
        self._require(
            self.sample_count >= samples * (1 - 1e-9),
            "sample_count",
            f"to contain the pulse of {duration:g} s and a range window of {window:g} s it must be "
            f"{np.ceil(samples):.0f} "
            "or more",
        )

    @property
    def dwell_bytes(self) -> int:
        """Samples of a dwell as complex64, bytes."""
        return self.detector_count * self.pulse_count * self.sample_count * 8

    @property
    def detector_count(self) -> int:
        """Number of detectors."""
        return len(self.elevation_boresights)

    @property
    def _frequency_count(self) -> int:
        """Number of fast-time frequencies.

        Raises:
            ValueError: the samples are not frequencies.
        """
        if self.waveform != "spectrum":
            raise ValueError(f"Samples of waveform {self.waveform!r} are not frequencies; use its spectrum_sensor.")
        return self.sample_count

    @property
    def frequency_step(self) -> float:
        """Spacing of the fast-time frequency samples, Hz."""
        return self.bandwidth / self._frequency_count

    @property
    def wavenumber_step(self) -> float:
        """Two-way wavenumber between neighbouring frequency samples, 4 pi df / c, rad/m."""
        return float(4 * np.pi * self.frequency_step / speed_of_light)

    @property
    def centre_wavenumber(self) -> float:
        """Two-way wavenumber of sample sample_count // 2, which an FFT takes for frequency 0, rad/m."""
        offset = self.sample_count // 2 - (self.sample_count - 1) / 2
        return float(4 * np.pi / self.wavelength + offset * self.wavenumber_step)

    @property
    def range_resolution(self) -> float:
        """Resolution c / 2B, m: also the spacing of independent range cells."""
        return float(speed_of_light / (2 * self.bandwidth))

    @property
    def range_window(self) -> float:
        """Slant range that the frequency samples cover without ambiguity, m."""
        return self.range_resolution * self._frequency_count

    @property
    def beamwidth(self) -> float:
        """Beamwidth along the detector axis: wavelength / elevation_diameter, rad."""
        return self.wavelength / self.elevation_diameter

    @property
    def azimuth_beamwidth(self) -> float:
        """Beamwidth across the detector axis: wavelength / azimuth_diameter, rad."""
        return self.wavelength / self.azimuth_diameter

    @cached_property
    def beams(self) -> Beams:
        """Beams of the detectors, as they receive from one direction; the channels are `mixing` times them."""
        widths = self.beamwidth, self.azimuth_beamwidth
        patterns = [tabulated_pattern(table, *widths) for table in self.beam_tables] or [
            detector_pattern(self.pattern, self.detector_size)
        ]
        return Beams(
            tuple(patterns),
            np.array(self.elevation_boresights),
            self.beamwidth,
            self.detector_rotation,
            azimuth_beamwidth=self.azimuth_beamwidth,
            uncertainty=self.beam_uncertainty,
        )

    def widened(self, factor: float) -> Sensor:
        """Return the sensor with beams `factor` times as wide around the same boresights, as of a smaller antenna.

        The config_hash is that of the original: the description given by the user has not changed.
        """

        def wider(angles: tuple[float, ...]) -> tuple[float, ...]:
            return tuple(factor * angle for angle in angles)

        return replace(
            self,
            elevation_diameter=self.elevation_diameter / factor,
            azimuth_diameter=self.azimuth_diameter / factor,
            beam_tables=tuple(
                replace(table, elevation=wider(table.elevation), azimuth=wider(table.azimuth))
                for table in self.beam_tables
            ),
        )

    @cached_property
    def mixing(self) -> C128:
        """The channel matrix M, shape (channels, detectors): channels = M @ detectors' signals."""
        return np.array(self.channel_matrix or np.eye(self.detector_count), dtype=np.complex128)

    @cached_property
    def is_mixed(self) -> bool:
        """True if a channel mixes several detectors."""
        matrix = self.mixing
        return bool(np.any(matrix != np.diag(np.diag(matrix))))

    def receives(self, nearest: F64, farthest: F64) -> Bool:
        """True for each channel that receives all of an interval of slant range (m, (n,)): shape (channels, n)."""
        received = np.ones((self.detector_count, len(nearest)), np.bool_)
        for channel, first, last in self.blanked_ranges:
            received[channel] &= (farthest < first) | (nearest > last)
        return received

    @cached_property
    def noise_covariance(self) -> C128:
        """E n n^H of a phase-history sample in the channels, shape (channels, channels).

        diag(noise_power) with the receivers behind the channel matrix M, M diag(noise_power) M^H with them before it.
        """
        receivers = np.diag(self.noise_power).astype(np.complex128)
        if self.matrix_in_antenna:
            return receivers
        matrix = self.mixing
        return matrix @ receivers @ matrix.conj().T


def _digest(values: dict[str, Any]) -> str:
    """The first 16 hexadecimal digits of the SHA-256 of what a description states.

    Uncertainties that it does not state are left out, so that descriptions that state none keep their identity.
    """
    for part in (values["uncertainty"], values["mounting"]):
        for name in [name for name, value in part.items() if value is None]:
            del part[name]
    if not values["uncertainty"]:
        del values["uncertainty"]
    text = json.dumps(values, sort_keys=True, default=lambda value: (value.real, value.imag))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@lru_cache(maxsize=16)
def _sensor_of(*values: Any) -> Sensor:
    """The sensor with these values of its fields; the same object for the same values."""
    return Sensor(*values)


@dataclass(frozen=True, eq=False)
class PhaseHistory(ShortRepr):
    """Phase history of one dwell.

    With waveform "spectrum", a point of amplitude A at distance R from the antenna contributes
    A exp(-j 4 pi f (R - reference_range) / c); for the others see sal_height_msgs/ChannelFrame.

    Attributes:
        stamp_ns: time of the first pulse, ns since the epoch.
        pulse_times: times of the pulses after the stamp, shape (pulses,), s.
        reference_range: range to which each pulse's phase refers, shape (pulses,), m.
        samples: complex64, shape (detectors, pulses, samples).
        saturated_share: fraction of clipped samples in the dwell of each pulse (`saturated_shares`), shape
            (channels, pulses); None: not counted.
    """

    stamp_ns: int
    pulse_times: F64
    reference_range: F64
    samples: C64
    saturated_share: F64 | None = None

    @property
    def stamp_of_last_pulse_ns(self) -> int:
        """Time of the last pulse, ns since the epoch."""
        return self.stamp_ns + round(float(self.pulse_times[-1]) * 1e9)

    def pulses(self, which: slice) -> PhaseHistory:
        """The phase history of some of the pulses; times count from the same stamp."""
        return PhaseHistory(
            self.stamp_ns,
            self.pulse_times[which],
            self.reference_range[which],
            self.samples[:, which],
            None if self.saturated_share is None else self.saturated_share[:, which],
        )

    @property
    def shares(self) -> F64:
        """Fractions of clipped samples, shape (channels, pulses); NaN where they were not counted."""
        return np.full(self.samples.shape[:2], np.nan) if self.saturated_share is None else self.saturated_share
