"""Point targets in an image: those whose surroundings show the system's response, and little else.

An image is surveyed at a low resolution, and what stands out is examined in chips (PSF paper, section 3, figures 1 to
3). Axis 0 of images and chips is range, axis 1 azimuth.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter, median_filter
from scipy.spatial import cKDTree

from sal_height.errors import NotDetermined, UserError
from sal_height.numeric import C64, C128, F64, Complex, Index, ShortRepr, in_parallel
from sal_height.response.impulse import chip_around
from sal_height.settings import Settings, setting

CHIP = (64, 64)  # rows and columns around a target, those of the paper
BLOCK = 16  # side of the pixels of the survey: 24 m at the paper's 1.5 m
CORE = (2, 1)  # pixels to each side of the peak, in range and azimuth, where a chip is not compared with its cuts


class PointTargetSettings(Settings):
    """Criteria for bright pixels that count as point targets. Powers are ratios in dB."""

    point_over_clutter_db: float = setting(
        20.0,
        "lowest peak power of a point target over the clutter around it; a million pixels of speckle reach 11 dB",
        unit="dB",
        minimum=10.0,
        maximum=100.0,
    )
    point_isolation_db: float = setting(
        20.0,
        "a point target is isolated if everything outside its cuts in the chip is this far below its peak",
        unit="dB",
        minimum=3.0,
        maximum=100.0,
    )
    point_sidelobes_db: float = setting(
        9.0,
        "sidelobes in the cuts of a point target lie this far below its peak; those of a flat band are at 13.3 dB",
        unit="dB",
        minimum=0.0,
        maximum=100.0,
    )
    point_energy_ratio: float = setting(
        1.25,
        "largest energy in the cuts of a point target over that of the other targets; more indicates several points",
        minimum=1.0,
        maximum=1000.0,
    )
    points_per_image: int = setting(
        25, "bright pixels examined in an image, the brightest first", minimum=1, maximum=10_000
    )


DEFAULTS = PointTargetSettings()


class Verdict(StrEnum):
    """Result of the tests of a candidate; all but ACCEPTED state why it does not show the system's response."""

    ACCEPTED = "accepted"
    SPARE = "fainter than those examined"
    EDGE = "too near the edge of the image"
    NOT_FINITE = "next to pixels that are not finite"
    GAPS = "next to pixels of 0"
    CROWDED = "not alone in the chip"
    CLIPPED = "clipped"
    COMPLICATED = "more than a point"


@dataclass(frozen=True)
class Candidate:
    """A pixel that stands out from its surroundings.

    Attributes:
        row: row of the brightest pixel.
        col: column of the brightest pixel.
        over_clutter: power over that of the clutter around.
        verdict: result of the tests.
    """

    row: int
    col: int
    over_clutter: float
    verdict: Verdict = Verdict.ACCEPTED


@dataclass(frozen=True, eq=False)
class PointTarget(ShortRepr):
    """A target's chip, with its interpolated peak moved to pixel (0, 0), where it is 1.

    Attributes:
        row: row of the peak in the image, with fractions, pixels.
        col: column of the peak in the image, with fractions, pixels.
        over_clutter: power of the peak over the mean power of the clutter.
        spectrum: discrete Fourier transform of the chip, from -1/2 cycle per pixel on along both axes; complex128,
            shape (rows, cols).
    """

    row: float
    col: float
    over_clutter: float
    spectrum: C128

    @property
    def chip(self) -> C128:
        """Pixels, cyclic, with the peak first; shape (rows, cols)."""
        return scipy.fft.ifft2(scipy.fft.ifftshift(self.spectrum))


@dataclass(frozen=True, eq=False)
class TargetSurvey:
    """Candidates and point targets of an image.

    Attributes:
        candidates: all pixels that stand out, the brightest first.
        targets: targets of the accepted candidates, the brightest first.
    """

    candidates: tuple[Candidate, ...]
    targets: tuple[PointTarget, ...]

    @classmethod
    def pooled(cls, surveys: Sequence[TargetSurvey]) -> TargetSurvey:
        """Joins the surveys of several images."""
        return cls(
            tuple(candidate for survey in surveys for candidate in survey.candidates),
            tuple(target for survey in surveys for target in survey.targets),
        )

    @property
    def verdicts(self) -> Counter[Verdict]:
        """Number of candidates of each verdict."""
        return Counter(candidate.verdict for candidate in self.candidates)

    def require(self) -> tuple[PointTarget, ...]:
        """The targets.

        Raises:
            NotDetermined: the image has none; the message counts the verdicts and states what is needed.
        """
        if self.targets:
            return self.targets
        found = ", ".join(f"{count} {verdict}" for verdict, count in self.verdicts.items())
        what = (
            f"None of the {len(self.candidates)} bright pixels is a point target that shows the response ({found})"
            if self.candidates
            else "No pixel stands out enough from its surroundings to show the response (setting point_over_clutter_db)"
        )
        raise NotDetermined(
            f"{what}; at least one point target is needed that is finite, not clipped and alone in a chip inside the "
            "image."
        )


