"""Several scatterers in a pixel: the search, the bound and the likelihood, each against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, beams_named, circular, elevation_at, make_beams, multilook, offset_of

from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS
from sal_height.elevation.array.likelihood import OBJECTIVES
from sal_height.elevation.array.search import PeakSearch, PeakSearches
from sal_height.elevation.layover import _several_kernels as kernels
from sal_height.elevation.layover.several import SeveralScatterers, deviations, fit_powers, search_several

STEP = 1e-3
"""Of central differences, beamwidths: good to 1e-5 of the bound."""

NAMES = pytest.mark.parametrize("name", ["sinc", "complex"])


def pixels_of(
    beams: Beams, offsets: np.ndarray, cnrs: tuple[float, ...], looks: int, rng: np.random.Generator
) -> np.ndarray:
    """Covariance (pixels, 1, M, M) of fluctuating scatterers at `offsets` (pixels, scatterers) in unit noise."""
    slc = circular(rng, (len(offsets), looks, beams.count))
    for offset, cnr in zip(offsets.T, cnrs, strict=True):
        response = beams.response(elevation_at(offset), 0.0)[:, None]
        slc += response * np.sqrt(cnr) * circular(rng, (len(offset), looks, 1))
    return multilook(np.moveaxis(slc, -1, 0), 1, looks, hermitian=beams.is_complex).covariance[:, :]


def search_of(beams: Beams) -> PeakSearch:
    return PeakSearches.over(beams, OBJECTIVES["normalised"], 3 * BEAMWIDTH).at(0.0)


def best_of(beams: Beams, covariance: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (pixels, S) and explained power of the best S scatterers of each pixel."""
    search = search_of(beams)
    elevation, explained = search.peaks(covariance).elevation[:, None], np.zeros(0)
    double, values = covariance.astype(np.result_type(covariance, np.float64)), search.on_grid(covariance)
    for _ in range(1, count):
        elevation, explained, _ = search_several(search, double, values, elevation, np.zeros(len(covariance)))
    return offset_of(elevation), explained


