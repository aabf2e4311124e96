"""The error of elevation by scatterers elsewhere, whose sidelobes reach into a pixel.

A sidelobe adds B a(t') to the samples A a(t) of a pixel's look. To first order the estimate of elevation moves by

    Re(B / A) p(t' - t),    p(d) = Re(u'^H u(t + d)) / |u'|^2

with the unit response u = a / |a| (A and B times |a|) and u' the part of its slope perpendicular to it: by the distance
itself if that is small, and by nothing beyond a beamwidth or so. Over K looks of the energy E in all, and with the
phases of speckle, its variance is

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

LEAST_PULLS = 2**18
"""Pulls that are worth a thread: 1 ms."""


def sidelobe_variance(
    elevation: F64, looks: Looks, beams: Beams, windows: tuple[Window, Window], response: CellResponse
) -> F64:
    """Variance of elevation (rad^2) by the sidelobes of the scatterers in other pixels of the same row or column.

    So it is with what phases that err from pulse to pulse spread along azimuth.

    Beyond the edge of the image the ground is taken to go on, turned by half a turn about the edge.

    Args:
        elevation: of the strongest scatterer in each pixel, rad, shape (rows, cols); NaN where none is known.
        looks: the pixels.
        beams: of the channels.
        windows: looks in range and in azimuth.
        response: of the images.
    """
    table, noise = squared_pull(beams), looks.receiver_noise * beams.count
    known = np.isfinite(elevation)
    place = np.where(known, elevation, 0.0) * (PULL_STEPS / beams.beamwidth)
    # Mean power of the looks' scatterers over all channels.
    mean = np.divide(looks.power, looks.count, where=looks.count > 0, out=np.zeros_like(place))
    power = np.where(known, np.maximum(mean - noise, 0.0), 0.0)
    pulled = np.zeros_like(place)
    _add_along(place, power, pulled, shares_of_pixels(response.down, windows[0].step), table)
    step = windows[1].step
    shares = shares_of_pixels(response.across, step) + response.pedestal * step
    _add_along(place.T, power.T, pulled.T, shares, table)
    # The scatterers' energy is uncertain by that of the noise of one channel at least.
    energy = looks.count * np.maximum(power, looks.receiver_noise)
    return np.divide(pulled, 2 * energy, where=energy > 0, out=np.zeros_like(pulled))


def _add_along(place: F64, power: F64, pulled: F64, shares: F64, table: F64) -> None:
    """`add_pulls` on all processors."""

    def add(columns: slice) -> None:
        add_pulls(place[:, columns], power[:, columns], pulled[:, columns], shares, table)

    in_parallel(add, place.shape[1], -(-LEAST_PULLS // max(1, 2 * len(place) * len(shares))))


@lru_cache(maxsize=8)
def squared_pull(beams: Beams) -> F64:
    """p^2 in rad^2 at distances from -PULL_SPAN to PULL_SPAN beamwidths in steps of 1 / PULL_STEPS, mid-array.

    Beams are told apart by their identity.
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
def shares_of_pixels(axis: AxisResponse, step: int) -> F64:
    """Share of a scatterer's energy that its sidelobes bring to a look of the pixel 1, 2, ... pixels on.

    Args:
        axis: response along it.
        step: samples from one pixel to the next.
    """
    whole, near = axis.shares()
    first = REACH + step - (step - 1) // 2
    beyond = (whole - near)[first:]
    return np.asarray(beyond[: len(beyond) // step * step].reshape(-1, step).sum(axis=1))
