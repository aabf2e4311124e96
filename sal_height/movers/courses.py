"""Targets of any course: found by undoing the smear along the flight and the range migration together.

What drives along the flight with u passes the beam at the speed v - u, so that its spectrum along the flight has the
phase pi s f^2 beyond that of a target at rest, f being the frequency in cycles per resolution cell and s the smear in
cells (Raney, Synthetic aperture imaging radar and moving targets, 1971):

    s = n ((1 - u / v)^-2 - 1),    n = 2 angle^2 R / wavelength.

Each part of the Doppler band shows it in another position, s f before that in focus, and in another row if it recedes.
The powers of these parts along such a path are added for all smears and speeds, in each channel over what is usual
there: a car's elevation is another than that of the ground in its row. What is bright is looked at more closely. There
the amplitudes are added, which gives the energy E of the target over a background of power 1.

It moves if that is likelier than all that stands still: bright points in the rows and columns of its path, each of
which costs the logarithm of the number of cells in which it may be, or speckle that is brighter there. What is brighter
is taken out before, one after the other, so that a mover may be dimmer than what it passes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter

from sal_height.movers.likelihood import MODEL_ERROR
from sal_height.movers.migration import REACH, Migrations
from sal_height.movers.spectrum import Bins
from sal_height.numeric import C64, C128, F32, F64, Index, fast_length, vertex

PARTS = 8
"""Number of parts of the Doppler band in the first search."""

SMEAR_STEP = 12.0
"""Step of the smears of the first search, cells: half of it moves a target by a third of the cell of a part."""

STILL = 8
"""Greatest number of bright points that are taken out before a mover."""


@dataclass(frozen=True, eq=False)
class Bright:
    """A pixel that is bright with a smear and a migration undone.

    Attributes:
        row, col: row and column.
        speed: radial velocity whose migration is undone, m/s.
        smear: smear that is undone, cells.
        channel: channel in which it is brightest.
    """

    row: int
    col: int
    speed: float
    smear: float
    channel: int


@dataclass(frozen=True, eq=False)
class FocusedTarget:
    """A target with its smear and its migration undone.

    Attributes:
        row: row at the aspect 0, in fractions.
        place: position in focus, cells from the middle of the image.
        speed: radial velocity by the migration, and its standard deviation, m/s.
        smear: smear, and its standard deviation, cells.
        elevation: elevation, rad.
        energy: energy over a background of 1.
        likelihood_ratio: twice the logarithm of the likelihood ratio against all that stands still.
    """

    row: float
    place: float
    speed: tuple[float, float]
    smear: tuple[float, float]
    elevation: float
    energy: float
    likelihood_ratio: float


@dataclass(frozen=True, eq=False)
class _PathOfTarget:
    """Path of a target: its row and place, radial velocity and smear, as in `FocusedTarget`."""

    row: float
    place: float
    speed: float
    smear: float


@dataclass(frozen=True, eq=False)
class _SpectraOfRows:
    """Spectra of rows around a path, of one channel or combined for an elevation, over a background of power 1.

    Attributes:
        numbers: numbers of the rows, shape (rows,).
        spectra: spectra, shape (rows, bins).
        bins: bins.
        shapes: amplitudes of the beam in the bins for some lags, each of norm 1, shape (lags, bins).
    """

    numbers: Index
    spectra: C128
    bins: Bins
    shapes: F64

    def matched(self, phases: C128) -> C128:
        """Amplitudes of targets with some lags whose spectra have these phases, shape (..., rows, bins)."""
        along = np.sum(phases.conj() * self.spectra, axis=-2)
        return np.asarray(along @ self.shapes.T)


@dataclass(frozen=True, eq=False)
class Courses:
    """Search for targets of any course in an image.

    Attributes:
        rows: search for migrations with spectra of whole rows.
        chip: bins of the pixels around a target in focus.
        smears: smears of the first search, cells.
        columns: first column in which targets are looked for, and the one after the last.
        together: number of points at rest that may together look like one mover.
    """

    rows: Migrations
    chip: Bins
    smears: F64
    columns: tuple[int, int]
    together: int = 3

    @property
    def hypotheses(self) -> int:
        """Number of speeds, smears and places that a look compares: about each pair of the first search a hundred."""
        return 100 * len(self._speeds) * len(self.smears)

    def candidates(self, prominence: float) -> list[Bright]:
        """Bright pixels with some smear and speed undone: peaks of the power over that of their row.

        Args:
            prominence: least energy over the background.
        """
        power, channels, speeds, smears = self._brightest()
        peaks = (power == maximum_filter(power, size=(5, 5))) & (power > PARTS + prominence)
        # A sidelobe has up to -25 dB of the brightest pixel in the same rows or columns.
        rows = maximum_filter(power.max(axis=1), size=3)
        columns = maximum_filter(power.max(axis=0), size=5)
        peaks &= power > 10**-2.5 * np.maximum(columns, rows[:, None])
        return [
            Bright(
                row,
                round((place + int(self.columns[0] / self._step)) * self._step),
                float(self._speeds[speeds[row, place]]),
                float(self.smears[smears[row, place]]),
                int(channels[row, place]),
            )
            for row, place in np.argwhere(peaks).tolist()
        ]

    @cached_property
    def _speeds(self) -> F64:
        """Speeds of the first search, of which a half step makes a row, m/s."""
        count = int(np.ceil(self.rows.fastest / (2 * self.rows.speed_of_row)))
        return self.rows.fastest / max(1, count) * np.arange(-count, count + 1, dtype=np.float64)

    @property
    def _places(self) -> int:
        """Number of positions of the image of a part of the band: two per cell of it."""
        return 2 * (-(-len(self.rows.search.bins.numbers) // PARTS))

    @property
    def _step(self) -> float:
        """Pixels from one of these positions to the next."""
        return self.rows.search.images.shape[-1] / self._places

    def _brightest(self) -> tuple[F32, Index, Index, Index]:
        """The greatest power over the background at each row and position, and its channel, speed and smear."""
        bins, images = self.rows.search.bins, self.rows.search.images
        groups = np.array_split(np.arange(len(bins.numbers)), PARTS)
        centres = np.array([np.mean(bins.frequencies[group]) for group in groups])
        shifts = np.rint(self.smears[:, None] * centres * bins.cell / self._step).astype(np.intp)
        margin = int(np.abs(shifts).max())
        side = ((0, 0), (0, 0), (margin, margin))
        first, last = int(self.columns[0] / self._step), math.ceil(self.columns[1] / self._step)
        shape = images.shape[1], last - first
        best = np.zeros(shape, np.float32)
        channels, speeds, smears = (np.zeros(shape, np.intp) for _ in range(3))
        total = np.empty((len(images), *shape), np.float32)
        for speed, spectrum in enumerate(self._undone()):
            powers = [
                np.pad(self._power_of_part(spectrum[..., bins.numbers[group]]), side, constant_values=1.0)
                for group in groups
            ]
            for smear, offsets in enumerate(shifts.tolist()):
                total[:] = 0.0
                for power, offset in zip(powers, offsets, strict=True):
                    total += power[..., margin - offset + first : margin - offset + last]
                brightest = total.max(axis=0)
                better = brightest > best
                best[better], speeds[better], smears[better] = brightest[better], speed, smear
                channels[better] = total[:, better].argmax(axis=0)
        return best, channels, speeds, smears

    def _power_of_part(self, spectrum: C64) -> F32:
        """Power of the image of bins of the band over the median of its rows, shape (channels, rows, positions)."""
        image = scipy.fft.ifft(spectrum, n=self._places, axis=-1)
        power = np.asarray(image.real**2 + image.imag**2)
        median = np.median(power[..., ::2], axis=-1, keepdims=True)
        power *= np.float32(np.log(2)) / np.maximum(median, np.float32(1e-30))
        return power

    def _undone(self) -> Iterator[C64]:
        """Doppler spectra of the channels with the migration of each speed undone, shape (channels, rows, cols)."""
        images, speeds = self.rows.search.images, self._speeds
        rows, cols = images.shape[1:]
        length = fast_length(rows + 2 * int(np.ceil(abs(speeds[0]) / self.rows.speed_of_row)) + 2)
        spectrum = scipy.fft.fft2(images.astype(np.complex64), s=(length, cols), axes=(1, 2))
        turns = np.fft.fftfreq(length)[:, None] * (self.rows.slope * self.rows.aspects)
        for speed in speeds:
            undoing = np.exp(-2j * np.pi * speed * turns).astype(np.complex64)
            yield scipy.fft.ifft(spectrum * undoing, axis=1)[:, :rows]

    def look(self, bright: Bright, threshold: float) -> FocusedTarget | None:
        """The target of a bright pixel; None: what stands still explains it.

        Args:
            bright: bright pixel.
            threshold: likelihood ratio that must be exceeded.
        """
        search, bins = self.rows.search, self.rows.search.bins
        spread = REACH + int(np.ceil(0.5 * abs(bright.speed) / self.rows.speed_of_row + 0.5))
        numbers = np.arange(max(0, bright.row - spread), min(search.images.shape[1], bright.row + spread + 1))
        spectra = search.spectra(numbers, np.full(len(numbers), bins.pixels // 2))
        start = _PathOfTarget(
            float(bright.row), (bright.col - bins.pixels // 2) / bins.cell, bright.speed, bright.smear
        )
        path, energy = self._focused(numbers, spectra, start, bright)
        if 2 * energy < threshold or energy * self._backgrounds_of_channels[bright.row, bright.channel] < (
            self._sidelobes[numbers].max()
        ):
            return None
        direction, background, elevation = self._direction(numbers, spectra, path, bright)
        beam = search.beams.response(direction, bins.aspects)
        beam /= np.linalg.norm(beam, axis=-1, keepdims=True)
        whole = np.einsum("bc,rbc->rb", beam.conj(), spectra) / np.sqrt(background)
        found = self._refined(self._around(numbers, whole, path), path)
        around = self._around(numbers, whole, found)
        energy = float(self._energies(around, [replace(found, smear=0.0, place=0.0)])[0])
        ratio = self._ratio(_SpectraOfRows(numbers, whole, bins, self._shapes(bins)), found)
        # The image of what is at rest is not quite that of points, which leave 0.001 of its energy unexplained; of
        # points that recede with 5 to 15 m/s they leave 0.034 to 0.26.
        if ratio < max(threshold, 0.05 * energy):
            return None
        if not self.columns[0] <= found.place * bins.cell + bins.pixels // 2 < self.columns[1]:
            return None
        return self._course(around, found, elevation, ratio)

    @cached_property
    def _backgrounds_of_channels(self) -> F64:
        """Power of each channel in each row, by the median, shape (rows, channels)."""
        power = np.abs(self.rows.search.images) ** 2
        return np.maximum(np.median(power, axis=-1).T / np.log(2), 1e-300)

    @cached_property
    def _sidelobes(self) -> F64:
        """Power of sidelobes in each row: -25 dB of its brightest pixel, -40 dB of that of the image, shape (rows,)."""
        power = np.max(np.abs(self.rows.search.images) ** 2, axis=(0, 2))
        return np.maximum(10**-2.5 * power, 1e-4 * power.max())

    def _shapes(self, bins: Bins) -> F64:
        """Amplitudes of the beam in bins for some lags, each of norm 1, shape (lags, bins)."""
        beams = self.rows.search.beams
        lags = beams.track_beamwidth * np.arange(-1.0, 1.01, 0.25)
        gains = np.linalg.norm(bins.amplitudes(beams, float(np.mean(beams.span)), lags), axis=-1)
        return np.asarray(gains / np.linalg.norm(gains, axis=-1, keepdims=True))

    def _focused(
        self, numbers: Index, spectra: C128, start: _PathOfTarget, bright: Bright
    ) -> tuple[_PathOfTarget, float]:
        """The path about another for which a channel is brightest in focus, by smear and place, and its energy."""
        bins = self.rows.search.bins
        smears = start.smear + np.arange(-SMEAR_STEP, SMEAR_STEP + 0.5, 1.5)
        places = start.place + np.arange(-12.0, 12.5, 0.5)
        weights = self.rows.weights(numbers, np.array([start.row]), np.array([start.speed]))[0]
        along = np.sum(weights * spectra[..., bright.channel], axis=0)
        turned = along * np.exp(-1j * np.pi * smears[:, None] * bins.frequencies**2)
        waves = np.exp(2j * np.pi * bins.frequencies[:, None] * places)
        power = np.abs(turned @ waves) ** 2
        smear, place = np.unravel_index(power.argmax(), power.shape)
        background = self._backgrounds_of_channels[bright.row, bright.channel] * len(bins.frequencies)
        found = replace(start, smear=float(smears[smear]), place=float(places[place]))
        return found, float(power.max() / background)

    def _direction(
        self, numbers: Index, spectra: C128, path: _PathOfTarget, bright: Bright
    ) -> tuple[float, float, float]:
        """Elevation near the axis of a channel for which a target has the greatest energy over the background.

        Returns:
            That elevation, rad, the power of the background there, and the elevation near it of the greatest energy.
        """
        search = self.rows.search
        grid = search.elevation_grid
        responses = search.beams.response(grid, float(np.mean(search.bins.aspects)))
        axis = grid[np.abs(responses[:, bright.channel]).argmax()]
        along = np.einsum("rb,rbc->c", self._phases(numbers, search.bins, path).conj(), spectra)
        power = np.abs(responses.conj() @ along) ** 2 / np.sum(np.abs(responses) ** 2, axis=-1)
        near = np.flatnonzero(np.abs(grid - axis) <= 0.6 * search.beams.beamwidth)
        backgrounds = search.backgrounds(np.full(len(near), bright.row), grid[near])
        best = int((power[near] / backgrounds).argmax())
        peak = int(near[best])
        while not (power[peak] >= power[max(peak - 1, 0)] and power[peak] >= power[min(peak + 1, len(grid) - 1)]):
            peak += 1 if power[min(peak + 1, len(grid) - 1)] > power[peak] else -1
        return float(grid[near[best]]), float(backgrounds[best]), float(grid[peak])

    def _around(self, numbers: Index, whole: C128, path: _PathOfTarget) -> _SpectraOfRows:
        """The pixels around a target whose smear is undone, from spectra of whole rows, shape (rows, bins)."""
        bins, chip = self.rows.search.bins, self.chip
        undone = whole * np.exp(-1j * np.pi * path.smear * bins.frequencies**2)
        turned = undone * np.exp(2j * np.pi * bins.frequencies * path.place)
        middle = bins.pixels // 2 - chip.pixels // 2
        pixels = bins.image(turned)[:, middle : middle + chip.pixels]
        return _SpectraOfRows(numbers, chip.spectra(pixels), chip, self._shapes(chip))

    def _phases(self, numbers: Index, bins: Bins, paths: _PathOfTarget | list[_PathOfTarget]) -> C128:
        """Spectra of points on paths, norm 1 in each bin, shape (rows, bins), or (paths, rows, bins) of a list."""
        several = paths if isinstance(paths, list) else [paths]
        rows, places, speeds, smears = (
            np.array([getattr(one, name) for one in several]) for name in ("row", "place", "speed", "smear")
        )
        frequencies = bins.frequencies
        weights = self.rows.weights(numbers, rows, speeds, bins.aspects)
        phase = np.pi * (smears[:, None] * frequencies**2 - 2 * places[:, None] * frequencies)
        phases = np.asarray(weights * np.exp(1j * phase)[:, None])
        return phases if isinstance(paths, list) else np.asarray(phases[0])

    def _energies(self, line: _SpectraOfRows, paths: list[_PathOfTarget]) -> F64:
        """Energies of a target on paths, the greatest of some lags."""
        return np.asarray(np.max(np.abs(line.matched(self._phases(line.numbers, line.bins, paths))) ** 2, axis=-1))

    def _refined(self, around: _SpectraOfRows, about: _PathOfTarget) -> _PathOfTarget:
        """The path about another with the greatest energy, by the pixels around the target on that."""
        path = replace(about, smear=0.0, place=0.0)
        for size in (1.0, 0.5, 0.25, 0.125):
            steps = {"speed": 0.5 * size * self.rows.speed_of_row, "row": 0.25 * size, "smear": 2 * size, "place": size}
            for _ in range(6):
                before = path
                for one, other in (("speed", "row"), ("smear", "place")):
                    tried = [
                        replace(
                            path, **{name: getattr(path, name) + k * steps[name] for name, k in ((one, i), (other, j))}
                        )
                        for i in (0, -1, 1)
                        for j in (0, -1, 1)
                    ]
                    path = tried[int(self._energies(around, tried).argmax())]
                if path == before:
                    break
        return replace(path, smear=about.smear + path.smear, place=about.place + path.place)

    def _ratio(self, line: _SpectraOfRows, path: _PathOfTarget) -> float:
        """Twice the logarithm of the likelihood ratio of a mover against what stands still."""
        frequencies = line.bins.frequencies
        half = 0.5 * abs(path.smear) * (frequencies[-1] - frequencies[0]) + 4
        places = np.arange(path.place - half, path.place + half, 0.25)
        beam = line.shapes[len(line.shapes) // 2]
        waves = beam[:, None] * np.exp(2j * np.pi * frequencies[:, None] * places)
        margin = 0.5 * abs(path.speed) / self.rows.speed_of_row + 1.0
        fractions = np.arange(path.row - margin, path.row + margin + 0.1, 0.125)
        responses = self.rows.response(line.numbers - fractions[:, None])
        responses /= np.linalg.norm(responses, axis=1, keepdims=True)
        cost = math.log(4 * half * margin)
        phases = self._phases(line.numbers, line.bins, path)
        amplitudes, image = line.matched(phases), responses @ (line.spectra @ waves)
        alike, energies, movers, spoiled = responses @ responses.T, [], [], 0.0
        for _ in range(STILL + self.together):
            movers.append(float(np.max(np.abs(amplitudes) ** 2)) / (1 + MODEL_ERROR * spoiled))
            row, place = np.unravel_index(np.abs(image).argmax(), image.shape)
            amplitude = image[row, place]
            energies.append(float(np.abs(amplitude) ** 2))
            point = replace(line, spectra=responses[row][:, None] * waves[:, place].conj())
            seen = point.matched(phases)
            spoiled += energies[-1] * float(np.max(np.abs(seen) ** 2))
            amplitudes = amplitudes - amplitude * seen
            image = image - amplitude * np.multiply.outer(alike[:, row], waves[:, place].conj() @ waves)
        gains = np.maximum(np.array(energies) - cost, 0.0)
        return 2 * max(
            movers[taken] - math.log1p(movers[taken]) - float(gains[taken : taken + self.together].sum())
            for taken in range(STILL)
            if taken == 0 or gains[taken - 1] > 0
        )

    def _course(self, around: _SpectraOfRows, path: _PathOfTarget, elevation: float, ratio: float) -> FocusedTarget:
        """The target on a path, with the standard deviations of speed and smear by the bend of the energy."""
        middle = replace(path, smear=0.0, place=0.0)
        steps, sigmas = {"speed": self.rows.speed_of_row / 8, "smear": 0.5}, {}
        for name, step in steps.items():
            tried = [replace(middle, **{name: getattr(middle, name) + k * step}) for k in (-1, 0, 1)]
            # Errors of the beam's amplitudes are a background, too.
            energies = self._energies(around, tried)
            known = energies / (1 + MODEL_ERROR * energies.max() / len(around.bins.numbers))
            before, there, after = known.tolist()
            sigmas[name] = step / math.sqrt(vertex(before, there, after)[1])
        lag = np.abs(around.matched(self._phases(around.numbers, around.bins, middle))).argmax()
        if abs(int(lag) - len(around.shapes) // 2) >= 3:
            # At an end of the band, where its ambiguity is at the other end, up to 5 m/s were wrong.
            sigmas["speed"] = math.hypot(sigmas["speed"], 0.3 * self.rows.speed_of_row)
        speed, smear = (path.speed, sigmas["speed"]), (path.smear, sigmas["smear"])
        return FocusedTarget(path.row, path.place, speed, smear, elevation, float(energies.max()), ratio)
