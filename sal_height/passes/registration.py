"""Shifts between the images of the passes: errors of position along range and along the flight.

An antenna with an error of position d along the flight or towards the scene sees it shifted by d. Images of bright
points are compared with the median of those of all passes; a common shift is not observable, and does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sal_height.numeric import C64, F64, vertex
from sal_height.passes.array import PassArray
from sal_height.passes.boxes import Box, Lattice, background
from sal_height.passes.settings import PassSettings


@dataclass(frozen=True, eq=False)
class Registered:
    """Passes with aligned images.

    Attributes:
        lattice: lattice with the antennas of the passes moved.
        boxes: boxes on the ground.
        images: images of all passes in these, with the background's power 1.
        background: power of the background in each pass, shape (passes,).
        shifts: shifts that were removed, in range and along the flight, shape (passes, 2), m.
    """

    lattice: Lattice
    boxes: Sequence[Box]
    images: Sequence[C64]
    background: F64
    shifts: F64


def registered(array: PassArray, settings: PassSettings) -> Registered:
    """Estimate and remove the shifts between the images of the passes, twice, and those above a quarter of a pixel.

    Smaller ones are estimated better from phases.

    Raises:
        UserError: a pass has no signal, or the volume is too large.
    """
    shifts = np.zeros((len(array.passes), 2))
    lattice = Lattice.of(array, settings)
    lattice.check_size()
    boxes = lattice.on_ground(settings)
    for last in (False, False, True):
        images = lattice.images(boxes)
        level = background(images)
        images = [(image / np.sqrt(level)[:, None, None]).astype(np.complex64) for image in images]
        if last:
            break
        found = measured_shifts(images, lattice, settings.largest_shift_m)
        found = np.where(np.abs(found) > 0.25 * np.array(lattice.spacing), found, 0.0)
        if not found.any():
            break
        shifts += found
        # A scene that appears too far was seen from farther back, and one that appears ahead from farther behind.
        lattice = Lattice.of(array.moved(-shifts @ array.axes[:2]), settings)
        boxes = lattice.on_ground(settings)
    return Registered(lattice, boxes, images, level, shifts)


def measured_shifts(images: Sequence[C64], lattice: Lattice, largest: float) -> F64:
    """Shift of each pass against the median of all, in range and along the flight, m, shape (passes, 2).

    The peak of the sum over boxes of the correlation of amplitudes; 0 where the largest is 0.
    """
    spacing = np.array(lattice.spacing)
    reach = np.minimum(np.floor(largest / spacing).astype(int), np.array(images[0].shape[1:]) // 2 - 1)
    total = np.zeros((len(images[0]), *(2 * reach + 1)))
    for image in images:
        amplitude = np.nan_to_num(np.abs(image))
        usual = np.median(amplitude, axis=0)
        spectra = np.fft.fft2(amplitude - amplitude.mean(axis=(1, 2), keepdims=True))
        against = np.fft.fft2(usual - usual.mean())
        correlation = np.fft.fftshift(np.fft.ifft2(spectra * against.conj()).real, axes=(1, 2))
        middle = np.array(image.shape[1:]) // 2
        low, high = middle - reach, middle + reach + 1
        total += correlation[:, low[0] : high[0], low[1] : high[1]]
    return np.array([_peak(one) - reach for one in total]) * spacing


def _peak(values: F64) -> F64:
    """Position of the greatest value, by parabolas; shape (2,)."""
    at = np.unravel_index(np.argmax(values), values.shape)
    place = np.array(at, np.float64)
    for axis in (0, 1):
        if 0 < at[axis] < values.shape[axis] - 1:
            line = np.take(values, at[1 - axis], axis=1 - axis)
            place[axis] += vertex(*line[at[axis] - 1 : at[axis] + 2])[0]
    return place