def find_targets(
    image: Complex, chip: tuple[int, int] = CHIP, settings: PointTargetSettings = DEFAULTS
) -> TargetSurvey:
    """Find the targets whose chips show the response to a point, and little else.

    A candidate is the brightest pixel of a block and the eight around it, if it stands far enough over the median of
    the blocks around. It is judged in a chip of its own; along an axis where the chip is as long as the image the image
    is assumed to be cyclic.

    Args:
        image: complex pixels, shape (rows, cols); range, azimuth.
        chip: rows and columns of a chip.
        settings: criteria for point targets.

    Raises:
        UserError: the image is not a complex matrix, or the chip does not fit into it.
    """
    _check(image, chip)
    with np.errstate(over="ignore", invalid="ignore"):  # too great values are not finite
        pixels = np.ascontiguousarray(image, dtype=np.complex64)
    places, power, clutter = _survey(pixels, _ratio(settings.point_over_clutter_db))
    verdicts = _position_verdicts(places, power, pixels.shape, chip, _ratio(-settings.point_isolation_db))
    promising = [index for index, verdict in enumerate(verdicts) if verdict is Verdict.ACCEPTED]
    targets: dict[int, PointTarget] = {}
    for index in promising[: settings.points_per_image]:
        verdicts[index], target = _examined(pixels, places[index], float(clutter[index]), chip, settings)
        if target:
            targets[index] = target
    for index in promising[settings.points_per_image :]:
        verdicts[index] = Verdict.SPARE
    for index in _wide(targets, settings.point_energy_ratio):
        verdicts[index] = Verdict.COMPLICATED
        del targets[index]
    candidates = (
        Candidate(int(row), int(col), float(over), verdict)
        for (row, col), over, verdict in zip(places, power / clutter, verdicts, strict=True)
    )
    return TargetSurvey(tuple(candidates), tuple(targets.values()))


