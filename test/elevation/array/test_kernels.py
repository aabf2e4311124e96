"""Every compiled loop of the package against a twin in plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, few, make_beams, target_slc

from sal_height.beams.array import Beams
from sal_height.elevation.array import _kernels as kernels
from sal_height.elevation.array.likelihood import OBJECTIVES
from sal_height.elevation.array.search import PeakSearches, SearchTables
from sal_height.elevation.looks import _look_kernels as look_kernels

Array = np.ndarray
RNG_SEED = 80


SQUINTS = np.array([-0.3, 0.0, 0.4]) * BEAMWIDTH


def tables_of(beams: Beams, objective: str = "normalised") -> SearchTables:
    """Tables at SQUINTS."""
    return PeakSearches.over(beams, OBJECTIVES[objective], 3 * BEAMWIDTH).at(SQUINTS).tables


def mixed_squints(pixels: int) -> Array:
    """Numbers of squints of pixels in no order, runs of several lengths among them."""
    return np.random.default_rng(RNG_SEED).integers(0, 3, pixels // 2 + 1).repeat(2)[:pixels]


def pixels_of(channels: int, pixels: int, looks: int) -> Array:
    """Real covariances of targets at 10 dB, (pixels, channels, channels), float32."""
    rng = np.random.default_rng([RNG_SEED, channels, looks])
    offsets = rng.uniform(-0.25, 0.25, (pixels, 1)) * channels
    slc = target_slc(make_beams("jinc", channels), offsets, pixels, looks, 10.0, rng)
    return np.ascontiguousarray(np.einsum("mpk,npk->pmn", slc, slc.conj()).real, dtype=np.float32)


def weights_at(tables: SearchTables, squint: int | Array, position: Array) -> Array:
    """Weights (..., detectors) at squints and positions in steps of the table, in double precision."""
    node = np.minimum(position.astype(int), tables.steps - 1)
    powers = (position - node)[..., None] ** np.arange(4)
    return np.einsum("...k,...km->...m", powers, tables.pieces[squint, node].astype(float))


def forms(matrices: Array, weights: Array) -> Array:
    """Quadratic forms of each pixel for all weights (nodes, detectors), (pixels, nodes)."""
    pairs = weights[:, :, None] * weights[:, None, :]
    return matrices.astype(float).reshape(len(matrices), -1) @ pairs.reshape(len(weights), -1).T


@pytest.mark.parametrize("channels", [2, 3, 5, 16])
@pytest.mark.parametrize("pixels", [1, 6, 15])
def test_grid_is_the_quadratic_form_at_its_nodes(channels: int, pixels: int) -> None:
    tables, matrices = tables_of(make_beams("jinc", channels)), pixels_of(channels, pixels, 4)
    nodes, squints = np.arange(tables.grid.shape[2]) * float(kernels.TABLE_STEPS), mixed_squints(pixels)
    expected = np.concatenate(
        [
            forms(matrix[None], weights_at(tables, squint, nodes))
            for matrix, squint in zip(matrices, squints, strict=True)
        ]
    )
    found = kernels.evaluate_on_grid(matrices, squints, tables.entries, tables.grid)
    np.testing.assert_allclose(found, expected, atol=2e-6 * expected.max())


def highest_peaks(tables: SearchTables, squint: int, matrices: Array) -> tuple[Array, Array, Array]:
    """The search in plain NumPy: place (in steps of the table), height, and second height of the peaks on a fine grid.

    Peaks are vertices of parabolas through 64 points in each step of the table.
    """
    fine = np.linspace(0, tables.steps, 64 * tables.steps + 1)
    value = forms(matrices, weights_at(tables, squint, fine))
    padded = np.pad(value, ((0, 0), (1, 1)), constant_values=-np.inf)
    peak = (value >= padded[:, :-2]) & (value > padded[:, 2:])
    heights = np.sort(np.where(peak, value, -np.inf), axis=1)
    top = np.argmax(value, axis=1).clip(1, len(fine) - 2)
    low, middle, high = (value[np.arange(len(value)), top + step] for step in (-1, 0, 1))
    vertex = ((low - high) / (2 * (low - 2 * middle + high))).clip(-1, 1)
    return fine[top] + vertex / 64, heights[:, -1], heights[:, -2]


@pytest.mark.parametrize("objective", sorted(OBJECTIVES))
@pytest.mark.parametrize(("channels", "looks"), few(2, [(3, 1), (16, 16), (5, 4), (16, 1)]))
def test_highest_and_second_peak_are_those_of_a_dense_search(channels: int, looks: int, objective: str) -> None:
    """But for ties within the errors of float32: 1e-4 of the height."""
    tables, matrices = tables_of(make_beams("jinc", channels), objective), pixels_of(channels, 300, looks)
    squints = np.arange(300) // 100
    parts = [highest_peaks(tables, squint, matrices[squints == squint]) for squint in range(3)]
    place, height, second = (np.concatenate(part) for part in zip(*parts, strict=True))
    values = kernels.evaluate_on_grid(matrices, squints, tables.entries, tables.grid)
    found = tuple(np.empty((3, len(matrices))))
    margins = np.full(len(matrices), np.max(height), np.float32)
    kernels.climb_highest(matrices, squints, values, margins, tables.pieces, found)
    np.testing.assert_allclose(found[1], height, rtol=1e-4)
    clear = height - second > 1e-3 * height
    assert np.mean(clear) > 0.95
    np.testing.assert_allclose(found[0][clear], place[clear], atol=0.02)
    high = second > 0.7 * height  # lower ones may be missed
    # A climb from behind a dip may end on the flank of a peak instead: the second peak is too high then.
    close = np.isclose(found[2][high], second[high], rtol=1e-3)
    assert np.count_nonzero(~close) <= 0.01 * len(matrices)
    assert np.all(close | (found[2][high] > second[high]))


@pytest.mark.parametrize("complex_beams", [False, True])
def test_fit_is_that_of_the_weights_at_a_place(complex_beams: bool) -> None:
    """Explained power and how fast the weights turn; complex ones, real parts first, but for a turn of phase."""
    rng, tables, matrices = np.random.default_rng(RNG_SEED), tables_of(make_beams("jinc", 6)), pixels_of(6, 50, 4)
    place, found, squints = rng.uniform(0, tables.steps, 50), np.empty((3, 50)), mixed_squints(50)
    kernels.fit_scatterer(matrices, squints, place, tables.pieces, tables.power, complex_beams, found)
    step = 1e-4
    weight, after, before = (weights_at(tables, squints, place + moved) for moved in (0, step, -step))
    slope = (after - before) / (2 * step)
    both = [part[:, :3] + 1j * part[:, 3:] if complex_beams else part for part in (weight, slope)]
    norm = np.sum(np.abs(both[0]) ** 2, axis=1)
    overlap = np.abs(np.sum(both[0].conj() * both[1], axis=1)) ** 2
    turning = (np.sum(np.abs(both[1]) ** 2, axis=1) - overlap / norm) / norm
    explained = np.einsum("pm,pmn,pn->p", weight, matrices.astype(float), weight) / norm
    np.testing.assert_allclose(found[0], explained, rtol=1e-5)
    np.testing.assert_allclose(found[2], turning, rtol=2e-3, atol=1e-6)


def images(channels: int) -> tuple[Array, Array]:
    """Images (channels, rows, cols), complex64, and the view of their real and imaginary parts."""
    slc = circular(np.random.default_rng([RNG_SEED, channels]), (channels, 7, 9)).astype(np.complex64)
    return slc, slc.view(np.float32)


def test_power_of_samples_and_marks_of_bad_ones() -> None:
    slc, numbers = images(3)
    slc[1, 2, 3], slc[0, 4, 0] = np.nan, np.inf
    weights, power = np.array([1.0, 0.5, 2.0], np.float32), np.empty((6, 9), np.float32)
    look_kernels.sum_powers(numbers, weights, 1, power)
    expected = np.einsum("c,crk->rk", weights, np.abs(slc[:, 1:]) ** 2)
    np.testing.assert_allclose(power, np.where(np.isfinite(expected), expected, -1), rtol=1e-5)


WINDOWS = ((-1, 2, np.array([1.0, 2.0, 0.5])), (0, 3, np.array([1.0, 0.7])))
"""First sample, step and weights in range and azimuth."""


def window_weights(window: tuple[int, int, Array], pixels: int, samples: int) -> Array:
    """Weights of all samples in each pixel along one axis, (pixels, samples)."""
    first, step, weights = window
    result = np.zeros((pixels, samples))
    for pixel in range(pixels):
        for k, weight in enumerate(weights):
            if 0 <= first + pixel * step + k < samples:
                result[pixel, first + pixel * step + k] = weight
    return result


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("channels", [1, 3, 8])
def test_covariances_are_weighted_sums_of_outer_products(channels: int, parts: int) -> None:
    slc, numbers = images(channels)
    rng = np.random.default_rng(RNG_SEED)
    gains, scale = circular(rng, (channels,)).astype(np.complex64), rng.random((4, 3)).astype(np.float32)
    scale[1, 1] = 0
    row, col = (axis.ravel() for axis in np.indices((4, 3)))
    found = np.empty((12, parts, channels, channels), np.float32)
    windows = [(first, step, weights.astype(np.float32)) for first, step, weights in WINDOWS]
    look_kernels.sum_covariances(numbers, gains, (row, col), *windows, scale, found)
    down, across = window_weights(WINDOWS[0], 4, 7), window_weights(WINDOWS[1], 3, 9)
    seen = gains[:, None, None] * slc
    expected = np.einsum("ir,jc,ij,mrc,nrc->ijmn", down, across, scale, seen, seen.conj()).reshape(12, channels, -1)
    np.testing.assert_allclose(found[:, 0], expected.real, atol=1e-5)
    if parts == 2:
        np.testing.assert_allclose(found[:, 1], expected.imag, atol=1e-5)
    samples = np.ascontiguousarray(circular(rng, (6, 5, channels)).astype(np.complex64))
    sums = np.empty((6, parts, channels, channels), np.float32)
    look_kernels.sum_samples(samples.view(np.float32), sums)
    expected = np.einsum("pkm,pkn->pmn", samples, samples.conj())
    np.testing.assert_allclose(sums[:, 0], expected.real, atol=1e-5)
