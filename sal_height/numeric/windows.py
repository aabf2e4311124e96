"""Amplitude windows over a band of samples: sidelobe level against resolution."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from sal_height.errors import UserError
from sal_height.numeric.arrays import F64


def taylor(count: int, sidelobe_db: float) -> F64:
    """Taylor weights of `count` samples, 1 in the middle (Carrara, Goodman, Majewski, appendix D.2).

    They are those of scipy.signal, which imports scipy.stats: half a second of every start.

    Args:
        count: number of samples.
        sidelobe_db: level of the nearest sidelobes below the peak, dB.
    """
    level = 5  # level - 1 sidelobes on each side fall off little
    order = np.arange(1.0, level)
    a = np.arccosh(10 ** (sidelobe_db / 20)) / np.pi
    dilation = level**2 / (a**2 + (level - 0.5) ** 2)  # of the zeros behind the level sidelobes
    coefficients = np.empty(len(order))
    for index, m in enumerate(order):
        zeros = np.prod(1 - m**2 / dilation / (a**2 + (order - 0.5) ** 2))
        poles = np.prod(1 - m**2 / order[:index] ** 2) * np.prod(1 - m**2 / order[index + 1 :] ** 2)
        coefficients[index] = -((-1) ** m) * zeros / (2 * poles)

    def weights(sample: F64) -> F64:
        return 1 + 2 * coefficients @ np.cos(2 * np.pi * order[:, None] * (sample - (count - 1) / 2) / count)

    return weights(np.arange(count, dtype=np.float64)) * (1 / weights(np.array([(count - 1) / 2])))


def _taylor(count: int) -> F64:
    """Sidelobes of -35 dB, of which 4 on each side fall off little."""
    return taylor(count, 35.0)


WINDOWS: dict[str, Callable[[int], F64]] = {"rectangular": np.ones, "taylor": _taylor, "hamming": np.hamming}
"""Windows by name, as functions of the number of samples."""


KEPT = 32  # windows, and widths of windows, that are cached: a sensor needs a few


@lru_cache(KEPT)
def window(name: str, count: int) -> F64:
    """Weights of `count` samples, scaled to a mean of 1 so that a point keeps its peak value; they cannot be changed.

    Raises:
        UserError: there is no window of that name.
    """
    if name not in WINDOWS:
        raise UserError(f"The window is {name!r}; allowed are {', '.join(sorted(WINDOWS))}.")
    weights = np.asarray(WINDOWS[name](count), dtype=np.float64)
    weights = weights / weights.mean()
    weights.flags.writeable = False
    return weights


def noise_gain(weights: F64) -> float:
    """Factor by which a window of mean 1 raises the noise power, and that of clutter: mean of its square."""
    return float(np.mean(weights**2))


def broadening(weights: F64) -> float:
    """Width of the response at -3 dB over that of the unweighted band: the spacing at which cells stay independent."""
    return _half_power_width(weights.tobytes()) / _half_power_width(np.ones(len(weights)).tobytes())


@lru_cache(KEPT)
def main_lobe(name: str) -> float:
    """Distance from the peak of a window's response to its first null, cells of the unweighted resolution."""
    samples, step = 512, 0.05
    weights, position = window(name, samples), (np.arange(samples) - (samples - 1) / 2) / samples

    def response(cells: float) -> float:
        return float(weights @ np.cos(2 * np.pi * position * cells))

    end = next(number for number in itertools.count(1) if response(step * number) < 0)
    return float(brentq(response, step * (end - 1), step * end))


@lru_cache(KEPT)
def _half_power_width(float64: bytes) -> float:
    """Width of the response to weights at half its peak power, in resolution bins; kept by the weights' bytes."""
    weights = np.frombuffer(float64)
    position = np.arange(len(weights)) - (len(weights) - 1) / 2

    def excess(bins: float) -> float:
        response = weights @ np.cos(2 * np.pi * position * bins / len(weights)) / weights.sum()
        return float(response**2 - 0.5)

    if excess(1.0) >= 0:
        raise UserError(f"A window over {len(weights)} samples has no width; the band must have more samples.")
    return 2 * float(brentq(excess, 0.0, 1.0))
