"""Impairments: differences of the simulated sensor from its description, which calibration estimates.

A receiver changes echoes, before its own noise, by a response over fast-time frequency; the antenna changes the
pointing and width of its beams; the processing of a real radar leaves a phase over the aperture
(PSF paper, sections 1 and 3). None of this is part of `sensor.Sensor`, which is the description; only the saturation of
receivers is described there: `full_scale`.

Fast-time frequencies are offsets from the carrier in cycles per range cell (c / 2 B of the images): the band is that
from -1/2 to 1/2. With waveform "chirp" or "deramped" the receiver's response is that of a filter before the mixer, so
that it acts on the echo's frequencies, not on the samples of the record.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated

import numpy as np
import numpy.typing as npt
import scipy.integrate
import scipy.special
from annotated_types import Ge, Gt, Le
from scipy.spatial.transform import Rotation

from sal_height.beams import ZERNIKE, Beams
from sal_height.configuration import Angle, Decibels, Float, Int, StrictKeys
from sal_height.geometry import look_direction
from sal_height.numeric import C128, F64, Complex, taylor
from sal_height.sensor import Sensor, echo_sensor, spectrum_sensor
from sal_height.simulation.air import SimulatedAir
from sal_height.simulation.harmonics import Harmonics
from sal_height.simulation.odometry_errors import EXACT, OdometryErrors
from sal_height.simulation.phase_errors import AT_REST, Vibration

MOST_SWING_BEAMWIDTHS = 0.5
"""Greatest swing of the antenna: the beams' middle stays within the band that a dwell may have (`imaging.checks`)."""

JITTER_LINES = 100


@dataclass(frozen=True)
class Turbulence(StrictKeys):
    """The air below and around the platform.

    Attributes:
        ground_cn2: structure constant C_n^2 at the ground, m^(-2/3): 1.7e-14 on a usual day, 0 is calm.
        wind_mps: rms wind at 5 to 20 km; 21 is usual.
    """

    ground_cn2: Annotated[Float, Ge(0), Le(1e-11)]
    wind_mps: Annotated[Float, Ge(0), Le(100)] = 21.0

    def cn2(self, height: F64) -> F64:
        """C_n^2 (m^(-2/3)) at heights above the ground (m)."""
        tropopause = 0.00594 * (self.wind_mps / 27) ** 2 * (1e-5 * height) ** 10 * np.exp(-height / 1000)
        return np.asarray(tropopause + 2.7e-16 * np.exp(-height / 1500) + self.ground_cn2 * np.exp(-height / 100))

    def structure(self, wavelength: float, slant_range: float, height: float) -> float:
        """Factor of x^(5/3) in the structure function D (rad^2) of echoes, for an antenna at a height (m)."""
        share = np.linspace(0.0, 1.0, 2001)
        way = self.cn2(height * (1 - share)) * (1 - share) ** (5 / 3)
        integral = slant_range * float(scipy.integrate.simpson(way, x=share))
        return 4 * 2.914 * (2 * np.pi / wavelength) ** 2 * integral

    def drawn(self, structure: float, speed: float, rng: np.random.Generator) -> Harmonics:
        """Phases of this structure function along a flight, as the displacement (rad) of harmonics over time.

        The spectrum a w^(-8/3) over the angular wavenumber w has the structure function
        -2 a Gamma(-5/3) cos(5 pi / 6) x^(5/3).
        """
        # Lengths of the waves, m. Waves longer than L add (x / L)^(1/3) to the structure function: there is no outer
        # scale, beyond which real air has less.
        edges = 2 * np.pi / np.geomspace(1e10, 1e-3, 401)
        level = structure / (-2 * scipy.special.gamma(-5 / 3) * np.cos(5 * np.pi / 6))
        power = level * 3 / 5 * (edges[:-1] ** (-5 / 3) - edges[1:] ** (-5 / 3))
        omega = speed * np.sqrt(edges[1:] * edges[:-1])
        return Harmonics(omega, (omega * np.sqrt(2 * power))[:, None], rng.uniform(0, 2 * np.pi, (len(omega), 1)))


@dataclass(frozen=True)
class VegetationWind(StrictKeys):
    """Motion of vegetation.

    Attributes:
        rms_velocity_mps: rms velocity of the moving part along the line of sight, m/s: 0.12 in light air, 0.18 in a
            breeze, 0.25 in wind, 0.33 in a gale (beta 12, 8, 5.7 and 4.3 s/m).
        still_share: fraction of the power at rest; the higher the frequency, the less: at 10 GHz in 10 miles per hour
            0.46, for light 0.
    """

    rms_velocity_mps: Annotated[Float, Gt(0), Le(10)]
    still_share: Annotated[Float, Ge(0), Le(1)] = 0.0

    def drawn(self, count: int, rng: np.random.Generator) -> F64:
        """Velocities (m/s) of scatterers, away from the sensor."""
        moving = rng.uniform(size=count) >= self.still_share
        return rng.laplace(scale=self.rms_velocity_mps / np.sqrt(2), size=count) * moving


