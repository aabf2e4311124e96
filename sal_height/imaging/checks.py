"""Refuse dwells that cannot be imaged: odometry, pulse times and Doppler that disagree, and aliasing.

Errors that the data cannot show are not refused but reported (`describe_unverified_squint`, `describe_strip_centroid`).
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from sal_height.doubts import Doubt
from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid
from sal_height.imaging.pixels import aim_point, line_of_sight
from sal_height.numeric import F64
from sal_height.sensor import PhaseHistory, Sensor, look_ahead_angle

ROUNDING = 1e-6  # by which a limit may be exceeded, so that a value at the limit that a message states is accepted

TIMING_TOLERANCE = 0.1
"""Greatest relative difference between the mean pulse interval and that of the stated pulse repetition frequency.

Pulse intervals may vary by design (staggered pulses), their mean may not; errors of description are factors of 2 or 10.
"""

OFF_MIDDLE = 0.1
"""Greatest distance of the Doppler centroid from the middle of the beams without doubt, beamwidths: the uneven ground
of presets moves it by less than half as much."""


def doubts_of_odometry(sentence: str) -> tuple[Doubt, ...]:
    """The doubt that a message on odometry states; none if it is empty."""
    return (Doubt("odometry", sentence),) if sentence else ()


def check_dwell(history: PhaseHistory, antenna: F64, sensor: Sensor, aperture: ApertureState) -> None:
    """Make sure that odometry, pulse times and frequencies fit each other and sample the lit ground.

    Args:
        history: phase history of all detectors, as fast-time frequencies.
        antenna: position at each pulse, m, shape (pulses, 3).
        sensor: sensor with waveform "spectrum".
        aperture: state of the platform in the middle of the pulses.

    Raises:
        Rejected: they do not.
    """
    reference_range = float(history.reference_range[len(antenna) // 2])
    check_frames(sensor, aperture, reference_range)
    check_pulse_times(sensor, history.pulse_times)
    check_pulses(sensor, antenna, aperture)
    check_range_window(sensor, reference_range)


def check_frames(sensor: Sensor, aperture: ApertureState, reference_range: float) -> None:
    """Make sure that map is east-north-up and base_link forward-left-up, as REP 103 of ROS has them.

    Odometry in the aviation frames (map north-east-down, base_link forward-right-down) is consistent in itself, so that
    the data focus and heights would be wrong by twice the height of the flight. Its antenna is below the map's origin.

    Raises:
        Rejected: z of the sensor frame (base_link, turned by the mounting) points down, or the antenna is far below the
            map's origin.
    """
    if aperture.rotation[2, 2] <= 0:
        raise Rejected(
            "odometry frames",
            f"The z axis of the sensor frame points {np.arccos(np.clip(aperture.rotation[2, 2], -1, 1)):.3g} rad away "
            "from up in map; base_link, turned by the mounting, must have x forward, y left, z up, map east-north-up. "
            "Parameters map_axes (ned) and body_axes (frd) accept the axes of aviation.",
        )
    height = float(aperture.position[2])
    drop = height - float(aim_point(sensor, aperture, reference_range)[2])
    # With z down, the ground would be nearer to the height of the origin than with z up: for any depth greater than 0.
    # Half of the height allows maps whose origin lies above the flight.
    if height < -0.5 * drop:
        raise Rejected(
            "odometry frames",
            f"The antenna is at z = {height:.4g} m in map and {drop:.4g} m above the point it looks at, as if z "
            "pointed down; odometry must be east-north-up, with the map's origin near the ground, or parameter "
            "map_axes be ned.",
        )


def check_pulse_times(sensor: Sensor, pulse_times: F64) -> None:
    """Reject pulses whose mean rate is not the stated pulse repetition frequency, within TIMING_TOLERANCE."""
    found, stated = _pulse_rate(pulse_times), sensor.pulse_repetition_frequency
    if abs(stated / found - 1) > TIMING_TOLERANCE:
        raise Rejected(
            "pulse times",
            f"The pulse times make a pulse repetition frequency of {found:.4g} Hz, sensor_info states {stated:.4g} Hz; "
            f"they must agree to {TIMING_TOLERANCE:.0%}.",
        )


def describe_unverified_squint(sensor: Sensor, aperture: ApertureState) -> str:
    """A message on a squint that the data cannot confirm; empty if they can.

    Doppler is measured modulo the pulse repetition frequency, so it confirms the pointing of the beams along the flight
    up to multiples of wavelength PRF / (2 speed). Beams within half of that about abeam, or within the effect of gusts
    on the direction of flight, are not doubted; farther ahead or behind, a wrong yaw has the same effect.
    """
    squint = float(np.arcsin(np.clip(line_of_sight(sensor, aperture) @ aperture.direction, -1.0, 1.0)))
    speed = float(np.linalg.norm(aperture.velocity))
    # Gusts of 2 m/s rms turn a flight at 50 m/s by 0.02 rad rms, at most 0.068.
    limit = max(0.07, sensor.wavelength * sensor.pulse_repetition_frequency / (4 * speed))
    if abs(squint) <= limit:
        return ""
    where = "ahead of" if squint > 0 else "behind"
    return (
        f"The odometry makes the beams look {abs(squint):.3g} rad {where} abeam of the flight; beyond {limit:.3g} rad "
        "the Doppler of the pulses cannot confirm it, so that an error in yaw or boresights would go unnoticed."
    )


def check_pulses(sensor: Sensor, antenna: F64, aperture: ApertureState) -> None:
    """Make sure that the pulses are dense enough for the beams, and the aperture resolves more than these do.

    Raises:
        Rejected: they alias the lit ground (a step above half the antenna), or there are too few.
    """
    way = float(np.linalg.norm(antenna[-1] - antenna[0]))
    step = way / (len(antenna) - 1)
    size = sensor.wavelength / sensor.beams.track_beamwidth
    speed = float(np.linalg.norm(aperture.velocity))
    if step > size / 2 * (1 + ROUNDING):
        raise Rejected(
            "aliased in azimuth",
            f"Pulses are {step:.3g} m apart at {speed:.4g} m/s; an antenna of {size:.3g} m needs one every "
            f"{size / 2:.3g} m, a pulse repetition frequency of {2 * speed / size:.4g} Hz.",
        )
    if way < size / 2 * (1 - ROUNDING):
        raise Rejected(
            "too few pulses",
            f"The {len(antenna)} pulses reach over {way:.3g} m; a synthetic aperture must be longer than half the "
            f"antenna ({size / 2:.3g} m), or it resolves no more than the beam.",
        )


def check_range_window(sensor: Sensor, reference_range: float) -> None:
    """Reject frequencies that do not resolve all ranges at which the beams meet level ground.

    Echoes from beyond the range window would appear within it.
    """
    first, last = sensor.beams.span
    lit = reference_range * (last - first) * np.tan((first + last) / 2)
    if lit > sensor.range_window * (1 + ROUNDING):
        raise Rejected(
            "aliased in range",
            f"The beams meet level ground over {lit:.4g} m of slant range, the frequencies give "
            f"{sensor.range_window:.4g} m apart; they must be spaced "
            f"{sensor.frequency_step * sensor.range_window / lit:.4g} Hz or less.",
        )


def check_doppler_centroid(
    history: PhaseHistory, antenna: F64, sensor: Sensor, aperture: ApertureState, grid: Grid
) -> str:
    """Reject a spotlight dwell whose Doppler centroid is outside the band of image or beam.

    Outside, the lit ground is not where attitude and boresights point.

    Returns:
        A message if the centroid is more than OFF_MIDDLE from the middle of the beams; else empty.

    Raises:
        Rejected: the centroid is outside.
    """
    aim = aim_point(sensor, aperture, float(np.mean(history.reference_range)))
    delay = np.linalg.norm(aim - antenna, axis=-1) - history.reference_range
    slant_range = float(np.linalg.norm(aim - aperture.position))
    speed = float(np.linalg.norm(aperture.velocity))
    width = max(grid.cols * grid.col_spacing / slant_range, sensor.beams.track_beamwidth)
    of_a_beamwidth = 2 * speed * sensor.beams.track_beamwidth / sensor.wavelength
    found = _centroid_offset(history, np.diff(delay), sensor, OFF_MIDDLE * of_a_beamwidth)
    allowed = speed * width / sensor.wavelength
    if abs(found) > allowed:
        raise Rejected(
            "Doppler centroid outside the band",
            f"The Doppler centroid is {found:+.4g} Hz off that of the beams' middle, image and beam make up "
            f"{allowed:.4g} Hz to each side; attitude, boresights or odometry must be wrong.",
        )
    beamwidths = found / of_a_beamwidth
    if abs(beamwidths) <= OFF_MIDDLE:
        return ""
    return (
        f"The Doppler centroid is {found:+.4g} Hz off that of the beams' middle, {abs(beamwidths):.2g} of a beamwidth, "
        "so that heights may be wrong; state in the covariances of the odometry how well velocity (twist) and attitude "
        "are known, or set autofocus to always."
    )


def describe_strip_centroid(history: PhaseHistory, antenna: F64, sensor: Sensor, aperture: ApertureState) -> str:
    """A message on a stripmap block whose Doppler centroid is not that of the middle of the beams; empty if it is.

    Level ground has its centroid there. That of a single target that outshines its surroundings is anywhere in the
    beam, so that such a block is not refused.
    """
    steps = -np.diff(antenna, axis=0) @ line_of_sight(sensor, aperture) - np.diff(history.reference_range)
    speed = float(np.linalg.norm(aperture.velocity))
    width = sensor.beams.track_beamwidth + 2 * look_ahead_angle(sensor.beams)
    expected = speed * width / sensor.wavelength
    found = _centroid_offset(history, steps, sensor, expected)
    if abs(found) <= expected:
        return ""
    return (
        f"The Doppler centroid is {found:+.4g} Hz off that of the beams' middle, more than the {expected:.4g} Hz that "
        "ground of even brightness can have: either a single bright target stands there, or yaw, boresights or "
        "odometry are wrong and the image is defocused."
    )


def _centroid_offset(history: PhaseHistory, steps: F64, sensor: Sensor, expected: float) -> float:
    """Doppler centroid (Hz) relative to a point whose delay changes by `steps` (m); 0 if the data have no centroid.

    The centroid is the phase from pulse to pulse, after dechirping to that point, averaged over everything (Madsen,
    IEEE Trans. AES 25, 1989). Noise, or errors of phase from pulse to pulse, have none. Where it is beyond what is
    expected, it is that of most range cells, whatever their brightness: a moving car may outshine all ground.
    """
    products = np.vecdot(history.samples[:, :-1], history.samples[:, 1:]).sum(axis=0)
    correlation = complex(np.sum(products * np.exp(1j * sensor.centre_wavenumber * steps)))
    coherent = 0.5  # least fraction of the products of neighbouring pulses that agree if there is one Doppler centroid
    if abs(correlation) <= coherent * float(np.sum(np.abs(products))):
        return 0.0
    of_a_radian = _pulse_rate(history.pulse_times) / (2 * np.pi)
    if abs(np.angle(correlation)) * of_a_radian <= expected:
        return float(np.angle(correlation)) * of_a_radian
    cells = scipy.fft.ifft(history.samples)
    of_cells = np.einsum("dtc,dtc->tc", cells[:, :-1].conj(), cells[:, 1:])
    correlations = np.exp(1j * sensor.centre_wavenumber * steps) @ of_cells
    agreeing = correlations[np.abs(correlations) > coherent * np.sum(np.abs(of_cells), axis=0)]
    turned = agreeing * np.conj(correlation)
    return float(np.angle(correlation) + (np.median(np.angle(turned)) if len(turned) else 0.0)) * of_a_radian


def _pulse_rate(pulse_times: F64) -> float:
    """Mean pulse repetition frequency, Hz."""
    return (len(pulse_times) - 1) / float(pulse_times[-1] - pulse_times[0])