def explained_by(beams: Beams, offsets: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """tr(P R) of scatterers at `offsets` (pixels, S)."""
    matrix = np.swapaxes(beams.response(elevation_at(offsets), 0.0), -1, -2)
    return np.trace(matrix @ np.linalg.pinv(matrix) @ covariance, axis1=-2, axis2=-1).real


@pytest.mark.parametrize("name", [*sorted(PATTERNS), "complex"])
@pytest.mark.parametrize("offsets", [(-0.25, 0.25), (-0.5, 0.5), (-2.0, 0.9), (-1.0, 0.0, 1.0), (-3.0, -1.5, 2.0)])
def test_scatterers_are_exact_without_noise(name: str, offsets: tuple[float, ...]) -> None:
    beams, places = beams_named(name), np.array(offsets) + np.linspace(-0.5, 0.5, 12)[:, None]
    response = beams.response(elevation_at(places), 0.0)
    energies = 1e4 * np.array([1.0, 0.25, 0.5])[: len(offsets)]
    covariance = np.einsum("s,psm,psn->pmn", energies, response, response.conj())
    found, explained = best_of(
        beams, covariance.astype(np.complex64 if name == "complex" else np.float32), len(offsets)
    )
    np.testing.assert_allclose(found, places, atol=1e-3)
    np.testing.assert_allclose(explained, np.trace(covariance, axis1=1, axis2=2).real, rtol=1e-5)


@NAMES
def test_weak_scatterer_beside_a_strong_one_is_found(name: str) -> None:
    """30 dB apart: the strong one must not be held at a node of the grid, where what it leaves exceeds the weak one."""
    beams, rng = beams_named(name), np.random.default_rng(63)
    places = np.sort(rng.uniform(-3.5, 3.5, (400, 2)), axis=1)
    places = places[np.diff(places, axis=1)[:, 0] > 1.0]
    found, _ = best_of(beams, pixels_of(beams, places, (1e4, 10.0), 16, rng)[:, 0], 2)
    assert np.mean(np.abs(found - places).max(axis=1) < 0.3) > 0.99


@NAMES
def test_no_pair_explains_more_than_the_one_that_was_found(name: str) -> None:
    """Against all pairs in steps of 0.04 beamwidths, over the array and 3 beamwidths around it.

    0.1 noise powers are left to pairs at the least separation; one in a hundred pixels has a better one farther away.
    """
    beams, rng = beams_named(name), np.random.default_rng(56)
    offsets = np.sort(rng.uniform(-3.5, 3.5, (150, 2)), axis=1)
    covariance = pixels_of(beams, offsets, (10.0, 30.0), 4, rng)[:, 0]
    mine = best_of(beams, covariance, 2)[1]
    place = np.arange(-6.98, 7, 0.04)
    fine = beams.response(elevation_at(place), 0.0)
    fine /= np.linalg.norm(fine, axis=1, keepdims=True)
    overlap = fine.conj() @ fine.T
    apart = np.abs(place[:, None] - place) > kernels.LEAST_SEPARATION / kernels.TABLE_STEPS * 0.2
    weight = np.divide(1, 1 - np.abs(overlap) ** 2, where=apart, out=np.zeros(apart.shape))
    dense = np.empty(len(covariance))
    for pixel, matrix in enumerate(covariance):
        products = fine.conj() @ matrix @ fine.T
        own = np.diagonal(products).real
        dense[pixel] = np.max((own[:, None] + own - 2 * (overlap.conj() * products).real) * weight)
    assert np.mean(mine > dense - 0.1) >= 0.98


@pytest.mark.parametrize("beams", [beams_named("sinc"), beams_named("complex"), make_beams(count=14)])
def test_gain_beside_is_that_of_projectors(beams: Beams) -> None:
    """Of 16 channels, which are added four at a time, and of 14, of which two are left."""
    rng = np.random.default_rng(59)
    covariance = pixels_of(beams, rng.uniform(-3.5, 3.5, (20, 2)), (10.0, 3.0), 4, rng)[:, 0]
    search, first = search_of(beams), elevation_at(rng.uniform(-3.0, 3.0, 20))
    gain, along = search.gain_beside(covariance, search.on_grid(covariance), first)
    nodes = beams.response(search.tables.grid_nodes, 0.0)
    for pixel, matrix in enumerate(covariance):
        one = beams.response(first[pixel], 0.0)
        beyond = nodes - np.outer(nodes @ one.conj(), one) / np.linalg.norm(one) ** 2
        norm = np.linalg.norm(beyond, axis=1)
        apart = norm > np.sqrt(kernels.LEAST_RESIDUE) * np.linalg.norm(nodes, axis=1)
        unit = beyond[apart] / norm[apart, None]
        assert gain[pixel] == pytest.approx(np.max(np.einsum("jm,mn,jn->j", unit.conj(), matrix, unit).real), rel=1e-3)
        slope = beams.slope(first[pixel], 0.0)
        turn = slope - one * (one.conj() @ slope) / np.linalg.norm(one) ** 2
        expected = (turn.conj() @ matrix @ turn).real / np.linalg.norm(turn) ** 2
        assert along[pixel] == pytest.approx(expected, rel=1e-3, abs=1e-3)


@NAMES
@pytest.mark.parametrize("count", [1, 2, 3])
def test_best_node_and_newton_step_are_those_of_projectors(name: str, count: int) -> None:
    """The step against central differences of f and the expected curvature."""
    beams, rng = beams_named(name), np.random.default_rng([61, count])
    matrix = pixels_of(beams, rng.uniform(-2, 2, (1, 2)), (10.0, 3.0), 4, rng)[0, 0].astype(complex)
    search = search_of(beams)
    kind = complex if beams.is_complex else float
    matrix = np.ascontiguousarray(matrix if beams.is_complex else matrix.real)
    values = search.on_grid(matrix[None].astype(np.complex64 if beams.is_complex else np.float32))[0]
    place, table = np.array([100.0, 130.0, 171.0])[:count], search.tables.precise_units_across[0]
    pieces = search.tables.unit_pieces[0]
    node, gain = kernels.best_node(matrix, values, table, pieces, place)

    def explained(positions: np.ndarray) -> float:
        return float(explained_by(beams, offset_of(search.elevation(positions))[None], matrix[None])[0])

    whole = [explained(np.append(place, kernels.TABLE_STEPS * j)) for j in range(table.shape[1])]
    assert gain == pytest.approx(whole[node] - explained(place), rel=1e-3)
    assert whole[node] == pytest.approx(np.max(whole), rel=1e-3)
    step, tiny = np.zeros(count), 1e-3
    work = np.empty((4, count, 16), kind), np.empty((3, count, count), kind), np.empty(16, kind)
    assert kernels.newton_step(matrix, place, pieces, step, work) == pytest.approx(explained(place), rel=1e-5)
    gradient = [(explained(place + tiny * e) - explained(place - tiny * e)) / (2 * tiny) for e in np.eye(count)]
    several = SeveralScatterers.at(search, matrix[None], np.ones(1), search.elevation(place[None]))
    turning = several.turning * np.swapaxes(several.fitted, 1, 2)
    curvature = 2 * search.tables.step**2 * turning[0].real
    np.testing.assert_allclose(curvature @ step, gradient, rtol=5e-3, atol=2e-3 * np.max(np.abs(gradient)))


def numerical_bound(beams: Beams, offsets: tuple[float, ...], signal: np.ndarray) -> np.ndarray:
    """Beamwidths, of 4 looks, by the Fisher information of Gaussian channels of covariance A S A^H + s I.

    Slepian-Bangs; unknown are the elevations, Hermitian S, and s.
    """
    count = len(offsets)
    upper = np.triu_indices(count, 1)

    def covariance(x: np.ndarray) -> np.ndarray:
        a = beams.response(elevation_at(x[:count]), 0.0).T
        s = np.diag(x[count : 2 * count]).astype(complex)
        s[upper] = x[2 * count : 2 * count + len(upper[0])] + 1j * x[2 * count + len(upper[0]) : -1]
        s[upper[1], upper[0]] = s[upper].conj()
        return a @ s @ a.conj().T + x[-1] * np.eye(len(a))

    point = np.array([*offsets, *np.diagonal(signal).real, *signal[upper].real, *signal[upper].imag, 1.0])
    inverse = np.linalg.inv(covariance(point))
    slopes = [
        inverse @ (covariance(point + STEP * unit) - covariance(point - STEP * unit)) / (2 * STEP)
        for unit in np.eye(len(point))
    ]
    fisher = 4 * np.array([[np.trace(first @ second).real for second in slopes] for first in slopes])
    return np.sqrt(np.diagonal(np.linalg.inv(fisher))[:count])


@NAMES
@pytest.mark.parametrize("offsets", [(-0.5, 0.5), (1.2, 1.7), (-1.0, 0.1, 0.9)])
def test_bound_is_the_inverse_fisher_information(name: str, offsets: tuple[float, ...]) -> None:
    """Amplitudes that are correlated, as those of a few looks always are; less noise, at first order, is 1e-4 off."""
    beams, count = beams_named(name), len(offsets)
    signal = 1e6 * np.diag([1.0, 0.1, 0.5][:count]).astype(complex)
    signal[0, 1] = 0.6 * np.exp(0.9j) * np.sqrt(signal[0, 0] * signal[1, 1])
    signal[1, 0] = signal[0, 1].conj()
    response = beams.response(elevation_at(np.array(offsets)), 0.0)
    covariance = 4 * (response.T @ signal @ response.conj() + np.eye(beams.count))
    covariance = (covariance if beams.is_complex else np.ascontiguousarray(covariance.real))[None]
    if not beams.is_complex:
        signal = signal.real.astype(complex)
    several = SeveralScatterers.at(search_of(beams), covariance, np.full(1, 4.0), elevation_at(np.array([offsets])))
    np.testing.assert_allclose(several.sigma[0] / BEAMWIDTH, numerical_bound(beams, offsets, signal), rtol=2e-3)
    np.testing.assert_allclose(several.power[0], np.diagonal(signal).real, rtol=1e-3)
    np.testing.assert_allclose(several.inverse @ several.gram, np.eye(count)[None], atol=1e-9)


@NAMES
def test_power_along_the_slopes_is_that_of_what_the_responses_leave_of_them(name: str) -> None:
    """By projectors; two surfaces whose spread is 0.05 beamwidths have the power that their spread explains.

    2000 pixels of 4 looks: a standard error of 2 %.
    """
    beams, rng, looks, spread = beams_named(name), np.random.default_rng(64), 4, 0.05
    places = np.repeat([[-0.9, 0.8]], 2000, axis=0)
    pieces = (places[..., None] + spread * np.sqrt(12) * (np.arange(8) - 3.5) / 8).reshape(2000, -1)
    covariance = pixels_of(beams, pieces, (500.0 / 8,) * 16, looks, rng)[:, 0]
    covariance = covariance.astype(np.result_type(covariance, np.float64))
    several = SeveralScatterers.at(search_of(beams), covariance, np.full(2000, float(looks)), elevation_at(places))
    units = [beams.response(elevation_at(places[0] + step), 0.0) for step in (-STEP, 0.0, STEP)]
    units = [unit / np.linalg.norm(unit, axis=1, keepdims=True) for unit in units]
    left = (units[2] - units[0]) @ (np.eye(beams.count) - np.linalg.pinv(units[1]) @ units[1])
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    expected = np.einsum("sm,pmn,sn->ps", left.conj(), covariance, left).real
    np.testing.assert_allclose(several.along_slopes, expected, rtol=1e-2)
    none, no_limit = np.zeros(2000), np.full(2000, np.inf)
    excess, unit = (part.mean() for part in several.along_surfaces(none, no_limit))
    # At known elevations all K looks have power along the slope, half a look more than at the peak.
    noise = 2 * 0.5
    assert np.sqrt((excess - noise) / unit * (looks - 0.5) / looks) / BEAMWIDTH == pytest.approx(spread, rel=0.1)
    level, _ = several.along_surfaces(np.full(2000, spread * BEAMWIDTH), no_limit)
    assert abs(level.mean()) < 0.3 * excess
    least, _ = several.along_surfaces(none, none)
    np.testing.assert_allclose(least, -2 * (looks - 0.5))


@NAMES
def test_scatterers_are_uncertain_by_half_the_spread_of_their_surfaces(name: str) -> None:
    """Surfaces with a spread of 0.05 beamwidths, and points; on ground that is as spread while level, neither.

    Of 500 pixels of 64 looks: the medians have a standard error of 1 %.
    """
    beams, rng, looks, spread = beams_named(name), np.random.default_rng(65), 64, 0.05
    places = np.repeat([[-0.9, 0.8]], 500, axis=0)
    pieces = (places[..., None] + spread * np.sqrt(12) * (np.arange(8) - 3.5) / 8).reshape(500, -1)

    def deviation(pieces: np.ndarray, cnrs: tuple[float, ...], level: float) -> np.ndarray:
        covariance = pixels_of(beams, pieces, cnrs, looks, rng)[:, 0]
        covariance = covariance.astype(np.result_type(covariance, np.float64))
        counts = np.full(500, float(looks))
        several = SeveralScatterers.at(search_of(beams), covariance, counts, elevation_at(places))
        return np.median(several.deviation_by_spread(np.full(500, level * BEAMWIDTH)), axis=0) / BEAMWIDTH

    np.testing.assert_allclose(deviation(pieces, (400.0 / 8,) * 16, 0.0), spread / 2, rtol=0.1)
    np.testing.assert_allclose(deviation(places, (200.0, 600.0), 0.0), 0.0)
    np.testing.assert_allclose(deviation(pieces, (400.0 / 8,) * 16, spread), 0.0, atol=0.1 * spread)


def test_information_that_is_not_positive_bounds_nothing() -> None:
    information = np.array([[[1.0, 0.0], [0.0, 4.0]], [[1.0, 2.0], [2.0, 1.0]], [[-1.0, 0.0], [0.0, -1.0]]])
    np.testing.assert_allclose(deviations(information), [[1, 0.5], [np.inf, np.inf], [np.inf, np.inf]])


@NAMES
def test_powers_are_at_the_maximum_of_the_likelihood(name: str) -> None:
    """The likelihood by determinants; no power 2 % away is better, and the information is that of Slepian and Bangs."""
    beams, rng, looks = beams_named(name), np.random.default_rng(62), 8
    offsets = np.tile([-0.4, 0.5], (5, 1))
    covariance = pixels_of(beams, offsets, (20.0, 50.0), looks, rng)[:, 0].astype(complex)
    covariance = covariance if beams.is_complex else np.ascontiguousarray(covariance.real)
    several = SeveralScatterers.at(search_of(beams), covariance, np.full(5, float(looks)), elevation_at(offsets))
    fit = fit_powers(several.gram, several.seen, several.looks, several.power * several.array_power)
    response = beams.response(elevation_at(offsets), 0.0)
    all_units = np.swapaxes(response / np.linalg.norm(response, axis=-1, keepdims=True), 1, 2)

    def likelihood(power: np.ndarray, pixel: int) -> float:
        units = all_units[pixel]
        model = units @ np.diag(power) @ units.conj().T + np.eye(beams.count)
        noise = np.trace(covariance[pixel]).real
        whole = np.trace(np.linalg.solve(model, covariance[pixel])).real + looks * np.linalg.slogdet(model)[1]
        return float(noise - whole)

    for pixel in range(5):
        best = likelihood(fit.power[pixel], pixel)
        assert best == pytest.approx(fit.log_likelihood[pixel], rel=1e-6)
        for factor in ((0.98, 1), (1.02, 1), (1, 0.98), (1, 1.02)):
            assert likelihood(fit.power[pixel] * factor, pixel) < best + 1e-6
        units, power = all_units[pixel], fit.power[pixel]
        inverse = np.linalg.inv(units @ np.diag(power) @ units.conj().T + np.eye(beams.count))
        parts = [inverse @ (p * np.outer(u, u.conj())) for p, u in zip(power, units.T, strict=True)]
        expected = [[looks * np.trace(a @ b).real for b in parts] for a in parts]
        np.testing.assert_allclose(fit.information[pixel], expected, rtol=1e-6)
