"""Statistics of a dwell's data that its tests are made of, in one pass over the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import Residue
from sal_height.elevation.array.likelihood import OBJECTIVES, search_guard
from sal_height.elevation.array.search import SQUINT_STEP, PeakSearch, PeakSearches
from sal_height.elevation.fit._fit_kernels import BINS, gather_ratios, median_levels, median_ratios, sort_pixels
from sal_height.elevation.layover.order import detection_threshold, path_length
from sal_height.elevation.looks.looks import Covariance, Looks
from sal_height.numeric import Index

MOST_PIXELS = 256
"""Most pixels whose covariance is read, of 552 in a dwell of preset sal_spotlight: all would take too long."""

LEAST_PART, LEAST_CNR, LEAST_FOR_STRETCH = 0.05, 1.0, 5.0
"""Least part that a channel should have of a scatterer's power, and least power in the others over a look's noise; and
least power of a scatterer for the stretch of the beams: the search finds 2 or 3 in noise alone."""

MOST_BESIDE = 0.004
"""Greatest fraction of a scatterer's power that another one may have where the stretch of the beams is measured."""

BLOCKS = 4
"""Number of blocks of rows, hence of ranges, whose noise levels are compared."""


@dataclass(frozen=True, eq=False)
class FitStatistics:
    """Statistics of the pixels of a dwell.

    Attributes:
        beams: beams of the M channels.
        repeated: number of pixels in which each look is.
        pixels: number of pixels.
        least_looks: least number of looks of a pixel.
        levels: median noise level over the stated one of the pixels with one scatterer, and their number, in each of
            BLOCKS blocks of rows and in all of them.
        gains: median, its standard deviation and the number of pixels of the gain of each channel.
        noises: the same of the amplitude of the noise of each channel over the stated one.
        stretch: the same of the stretch of the beams.
        scores: sums of the scores and of their variances, of pixels with several scatterers and of those with one, of a
            wave alike in all channels and of noise that neighbours have in common.
    """

    beams: Beams
    repeated: float
    pixels: int
    least_looks: float
    levels: list[list[float]]
    gains: list[list[float]]
    noises: list[list[float]]
    stretch: list[float]
    scores: list[list[list[float]]]

    @classmethod
    def of(cls, residue: Residue, looks: Looks, beams: Beams, repeated: float) -> FitStatistics:
        """Statistics of a dwell.

        Responses are those at the nearest squint for which they are exact, which is the same in most dwells.

        Args:
            residue: fit of a single scatterer to each pixel.
            looks: covariance of M channels of equal noise in each pixel.
            beams: beams of the M channels.
            repeated: number of pixels in which each look is.
        """
        noise, size, count = looks.receiver_noise, beams.count, looks.count
        step, cols = SQUINT_STEP * beams.track_beamwidth, count.shape[1]
        first, last = round(float(looks.squint[0]) / step), round(float(looks.squint[-1]) / step)
        # Pixels at a corner have the fewest looks.
        few, many = float(count[0, 0]), float(count[len(count) // 2, cols // 2])
        search, usual = _search(beams, first, last, cols), _usually_beside(beams, first, few, many)
        levels, chosen = np.empty(count.shape), np.empty(count.size, np.intp)
        counted, inside = sort_pixels(
            looks.power,
            residue.explained,
            residue.beside,
            count,
            residue.elevation,
            looks.finite,
            size,
            noise,
            size * beams.uncertainty**2,
            usual,
            beams.span,
            levels,
            chosen,
        )
        pixels = chosen[_evenly(inside)] if inside > MOST_PIXELS else chosen[:inside]
        matrices, numbers = _covariances(looks, pixels, is_complex=search.tables.complex_beams)
        ratios, sums, scores = np.zeros((2 * size + 1, BINS)), np.zeros((2, 2 * size + 1)), np.zeros((2, 2, 2))
        tables = search.tables
        gather_ratios(
            matrices,
            pixels,
            numbers,
            search.squints,
            residue.elevation,
            (tables.first, tables.step),
            beams.boresights,
            tables.unit_pieces,
            tables.power,
            count,
            levels,
            residue.beside,
            noise,
            (LEAST_PART, LEAST_CNR, LEAST_FOR_STRETCH),
            MOST_BESIDE,
            ratios,
            sums,
            scores,
        )
        of_levels, of_ratios = np.empty((2, BLOCKS + 1)), np.empty((3, 2 * size + 1))
        median_ratios(ratios, sums, of_ratios)
        median_levels(levels, _ends(len(levels)), of_levels)
        by_level, by_ratio = of_levels.T.tolist(), of_ratios.T.tolist()
        gains, noises, stretch = by_ratio[:size], by_ratio[size:-1], by_ratio[-1]
        return cls(beams, repeated, counted, min(few, many), by_level, gains, noises, stretch, scores.tolist())


@lru_cache(maxsize=16)
def _search(beams: Beams, first: int, last: int, cols: int) -> PeakSearch:
    """The search of each of a number of columns, from squint to squint, in SQUINT_STEP; beams by their identity."""
    searches = PeakSearches.over(beams, OBJECTIVES["normalised"], search_guard(beams))
    return searches.at(np.rint(np.linspace(first, last, cols)) * (SQUINT_STEP * beams.track_beamwidth))


@lru_cache(maxsize=64)
def _usually_beside(beams: Beams, squint: int, few: float, many: float) -> tuple[float, float]:
    """Power that one more scatterer explains in half of the pixels of noise, as a line over the number of looks.

    Args:
        beams: beams of the channels, distinguished by their identity.
        squint: squint of a column, in SQUINT_STEP.
        few: number of looks of some pixels.
        many: that of others.
    """
    length = path_length(beams, squint * (SQUINT_STEP * beams.track_beamwidth))
    least, most = (detection_threshold(length, looks, 0.5) for looks in (few, many))
    slope = (most - least) / (many - few) if many != few else 0.0
    return least - slope * few, slope


@lru_cache(maxsize=64)
def _evenly(number: int) -> Index:
    """MOST_PIXELS of a number of pixels, at equal distances."""
    return np.arange(MOST_PIXELS) * number // MOST_PIXELS


@lru_cache(maxsize=16)
def _ends(rows: int) -> Index:
    """First row of each block, and the end of the last one, (BLOCKS + 1,)."""
    return np.arange(BLOCKS + 1) * rows // BLOCKS


def _covariances(looks: Looks, pixels: Index, *, is_complex: bool) -> tuple[Covariance, Index]:
    """Covariances of an image, or of some of its pixels, and the numbers of these among them."""
    whole, (cols, channels) = looks.covariance, looks.covariance.shape[1:3]
    if isinstance(whole, np.ndarray) and (whole.dtype.kind == "c") == is_complex:
        return whole.reshape(-1, channels, channels), pixels
    some = whole[pixels // cols, pixels % cols]
    return (some if is_complex else np.ascontiguousarray(some.real)), np.arange(len(pixels))
