"""Point targets in an image: those whose surroundings show the system's response, and little else.

An image is surveyed at a low resolution, and what stands out is looked at in chips (PSF paper, section 3, figures 1 to
3). Axis 0 of images and chips is range, axis 1 azimuth.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter, median_filter
from scipy.spatial import cKDTree

from sal_height.errors import NotDetermined, UserError
from sal_height.numeric import C64, C128, F32, F64, Complex, compiled, in_parallel
from sal_height.response.impulse import chip_around

CHIP = (64, 64)
"""Rows and columns around a target, those of the paper."""

CONTEXT = 2
"""Sides of the window that a peak is moved in, over those of the chip, as far as the image goes."""

PEAK_STEPS = 5
"""Of Newton's method towards a peak, each of which doubles the digits."""

PEAK_ROUNDS = 2
"""Of the search for a peak along range, then along azimuth."""

BLOCK = 16
"""Side of the pixels of the survey: 24 m at the paper's 1.5 m."""

SURROUNDINGS = 5
"""Blocks along each side of the square whose median power is the clutter of the block in its middle."""

LEAST_OVER_CLUTTER_DB = 20.0
"""Peak power over that of the clutter: speckle of 1e6 pixels has peaks of 11 dB."""

MAX_CHIPS = 25
"""That are looked at, those of the brightest candidates; the paper's number."""

FOREIGN = 0.01
"""Power beside a target, over its own, from which on it does not count as alone: sidelobes far from it are less."""

SECOND_PEAK = 0.125
"""Power of a second peak in the cuts through the first, over its own, that is no sidelobe: of a flat band 0.047."""

OVER_SPECKLE = 20.0
"""Power over the mean clutter that speckle in a chip does not reach: exp(-20) a pixel."""

WIDE = 1.25
"""Energy of a target's cut, over that of the others', from which on it is more than a point."""

CORE = (2, 1)
"""Pixels to each side of the peak, along range and azimuth, where a chip is not compared with its cuts."""

GAP_SHARE = 0.01
"""Share of pixels that are exactly 0 from which on a chip has gaps."""

EQUAL_PEAKS = 3
"""Equally great real or imaginary parts, or amplitudes, in a chip that indicate clipping."""

EXPONENT = np.uint32(0x7F800000)
"""Of a float32: all set if it is infinite or not a number, which compiled loops do not tell otherwise."""


class Verdict(StrEnum):
    """What became of a candidate; all but ACCEPTED say why it does not show the system's response."""

    ACCEPTED = "accepted"
    SPARE = "fainter than those looked at"
    EDGE = "too near the edge of the image"
    NOT_FINITE = "beside pixels that are not finite"
    GAPS = "beside pixels of 0"
    CROWDED = "not alone in the chip"
    CLIPPED = "clipped"
    COMPLICATED = "more than a point"


@dataclass(frozen=True)
class Candidate:
    """A pixel that stands out from its surroundings.

    Attributes:
        row: of the brightest pixel.
        col: of the brightest pixel.
        over_clutter: its power over that of the clutter around.
        verdict: whether it is a point target, or why not.
    """

    row: int
    col: int
    over_clutter: float
    verdict: Verdict = Verdict.ACCEPTED


