"""Images of successive spotlight dwells, and the pixel of a position in each.

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
from sal_height.numeric import C64, C128, F64, Bool, Index, ShortRepr
from sal_height.sensor import Sensor

COLUMN_STEPS = 4
"""Number of steps to which a column is interpolated: half of one costs 0.1 dB."""


@dataclass(frozen=True, eq=False)
class DwellImage(ShortRepr):
    """The image of a dwell.

    Attributes:
        pixels: pixels of channels of independent noise of one power, without the phase of their range, COLUMN_STEPS to
            a column, shape (channels, rows, steps).
        grid: grid of the image.
        aperture: state of the platform in the middle of the dwell.
        seconds: time of that after an arbitrary one, s.
        period: distance along the flight after which Doppler frequencies repeat, the width of the image, m.
        look_side: side of the flight, +1 right, -1 left.
        error: standard deviation of its offset along the flight that other dwells do not share, m.
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

        The width of an image may differ by 2 % from that of all Doppler frequencies, and the cosine of the angle
        between its rows and the line of sight by 1 % from 1.

        Raises:
            Rejected: it does not have all Doppler frequencies, or is in another plane than range and Doppler.
        """
        grid, aperture = slc.grid, slc.aperture
        sight = grid.middle - aperture.position
        slant_range = float(np.linalg.norm(sight))
        speed = float(np.linalg.norm(aperture.velocity))
        period = slant_range * (sensor.wavelength * sensor.pulse_repetition_frequency / 2 / speed)
        if float(grid.row_direction @ sight) < 0.99 * slant_range:
            raise Rejected(
                "image plane",
                "Movers are estimated in the plane of range and Doppler; set parameter image_plane of sar_compression "
                "to slant.",
            )
        if abs(grid.cols * grid.col_spacing / period - 1) > 0.02:
            raise Rejected(
                "Doppler of images",
                f"An image of a dwell has {grid.cols} columns; to find movers it needs all Doppler frequencies, "
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
        """Row, in fractions, and step of a target at rest at a position (m, map)."""
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
        """Elevation and squint of a position (m, map), rad."""
        _, elevation, squint = angles_of(place, self.aperture, self.look_side)
        return float(elevation), float(squint)

    def column(self, rows: Index, step: int) -> tuple[C64, Bool]:
        """Pixels of numbered rows at a step, shape (rows, channels), 0 beyond the image, and True where within it."""
        inside = (rows >= 0) & (rows < self.grid.rows)
        found = self.pixels[:, np.where(inside, rows, 0), step].T
        return np.where(inside[:, None], found, 0), inside

    def around(self, row: int, step: int, size: tuple[int, int]) -> C64:
        """Pixels within rows and columns to each side given by `size`, shape (channels, pixels)."""
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
