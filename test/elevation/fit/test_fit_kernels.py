"""Loops of the tests of a dwell's data against twins in plain NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, make_beams

from sal_height.elevation.array.likelihood import OBJECTIVES
from sal_height.elevation.array.search import PeakSearches
from sal_height.elevation.fit import _fit_kernels as kernels

Array = np.ndarray

SQUINTS = np.array([-0.3, 0.0, 0.4]) * BEAMWIDTH
CHANNELS, PIXELS, LOOKS = 8, 40, 4


def test_levels_are_those_of_pixels_with_one_scatterer() -> None:
    rng = np.random.default_rng(1)
    explained, count = rng.uniform(5, 50, PIXELS), rng.choice([3.0, 4.0], PIXELS)
    left, beside = rng.uniform(10, 40, PIXELS), rng.uniform(0, 10, PIXELS)
    finite, error = rng.random(PIXELS) < 0.8, 0.01
    beside[0], levels = 0.0, np.empty(PIXELS)
    power = left + (1 + error) * explained
    number = kernels.levels_of_noise(power, explained, beside, count, finite, CHANNELS, error, (2.0, 1.0), levels)
    order = (CHANNELS - 1) * count - 0.5
    expected = finite & (beside > 0) & (beside <= left / order * (2 + count))
    assert 5 < number < PIXELS - 5
    assert levels[:number] == pytest.approx((left / (order - 1 / 3))[expected])


@pytest.mark.parametrize("is_complex", [False, True])
def test_gains_are_those_of_each_channel_over_what_the_others_predict(is_complex: bool) -> None:
    rng = np.random.default_rng(2)
    beams = make_beams("jinc", CHANNELS)
    if is_complex:
        beams = beams.combined(np.diag(np.exp(1j * rng.uniform(0, 6, CHANNELS))))
    search = PeakSearches.over(beams, OBJECTIVES["normalised"], 0.0).at(SQUINTS)
    squints, position = rng.integers(0, 3, PIXELS), rng.uniform(0, search.tables.steps, PIXELS)
    elevation = search.elevation(position)
    unit, _, _ = replace(search, squints=squints).responses_at(elevation)
    seen = _samples(unit, rng)
    matrices = np.einsum("pkm,pkn->pmn", seen, seen.conj())
    matrices = matrices.astype(np.complex64) if is_complex else np.ascontiguousarray(matrices.real, dtype=np.float32)
    explained = np.einsum("pm,pmn,pn->p", unit.conj(), matrices, unit).real
    noise, least = np.full(PIXELS, float(LOOKS)), (0.05, 1.0)
    weights, sums, found = np.zeros((CHANNELS, kernels.BINS)), np.zeros((2, CHANNELS)), np.empty((3, CHANNELS))
    pieces = search.tables.unit_pieces
    kernels.gather_gains(matrices, np.arange(PIXELS), squints, position, pieces, explained, noise, least, weights, sums)
    kernels.median_gains(weights, sums, found)
    gains, weight = _gains(matrices, unit, noise, least)
    width = (kernels.HIGHEST - kernels.LOWEST) / kernels.BINS
    for m in range(CHANNELS):
        used = weight[:, m] > 0
        assert found[2, m] == np.count_nonzero(used)
        assert np.sum(weights[m]) == pytest.approx(np.sum(weight[:, m]), rel=1e-3)
        low, middle, high = (_quantile(gains[used, m], weight[used, m], q) for q in (0.25, 0.5, 0.75))
        assert found[0, m] == pytest.approx(np.clip(middle, kernels.LOWEST, kernels.HIGHEST), abs=1.01 * width)
        deviation = np.sqrt(np.pi / 2 * np.sum(weight[:, m] ** 2)) / np.sum(weight[:, m]) / 1.349
        assert found[1, m] == pytest.approx(deviation * (high - low), abs=2.02 * width * deviation)


def _samples(unit: Array, rng: np.random.Generator) -> Array:
    shape = (PIXELS, LOOKS)
    amplitude = 5 * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    noise = rng.standard_normal((*shape, CHANNELS, 2)).view(complex)[..., 0] * np.sqrt(0.5)
    seen: Array = amplitude[..., None] * unit[:, None] + noise
    return seen


def _gains(matrices: Array, unit: Array, noise: Array, least: tuple[float, float]) -> tuple[Array, Array]:
    """The gains and their weights, channel by channel, from the definition."""
    gains, weight = np.zeros((2, PIXELS, CHANNELS))
    for p in range(PIXELS):
        for m in range(CHANNELS):
            others = unit[p].copy()
            others[m] = 0
            rest = np.sum(np.abs(others) ** 2)
            signal = (others.conj() @ matrices[p] @ others).real / rest - noise[p]
            part = abs(unit[p, m]) ** 2
            if least[0] <= part <= 1 - least[0] and signal >= least[1] * noise[p]:
                gains[p, m] = (unit[p, m].conj() * (matrices[p, m] @ others)).real / (part * signal)
                weight[p, m] = np.sqrt(part * signal)
    return gains, weight


def _quantile(values: Array, weight: Array, q: float) -> float:
    order = np.argsort(values)
    below = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(below, q * below[-1])])