@dataclass(frozen=True)
class RangeSawtooth(StrictKeys):
    """A sawtooth on the amplitude of a receiver's response over frequency (PSF paper, section 3).

    The amplitude is 1 + depth saw(teeth x) at the frequency x, with saw(x) = 2 x from -1/2 to 1/2. It puts paired
    echoes `teeth` range cells before and behind a target, of the amplitude depth / pi over the target's; with N
    frequencies and M = N / teeth of them in a tooth, depth / (M sin(pi / M)). Its harmonics are echoes farther off.

    Attributes:
        depth: depth of the amplitude.
        teeth: number of teeth over the band; at most half the number of frequencies.
        receivers: numbers of the receivers that have it, counted from 0; empty: all.
    """

    depth: Annotated[Float, Gt(0), Le(1)]
    teeth: Annotated[Float, Gt(0), Le(32768)]
    receivers: tuple[Annotated[Int, Ge(0)], ...] = ()

    def response(self, frequency: F64) -> F64:
        """Amplitude at frequencies in cycles per range cell."""
        tooth = self.teeth * frequency
        return 1 + self.depth * 2 * (tooth - np.floor(tooth + 0.5))


@dataclass(frozen=True)
class ChirpRipple(StrictKeys):
    """A chirp that is not linear: a sine on the phase over frequency, as all receivers have it.

    It puts paired echoes `cycles` range cells before and behind a target, of the amplitude J_1(a) / J_0(a) over the
    target's, and weaker ones at multiples of that (Klauder et al., Bell Syst. Tech. J. 39, 1960, section 4). In a
    deramped record it is the part that a reference of the same delay has not removed.

    Attributes:
        amplitude_rad: amplitude a of the phase, rad.
        cycles: cycles of the sine over the band; at most half the number of frequencies.
    """

    amplitude_rad: Annotated[Float, Ge(0), Le(3)]
    cycles: Annotated[Float, Gt(0), Le(32768)]

    def response(self, frequency: F64) -> C128:
        """Factor at frequencies in cycles per range cell."""
        return np.exp(1j * self.amplitude_rad * np.sin(2 * np.pi * self.cycles * frequency))


@dataclass(frozen=True)
class RangeTaper(StrictKeys):
    """Taylor weights over the middle of the band in all receivers (PSF paper, section 1).

    They are 1 in the middle of the band and 0 outside of their part of it.

    Attributes:
        sidelobe_db: level by which the 4 sidelobes to each side stay below the peak.
        band_share: fraction of the band that has weights.
    """

    sidelobe_db: Annotated[Float, Ge(13), Le(100)] = 35.0
    band_share: Annotated[Float, Ge(0.01), Le(1)] = 1.0

    def response(self, frequency: F64) -> F64:
        """Amplitude at frequencies in cycles per range cell."""
        nodes = np.linspace(-self.band_share / 2, self.band_share / 2, 4097)
        return np.interp(frequency, nodes, taylor(len(nodes), self.sidelobe_db), left=0.0, right=0.0)


@dataclass(frozen=True)
class AntennaSwing(StrictKeys):
    """The beams swing along the flight (PSF paper, section 1): ahead by amplitude sin(2 pi t / period + phase).

    The odometry does not contain it. With a period much longer than the flight and a phase of pi / 2 the beams squint.

    Attributes:
        amplitude_rad: angle along the flight; at most MOST_SWING_BEAMWIDTHS.
        period_s: period, s.
        phase_rad: phase when the first dwell starts, rad.
    """

    amplitude_rad: Annotated[Float, Ge(0), Le(1)]
    period_s: Annotated[Float, Ge(1e-6), Le(1e9)]
    phase_rad: Angle = 0.0

    def pointing(self, seconds: npt.ArrayLike) -> F64:
        """Angle (rad) by which the beams point ahead at times (s) after the start of the first dwell."""
        turn = 2 * np.pi * np.asarray(seconds, dtype=np.float64) / self.period_s + self.phase_rad
        return self.amplitude_rad * np.sin(turn)


@dataclass(frozen=True)
class PointingJitter(StrictKeys):
    """Random angles by which the beams point ahead and farther off nadir; the odometry does not contain them.

    Attributes:
        rms_rad: rms of each of the two angles, rad.
        highest_hz: highest frequency of their spectrum, which is flat below, Hz.
    """

    rms_rad: Annotated[Float, Ge(0), Le(1)]
    highest_hz: Annotated[Float, Gt(0), Le(1e6)]

    def drawn(self, rng: np.random.Generator) -> Harmonics:
        """The angles of a flight (rad), ahead and off nadir, as the velocity of harmonics."""
        omega = 2 * np.pi * self.highest_hz * (np.arange(JITTER_LINES) + rng.uniform(size=JITTER_LINES)) / JITTER_LINES
        amplitude = np.full((JITTER_LINES, 2), self.rms_rad * np.sqrt(2 / JITTER_LINES))
        return Harmonics(omega, amplitude, rng.uniform(0, 2 * np.pi, (JITTER_LINES, 2)))


