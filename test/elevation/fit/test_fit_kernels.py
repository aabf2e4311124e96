"""Loops of the tests of a dwell's data against twins in plain NumPy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
from helpers import BEAMWIDTH, make_beams

from sal_height.elevation.array.likelihood import OBJECTIVES
from sal_height.elevation.array.search import PeakSearch, PeakSearches
from sal_height.elevation.fit import _fit_kernels as kernels

Array = np.ndarray

COLS = 5
SQUINTS = np.linspace(-0.3, 0.4, COLS) * BEAMWIDTH
CHANNELS, ROWS, LOOKS = 8, 12, 4
SHAPE = ROWS, COLS
LEAST, MOST_BESIDE, NOISE = (0.05, 1.0, 5.0), 0.01, 0.7


def test_levels_are_what_a_scatterer_leaves_and_negative_with_several() -> None:
    rng = np.random.default_rng(1)
    explained, count = rng.uniform(5, 50, SHAPE), rng.choice([3.0, 4.0], SHAPE)
    left, beside = rng.uniform(10, 40, SHAPE), rng.uniform(0, 10, SHAPE)
    elevation, finite, error = rng.uniform(-1, 1, SHAPE), rng.random(SHAPE) < 0.8, 0.01
    beside[0, 0], levels, chosen = 0.0, np.empty(SHAPE), np.empty(ROWS * COLS, np.intp)
    power = NOISE * (left + (1 + error) * explained)
    fit, usual, span = (power, explained, beside, count, elevation, finite), (2.0, 1.0), (-0.5, 0.6)
    counted, inside = kernels.sort_pixels(*fit, CHANNELS, NOISE, error, usual, span, levels, chosen)
    order = (CHANNELS - 1) * count - 0.5
    is_single = finite & (beside > 0) & (beside <= left / order * (2 + count))
    expected = np.where(is_single, 1, -1) * left / (order - 1 / 3) * finite
    assert levels == pytest.approx(expected)
    assert counted == finite.sum()
    assert 5 < is_single.sum() < counted - 5
    expected_inside = np.flatnonzero(finite & (elevation >= -0.5) & (elevation <= 0.6))
    assert chosen[:inside].tolist() == expected_inside.tolist()


@dataclass(frozen=True, eq=False)
class Pixels:
    """Pixels with one scatterer each, whose statistics are computed from their definitions."""

    is_complex: bool

    @cached_property
    def search(self) -> PeakSearch:
        beams = make_beams("jinc", CHANNELS)
        if self.is_complex:
            beams = beams.combined(np.diag(np.exp(1j * np.random.default_rng(3).uniform(0, 6, CHANNELS))))
        return PeakSearches.over(beams, OBJECTIVES["normalised"], 0.0).at(SQUINTS)

    @cached_property
    def elevation(self) -> Array:
        tables = self.search.tables
        return np.random.default_rng(2).uniform(tables.first, tables.last, ROWS * COLS)

    @cached_property
    def responses(self) -> tuple[Array, Array, Array]:
        """Unit responses, their slopes and the response itself over its power, of all pixels."""
        every = replace(self.search, squints=np.tile(self.search.squints, ROWS))
        return every.responses_at(self.elevation)

    @cached_property
    def matrices(self) -> Array:
        rng, (unit, _, _) = np.random.default_rng(4), self.responses
        shape = (len(unit), LOOKS)
        amplitude = rng.uniform(0.5, 6, (len(unit), 1)) * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
        noise = np.sqrt(NOISE / 2) * rng.standard_normal((*shape, CHANNELS, 2)).view(complex)[..., 0]
        seen = amplitude[..., None] * unit[:, None] + noise
        matrices = np.einsum("pkm,pkn->pmn", seen, seen.conj())
        if self.is_complex:
            return matrices.astype(np.complex64)
        return np.ascontiguousarray(matrices.real, dtype=np.float32)

    @cached_property
    def levels(self) -> Array:
        rng = np.random.default_rng(5)
        return rng.uniform(0.5, 2, ROWS * COLS) * rng.choice([-1, 1], ROWS * COLS)

    @cached_property
    def beside(self) -> Array:
        return np.random.default_rng(6).uniform(0, 2, ROWS * COLS)

    @cached_property
    def gathered(self) -> tuple[Array, Array, Array]:
        ratios, sums = np.zeros((2 * CHANNELS + 1, kernels.BINS)), np.zeros((2, 2 * CHANNELS + 1))
        scores, tables, numbers = np.zeros((2, 2, 2)), self.search.tables, np.arange(ROWS * COLS)
        boresights = make_beams("jinc", CHANNELS).boresights
        kernels.gather_ratios(
            self.matrices,
            numbers,
            numbers,
            self.search.squints,
            self.elevation.reshape(SHAPE),
            (tables.first, tables.step),
            boresights,
            tables.unit_pieces,
            tables.power,
            np.full(SHAPE, float(LOOKS)),
            self.levels.reshape(SHAPE),
            self.beside.reshape(SHAPE),
            NOISE,
            LEAST,
            MOST_BESIDE,
            ratios,
            sums,
            scores,
        )
        return ratios, sums, scores


@pytest.fixture(params=[False, True], ids=["real", "complex"])
def pixels(request: pytest.FixtureRequest) -> Pixels:
    return Pixels(request.param)


def test_gains_are_those_of_each_channel_over_what_the_others_predict(pixels: Pixels) -> None:
    ratios, sums, _ = pixels.gathered
    found = np.empty((3, 2 * CHANNELS + 1))
    kernels.median_ratios(ratios, sums, found)
    values, weight = _gains(pixels)
    _assert_medians(found[:, :CHANNELS], ratios[:CHANNELS], values, weight)


def test_noise_is_what_is_left_of_channels_without_the_scatterer(pixels: Pixels) -> None:
    ratios, sums, _ = pixels.gathered
    found = np.empty((3, 2 * CHANNELS + 1))
    kernels.median_ratios(ratios, sums, found)
    unit, _, _ = pixels.responses
    across = np.eye(CHANNELS) - unit[:, :, None] * unit[:, None].conj()
    left, part = np.einsum("pmm->pm", across @ pixels.matrices @ across).real, np.abs(unit) ** 2
    own = np.einsum("pm,pmn,pn->p", unit.conj(), pixels.matrices, unit).real
    dark = (part < LEAST[0]) & (part * own[:, None] < LOOKS * NOISE)
    assert np.all(np.count_nonzero(dark, axis=0) > 5)
    amplitude = np.sqrt(left / (LOOKS * NOISE * (1 - part)))
    _assert_medians(found[:, CHANNELS:-1], ratios[CHANNELS:-1], amplitude, dark.astype(float))


def test_the_stretch_is_that_of_the_derivative_by_the_width(pixels: Pixels) -> None:
    ratios, sums, _ = pixels.gathered
    found = np.empty((3, 2 * CHANNELS + 1))
    kernels.median_ratios(ratios, sums, found)
    values, weight = _stretches(pixels)
    assert 10 < np.count_nonzero(weight) < ROWS * COLS
    _assert_medians(found[:, -1:], ratios[-1:], values[:, None], weight[:, None])


def test_scores_are_those_of_patterns_in_what_a_scatterer_leaves(pixels: Pixels) -> None:
    _, _, scores = pixels.gathered
    unit, _, _ = pixels.responses
    across = np.eye(CHANNELS) - unit[:, :, None] * unit[:, None].conj()
    left = across @ pixels.matrices @ across
    alike = np.full((CHANNELS, CHANNELS), 1 / CHANNELS)
    neighbours = np.eye(CHANNELS, k=1) + np.eye(CHANNELS, k=-1)
    for row, pattern in ((kernels.ALIKE, alike), (kernels.NEIGHBOURS, neighbours)):
        expected = LOOKS * np.einsum("pmn,nm->p", across, pattern).real
        variance = LOOKS * np.einsum("pmn,nk,pkl,lm->p", across, pattern, across, pattern).real
        level = np.einsum("pmm->p", left).real / ((CHANNELS - 1) * LOOKS - 0.5)
        score = np.einsum("pmn,nm->p", left, pattern).real / level - expected
        for single in (False, True):
            some = (pixels.levels > 0) == single
            assert scores[int(single), row] == pytest.approx([np.sum(score[some]), np.sum(variance[some])], rel=1e-3)


def _assert_medians(found: Array, ratios: Array, values: Array, weight: Array) -> None:
    """The medians, their deviations and the numbers of pixels, to a bin."""
    width = (kernels.HIGHEST - kernels.LOWEST) / kernels.BINS
    for m in range(values.shape[1]):
        used = weight[:, m] > 0
        assert found[2, m] == np.count_nonzero(used)
        assert np.sum(ratios[m]) == pytest.approx(np.sum(weight[:, m]), rel=1e-3)
        kept = np.clip(values[used, m], kernels.LOWEST, kernels.HIGHEST)
        low, middle, high = (_quantile(kept, weight[used, m], q) for q in (0.25, 0.5, 0.75))
        assert found[0, m] == pytest.approx(middle, abs=1.01 * width)
        deviation = np.sqrt(np.pi / 2 * np.sum(weight[:, m] ** 2)) / np.sum(weight[:, m]) / 1.349
        assert found[1, m] == pytest.approx(deviation * (high - low), abs=2.02 * width * deviation)


def _gains(pixels: Pixels) -> tuple[Array, Array]:
    """The gains and their weights, channel by channel, from the definition."""
    gains, weight = np.zeros((2, ROWS * COLS, CHANNELS))
    unit, looks = pixels.responses[0], LOOKS * NOISE
    for p, matrix in enumerate(pixels.matrices):
        for m in range(CHANNELS):
            others = unit[p].copy()
            others[m] = 0
            rest = np.sum(np.abs(others) ** 2)
            signal = (others.conj() @ matrix @ others).real / rest - looks
            part = abs(unit[p, m]) ** 2
            if LEAST[0] <= part <= 1 - LEAST[0] and signal >= LEAST[1] * looks:
                gains[p, m] = (unit[p, m].conj() * (matrix[m] @ others)).real / (part * signal)
                weight[p, m] = np.sqrt(part * signal)
    return gains, weight


def _stretches(pixels: Pixels) -> tuple[Array, Array]:
    """1 + MAGNIFIED times the stretch of the beams of each pixel, and its weight, from wider beams."""
    beams, step = make_beams("jinc", CHANNELS), 1e-4
    values, weight = np.zeros((2, ROWS * COLS))
    unit, slope, power = pixels.responses
    phases = unit / np.where(np.abs(unit) > 0, np.abs(unit), 1)
    for p, (matrix, elevation) in enumerate(zip(pixels.matrices, pixels.elevation, strict=True)):
        own = (unit[p].conj() @ matrix @ unit[p]).real
        signal = own - LOOKS * NOISE
        one_scatterer = pixels.levels[p] > 0 or pixels.beside[p] * NOISE <= MOST_BESIDE * own
        if signal < LEAST[2] * LOOKS * NOISE or not one_scatterer:
            continue
        # Beams that are closer to each other, around the scatterer, are as wide ones; along the flight nothing changes.
        moved = [
            replace(beams, boresights=elevation + (beams.boresights - elevation) * (1 + side * step)).response(
                elevation, SQUINTS[p % COLS]
            )
            for side in (-1, 1)
        ]
        response = beams.response(elevation, SQUINTS[p % COLS])
        turn = (moved[1] - moved[0]) / (2 * step) * phases[p] * np.sign(response) / np.sqrt(power[p])
        basis = np.linalg.qr(np.stack([unit[p], slope[p]], axis=-1))[0]
        rest = turn - basis @ (basis.conj().T @ turn)
        expected = signal * np.sum(np.abs(rest) ** 2)
        values[p] = 1 - kernels.MAGNIFIED * (rest.conj() @ matrix @ unit[p]).real / expected
        weight[p] = np.sqrt(expected)
    return values, weight


def _quantile(values: Array, weight: Array, q: float) -> float:
    order = np.argsort(values)
    below = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(below, q * below[-1])])


def test_median_levels_are_those_of_single_scatterers_in_blocks_of_rows() -> None:
    levels = np.random.default_rng(7).uniform(-1, 2, SHAPE)
    levels[3:6], ends, found = -1.0, np.array([0, 3, 6, ROWS]), np.empty((2, 4))
    kernels.median_levels(levels, ends, found)
    for block, rows in enumerate((slice(0, 3), slice(3, 6), slice(6, ROWS), slice(0, ROWS))):
        some = levels[rows][levels[rows] > 0]
        assert found[1, block] == some.size
        assert found[0, block] == (pytest.approx(np.median(some)) if some.size else 0)
