"""Whether pulses and frequencies sample the scene that the beams light: what an image cannot be made of."""

from __future__ import annotations

import numpy as np

from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid
from sal_height.imaging.pixels import aim_point
from sal_height.numeric import F64
from sal_height.sensor import PhaseHistory, Sensor

COHERENT = 0.5
"""Share of the products of neighbouring pulses that must agree, for the dwell to have one Doppler centroid."""


ROUNDING = 1e-6
"""Share by which a limit may be passed: who keeps to the number that a sentence states is within."""


def check_pulses(sensor: Sensor, antenna: F64, aperture: ApertureState) -> None:
    """Make sure that the pulses are close enough for the beams, and reach far enough to resolve more than they do.

    Args:
        sensor: wavelength and antenna.
        antenna: position at each pulse, m, shape (pulses, 3).
        aperture: state of the platform.

    Raises:
        Rejected: they alias what the beams light (a step above half the antenna), or there are too few.
    """
    way = float(np.linalg.norm(antenna[-1] - antenna[0]))
    step = way / (len(antenna) - 1)
    speed = float(np.linalg.norm(aperture.velocity))
    if step > sensor.aperture / 2 * (1 + ROUNDING):
        raise Rejected(
            "aliased in azimuth",
            f"Pulses are {step:.3g} m apart at {speed:.4g} m/s; an antenna of {sensor.aperture:.3g} m needs one every "
            f"{sensor.aperture / 2:.3g} m, a pulse repetition frequency of {2 * speed / sensor.aperture:.4g} Hz.",
        )
    if way < sensor.aperture / 2 * (1 - ROUNDING):
        raise Rejected(
            "too few pulses",
            f"The {len(antenna)} pulses reach over {way:.3g} m; a synthetic aperture must be longer than half the "
            f"antenna ({sensor.aperture / 2:.3g} m), or it resolves no more than the beam.",
        )


def check_range_window(sensor: Sensor, reference_range: float) -> None:
    """Make sure that the frequencies tell apart all ranges at which the beams meet level ground.

    Args:
        sensor: with waveform "spectrum": beams and frequencies.
        reference_range: slant range of the middle of the beams, m.

    Raises:
        Rejected: they do not; echoes from beyond the window would appear within it.
    """
    first, last = sensor.beams.span
    lit = reference_range * (last - first) * np.tan((first + last) / 2)
    if lit > sensor.range_window * (1 + ROUNDING):
        raise Rejected(
            "aliased in range",
            f"The beams meet level ground over {lit:.4g} m of slant range, the frequencies tell "
            f"{sensor.range_window:.4g} m apart; they must be spaced "
            f"{sensor.frequency_step * sensor.range_window / lit:.4g} Hz or less.",
        )


def check_doppler_centroid(
    history: PhaseHistory, antenna: F64, sensor: Sensor, aperture: ApertureState, grid: Grid
) -> None:
    """Make sure that a spotlight dwell's Doppler centroid lies in the band that image or beam make up.

    The centroid is the phase from pulse to pulse, after dechirping to the aim point, averaged over everything (Madsen,
    IEEE Trans. AES 25, 1989). What lies outside was not lit where attitude and boresights say.

    Raises:
        Rejected: the centroid is outside.
    """
    aim = aim_point(sensor, aperture, float(np.mean(history.reference_range)))
    delay = np.linalg.norm(aim - antenna, axis=-1) - history.reference_range
    turn = np.exp(1j * sensor.centre_wavenumber * np.diff(delay))
    products = np.einsum("mpf,mpf->p", history.samples[:, :-1].conj(), history.samples[:, 1:])
    correlation = complex(np.sum(products * turn))
    if abs(correlation) <= COHERENT * float(np.sum(np.abs(products))):
        return  # noise, or errors of phase from pulse to pulse: there is no centroid
    slant_range = float(np.linalg.norm(aim - aperture.position))
    step = float(np.linalg.norm(antenna[-1] - antenna[0])) / (len(antenna) - 1)
    rate = float(np.linalg.norm(aperture.velocity)) / step
    half_width = max(grid.cols * grid.col_spacing, sensor.beamwidth * slant_range) / 2
    found = float(np.angle(correlation)) / (2 * np.pi) * rate
    allowed = 2 * half_width * step * rate / (sensor.wavelength * slant_range)
    if abs(found) > allowed:
        raise Rejected(
            "Doppler centroid outside the band",
            f"The Doppler centroid is {found:+.4g} Hz off that of the beams' middle, image and beam make up "
            f"{allowed:.4g} Hz to each side; attitude, boresights or odometry must be wrong.",
        )