STEADY = PointingJitter(rms_rad=0.0, highest_hz=1.0)
"""Beams that keep their direction."""


@dataclass(frozen=True)
class PupilAberrations(StrictKeys):
    """Zernike terms of the phase of the pupil, each in waves rms (`beams.ZERNIKE`)."""

    defocus: Annotated[Float, Ge(-1), Le(1)] = 0.0
    astigmatism: Annotated[Float, Ge(-1), Le(1)] = 0.0
    oblique_astigmatism: Annotated[Float, Ge(-1), Le(1)] = 0.0
    coma: Annotated[Float, Ge(-1), Le(1)] = 0.0
    coma_beside: Annotated[Float, Ge(-1), Le(1)] = 0.0
    spherical: Annotated[Float, Ge(-1), Le(1)] = 0.0

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients in the order of `beams.ZERNIKE`, waves rms."""
        return tuple(getattr(self, name) for name in ZERNIKE)


@dataclass(frozen=True)
class Impairments(StrictKeys):
    """Differences of the simulated sensor from its description; by default none.

    Receivers add noise behind the detectors, or behind a hybrid in the antenna (Sigma, then Delta). They change echoes
    before their noise, which stays as described.

    Attributes:
        range_sawtooth: sawtooth of the receivers' response.
        range_taper: taper of the receivers' response.
        chirp_ripple: ripple of the waveform; None: its chirp is linear.
        undescribed_gains_db: gains of the receivers, one each, dB; empty: 0.
        undescribed_phases_rad: phases of the receivers, one each, rad; empty: 0.
        nyquist_spur_over_noise: amplitude, over the rms of the receiver's noise in a sample, of a signal in the first
            of an even number of frequencies: a wave of half a cycle per range cell in the image (PSF paper, section 3).
            It is the same in every pulse: in stripmap it has everywhere the same amplitude, in spotlight it stands in
            the columns abeam of the antenna. Waveform "spectrum" only.
        beam_width_factor: width of all beams, about their boresights, over that described.
        pupil_aberrations_waves: aberrations of the common pupil of all detectors by the names of `beams.ZERNIKE`, waves
            rms; patterns "jinc" only.
        antenna_swing: swing of all beams.
        pointing_jitter: jitter of all beams.
        quartic_phase_rad: phase at the edge of the aperture, growing with the fourth power (PSF paper, section 3): in
            spotlight over the pulses of the dwell, in stripmap over a scatterer's angle to the beams along the flight,
            whose half a beamwidth is the edge.
        odometry: errors of the odometry, and of the described position of the sensor.
        vibration: vibration of the antenna along the line of sight; the odometry does not contain it.
        laser_linewidth_hz: full width at half maximum of the line of the laser, Hz.
        laser_within_pulse: True if its phase drifts within a pulse, too; not with waveform "spectrum", whose samples
            are no times.
        air: air between platform and ground, which delays and bends echoes; None: no air.
        turbulence: turbulence of the air; None: it is at rest.
        vegetation_wind: wind that moves scatterers above the terrain; None: they are at rest.
        adc_bits: bits of the converters of real and imaginary parts, over the full scale that the sensor must have; 0:
            as fine as floating-point numbers.
    """

    range_sawtooth: RangeSawtooth | None = None
    range_taper: RangeTaper | None = None
    chirp_ripple: ChirpRipple | None = None
    undescribed_gains_db: tuple[Decibels, ...] = ()
    undescribed_phases_rad: tuple[Angle, ...] = ()
    nyquist_spur_over_noise: Annotated[Float, Ge(0), Le(1e6)] = 0.0
    beam_width_factor: Annotated[Float, Ge(0.5), Le(2)] = 1.0
    pupil_aberrations_waves: PupilAberrations = PupilAberrations()
    antenna_swing: AntennaSwing = AntennaSwing(amplitude_rad=0.0, period_s=1.0)
    pointing_jitter: PointingJitter = STEADY
    quartic_phase_rad: Annotated[Float, Ge(-100), Le(100)] = 0.0
    odometry: OdometryErrors = EXACT
    vibration: Vibration = AT_REST
    laser_linewidth_hz: Annotated[Float, Ge(0), Le(1e9)] = 0.0
    laser_within_pulse: bool = False
    air: SimulatedAir | None = None
    turbulence: Turbulence | None = None
    vegetation_wind: VegetationWind | None = None
    adc_bits: Annotated[Int, Ge(0), Le(24)] = 0

    def receiver_response(self, sensor: Sensor) -> C128:
        """Factor of each receiver on the echoes at the frequencies of `echo_sensor(sensor)`.

        Args:
            sensor: sensor as it is described, of any waveform.

        Returns:
            complex128, shape (receivers, frequencies), frequencies ascending: with waveform "spectrum" the first is at
            -1/2 cycle per range cell of the image. 1 where there is no impairment.
        """
        echo = echo_sensor(sensor)
        offsets = (np.arange(echo.sample_count) - (echo.sample_count - 1) / 2) * echo.frequency_step
        frequency = np.asarray(offsets / spectrum_sensor(sensor).bandwidth)
        gains = 10 ** (np.array(self.undescribed_gains_db or (0.0,)) / 20)
        phases = np.array(self.undescribed_phases_rad or (0.0,))
        response = np.ones((sensor.detector_count, len(frequency)), dtype=np.complex128)
        response *= (gains * np.exp(1j * phases))[:, None]
        if self.range_taper:
            response *= self.range_taper.response(frequency)
        if self.chirp_ripple:
            response *= self.chirp_ripple.response(frequency)
        if self.range_sawtooth:
            response[list(self.range_sawtooth.receivers) or slice(None)] *= self.range_sawtooth.response(frequency)
        return response

    def built(self, sensor: Sensor) -> BuiltSensor:
        """The sensor with the beams that it really has, from its description; its config_hash stays."""
        wide = sensor.widened(self.beam_width_factor)
        values = {field.name: getattr(wide, field.name) for field in fields(Sensor)}
        return BuiltSensor(**values, pupil=self.pupil_aberrations_waves.coefficients)

    @property
    def greatest_swing(self) -> float:
        """Angle ahead beyond which the beams hardly ever point, rad."""
        return self.antenna_swing.amplitude_rad + 4 * self.pointing_jitter.rms_rad

    @property
    def turns_pulses(self) -> bool:
        """True if vibration, laser or air change the phase of pulses."""
        return bool(self.laser_linewidth_hz or self.turbulence) or not self.vibration.is_none

    def dwell_phase(self, pulses: int) -> F64:
        """Quartic phase (rad) of the pulses of a spotlight dwell, shape (pulses,)."""
        along = (np.arange(pulses) - (pulses - 1) / 2) / (pulses / 2)
        return np.asarray(self.quartic_phase_rad * along**4)


@dataclass(frozen=True)
class BuiltSensor(Sensor):
    """A sensor with the pupil that it really has; `Sensor` describes one without aberrations.

    Attributes:
        pupil: coefficients of the terms of `beams.ZERNIKE`, waves rms.
    """

    pupil: tuple[float, ...] = ()

    @cached_property
    def beams(self) -> Beams:
        """As of `Sensor`, behind the pupil."""
        return super().beams.aberrated(self.pupil)


UNIMPAIRED = Impairments()


def through_receivers(clean: Complex, sensor: Sensor, impairments: Impairments) -> Complex:
    """Echoes from which receivers as described would deliver the samples of the impaired ones.

    With receivers R behind the channel matrix M in the antenna that is M^-1 (R M s + spur), without it R s + spur. The
    difference from s is added, if there is one.

    Args:
        clean: noise-free samples s of `echo_sensor(sensor)`, shape (detectors, pulses, frequencies); not changed.
        sensor: sensor as it is described.
        impairments: impairments of its receivers.

    Returns:
        Samples of the shape of `clean`, which is returned itself where nothing is impaired.
    """
    response = impairments.receiver_response(sensor)
    if np.all(response == 1) and not impairments.nyquist_spur_over_noise:
        return clean
    matrix = sensor.mixing if sensor.matrix_in_antenna else np.eye(sensor.detector_count)
    arriving = np.tensordot(matrix, clean, axes=1)
    change = (response - 1)[:, None] * arriving
    change[..., 0] += (impairments.nyquist_spur_over_noise * np.sqrt(sensor.noise_power))[:, None]
    return clean + np.tensordot(np.linalg.inv(matrix), change, axes=1)


def pointing_rotation(ahead: F64, off_nadir: F64, sensor: Sensor) -> F64:
    """Matrices, in body axes, that turn the middle of the beams ahead and farther off nadir, shape (..., 3, 3).

    Angles are in rad. A direction at the squint y in the plane of the line of sight and the flight has, seen from the
    turned antenna, the squint y - ahead.
    """
    boresight = look_direction(float(np.mean(sensor.beams.span)), 0.0, sensor.look_side)
    forward = np.array([1.0, 0.0, 0.0])
    turned = Rotation.from_rotvec(ahead[..., None] * np.cross(boresight, forward))
    return (Rotation.from_rotvec(-sensor.look_side * off_nadir[..., None] * forward) * turned).as_matrix()