def chip_at(image: Complex, row: int, col: int, clutter: float, shape: tuple[int, int] = CHIP) -> PointTarget:
    """The chip around a pixel, with its interpolated peak moved to pixel (0, 0).

    Values between pixels are interpolated in a window twice as long and wide as the chip, as far as the image goes.

    Args:
        image: complex pixels, shape (rows, cols).
        row: row of the brightest pixel; the chip must fit into the image.
        col: column of the brightest pixel.
        clutter: mean power of the clutter.
        shape: rows and columns of the chip.
    """
    window = chip_around(image, row, col, (2 * shape[0], 2 * shape[1]))
    peak_row, peak_col = window.peak(row, col)
    down, across = (scipy.fft.ifftshift(np.arange(size) - size // 2) for size in shape)
    moved = scipy.fft.ifft2(window.spectrum * window.waves(0, peak_row).T * window.waves(1, peak_col))
    pixels = moved[np.ix_(down, across)]
    here = np.einsum("i,ij,j", window.waves(0, row)[0], window.spectrum, window.waves(1, col)[0])
    gain = moved[0, 0] * moved.size / here
    power = float(np.abs(gain * np.complex128(image[row, col])) ** 2)
    spectrum = np.asarray(scipy.fft.fftshift(scipy.fft.fft2(pixels / pixels[0, 0])))
    return PointTarget(peak_row, peak_col, power / clutter, spectrum)


def _check(image: Complex, chip: tuple[int, int]) -> None:
    if image.ndim != 2 or not np.iscomplexobj(image):
        raise UserError(
            f"An image of {image.dtype} of the shape {image.shape} has no transfer function; it must be a matrix of "
            "complex pixels (range, azimuth)."
        )
    if not all(4 <= size <= length for size, length in zip(chip, image.shape, strict=True)):
        raise UserError(
            f"A chip of {chip[0]} x {chip[1]} pixels does not fit the image of {image.shape[0]} x {image.shape[1]}; "
            "each side must be 4 pixels or more, and no more than the image has."
        )


def _survey(image: C64, least: float) -> tuple[Index, F64, F64]:
    """Rows and columns of the pixels that stand out, the brightest first, their power, and the clutter around each."""
    mean, peak = _blocks(image)
    clutter = median_filter(mean, 5, mode="nearest")  # of 5 x 5 blocks
    standing_out = (peak > least * clutter) & (peak == maximum_filter(peak, 3)) & (clutter > 0)
    blocks = np.argwhere(standing_out)
    blocks = blocks[np.argsort(-peak[standing_out], kind="stable")]
    places = np.zeros_like(blocks)
    for place, (i, j) in zip(places, BLOCK * blocks, strict=True):
        power = _power(image[i : i + BLOCK, j : j + BLOCK])
        row, col = np.unravel_index(np.argmax(power), power.shape)
        place[:] = i + row, j + col
    return places, peak[tuple(blocks.T)], clutter[tuple(blocks.T)]


def _blocks(image: C64) -> tuple[F64, F64]:
    """Mean and greatest power of each block's finite pixels, 0 without any; shapes (blocks down, across)."""
    edges = np.arange(0, image.shape[1], BLOCK)
    mean, peak = np.zeros((2, -(-image.shape[0] // BLOCK), len(edges)))

    def work(part: slice) -> None:
        for row in range(part.start, part.stop):
            strip = image[BLOCK * row : BLOCK * (row + 1)]
            power, finite = _power(strip), np.isfinite(strip).sum(axis=0)
            mean[row] = np.add.reduceat(power.sum(axis=0), edges) / np.maximum(np.add.reduceat(finite, edges), 1)
            peak[row] = np.maximum.reduceat(power.max(axis=0), edges)

    in_parallel(work, len(mean))
    return mean, peak


def _power(pixels: C64) -> F64:
    """Power of pixels, 0 where they are not finite."""
    power = np.square(pixels.real, dtype=np.float64) + np.square(pixels.imag, dtype=np.float64)
    return np.where(np.isfinite(power), power, 0.0)


def _position_verdicts(
    places: Index, power: F64, shape: tuple[int, ...], chip: tuple[int, int], foreign: float
) -> list[Verdict]:
    """EDGE where a chip leaves the image, CROWDED where it contains a candidate of over `foreign` its power."""
    crowded = np.zeros(len(places), dtype=np.bool_)
    if len(places):
        halves = places / (np.array(chip) // 2)
        first, second = cKDTree(halves).query_pairs(1 + 1e-6, p=np.inf, output_type="ndarray").T
        crowded[first[power[second] > foreign * power[first]]] = True
        crowded[second[power[first] > foreign * power[second]]] = True
    starts = [_chip_start(place, shape, chip) for place in places.tolist()]
    return [
        Verdict.EDGE if start is None else Verdict.CROWDED if is_crowded else Verdict.ACCEPTED
        for start, is_crowded in zip(starts, crowded.tolist(), strict=True)
    ]


def _chip_start(place: Sequence[int], shape: tuple[int, ...], chip: tuple[int, int]) -> tuple[int, int] | None:
    """First row and column of the chip around a pixel; None if it leaves the image."""
    row, col = (0 if n == size else at - size // 2 for at, n, size in zip(place, shape, chip, strict=True))
    return (row, col) if row >= 0 <= col and row + chip[0] <= shape[0] and col + chip[1] <= shape[1] else None


def _examined(
    image: C64, place: Index, clutter: float, shape: tuple[int, int], settings: PointTargetSettings
) -> tuple[Verdict, PointTarget | None]:
    """The verdict on a candidate with a chip of its own, and the target if it is one."""
    row, col = place.tolist()
    first_row, first_col = _chip_start((row, col), image.shape, shape) or (0, 0)
    pixels = image[first_row : first_row + shape[0], first_col : first_col + shape[1]]
    if not np.all(np.isfinite(pixels)):
        return Verdict.NOT_FINITE, None
    if np.mean(pixels == 0) > 0.01:
        return Verdict.GAPS, None
    if _is_clipped(pixels):
        return Verdict.CLIPPED, None
    target = chip_at(image, row, col, clutter, shape)
    # All of a chip but its middle is the product of its cuts (PSF paper, eq. 2.10), and each cut has one peak.
    chip = target.chip
    rest = np.abs(chip - chip[:, :1] * chip[:1]) ** 2
    down, across = (np.minimum(np.arange(size), size - np.arange(size)) for size in shape)
    rest[np.ix_(down <= CORE[0], across <= CORE[1])] = 0
    second_peak = max(_second_peak(np.abs(cut) ** 2) for cut in (chip[:, 0], chip[0]))
    over_speckle = 20.0  # power over the mean that speckle in a chip does not reach: exp(-20) a pixel
    allowed = max(_ratio(-settings.point_isolation_db), over_speckle / target.over_clutter)
    if rest.max() > allowed or second_peak > _ratio(-settings.point_sidelobes_db):
        return Verdict.COMPLICATED, None
    return Verdict.ACCEPTED, target


def _ratio(decibels: float) -> float:
    return float(10 ** (decibels / 10))


def _is_clipped(pixels: C64) -> bool:
    """True if several pixels have the greatest part, or the greatest amplitude, to single precision."""
    parts = np.maximum(np.abs(pixels.real), np.abs(pixels.imag))
    amplitude = np.abs(pixels)
    equal = np.count_nonzero(parts == parts.max()), np.count_nonzero(amplitude >= amplitude.max() * (1 - 1e-6))
    return bool(max(equal) >= 3)


def _second_peak(power: F64) -> float:
    """Greatest local maximum of a cyclic cut apart from the first sample, and its neighbours."""
    tops = (power > np.roll(power, 1)) & (power >= np.roll(power, -1))
    tops[[0, 1, -1]] = False
    return float(np.max(power, where=tops, initial=0.0))


def _wide(targets: dict[int, PointTarget], ratio: float) -> list[int]:
    """Targets whose cuts have more energy than `ratio` times that of the median target, less their clutter."""
    if not targets:
        return []
    energies = []
    for target in targets.values():
        cuts = target.spectrum.mean(axis=1), target.spectrum.mean(axis=0)
        energies.append([np.mean(np.abs(cut) ** 2) - len(cut) / target.over_clutter for cut in cuts])
    usual = np.quantile(energies, 0.5, axis=0, method="lower")
    return [index for index, energy in zip(targets, energies, strict=True) if np.any(energy > ratio * usual)]
