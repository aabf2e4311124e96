"""The sensor: what a receiver must know to process its frames."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
from scipy.constants import speed_of_light

from sal_height.beams import Beams, BeamTable, Pattern, detector_pattern, tabulated_pattern
from sal_height.errors import UserError
from sal_height.geometry import AT_BASE_LINK, Mounting
from sal_height.numeric import C128

MAX_DETECTORS = 128
"""Greatest number of detectors: estimators hold M x M numbers per pixel and direction."""


MODES = ("spotlight", "stripmap")
"""Steering of the antenna: held on the scene during a dwell, or fixed to the body."""

WAVEFORMS = ("spectrum", "chirp", "deramped")
"""Kinds of fast-time samples: frequencies, the echo of a linear FM pulse, or that echo mixed with a replica."""

LARGEST_CONDITION = 1e6
"""Greatest condition number of a channel matrix: beyond it, single-precision channels lose some beams to rounding."""

BANDWIDTH_TOLERANCE = 0.01
"""Allowed relative difference between the bandwidth of a linear FM pulse and |chirp_rate| * pulse_duration."""


@dataclass(frozen=True)
class Sensor:
    """Description of a multi-detector sensor; the same content as sal_height_msgs/SensorInfo.

    Quantities derived from the fast-time frequencies (`frequency_step` to `range_window`) exist for waveform "spectrum"
    only; `waveform.spectrum_sensor` gives the corresponding sensor for the others.

    Attributes:
        name: shown to users.
        look_side: +1 looking right of the flight direction, -1 left.
        wavelength: of the carrier, m.
        bandwidth: of the pulse; with waveform "spectrum", that spanned by the fast-time frequency samples, Hz.
        sample_count: fast-time samples in a pulse.
        pulse_count: pulses in a dwell.
        pulse_repetition_frequency: Hz.
        elevation_diameter: of the receive antenna along the detector axis, m.
        azimuth_diameter: of the receive antenna beside the detector axis, m.
        pattern: name of the beam pattern that the antenna gives, or "table".
        elevation_boresights: rad from nadir of the sensor frame (`mounting`), increasing, one per detector.
        noise_power: E|n|^2 of a phase-history sample, one per receiver; 0: unknown.
        mode: one of MODES.
        waveform: one of WAVEFORMS: what the fast-time samples are.
        chirp_rate: of the linear FM, Hz/s, negative for a falling one; 0 for "spectrum".
        pulse_duration: of the linear FM, s; 0 for "spectrum".
        sampling_rate: of the fast-time samples, Hz; 0 for "spectrum".
        detector_size: width of the detectors along their axis and beside it, beamwidths; 0: points.
        beam_tables: with pattern "table", the measured beam of every detector, or the one common to all.
        detector_rotation: by which the axis of the detectors is turned in the plane across the line of sight, rad:
            from elevation (growing) towards the direction of flight. Boresights are angles along that axis.
        channel_matrix: channels from detectors: complex, a row per channel, a column per detector; empty: identity. A
            diagonal matrix holds the detectors' complex calibration constants; [[1, 1], [-1, 1]] / sqrt(2) is a
            lossless sum-difference hybrid (relief paper, eqs. 2 and 3).
        matrix_in_antenna: whether the channels are formed before the receivers, so that noise_power is of the channels;
            else it is of the detectors, and the channels' noise is correlated (`noise_covariance`).
        full_scale: magnitude at which the receivers clip the real and the imaginary part of a sample, in the unit of
            the samples; 0: not known.
        mounting: where the antenna is on the platform, and how it is turned.
        calibration_id: calibration already applied by the sensor; empty: none.
        config_hash: identity of this description; empty: the first 16 hexadecimal digits of the SHA-256 of the rest.

    Raises:
        UserError: a value is out of its range.
    """

    name: str
    look_side: int
    wavelength: float
    bandwidth: float
    sample_count: int
    pulse_count: int
    pulse_repetition_frequency: float
    elevation_diameter: float
    azimuth_diameter: float
    pattern: str
    elevation_boresights: tuple[float, ...]
    noise_power: tuple[float, ...]
    mode: str = "spotlight"
    waveform: str = "spectrum"
    chirp_rate: float = 0.0
    pulse_duration: float = 0.0
    sampling_rate: float = 0.0
    detector_size: tuple[float, float] = (0.0, 0.0)
    detector_rotation: float = 0.0
    beam_tables: tuple[BeamTable, ...] = ()
    channel_matrix: tuple[tuple[complex, ...], ...] = ()
    matrix_in_antenna: bool = True
    full_scale: float = 0.0
    mounting: Mounting = AT_BASE_LINK
    calibration_id: str = ""
    config_hash: str = ""

    def __post_init__(self) -> None:
        if self.look_side not in (-1, 1):
            raise UserError(f"Sensor look_side is {self.look_side}; allowed are +1 (right) and -1 (left).")
        for key, allowed in (("mode", MODES), ("waveform", WAVEFORMS)):
            if getattr(self, key) not in allowed:
                raise UserError(f"Sensor {key} is {getattr(self, key)!r}; allowed are {', '.join(allowed)}.")
        for key in ("wavelength", "bandwidth", "pulse_repetition_frequency", "elevation_diameter", "azimuth_diameter"):
            value = getattr(self, key)
            if not (np.isfinite(value) and value > 0):
                raise UserError(f"Sensor {key} is {value}; it must be finite and greater than 0.")
        if self.bandwidth >= 2 * speed_of_light / self.wavelength:
            raise UserError(
                f"Sensor bandwidth is {self.bandwidth} Hz; it must be less than twice the carrier frequency."
            )
        for key in ("sample_count", "pulse_count"):
            if getattr(self, key) < 2:
                raise UserError(f"Sensor {key} is {getattr(self, key)}; it must be 2 or more.")
        self._check_detectors()
        self._check_beams()
        self._check_channels()
        self._check_waveform()
        if not self.config_hash:
            text = json.dumps(asdict(self), sort_keys=True, default=_complex_parts)
            digest = hashlib.sha256(text.encode()).hexdigest()
            object.__setattr__(self, "config_hash", digest[:16])

    def _check_detectors(self) -> None:
        boresights = np.array(self.elevation_boresights)
        if not (
            boresights.size and np.all((boresights > 0) & (boresights < np.pi / 2)) and np.all(np.diff(boresights) > 0)
        ):
            raise UserError(
                "Sensor elevation_boresights must be one or more increasing angles between 0 (nadir) and pi/2 rad, "
                f"not {self.elevation_boresights}."
            )
        if boresights.size > MAX_DETECTORS:
            raise UserError(f"Sensor has {boresights.size} detectors; at most {MAX_DETECTORS} are allowed.")
        noise = np.array(self.noise_power)
        if noise.shape != boresights.shape or not np.all(np.isfinite(noise) & (noise >= 0)):
            raise UserError(
                f"Sensor noise_power must be {boresights.size} finite numbers of 0 or more, one per detector, "
                f"not {self.noise_power}."
            )

    def _check_beams(self) -> None:
        if not abs(self.detector_rotation) <= np.pi / 2:
            raise UserError(f"Sensor detector_rotation is {self.detector_rotation}; allowed are -pi/2 to pi/2 rad.")
        if (self.pattern == "table") != bool(self.beam_tables):
            raise UserError(
                f"Sensor pattern is {self.pattern!r} with {len(self.beam_tables)} beam tables; tables go with the "
                "pattern 'table' and with no other."
            )
        if self.beam_tables and len(self.beam_tables) not in (1, self.detector_count):
            raise UserError(
                f"Sensor has {len(self.beam_tables)} beam tables for {self.detector_count} detectors; "
                "give one for each, or one for all."
            )
        self.beams.domain(0.0)  # refuses beams that do not overlap

    def _check_channels(self) -> None:
        if not (np.isfinite(self.full_scale) and self.full_scale >= 0):
            raise UserError(f"Sensor full_scale is {self.full_scale}; it must be finite and 0 or more.")
        if not self.channel_matrix:
            return
        count = self.detector_count
        if {len(self.channel_matrix), *map(len, self.channel_matrix)} != {count}:
            raise UserError(
                f"Sensor channel_matrix has rows of {[len(row) for row in self.channel_matrix]} entries; it must have "
                f"{count} of {count}, one row per channel and one column per detector, or none."
            )
        matrix = self.mixing
        if not np.all(np.isfinite(matrix)):
            raise UserError("Sensor channel_matrix has NaN or infinite entries; all must be finite.")
        if not np.linalg.cond(matrix) <= LARGEST_CONDITION:
            raise UserError(
                f"Sensor channel_matrix has the condition number {np.linalg.cond(matrix):.3g}; to be inverted it must "
                f"have {LARGEST_CONDITION:g} or less."
            )

    def _check_waveform(self) -> None:
        keys = ("chirp_rate", "pulse_duration", "sampling_rate")
        if self.waveform == "spectrum":
            for key in keys:
                if getattr(self, key) != 0:
                    raise UserError(f"Sensor {key} is {getattr(self, key):g}; with waveform 'spectrum' it must be 0.")
            return
        rate, duration, sampling = self.chirp_rate, self.pulse_duration, self.sampling_rate
        if not (np.isfinite(rate) and rate != 0):
            raise UserError(
                f"Sensor chirp_rate is {rate}; with waveform {self.waveform!r} it must be finite and not 0."
            )
        for key in keys[1:]:
            if not (np.isfinite(getattr(self, key)) and getattr(self, key) > 0):
                raise UserError(
                    f"Sensor {key} is {getattr(self, key)}; with waveform {self.waveform!r} it must be finite and "
                    "greater than 0."
                )
        if not abs(abs(rate) * duration / self.bandwidth - 1) <= BANDWIDTH_TOLERANCE:
            raise UserError(
                f"Sensor bandwidth is {self.bandwidth:g} Hz; it must be |chirp_rate| * pulse_duration = "
                f"{abs(rate) * duration:g} Hz within 1 %."
            )
        least = self.bandwidth if self.waveform == "chirp" else 3 / duration
        if sampling < least:
            raise UserError(f"Sensor sampling_rate is {sampling:g} Hz; it must be {least:g} Hz or more.")
        window = 2 / self.bandwidth if self.waveform == "chirp" else sampling / abs(rate)
        samples = (duration + window) * sampling
        if self.sample_count < samples * (1 - 1e-9):
            raise UserError(
                f"Sensor sample_count is {self.sample_count}; to hold the pulse of {duration:g} s and a range window "
                f"of {window:g} s it must be {np.ceil(samples):.0f} or more."
            )

    @property
    def detector_count(self) -> int:
        """Number of detectors."""
        return len(self.elevation_boresights)

    @property
    def frequency_step(self) -> float:
        """Spacing of the fast-time frequency samples, Hz.

        Raises:
            ValueError: the samples are not frequencies.
        """
        if self.waveform != "spectrum":
            raise ValueError(f"Samples of waveform {self.waveform!r} are not frequencies; use its spectrum_sensor.")
        return self.bandwidth / self.sample_count

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
        """Slant range that the frequency samples cover without ambiguity, m.

        Raises:
            ValueError: the samples are not frequencies.
        """
        if self.waveform != "spectrum":
            raise ValueError(f"Samples of waveform {self.waveform!r} are not frequencies; use its spectrum_sensor.")
        return self.range_resolution * self.sample_count

    @property
    def beamwidth(self) -> float:
        """Beamwidth along the detector axis: wavelength / elevation_diameter, rad."""
        return self.wavelength / self.elevation_diameter

    @property
    def azimuth_beamwidth(self) -> float:
        """Beamwidth beside the detector axis: wavelength / azimuth_diameter, rad."""
        return self.wavelength / self.azimuth_diameter

    @cached_property
    def beams(self) -> Beams:
        """Beams of the detectors, as they receive from one direction; the channels are `mixing` times them."""
        return Beams(
            self._patterns,
            np.array(self.elevation_boresights),
            self.beamwidth,
            self.detector_rotation,
            azimuth_beamwidth=self.azimuth_beamwidth,
        )

    def widened(self, factor: float) -> Sensor:
        """Return the sensor with beams `factor` times as wide around the same boresights, as of a smaller antenna.

        The config_hash is that of the original: the description given by the user has not changed.
        """
        tables = tuple(
            replace(
                table,
                elevation=tuple(factor * angle for angle in table.elevation),
                azimuth=tuple(factor * angle for angle in table.azimuth),
            )
            for table in self.beam_tables
        )
        return replace(
            self,
            elevation_diameter=self.elevation_diameter / factor,
            azimuth_diameter=self.azimuth_diameter / factor,
            beam_tables=tables,
        )

    @property
    def mixing(self) -> C128:
        """The channel matrix M, shape (channels, detectors): channels = M @ detectors' signals."""
        return np.array(self.channel_matrix or np.eye(self.detector_count), dtype=np.complex128)

    @property
    def is_mixed(self) -> bool:
        """Whether a channel mixes several detectors."""
        matrix = self.mixing
        return bool(np.any(matrix != np.diag(np.diag(matrix))))

    @property
    def noise_covariance(self) -> C128:
        """E n n^H of a phase-history sample in the channels, shape (channels, channels).

        diag(noise_power) with the receivers behind the channel matrix M, M diag(noise_power) M^H with them before it.
        """
        receivers = np.diag(self.noise_power).astype(np.complex128)
        if self.matrix_in_antenna:
            return receivers
        matrix = self.mixing
        return matrix @ receivers @ matrix.conj().T

    @property
    def _patterns(self) -> tuple[Pattern, ...]:
        if self.beam_tables:
            return tuple(tabulated_pattern(table, self.beamwidth, self.azimuth_beamwidth) for table in self.beam_tables)
        return (detector_pattern(self.pattern, self.detector_size),)


def _complex_parts(value: complex) -> tuple[float, float]:
    """A complex number for JSON."""
    return value.real, value.imag
