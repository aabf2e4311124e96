"""Extended surfaces: their likelihood against its formula, and what is fitted against what was drawn."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, beams_named, circular, elevation_at, few, make_beams, offset_of

from sal_height.beams.array import Beams
from sal_height.elevation.array.likelihood import OBJECTIVES, search_guard
from sal_height.elevation.array.search import PeakSearch, PeakSearches
from sal_height.elevation.layover import _extended_kernels as kernels
from sal_height.elevation.layover.extended import (
    GREATEST_SPREAD,
    LEAST_SPREAD,
    QUADRATURES,
    ExtendedSurfaces,
    Surfaces,
    explained_by,
    log_prior,
    spread_of,
    surfaces_over,
    table_of,
)
from sal_height.elevation.layover.several import SeveralScatterers, adjoint, search_several

PATTERNS = pytest.mark.parametrize("pattern", ["jinc", "complex"])
DOMAIN = 7.5 * BEAMWIDTH


def search_of(beams: Beams) -> PeakSearch:
    return PeakSearches.over(beams, OBJECTIVES["normalised"], search_guard(beams)).at(0.0)


def covariance_of(
    beams: Beams, offset: np.ndarray, spread: float, cnr: float, looks: int, rng: np.random.Generator
) -> np.ndarray:
    """Sums over looks of g g^H for surfaces of 40 pieces, evenly spread about `offset` beamwidths, (pixels, M, M)."""
    samples = circular(rng, (len(offset), looks, beams.count))
    for piece in np.sqrt(12) * spread * (np.arange(40) - 19.5) / 40:
        response = beams.response(elevation_at(offset + piece), 0.0)[:, None]
        samples += np.sqrt(cnr / 40) * response * circular(rng, (len(offset), looks, 1))
    covariance = np.einsum("pkm,pkn->pmn", samples, samples.conj())
    return covariance if beams.is_complex else np.ascontiguousarray(covariance.real)


def log_likelihood(
    search: PeakSearch, covariance: np.ndarray, looks: np.ndarray, surfaces: Surfaces, count: int = 9
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The twin of the compiled one: matrices of the channels, (pixels, M, M), as the formulas have them.

    With `count` nodes of the quadrature.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    places = np.sqrt(3) * nodes
    elevation = surfaces.elevation[:, None] + surfaces.spread[:, None] * places
    units, slopes, array_power = search.responses_at(elevation)
    inside = (elevation >= search.tables.first) & (elevation <= search.tables.last)
    amplitude = np.sqrt(inside * weights / 2 * array_power * surfaces.cnr[:, None])[..., None]
    responses = np.swapaxes(units * amplitude, 1, 2)
    turns = np.swapaxes(slopes * amplitude, 1, 2) * surfaces.spread[:, None, None]
    identity, across = np.eye(covariance.shape[-1]), adjoint(responses)
    model = responses @ across + identity
    halves = [part @ across for part in (turns, turns * places, responses / 2)]
    derivatives = [half + adjoint(half) for half in halves]
    whitened = np.stack([np.linalg.solve(model, one) for one in derivatives], axis=1)
    seen = np.linalg.solve(model, covariance)
    gradient = np.einsum("pimn,pnm->pi", whitened, seen - looks[:, None, None] * identity).real
    information = looks[:, None, None] * np.einsum("pimn,pjnm->pij", whitened, whitened).real
    explained = np.trace(covariance - seen, axis1=1, axis2=2).real
    return explained - looks * np.linalg.slogdet(model)[1], gradient, information


@PATTERNS
def test_likelihood_is_that_of_its_formula(pattern: str) -> None:
    """The compiled one, by the directions of the surface, against matrices of the channels; also across the end."""
    beams, rng, looks = beams_named(pattern), np.random.default_rng(70), np.full(20, 4.0)
    covariance, search = covariance_of(beams, np.zeros(20), 0.4, 20.0, 4, rng), search_of(beams)
    offset, spread, cnr = rng.uniform(-4, 4, 20), np.linspace(0.05, 0.8, 20), 10 ** rng.uniform(0, 2, 20)
    offset[0] = offset_of(search.tables.last) - 0.3
    surfaces = Surfaces(elevation_at(offset), spread * BEAMWIDTH, cnr)
    of_counts = {count: log_likelihood(search, covariance, looks, surfaces, count) for count, _ in QUADRATURES}
    table, kind = kernels.at_squint(table_of(search.tables, BEAMWIDTH), 0), covariance.dtype
    places = surfaces.in_steps(search.tables).T.copy()
    for pixel in range(20):
        expected = of_counts[next(count for count, greatest in QUADRATURES if spread[pixel] <= greatest)]
        work = np.empty((3, 9, beams.count), kind), np.empty((7, 9, 9), kind)
        gradient, information = np.empty(3), np.empty((3, 3))
        likelihood = kernels.likelihood_at(covariance[pixel], 4.0, places[pixel], table, work, gradient, information)
        scale = np.sqrt(np.diag(expected[2][pixel]))
        assert likelihood == pytest.approx(expected[0][pixel], rel=1e-5, abs=1e-3)
        np.testing.assert_allclose(gradient / scale, expected[1][pixel] / scale, rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(
            information / np.outer(scale, scale), expected[2][pixel] / np.outer(scale, scale), atol=5e-4
        )


@pytest.mark.parametrize(("rule", "error"), [(0, 2e-5), (1, 2e-5), (2, 2e-2)])
def test_quadratures_are_as_exact_as_stated(rule: int, error: float) -> None:
    """Covariances of surfaces of the greatest spread that each is for, against 41 nodes; |a|^2 is 2."""
    search, (_, spread) = search_of(make_beams("jinc")), QUADRATURES[rule]
    surfaces = Surfaces(elevation_at(np.array([0.3])), np.array([spread * BEAMWIDTH]), np.ones(1))
    rows = np.empty((1, 9, 16))
    table = table_of(search.tables, BEAMWIDTH)
    kernels.all_responses(surfaces.in_steps(search.tables), np.zeros(1, np.intp), table, rows)
    nodes, weights = np.polynomial.legendre.leggauss(41)
    units, _, power = search.responses_at(surfaces.elevation + surfaces.spread * np.sqrt(3) * nodes)
    exact = np.einsum("i,im,in->mn", weights / 2 * power, units, units)
    np.testing.assert_allclose(rows[0].T @ rows[0], exact, atol=error)


@PATTERNS
def test_gradient_and_information_are_those_of_the_likelihood(pattern: str) -> None:
    """Against central differences; the information against the mean of the squared gradient of 2000 pixels (3 %)."""
    beams, rng, looks = beams_named(pattern), np.random.default_rng(71), np.full(2000, 4.0)
    covariance, search = covariance_of(beams, np.zeros(2000), 0.4, 20.0, 4, rng), search_of(beams)

    def at(step: np.ndarray) -> Surfaces:
        spread = 0.4 * BEAMWIDTH * np.exp(step[1])
        place = elevation_at(0.0) + step[0] * spread, spread, 20.0 * np.exp(step[2])
        return Surfaces(*(np.full(2000, value) for value in place))

    _, gradient, information = log_likelihood(search, covariance, looks, at(np.zeros(3)))
    for number, step in enumerate(1e-3 * np.eye(3)):
        above, below = (log_likelihood(search, covariance, looks, at(sign * step))[0] for sign in (1, -1))
        np.testing.assert_allclose((above - below) / 2e-3, gradient[:, number], rtol=2e-3, atol=2e-2)
    square = np.einsum("pi,pj->ij", gradient, gradient) / len(gradient)
    scale = np.sqrt(np.diag(information[0]))
    np.testing.assert_allclose(square / np.outer(scale, scale), information[0] / np.outer(scale, scale), atol=0.12)


@pytest.mark.parametrize(("cnr_db", "looks", "spread"), few(2, [(20, 4, 0.3), (30, 4, 0.9), (10, 16, 0.6)]))
def test_surfaces_are_found_within_their_sigma(cnr_db: int, looks: int, spread: float) -> None:
    """1000 pixels: coverage within 1.5 % (standard error), spread within 1 % of the median."""
    beams, rng = make_beams("jinc"), np.random.default_rng([72, cnr_db])
    middle, count = rng.uniform(-1.5, 1.5, 1000), np.full(1000, float(looks))
    covariance, search = covariance_of(beams, middle, spread, 10 ** (cnr_db / 10), looks, rng), search_of(beams)
    single = search.peaks(covariance).elevation[:, None]
    pair, _, _ = search_several(search, covariance, search.on_grid(covariance), single, np.zeros(1000))
    first = surfaces_over(pair, SeveralScatterers.at(search, covariance, count, pair).power)
    found = ExtendedSurfaces.fit(search, covariance, count, first, np.full(1000, -np.inf), DOMAIN, BEAMWIDTH)
    score = np.abs(offset_of(found.found.elevation) - middle) * BEAMWIDTH / found.sigma
    assert np.mean(score < 1) == pytest.approx(0.66, abs=0.06)
    assert np.mean(score > 5) < 5e-3
    assert np.median(found.found.spread) / BEAMWIDTH == pytest.approx(spread, rel=0.05)
    # What it leaves is noise.
    explained, directions = explained_by(search, covariance, found.found, BEAMWIDTH)
    left = np.trace(covariance, axis1=1, axis2=2) - explained
    assert np.mean(left) / np.mean((beams.count - directions) * count) == pytest.approx(1, abs=0.03)


def test_evidence_is_the_likelihood_less_what_the_looks_leave_of_the_prior() -> None:
    """Of surfaces as they are found, by determinants of the information on t, ln s and ln p (Laplace)."""
    beams, rng, count = make_beams("jinc"), np.random.default_rng(74), np.full(50, 4.0)
    covariance, search = covariance_of(beams, np.zeros(50), 0.3, 100.0, 4, rng), search_of(beams)
    start = Surfaces(elevation_at(np.zeros(50)), np.full(50, 0.3 * BEAMWIDTH), np.full(50, 100.0))
    found = ExtendedSurfaces.fit(search, covariance, count, start, np.full(50, -np.inf), DOMAIN, BEAMWIDTH)
    ranges = np.stack([DOMAIN / found.found.spread, *np.log(np.full((50, 2), [20.0, 1e4]).T)], axis=1)
    scaled = found.information * ranges[:, :, None] * ranges[:, None] / (2 * np.pi) + np.eye(3)
    expected = found.log_likelihood - np.linalg.slogdet(scaled)[1] / 2 + log_prior(found.found.spread / BEAMWIDTH)
    np.testing.assert_allclose(found.log_evidence, expected, rtol=1e-9)


def test_prior_of_the_spread_is_a_density() -> None:
    """Over an even one between the bounds its mean is 1."""
    log_spread = np.linspace(np.log(LEAST_SPREAD), np.log(GREATEST_SPREAD), 100_001)
    density = np.exp(log_prior(np.exp(log_spread)))
    assert np.trapezoid(density, log_spread) == pytest.approx(np.ptp(log_spread), rel=1e-6)


def test_pixels_that_cannot_reach_the_evidence_of_interest_are_left() -> None:
    """A point at 30 dB is fitted neither worse nor better for it than what the first step finds."""
    beams, rng, count = make_beams("jinc"), np.random.default_rng(73), np.full(50, 4.0)
    covariance, search = covariance_of(beams, np.zeros(50), 0.3, 1000.0, 4, rng), search_of(beams)
    start = Surfaces(elevation_at(np.full(50, 1.5)), np.full(50, 0.1 * BEAMWIDTH), np.full(50, 100.0))
    to_the_end = ExtendedSurfaces.fit(search, covariance, count, start, np.full(50, -np.inf), DOMAIN, BEAMWIDTH)
    given_up = ExtendedSurfaces.fit(search, covariance, count, start, np.full(50, np.inf), DOMAIN, BEAMWIDTH)
    np.testing.assert_array_equal(given_up.found.elevation, start.elevation)
    assert np.all(to_the_end.log_likelihood > given_up.log_likelihood)


def test_surface_over_scatterers_has_their_moments() -> None:
    """A third of the power 1.5 beamwidths above the rest: its middle and spread; and one without CNR."""
    first = surfaces_over(np.array([[0.0, 1.5], [0.2, 3.0]]), np.array([[20.0, 10.0], [1e9, -3.0]]))
    np.testing.assert_allclose(first.elevation, [0.5, 0.2], rtol=1e-9)
    np.testing.assert_allclose(first.spread, [np.sqrt(0.5), 0.0], atol=1e-4)
    np.testing.assert_allclose(first.cnr, [30.0, 1e9], rtol=1e-9)


def test_spread_follows_from_the_power_along_the_slope() -> None:
    """K = 4 looks of noise and of a spread s have (4 - 1/2)(1 + p D s^2 / |a|^2) there on average."""
    found = spread_of(
        np.array([3.5 * (1 + 20 * 2.5 * 0.04), 3.0]), np.array([4.0, 4.0]), np.array([20.0] * 2), np.array([2.5] * 2)
    )
    np.testing.assert_allclose(found, [0.2, 0.0], atol=1e-12)
