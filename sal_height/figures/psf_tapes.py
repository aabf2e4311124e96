"""What the PSF paper's figures share: the number of tapes, and the points that are checked against theory."""

from __future__ import annotations

import numpy as np

from sal_height.figures.curve import Curve, exact_curve
from sal_height.numeric import F64, Bool, Complex, frequencies

COUNT = 64
"""Pixels along each side of chips and sub-images, as in the paper."""

FREQUENCY = frequencies(COUNT)
"""Frequencies of a chip, cycles per pixel."""

TRIALS_OF_A_TAPE = 1000
"""Trials that one tape stands for: 20 tapes of the usual 20 000."""

LEAST_TAPES, MOST_TAPES = 4, 40

HELD = 5
"""Step of the frequencies that are checked: bins err independently, and of hundreds some are three sigma off."""

IN_BAND = 0.1
"""Least modulus of a response, over its greatest, at which its phase is shown and checked."""


def generators(trials: int, seed: int, figure: int, tapes: float = 1.0) -> list[np.random.Generator]:
    """Make a random generator for each tape.

    Args:
        trials: that `sal-height figures` is asked for.
        seed: of all.
        figure: number of the figure, so that its tapes differ from those of others.
        tapes: over the usual number of them.
    """
    count = round(tapes * min(max(trials // TRIALS_OF_A_TAPE, LEAST_TAPES), MOST_TAPES))
    return [np.random.default_rng(sequence) for sequence in np.random.SeedSequence((seed, figure)).spawn(count)]


def in_band(response: Complex | F64) -> Bool:
    """Where a response is strong enough to have a phase."""
    return np.abs(response) > IN_BAND * np.abs(response).max()


def held(quantity: str, case: str, value: F64, error: F64, theory: F64, colour: int) -> Curve:
    """A curve over FREQUENCY of which one point in HELD has a closed form."""
    closed_form = np.where(np.arange(COUNT) % HELD == 0, theory, np.nan)
    return Curve(quantity, case, FREQUENCY, value, error, closed_form, "-", colour)


def shown(quantity: str, case: str, x: F64, value: F64, style: str = "-", colour: int = 0) -> Curve:
    """A curve that is shown and not checked: of one draw, or of theory itself."""
    return exact_curve(quantity, case, x, value, np.full_like(value, np.nan), style, colour)