@dataclass(frozen=True)
class PointTarget:
    """A target's chip, with its interpolated peak moved to pixel (0, 0), where it is 1.

    Attributes:
        row: of the peak in the image, pixels, with fractions.
        col: of the peak in the image, pixels, with fractions.
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


@dataclass(frozen=True)
class TargetSurvey:
    """What was found in an image.

    Attributes:
        candidates: all that stand out, the brightest first.
        targets: of the accepted ones, the brightest first.
    """

    candidates: tuple[Candidate, ...]
    targets: tuple[PointTarget, ...]

    @property
    def verdicts(self) -> Counter[Verdict]:
        """Number of candidates of each verdict."""
        return Counter(candidate.verdict for candidate in self.candidates)

    def require(self) -> tuple[PointTarget, ...]:
        """The targets.

        Raises:
            NotDetermined: there is none; the sentence counts the verdicts and says what is needed.
        """
        if not self.targets:
            level = f"{LEAST_OVER_CLUTTER_DB:g} dB"
            found = ", ".join(f"{count} {verdict}" for verdict, count in self.verdicts.items())
            raise NotDetermined(
                f"No point target shows the response of the system: of {len(self.candidates)} that stand {level} over "
                f"their surroundings, {found}; needed is one at least that is finite, not clipped and alone "
                "in a chip that lies within the image."
                if self.candidates
                else f"No pixel stands {level} over its surroundings and could show the response of the system; needed "
                "is one point target at least that does, alone in a chip that lies within the image."
            )
        return self.targets


def find_targets(image: Complex, chip: tuple[int, int] = CHIP) -> TargetSurvey:
    """Find the targets whose chips show the response to a point, and little else.

    A candidate is the brightest pixel of a block and the eight around it that stands LEAST_OVER_CLUTTER_DB over the
    median of the blocks around. It is judged in a chip of its own; along an axis where the chip is as long as the image
    the image is taken for cyclic.

    Args:
        image: complex pixels, shape (rows, cols); range, azimuth.
        chip: rows and columns of a chip.

    Raises:
        UserError: the image is not a complex matrix, or the chip does not fit into it.
    """
    _check(image, chip)
    with np.errstate(over="ignore", invalid="ignore"):  # what is too great is not finite
        pixels = np.ascontiguousarray(image, dtype=np.complex64)
    candidates, clutter = _survey(pixels)
    candidates = _mark_crowds(candidates, clutter, chip, pixels.shape)
    promising = [index for index, one in enumerate(candidates) if one.verdict is Verdict.ACCEPTED]
    targets: dict[int, PointTarget] = {}
    for index in promising[:MAX_CHIPS]:
        verdict, target = _judged(pixels, candidates[index], float(clutter[index]), chip)
        candidates[index] = replace(candidates[index], verdict=verdict)
        if target:
            targets[index] = target
    for index in promising[MAX_CHIPS:]:
        candidates[index] = replace(candidates[index], verdict=Verdict.SPARE)
    for index in _wide(targets):
        candidates[index] = replace(candidates[index], verdict=Verdict.COMPLICATED)
        del targets[index]
    return TargetSurvey(tuple(candidates), tuple(targets.values()))


def chip_at(image: Complex, row: int, col: int, clutter: float, shape: tuple[int, int] = CHIP) -> PointTarget:
    """The chip around a pixel, with its interpolated peak moved to pixel (0, 0).

    Values between pixels are interpolated in a window twice as long and wide as the chip, as far as the image goes.

    Args:
        image: complex pixels, shape (rows, cols).
        row: of the brightest pixel; the chip must fit into the image.
        col: of the brightest pixel.
        clutter: mean power of the clutter.
        shape: rows and columns of the chip.
    """
    window = chip_around(image, row, col, (2 * shape[0], 2 * shape[1]))
    peak_row, peak_col = window.peak(row, col)
    down, across = (scipy.fft.ifftshift(np.arange(size) - size // 2) for size in shape)
    pixels = window.values(peak_row + down, peak_col + across)
    gain = pixels[0, 0] / window.values(row, col)[0, 0]
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


def _survey(image: C64) -> tuple[list[Candidate], F64]:
    """What stands out, the brightest first, and the clutter (power) around each."""
    mean, peak = _blocks(image)
    clutter = median_filter(mean, SURROUNDINGS, mode="nearest")
    stands_out = (peak > 10 ** (LEAST_OVER_CLUTTER_DB / 10) * clutter) & (peak == maximum_filter(peak, 3))
    places = np.argwhere(stands_out & (clutter > 0))
    places = places[np.argsort(-peak[tuple(places.T)], kind="stable")]
    candidates = []
    for i, j in places:
        rows, cols = (slice(BLOCK * k, BLOCK * (k + 1)) for k in (i, j))
        power = np.nan_to_num(np.abs(image[rows, cols].astype(np.complex128)), posinf=0.0) ** 2
        row, col = np.unravel_index(np.argmax(power), power.shape)
        over = float(peak[i, j] / clutter[i, j])
        candidates.append(Candidate(BLOCK * int(i) + int(row), BLOCK * int(j) + int(col), over))
    return candidates, np.asarray(clutter[tuple(places.T)])


def _blocks(image: C64) -> tuple[F64, F64]:
    """Mean and greatest power of each block's finite pixels, 0 if there is none; shapes (blocks down, across)."""
    shape = -(-image.shape[0] // BLOCK), -(-image.shape[1] // BLOCK)
    mean, peak = np.zeros(shape), np.zeros(shape)
    parts = image.view(np.float32)

    def work(rows: slice) -> None:
        _add_blocks(parts[BLOCK * rows.start : BLOCK * rows.stop], mean[rows], peak[rows])

    in_parallel(work, shape[0])
    return mean, peak


@compiled
def _add_blocks(parts: F32, mean: F64, peak: F64) -> None:
    bits = parts.view(np.uint32)
    rows, numbers = parts.shape
    for i in range(mean.shape[0]):
        for j in range(mean.shape[1]):
            last_row, last = min(BLOCK * (i + 1), rows), min(2 * BLOCK * (j + 1), numbers)
            total, greatest, count = 0.0, 0.0, 0
            for r in range(BLOCK * i, last_row):
                for c in range(2 * BLOCK * j, last, 2):
                    bad = (bits[r, c] & EXPONENT) == EXPONENT or (bits[r, c + 1] & EXPONENT) == EXPONENT
                    re, im = np.float64(parts[r, c]), np.float64(parts[r, c + 1])
                    power = 0.0 if bad else re * re + im * im
                    total += power
                    greatest = max(greatest, power)
                    count += 0 if bad else 1
            mean[i, j] = total / max(count, 1)
            peak[i, j] = greatest


def _mark_crowds(
    candidates: list[Candidate], clutter: F64, chip: tuple[int, int], shape: tuple[int, ...]
) -> list[Candidate]:
    """The candidates with the verdict CROWDED where a chip holds another bright one, EDGE where it leaves the image.

    Another one crowds a chip if it has more than FOREIGN times the power of the candidate in its middle.
    """
    if not candidates:
        return []
    places = np.array([(one.row, one.col) for one in candidates]) / (np.array(chip) // 2)
    power = np.array([one.over_clutter for one in candidates]) * clutter
    first, second = cKDTree(places).query_pairs(1 + 1e-6, p=np.inf, output_type="ndarray").T
    crowded = np.zeros(len(candidates), dtype=np.bool_)
    crowded[first[power[second] > FOREIGN * power[first]]] = True
    crowded[second[power[first] > FOREIGN * power[second]]] = True
    marked = []
    for one, alone in zip(candidates, ~crowded, strict=True):
        inside = _start(one.row, shape[0], chip[0]) >= 0 and _start(one.col, shape[1], chip[1]) >= 0
        verdict = Verdict.EDGE if not inside else one.verdict if alone else Verdict.CROWDED
        marked.append(replace(one, verdict=verdict))
    return marked


def _start(position: int, length: int, size: int) -> int:
    """First pixel of a chip of `size` around a position in `length` pixels; -1 if it leaves them."""
    first = 0 if size == length else int(position) - size // 2
    return first if first + size <= length else -1


def _judged(image: C64, one: Candidate, clutter: float, shape: tuple[int, int]) -> tuple[Verdict, PointTarget | None]:
    """The verdict on a candidate with a chip of its own, and the target if it is one."""
    start = _start(one.row, image.shape[0], shape[0]), _start(one.col, image.shape[1], shape[1])
    pixels = image[start[0] : start[0] + shape[0], start[1] : start[1] + shape[1]]
    if not np.all(np.isfinite(pixels)):
        return Verdict.NOT_FINITE, None
    if np.mean(pixels == 0) > GAP_SHARE:
        return Verdict.GAPS, None
    if _is_clipped(pixels):
        return Verdict.CLIPPED, None
    target = chip_at(image, one.row, one.col, clutter, shape)
    if _is_complicated(target):
        return Verdict.COMPLICATED, None
    return Verdict.ACCEPTED, target


def _is_clipped(pixels: C64) -> bool:
    """Whether several pixels share the greatest part, or the greatest amplitude to single precision."""
    parts = np.maximum(np.abs(pixels.real), np.abs(pixels.imag))
    amplitude = np.abs(pixels)
    equal = np.count_nonzero(parts == parts.max()), np.count_nonzero(amplitude >= amplitude.max() * (1 - 1e-6))
    return bool(max(equal) >= EQUAL_PEAKS)


def _is_complicated(target: PointTarget) -> bool:
    """Whether the chip holds more than the product of its cuts (PSF paper, eq. 2.10), or a cut a second peak."""
    chip = target.chip
    product = chip[:, :1] * chip[:1]
    rest = np.abs(chip - product) ** 2
    down, across = (np.minimum(np.arange(size), size - np.arange(size)) for size in chip.shape)
    rest[np.ix_(down <= CORE[0], across <= CORE[1])] = 0
    return bool(rest.max() > max(FOREIGN, OVER_SPECKLE / target.over_clutter)) or any(
        _second_peak(np.abs(cut) ** 2) > SECOND_PEAK for cut in (chip[:, 0], chip[0])
    )


def _second_peak(power: F64) -> float:
    """Greatest local maximum of a cyclic cut beside the first sample, and its neighbours."""
    tops = (power > np.roll(power, 1)) & (power >= np.roll(power, -1))
    tops[[0, 1, -1]] = False
    return float(np.max(power, where=tops, initial=0.0))


def _wide(targets: dict[int, PointTarget]) -> Sequence[int]:
    """Those whose cuts hold more energy than those of the others, less their clutter."""
    if not targets:
        return []
    energies = []
    for target in targets.values():
        cuts = target.spectrum.mean(axis=1), target.spectrum.mean(axis=0)
        energies.append([np.mean(np.abs(cut) ** 2) - len(cut) / target.over_clutter for cut in cuts])
    usual = np.quantile(energies, 0.5, axis=0, method="lower")
    return [index for index, energy in zip(targets, energies, strict=True) if np.any(energy > WIDE * usual)]
