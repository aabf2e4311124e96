"""Common parts of the PSF paper's figures: the number of tapes, and the points that are checked against theory."""

from __future__ import annotations

import numpy as np

from sal_height.figures.curve import Curve, exact_curve
from sal_height.numeric import F64, Bool, Complex, frequencies

COUNT = 64
"""Pixels along each side of chips and sub-images, as in the paper."""

FREQUENCY = frequencies(COUNT)
"""Frequencies of a chip, cycles per pixel."""


def generators(trials: int, seed: int, figure: int, tapes: float = 1.0) -> list[np.random.Generator]:
    """Make a random generator for each tape.

    Args:
        trials: number of trials of `sal-height figures`.
        seed: seed of all random numbers.
        figure: number of the figure, whose tapes differ from those of others.
        tapes: number of tapes over the usual one.
    """
    # A tape stands for 1000 trials: 20 tapes for the usual 20 000.
    count = round(tapes * min(max(trials // 1000, 4), 40))
    return [np.random.default_rng(sequence) for sequence in np.random.SeedSequence((seed, figure)).spawn(count)]


def in_band(response: Complex | F64) -> Bool:
    """True where a response is strong enough to have a phase."""
    return np.abs(response) > 0.1 * np.abs(response).max()


def checked(quantity: str, case: str, value: F64, error: F64, theory: F64, colour: int) -> Curve:
    """A curve over FREQUENCY of which every fifth point has a closed form.

    Bins err independently, and of hundreds some are three sigma off.
    """
    closed_form = np.where(np.arange(COUNT) % 5 == 0, theory, np.nan)
    return Curve(quantity, case, FREQUENCY, value, error, closed_form, "-", colour)


def shown(quantity: str, case: str, x: F64, value: F64, style: str = "-", colour: int = 0) -> Curve:
    """A curve that is shown and not checked: of one draw, or of theory itself."""
    return exact_curve(quantity, case, x, value, np.full_like(value, np.nan), style, colour)
