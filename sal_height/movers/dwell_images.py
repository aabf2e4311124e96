"""Images of spotlight dwells that follow each other: where each shows one and the same place.

An image of a dwell has a column for each Doppler frequency. As wide as the pulse repetition frequency, it goes on at
its other edge, and everything that the beam lights is somewhere in it, whatever its radial velocity is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy.fft

from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid, angles_of, pixels_at, ranges_of_phase
from sal_height.imaging import Slc
from sal_height.numeric import C64, C128, F64, Bool, Index
from sal_height.sensor import Sensor

COLUMN_STEPS = 4
"""Steps to which columns are interpolated, in a column: half of one costs 0.1 dB."""

WHOLE = 0.02
"""Greatest difference of the width of an image from that of all Doppler frequencies, over that."""

SLANT = 0.99
"""Least cosine of the angle between the rows of an image and the line of sight."""


@dataclass(frozen=True, eq=False)
class DwellImage:
    """The image of a dwell.

    Attributes:
        pixels: of channels of independent noise of one power, without the phase of their range, COLUMN_STEPS to a
            column, shape (channels, rows, steps).
        grid: of the image.
        aperture: state of the platform in the middle of the dwell.
        seconds: time of that, after any.
        period: way along the flight after which Doppler frequencies come again, m: the width of the image.
        look_side: +1 right, -1 left.
        error: standard deviation of its place along the flight that other dwells do not share, m.
    """

    pixels: C64
    grid: Grid
    aperture: ApertureState
    seconds: float
    period: float
    look_side: int
    error: float = 0.0

    @classmethod
    def of(cls, images: C64 | C128, slc: Slc, seconds: float, sensor: Sensor) -> Self:
        """The image of an `Slc`, whose channels are combined to `images`, shape (channels, rows, cols).

        Raises:
            Rejected: it does not have all Doppler frequencies, or is in another plane than range and Doppler.
        """
        grid, aperture = slc.grid, slc.aperture
        sight = grid.middle - aperture.position
        slant_range = float(np.linalg.norm(sight))
        speed = float(np.linalg.norm(aperture.velocity))
        period = slant_range * (sensor.wavelength * sensor.pulse_repetition_frequency / 2 / speed)
        if float(grid.row_direction @ sight) < SLANT * slant_range:
            raise Rejected(
                "image plane",
                "Movers are detected in the plane of range and Doppler; set parameter image_plane of "
                "sar_compression to "
                "slant.",
            )
        if abs(grid.cols * grid.col_spacing / period - 1) > WHOLE:
            raise Rejected(
                "Doppler of images",
                f"An image of a dwell has {grid.cols} columns; to detect movers it needs all Doppler frequencies, "
                f"{period / grid.col_spacing:.0f} columns (parameter cols of sar_compression).",
            )
        phases = np.exp(-4j * np.pi / sensor.wavelength * ranges_of_phase(grid, aperture))
        flat = (np.where(np.isfinite(images), images, 0) * phases).astype(np.complex64)
        error = slc.placement.own_error * slant_range / speed
        return cls(_interpolated(flat), grid, aperture, seconds, period, sensor.look_side, error)

    @property
    def steps(self) -> int:
        """Steps along a row."""
        return self.pixels.shape[-1]

    @property
    def power(self) -> F64:
        """Sum over the channels, at the columns, shape (rows, cols)."""
        return np.asarray(np.sum(np.abs(self.pixels[..., ::COLUMN_STEPS]) ** 2, axis=0), np.float64)

    def shows(self, place: F64) -> tuple[float, int]:
        """Row, in fractions, and step at which the image has what stands still at a place (m, map)."""
        sight = place - self.aperture.position
        along, reach = float(sight @ self.aperture.direction), float(np.linalg.norm(sight))
        grid = self.grid
        middle = grid.middle - self.aperture.position
        off = along - float(middle @ self.aperture.direction)
        wrapped = along - self.period * float(np.rint(off / self.period))
        across = np.sqrt(np.asarray(reach**2 - wrapped**2, np.float64))
        row, col = pixels_at(across, np.asarray(wrapped, np.float64), self.aperture, grid)
        return float(row), round(float(col) * COLUMN_STEPS) % self.steps

    def angles(self, place: F64) -> tuple[float, float]:
        """Elevation and squint under which a place (m, map) is seen, rad."""
        _, elevation, squint = angles_of(place, self.aperture, self.look_side)
        return float(elevation), float(squint)

    def column(self, rows: Index, step: int) -> tuple[C64, Bool]:
        """Pixels of numbered rows at a step, shape (rows, channels), 0 beyond the image, and whether they are in it."""
        inside = (rows >= 0) & (rows < self.grid.rows)
        found = self.pixels[:, np.where(inside, rows, 0), step].T
        return np.where(inside[:, None], found, 0), inside

    def around(self, row: int, step: int, size: tuple[int, int]) -> C64:
        """Pixels so many rows and columns to each side, shape (channels, pixels)."""
        rows = np.arange(max(0, row - size[0]), min(self.grid.rows, row + size[0] + 1))
        steps = step + COLUMN_STEPS * np.arange(-size[1], size[1] + 1)
        return self.pixels[:, rows[:, None], steps % self.steps].reshape(len(self.pixels), -1)


def _interpolated(images: C64) -> C64:
    """Images with COLUMN_STEPS steps to a column, of which the first is the column itself."""
    cols = images.shape[-1]
    spectrum = scipy.fft.fft(images, axis=-1)
    wide = np.zeros((*images.shape[:-1], cols * COLUMN_STEPS), np.complex64)
    wide[..., : (cols + 1) // 2] = spectrum[..., : (cols + 1) // 2]
    wide[..., wide.shape[-1] - cols // 2 :] = spectrum[..., (cols + 1) // 2 :]
    return np.asarray(scipy.fft.ifft(wide, axis=-1) * COLUMN_STEPS, np.complex64)
