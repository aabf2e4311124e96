"""Stripmap: the antenna is fixed to the body, and every point of the ground has the aperture in which beams pass it."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from sal_height.beams import Beams
from sal_height.geometry import look_direction
from sal_height.numeric import (
    C64,
    F32,
    F64,
    OVERSAMPLING,
    TAPS,
    Complex,
    spectra_of_profiles,
    tap_polynomials,
    tap_weights,
    unit_phasors,
)
from sal_height.sensor import Sensor, lit_angle
from sal_height.simulation._kernels import spread_echoes
from sal_height.simulation.scene import VisibleSurface


def mean_square_gain(beams: Beams) -> float:
    """Mean square over the processed angle of the first detector's pattern, for a target at the boresight's elevation.

    A focused pixel is the mean of its pulses. Noise has the power of a sample over their number; the cells of level
    ground have, by Parseval, that of a beam that is even over the aperture, times this gain. (A point has at its peak
    the square of the mean of the pattern instead: for the square aperture 0.07 dB less.)
    """
    nodes = (np.arange(1000) + 0.5) / 1000 - 0.5
    along = math.sin(beams.rotation) * (beams.track_beamwidth / beams.beamwidth)
    beside = math.cos(beams.rotation) * (beams.track_beamwidth / beams.beamwidth_beside)
    return float(np.mean(np.abs(beams.patterns[0].amplitude(nodes * along, nodes * beside)) ** 2))


def simulate_block(
    sensor: Sensor,
    surface: VisibleSurface,
    amplitudes: Complex,
    antenna: F64,
    rotation: F64,
    reference_range: F64,
    seconds: npt.ArrayLike = 0.0,
    quartic_phase: float = 0.0,
) -> C64:
    """Noise-free phase history of every detector with the antenna fixed to the body.

    A scatterer has in each pulse the weight of the direction in which the body sees it then, and none when it is more
    than `lit_angle`, along the flight, from where the beams meet the ground at the reference range (which is asked of
    the positions as given). As in `simulate_dwell` that is the weight of the receiving beam.

    The sum over scatterers at every frequency is the adjoint of reading a range profile at their delays: each is spread
    with the interpolator's kernel onto a dense profile, whose FFT is then divided by that of the kernel.

    Angles are measured from the middle of the beams, and phases reduced to a turn, in float64; what follows is float32,
    which has as many digits as the samples need and is several times faster.

    Args:
        sensor: wavelength, frequencies and beams.
        surface: scatterers; where they are, not how they were seen.
        amplitudes: of the scatterers, shape (scatterers,).
        antenna: position at each pulse on a flight eastwards, m, shape (pulses, 3).
        rotation: matrix that turns body into map axes at each pulse, shape (pulses, 3, 3).
        reference_range: m, shape (pulses,).
        seconds: times of the pulses after that of the surface's positions; broadcasts with (pulses,).
        quartic_phase: of a scatterer half a beamwidth off the beams' middle along the flight, growing with the fourth
            power of that angle, rad.

    Returns:
        Complex64 samples, shape (detectors, pulses, frequencies).
    """
    order = np.argsort(surface.positions[:, 0], kind="stable")
    positions, strengths = surface.positions[order], amplitudes[order].astype(np.complex64)
    velocity, moving = surface.velocity[order], bool(np.any(surface.velocity))
    east = positions[:, 0].copy()
    middle = float(np.mean(sensor.beams.span))
    beams = replace(sensor.beams, boresights=(sensor.beams.boresights - middle).astype(np.float32), middle=0.0)
    boresight = look_direction(middle, 0.0, sensor.look_side)
    outwards = look_direction(middle + np.pi / 2, 0.0, sensor.look_side)
    taps, dense = tap_polynomials(), OVERSAMPLING * sensor.sample_count
    axes = np.stack([np.array([1.0, 0.0, 0.0]), outwards, boresight], axis=-1)

    def pulse_profile(position: F64, rotation: F64, reference: float, second: float) -> F32:
        reach = lit_angle(sensor.beams) * reference
        aim = position[0] + reference * (rotation @ boresight)[0]
        lit = slice(*np.searchsorted(east, (aim - reach, aim + reach)))
        there = positions[lit] + second * velocity[lit] if moving else positions[lit]
        sight = np.einsum("si,ij->js", there - position, rotation @ axes)  # no BLAS: its threads would wait
        distance = np.sqrt(np.einsum("is,is->s", sight, sight))
        delay = distance - reference
        elevation = np.arctan2(sight[1].astype(np.float32), sight[2].astype(np.float32))
        squint = np.arcsin((sight[0] / distance).astype(np.float32))
        response = beams.response(elevation, squint)
        beam_phase = quartic_phase * np.square(np.square(squint * (2 / sensor.beams.track_beamwidth)))
        echoes = strengths[lit] * unit_phasors(beam_phase - sensor.centre_wavenumber * delay)
        place = np.mod(delay * (dense / sensor.range_window) + dense // 2, dense)
        before = np.floor(place).astype(np.int32)
        profile = np.zeros((dense + TAPS, 2 * sensor.detector_count), dtype=np.float32)
        weights = tap_weights((place - before).astype(np.float32), taps)
        spread_echoes(before + 1, weights, echoes, response.real.astype(np.float32), profile)
        if np.iscomplexobj(response):
            spread_echoes(before + 1, weights, 1j * echoes, response.imag.astype(np.float32), profile)
        return profile

    with ThreadPoolExecutor() as pool:
        pulses = (antenna, rotation, reference_range, np.broadcast_to(seconds, len(antenna)))
        profiles = np.stack(list(pool.map(pulse_profile, *pulses)))
    real, imaginary = np.split(profiles, 2, axis=-1)
    return spectra_of_profiles(real + 1j * imaginary)
