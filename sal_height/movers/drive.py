"""Velocity along the flight of targets in strips, by which their images are out of focus.

What drives along the flight with u passes the beam more slowly: its Doppler frequency f changes at the rate
(1 - u / v)^2 of what stands still, v being the speed of the platform. Its image has the spectrum of a point times
exp(j pi q f^2), f from -1/2 to 1/2 over the angle that is processed, and is smeared over

    q = n ((1 - u / v)^-2 - 1),  n = 2 angle^2 rho / wavelength

cells along the flight, rho being the range (Raney, IEEE Trans. AES 7, 1971). The q with which the image is sharpest
tells u, and where the image is.

Where autofocus has placed one block after the other, each with an error of its own, the image of what stands still is
smeared, too, by up to 40 cells where bright targets move. A smear tells no velocity then, and the times at which
Doppler frequencies are seen, by which a target walks, are as unsure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sal_height.geometry import aperture_at
from sal_height.imaging import Slc
from sal_height.movers.search import Search
from sal_height.movers.spectrum import Bins
from sal_height.numeric import C128, F64, vertex
from sal_height.sensor import Sensor

SMEAR_STEP, PLACE_STEP = 1.0, 0.25
"""Of the search for the sharpest image, in cells."""

LEAST_SHARPER = 10**0.05
"""Power of an image in focus over that out of focus from which its target is said to drive along the flight."""

IN_FOCUS = 0.7
"""Power of its brightest pixel over that of a point in focus from which the image of a whole row is one.

Points of 24 to 34 dB over the cells of a street reach 0.85."""

ABOUT_IN_FOCUS = 0.5
"""The same of the pixels around a target, from which it may be told.

Of 29 movers in strips of exact odometry those of which all was right had 0.59 and more, where their smear was taken
out; seven that drove along the flight faster than is looked for, or beside brighter ones, had 0.37 at most, and places
up to half a metre off."""

SMEAR_ERROR = 1.0
"""Standard deviation of the smear that other targets leave, in cells."""

SMEAR_OF_BLOCKS = 2 * np.sqrt(2)
"""Smear by errors of the places of blocks, over that of one: each half of the aperture lies in another block."""


@dataclass(frozen=True, eq=False)
class Drive:
    """How a target drives along the flight.

    Attributes:
        along: velocity along the flight, and its standard deviation, m/s; None: the whole image may be out of focus.
        smear: that has been taken out, over n (see above).
        speed: of the platform, m/s.
        col: of its image in focus.
        row: the row, or what the walk makes of it, in focus, shape (channels, cols).
    """

    along: tuple[float, float] | None
    smear: float
    speed: float
    col: int
    row: C128

    @property
    def share(self) -> float:
        """1 - u / v: speed with which the target passes the beam, over that of the platform."""
        return 1 - self.along[0] / self.speed if self.along else 1.0

    def slowed(self, velocity: tuple[float, float]) -> tuple[float, float]:
        """The walk and its standard deviation, m/s, that look so where Doppler frequencies change with the platform."""
        unsure = 2 * self.share * self.along[1] / self.speed if self.along else self.smear
        return self.share**2 * velocity[0], float(np.hypot(self.share**2 * velocity[1], unsure * velocity[0]))


@dataclass(frozen=True, eq=False)
class Drives:
    """What drives along the flight in an image.

    Attributes:
        search: whose spectra are those of whole rows.
        cells: n, see above.
        speed: of the platform, m/s.
        blur: standard deviation of the smear of what stands still, in cells.
    """

    search: Search
    cells: float
    speed: float
    blur: float

    @classmethod
    def of(cls, search: Search, slc: Slc, sensor: Sensor) -> Self:
        """Those of an image, whose rows `search` looks at as a whole."""
        grid = slc.grid
        middle = grid.middle
        slant_range = float(np.linalg.norm(middle - aperture_at(middle, slc.aperture).position))
        cells = 2 * search.bins.angle**2 * slant_range / sensor.wavelength
        speed = float(np.linalg.norm(slc.aperture.velocity))
        place = slc.placement.beams_error * slant_range / speed
        return cls(search, cells, speed, SMEAR_OF_BLOCKS * place / (search.bins.cell * grid.col_spacing))

    def blurred(self, velocity: tuple[float, float]) -> tuple[float, float]:
        """A walk and its standard deviation, m/s, with what an image out of focus does to the rate of its Doppler."""
        return velocity[0], float(np.hypot(velocity[1], self.blur / self.cells * velocity[0]))

    def look(self, spectra: C128, elevation: float) -> Drive | None:
        """How a target drives; None: not at all, as far as its image tells.

        Args:
            spectra: of the channels in its row, or along its walk, shape (bins, channels).
            elevation: rad.
        """
        bins = self.search.bins
        line = _line(self.search, spectra, elevation)
        most = len(line) // 2
        smears = np.arange(-most, most + SMEAR_STEP / 2, SMEAR_STEP)
        places, waves = _places(bins)
        focused = line * np.exp(-1j * np.pi * smears[:, None] * bins.frequencies**2)
        power = np.abs(focused @ waves) ** 2
        brightest = power.max(axis=1)
        best = int(np.clip(brightest.argmax(), 1, len(smears) - 2))
        sharper = brightest[best] / brightest[len(smears) // 2]
        share = brightest[best] / np.sum(np.abs(line)) ** 2  # 1: a point in focus
        if sharper < LEAST_SHARPER or share < IN_FOCUS:
            return None
        smear = float(smears[best] + SMEAR_STEP * vertex(*brightest[best - 1 : best + 2])[0])
        place = float(places[power[best].argmax()])
        rate = 1 + smear / self.cells
        if rate <= 0:
            return None
        along, per_cell = self.speed * (1 - rate**-0.5), self.speed * rate**-1.5 / (2 * self.cells)
        published = None if self.blur else (along, per_cell * SMEAR_ERROR)
        col = bins.pixels // 2 + round(place * bins.cell)
        in_focus = spectra.T * np.exp(-1j * np.pi * smear * bins.frequencies**2)
        return Drive(published, smear / self.cells, self.speed, col, bins.image(in_focus))


def is_in_focus(search: Search, spectra: C128, elevation: float) -> bool:
    """Whether a target has the image of a point, about, as far as the pixels around it show.

    Otherwise it drives along the flight faster than is looked for, and the Doppler frequencies of these pixels are not
    all that it has.

    Args:
        search: whose spectra these are.
        spectra: of the channels, shape (bins, channels).
        elevation: rad.
    """
    line = _line(search, spectra, elevation)
    _, waves = _places(search.bins)
    return bool(np.max(np.abs(line @ waves)) ** 2 >= ABOUT_IN_FOCUS * np.sum(np.abs(line)) ** 2)


def _line(search: Search, spectra: C128, elevation: float) -> C128:
    """Spectrum of the channels together, with a window, shape (bins,)."""
    beam = search.beams.response(elevation, search.bins.aspects)
    return np.asarray(np.sum(beam.conj() * spectra, axis=-1) / np.linalg.norm(beam, axis=-1) * np.hanning(len(spectra)))


def _places(bins: Bins) -> tuple[F64, C128]:
    """Places in an image, in cells, and the waves of the bins from there, shape (bins, places)."""
    places = np.arange(-len(bins.frequencies) / 2, len(bins.frequencies) / 2, PLACE_STEP)
    return places, np.exp(2j * np.pi * bins.frequencies[:, None] * places)
