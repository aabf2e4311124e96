"""The error of elevation caused by the sidelobes of scatterers in other pixels.

A sidelobe adds B a(t') to the samples A a(t) of a pixel's look. To first order the estimate of elevation moves by

    Re(B / A) p(t' - t),    p(d) = Re(u'^H u(t + d)) / |u'|^2

with the unit response u = a / |a| (A and B times |a|) and u' the part of its slope perpendicular to it: by the
difference itself if that is small, and hardly at all beyond a beamwidth. Over K looks of the total energy E, and with
the phases of speckle, its variance is

    sum over pixels of (expected power of their sidelobes in a look) p^2 / (2 E)
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.bounds import unit_vectors
from sal_height.elevation.looks._look_kernels import add_pulls
from sal_height.elevation.looks.cell_response import REACH, AxisResponse, CellResponse
from sal_height.elevation.looks.look_windows import Window
from sal_height.elevation.looks.looks import Looks
from sal_height.numeric import F64, in_parallel

PULL_SPAN = 4.0
"""Beamwidths to each side over which the pull of another elevation is tabulated; beyond, it is that at the end."""

PULL_STEPS = 64
"""Steps of the table per beamwidth."""


def sidelobe_variance(
    elevation: F64, looks: Looks, beams: Beams, windows: tuple[Window, Window], response: CellResponse
) -> F64:
    """Variance of elevation (rad^2) caused by sidelobes of the scatterers in other pixels of the same row or column.

    The energy that random phase errors of pulses spread along azimuth is included. Beyond the edge of the image the
    ground is continued, rotated by half a turn about the edge.

    Args:
        elevation: elevation of the strongest scatterer in each pixel, NaN where unknown, shape (rows, cols), rad.
        looks: covariance of the pixels.
        beams: beams of the channels.
        windows: looks in range and in azimuth.
        response: impulse response of the images.
    """
    table, noise = squared_pull(beams), looks.receiver_noise * beams.count
    known = np.isfinite(elevation)
    position = np.where(known, elevation, 0.0) * (PULL_STEPS / beams.beamwidth)
    # Mean power of the looks' scatterers over all channels.
    mean = np.divide(looks.power, looks.count, where=looks.count > 0, out=np.zeros_like(position))
    power = np.where(known, np.maximum(mean - noise, 0.0), 0.0)
    pulled = np.zeros_like(position)
    _add_along(position, power, pulled, sidelobe_fractions(response.down, windows[0].step), table)
    step = windows[1].step
    fractions = sidelobe_fractions(response.across, step) + response.pedestal * step
    _add_along(position.T, power.T, pulled.T, fractions, table)
    # The scatterers' energy is uncertain by that of the noise of one channel at least.
    energy = looks.count * np.maximum(power, looks.receiver_noise)
    return np.divide(pulled, 2 * energy, where=energy > 0, out=np.zeros_like(pulled))


def _add_along(position: F64, power: F64, pulled: F64, fractions: F64, table: F64) -> None:
    """`add_pulls` on all processors."""

    def add(columns: slice) -> None:
        add_pulls(position[:, columns], power[:, columns], pulled[:, columns], fractions, table)

    # 2^18 pulls take 1 ms, for which another thread pays.
    in_parallel(add, position.shape[1], -(-(2**18) // max(1, 2 * len(position) * len(fractions))))


@lru_cache(maxsize=8)
def squared_pull(beams: Beams) -> F64:
    """p^2 in rad^2 at distances from -PULL_SPAN to PULL_SPAN beamwidths in steps of 1 / PULL_STEPS, mid-array.

    Beams are distinguished by their identity.
    """
    count = round(PULL_SPAN * PULL_STEPS)
    distance = np.arange(-count, count + 1) / PULL_STEPS * beams.beamwidth
    middle = float(np.mean(beams.span))
    here, slope = beams.response(middle, 0.0), beams.slope(middle, 0.0)
    norm = np.linalg.norm(here)
    unit = here / norm
    turn = (slope - unit * np.sum(unit.conj() * slope)) / norm
    pull = (unit_vectors(beams.response(middle + distance, 0.0)) @ turn.conj()).real / np.sum(np.abs(turn) ** 2)
    return np.asarray(pull**2, dtype=np.float64)


@lru_cache(maxsize=16)
def sidelobe_fractions(axis: AxisResponse, step: int) -> F64:
    """Fraction of a scatterer's energy in the sidelobes at a look of the pixel at a distance of 1, 2, ... pixels.

    Args:
        axis: response along the axis.
        step: distance of pixels, samples.
    """
    whole, near = axis.fractions()
    first = REACH + step - (step - 1) // 2
    beyond = (whole - near)[first:]
    return np.asarray(beyond[: len(beyond) // step * step].reshape(-1, step).sum(axis=1))
