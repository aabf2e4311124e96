"""Velocity along the flight of targets in strips, by which their images are out of focus.

What drives along the flight with u passes the beam more slowly: its Doppler frequency f changes at the rate
(1 - u / v)^2 of what stands still, v being the speed of the platform. Its image has the spectrum of a point times
exp(j pi q f^2), f from -1/2 to 1/2 over the angle that is processed, and is smeared over

    q = n ((1 - u / v)^-2 - 1),  n = 2 angle^2 rho / wavelength

cells along the flight, rho being the range (Raney, IEEE Trans. AES 7, 1971). The q with which the image is sharpest
tells u, and where the image is.

Where autofocus has placed one block after the other, each with an error of its own, the image of what stands still is
smeared, too. A smear that may come from that tells no velocity, and the times at which Doppler frequencies are seen,
by which a target walks, are as unsure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sal_height.geometry import aperture_at
from sal_height.imaging import Slc
from sal_height.movers.search import Search
from sal_height.numeric import C128, vertex
from sal_height.sensor import Sensor

SMEAR_STEP, PLACE_STEP = 1.0, 0.25
"""Of the search for the sharpest image, in cells."""

LEAST_SHARPER = 10**0.05
"""Power of an image in focus over that out of focus from which its target is said to drive along the flight."""

MUCH_SHARPER, LEAST_SHARE = 1.2, 0.1
"""The same, and power of its brightest pixel over that of a point in focus, from which an image is that of a target
which drives along the flight, though it is not in focus with any smear: in a row there is more than one target."""

IN_FOCUS = 0.7
"""Power of its brightest pixel over that of a point in focus from which an image is one.

Points of 24 to 34 dB over the cells of a street reach 0.85."""

SMEAR_ERROR = 1.0
"""Standard deviation of the smear that other targets leave, in cells."""

SMEAR_OF_BLOCKS = 2 * np.sqrt(2)
"""Smear by errors of the places of blocks, over that of one: each half of the aperture lies in another block."""

SURE = 5.0
"""Standard deviations of the smear of the whole image from which a target's own is told from it."""


@dataclass(frozen=True, eq=False)
class Drive:
    """How a target drives along the flight.

    Attributes:
        along: velocity along the flight, and its standard deviation, m/s; None: the whole image may be out of focus.
        speed: of the platform, m/s.
        col: of its image in focus.
        row: the row, or what the walk makes of it, in focus, shape (channels, cols).
    """

    along: tuple[float, float] | None
    speed: float
    col: int
    row: C128

    @property
    def share(self) -> float:
        """1 - u / v: speed with which the target passes the beam, over that of the platform."""
        return 1 - self.along[0] / self.speed if self.along else 1.0

    def slowed(self, walk: tuple[float, float]) -> tuple[float, float]:
        """The walk and its standard deviation, m/s, that look so where Doppler frequencies change with the platform."""
        unsure = 2 * self.share * self.along[1] / self.speed if self.along else 0.0
        return self.share**2 * walk[0], float(np.hypot(self.share**2 * walk[1], unsure * walk[0]))


class OutOfFocus(Exception):  # noqa: N818 (it is what is found, not an error)
    """A target drives along the flight faster than can be told, so that nothing of it can."""


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

    def blurred(self, walk: tuple[float, float]) -> tuple[float, float]:
        """A walk and its standard deviation, m/s, with what an image out of focus does to the rate of its Doppler."""
        return walk[0], float(np.hypot(walk[1], self.blur / self.cells * walk[0]))

    def look(self, spectra: C128, elevation: float) -> Drive | None:
        """How a target drives; None: not at all, as far as its image tells.

        Args:
            spectra: of the channels in its row, or along its walk, shape (bins, channels).
            elevation: rad.

        Raises:
            OutOfFocus: its image is much sharper with some smear taken out, but in focus with none that is looked for.
        """
        bins = self.search.bins
        beam = self.search.beams.response(elevation, bins.aspects)
        line = np.sum(beam.conj() * spectra, axis=-1) / np.linalg.norm(beam, axis=-1) * np.hanning(len(spectra))
        most = len(line) // 2
        smears = np.arange(-most, most + SMEAR_STEP / 2, SMEAR_STEP)
        places = np.arange(-len(line) / 2, len(line) / 2, PLACE_STEP)
        waves = np.exp(2j * np.pi * bins.frequencies[:, None] * places)
        focused = line * np.exp(-1j * np.pi * smears[:, None] * bins.frequencies**2)
        power = np.abs(focused @ waves) ** 2
        brightest = power.max(axis=1)
        best = int(np.clip(brightest.argmax(), 1, len(smears) - 2))
        sharper = brightest[best] / brightest[len(smears) // 2]
        share = brightest[best] / np.sum(np.abs(line)) ** 2  # 1: a point in focus
        if sharper > MUCH_SHARPER and LEAST_SHARE < share < IN_FOCUS:
            raise OutOfFocus
        if sharper < LEAST_SHARPER or share < IN_FOCUS:
            return None
        smear = float(smears[best] + SMEAR_STEP * vertex(*brightest[best - 1 : best + 2])[0])
        place = float(places[power[best].argmax()])
        rate = 1 + smear / self.cells
        if rate <= 0:
            return None
        along, per_cell = self.speed * (1 - rate**-0.5), self.speed * rate**-1.5 / (2 * self.cells)
        told = (along, per_cell * float(np.hypot(SMEAR_ERROR, self.blur))) if abs(smear) > SURE * self.blur else None
        col = bins.pixels // 2 + round(place * bins.cell)
        in_focus = spectra.T * np.exp(-1j * np.pi * smear * bins.frequencies**2)
        return Drive(told, self.speed, col, bins.image(in_focus))
