"""Colours of values."""

from __future__ import annotations

import functools
from collections import deque

import numpy as np
import numpy.typing as npt

from sal_height.elevation import Validity
from sal_height.numeric import U8
from sal_height.relief import HeightField

EMPTY = (18, 20, 24)
"""Red, green and blue of pixels without a value, and behind the points."""

VALIDITY_COLOURS = {
    Validity.OK: (48, 160, 80),
    Validity.TWO_SCATTERERS: (60, 190, 210),
    Validity.THREE_SCATTERERS: (40, 110, 220),
    Validity.EXTENDED: (150, 205, 90),
    Validity.INTERPOLATED: (225, 205, 80),
    Validity.LOW_CNR: (70, 70, 80),
    Validity.NO_SIGNAL: (30, 30, 38),
    Validity.OUTSIDE_ARRAY: (110, 95, 85),
    Validity.OUTSIDE_PAIR: (135, 115, 100),
    Validity.NOT_ONE_SCATTERER: (215, 80, 60),
    Validity.MISSING_DATA: (120, 0, 20),
    Validity.AMBIGUOUS: (200, 90, 190),
    Validity.SATURATED: (255, 150, 40),
    Validity.IMPRECISE: (120, 80, 150),
    Validity.NO_GROUND: (90, 60, 40),
}
"""Red, green and blue: green and blue where there is a measurement, the more scatterers the bluer; yellow between
measurements; grey where there is too little signal; red and violet where a measurement cannot be used."""


class Span:
    """The values that colours stand for: those of the last images but for the outermost, so that none decides alone.

    Attributes:
        ends: lowest and highest value, which differ.
    """

    def __init__(self, low: float, high: float, images: int) -> None:
        """Look at the percentiles `low` and `high` of that many images."""
        self._percentiles = low, high
        self._ends: deque[tuple[float, float]] = deque(maxlen=images)
        self.ends = 0.0, 1.0

    def add(self, values: npt.NDArray[np.floating]) -> None:
        """Look at an image, of any shape; values that are not finite do not count."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return
        most = 20_000  # numbers; more would not change percentiles by more than a colour
        first, last = np.percentile(finite[:: 1 + finite.size // most], self._percentiles)
        self._ends.append((float(first), float(last)))
        low, high = min(one for one, _ in self._ends), max(other for _, other in self._ends)
        wider = 0.0 if high > low else max(0.5, abs(low))
        self.ends = low - wider, high + wider


class Spans:
    """Spans of the colours of heights and of their sigmas.

    Attributes:
        heights: span of the heights, m.
        sigmas: span of the sigmas, m.
        are_settled: True if images that are drawn do not change them any more.
    """

    def __init__(self, images: int = 64) -> None:
        """Look at the last surfaces, that many."""
        self.heights, self.sigmas = Span(0.5, 99.5, images), Span(0.0, 95.0, images)
        self.are_settled = False

    def add(self, field: HeightField) -> None:
        """Look at a height image."""
        for surface in field.surfaces:
            self.heights.add(surface.height)
        self.sigmas.add(field.first.sigma)


@functools.cache
def _table(name: str) -> U8:
    """A colour map of Matplotlib, shape (256, 3)."""
    import matplotlib as mpl  # noqa: PLC0415 (slow)

    return np.round(255 * mpl.colormaps[name](np.arange(256))[:, :3]).astype(np.uint8)


def coloured(values: npt.NDArray[np.floating], span: tuple[float, float], name: str) -> U8:
    """Red, green and blue of values, EMPTY where they are not finite: their shape with one more axis of 3.

    Args:
        values: values, any shape.
        span: values of the first and the last colour.
        name: name of a colour map of Matplotlib, such as "viridis".
    """
    low, high = span
    there = np.isfinite(values)
    share = np.clip((np.where(there, values, low) - low) / (high - low), 0.0, 1.0)
    colours = _table(name)[np.round(255 * share).astype(np.intp)]
    colours[~there] = EMPTY
    return colours
