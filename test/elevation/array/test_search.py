"""The tables of a search against the beams themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, elevation_at, make_beams, offset_of, phased, target_slc

from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS
from sal_height.elevation.array._kernels import NO_PEAK, is_behind_a_dip
from sal_height.elevation.array.bounds import beam_power, information, unit_vectors
from sal_height.elevation.array.estimate import explained_power
from sal_height.elevation.array.likelihood import GUARD, OBJECTIVES, peak_elevation
from sal_height.elevation.array.search import SQUINT_STEP, PeakSearch, PeakSearches
from sal_height.elevation.looks.looks import Looks, covariance

OFFSETS = np.linspace(-6.9, 6.9, 400)
"""Over array and guard of 16 detectors, beamwidths."""


def beams_of(kind: str) -> Beams:
    """Beams of a pattern, complex ones, so that a' has a part along j a, or beams on a turned axis."""
    beams = make_beams(kind if kind in PATTERNS else "jinc")
    if kind == "complex":
        return replace(beams, patterns=(phased(PATTERNS["jinc"], tilt=0.7),))
    return replace(beams, rotation=0.4) if kind == "turned" else beams


@pytest.mark.parametrize("objective", sorted(OBJECTIVES))
@pytest.mark.parametrize("kind", [*sorted(PATTERNS), "complex", "turned"])
def test_fit_is_what_the_beams_say(kind: str, objective: str) -> None:
    """Errors of the tables: 5e-8 of w and 5e-6 per beamwidth of w', which is 1 or so."""
    beams = beams_of(kind)
    squint, elevation = 0.3 * BEAMWIDTH, elevation_at(OFFSETS if kind != "turned" else OFFSETS * 0.9)
    matrices = covariance(circular(np.random.default_rng(1), (400, 4, 16)).astype(np.complex64), beams.is_complex)
    found = search(beams, squint, objective).fit(matrices, elevation)
    power = beam_power(beams.response(elevation, squint))
    seen = power > 1e-3  # a Gaussian beam ends
    np.testing.assert_allclose(found[0, seen], explained_power(matrices, beams.response(elevation, squint))[seen], 2e-5)
    np.testing.assert_allclose(found[1, seen], power[seen], rtol=1e-4, atol=1e-6)
    turning = information(beams, elevation, squint) / power * BEAMWIDTH**2
    np.testing.assert_allclose(found[2, seen] * BEAMWIDTH**2, turning[seen], rtol=1e-3, atol=1e-4)


def test_fit_of_no_elevation_is_none_and_beyond_the_domain_is_its_end() -> None:
    beams = make_beams("sinc")
    matrices = covariance(circular(np.random.default_rng(2), (3, 4, 16)).astype(np.complex64), False)
    low, high = beams.domain(GUARD * BEAMWIDTH)
    inside, beyond = (
        search(beams, 0.0).fit(matrices, np.array(where))
        for where in ([low, np.nan, high], [low - BEAMWIDTH, np.nan, high + BEAMWIDTH])
    )
    np.testing.assert_array_equal(inside, beyond)
    np.testing.assert_array_equal(np.isnan(inside), np.tile([False, True, False], (3, 1)))


@pytest.mark.parametrize("kind", [*sorted(PATTERNS), "complex", "turned"])
def test_between_tables_the_beams_are_as_they_are(kind: str) -> None:
    """Half way between two squints, where the polynomial errs most; targets are found right to 1e-5 beamwidths."""
    beams = beams_of(kind)
    for squint in (np.array([-0.5, 1.5, 14.5]) * SQUINT_STEP * BEAMWIDTH).tolist():
        offsets = np.linspace(-3.7, 3.7, 200)
        unit = unit_vectors(beams.response(elevation_at(offsets), squint))
        weights, slopes, _ = search(beams, squint).responses_at(elevation_at(offsets))
        np.testing.assert_allclose(weights, unit, atol=2e-5)
        # By how much the table's response moves the peak of a target that has the beams' own.
        beyond = slopes - unit * np.sum(unit.conj() * slopes, axis=1, keepdims=True)
        moved = np.sum(beyond.conj() * (unit - weights), axis=1).real / np.sum(np.abs(beyond) ** 2, axis=1)
        assert np.abs(moved).max() < 1e-5 * BEAMWIDTH


def test_a_column_is_searched_as_if_it_were_alone() -> None:
    """Whatever columns are beside it, and whatever images came before."""
    rng, beams = np.random.default_rng(3), make_beams("jinc")
    squint, matrices = np.linspace(-0.31, 0.4, 70) * BEAMWIDTH, np.empty((20, 70, 16, 16), np.float32)
    for column in range(70):
        matrices[:, column] = covariance(circular(rng, (20, 4, 16)).astype(np.complex64), False)

    def elevations(cols: slice | list[int], some: Beams) -> np.ndarray:
        looks = Looks.of(np.ascontiguousarray(matrices[:, cols]), 4, squint[cols])
        return peak_elevation(looks, some, OBJECTIVES["normalised"], GUARD * BEAMWIDTH)

    whole = elevations(slice(None), beams)
    for column in (0, 33, 69):
        np.testing.assert_array_equal(elevations([column], make_beams("jinc"))[:, 0], whole[:, column])
    np.testing.assert_array_equal(elevations(slice(None, None, -1), beams), whole[:, ::-1])


def search(beams: Beams, squint: float, objective: str = "normalised") -> PeakSearch:
    return PeakSearches.over(beams, OBJECTIVES[objective], GUARD * BEAMWIDTH).at(squint)


FINE = np.arange(-7, 7 + 5e-4, 1e-3)
"""Offsets of a dense search over array and guard of 16 detectors, beamwidths."""


def assert_highest(matrices: np.ndarray, objective: str) -> None:
    """Assert that `peaks` finds the highest value of w^H R w on FINE, and its place but for near ties."""
    beams = make_beams("sinc")
    response = beams.response(elevation_at(FINE), 0.0)
    weight, _ = OBJECTIVES[objective](response, np.zeros_like(response))
    pairs = weight[:, :, None] * weight[:, None, :]
    values = matrices.reshape(len(matrices), -1) @ pairs.reshape(len(FINE), -1).T
    best, spread = values.max(axis=1), np.ptp(values, axis=1)
    found = search(beams, 0.0, objective).peaks(matrices.astype(np.float32))
    np.testing.assert_array_less(np.abs(found.height - best), 1e-4 * spread)
    error = np.abs(offset_of(found.elevation) - FINE[values.argmax(axis=1)])
    assert np.mean(error < 2e-3) > 0.995
    there = values[np.arange(len(values)), np.searchsorted(FINE, offset_of(found.elevation)).clip(1) - 1]
    np.testing.assert_array_less(best - there, 1e-3 * spread)


@pytest.mark.parametrize("objective", sorted(OBJECTIVES))
@pytest.mark.parametrize("looks", [1, 4, 16])
def test_highest_peak_is_found_of_objectives_of_any_sign(looks: int, objective: str) -> None:
    """Of Capon's -R^-1, negative everywhere; of R less a multiple of I, of both signs; and of R, positive."""
    rng, unit = np.random.default_rng([50, looks]), np.eye(16)
    slc = target_slc(make_beams("sinc"), rng.uniform(-3.75, 3.75, (400, looks)), 400, looks, 10.0, rng)
    matrices = np.ascontiguousarray(np.einsum("mpk,npk->pmn", slc, slc.conj()).real)
    assert_highest(-np.linalg.inv(matrices / looks + unit), objective)
    assert_highest(matrices - matrices.trace(axis1=1, axis2=2)[:, None, None] / 16 * unit, objective)
    assert_highest(matrices, objective)


def test_second_peak_is_told_from_the_first() -> None:
    """Two scatterers are 3 beamwidths apart, one 20 % weaker; three Gaussian beams alike make one peak only."""
    beams = make_beams("sinc")
    a, b = (beams.response(elevation_at(offset), 0.0) for offset in (-1.5, 1.5))
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    b = b - a * (a @ b)
    b /= np.linalg.norm(b)
    found = search(beams, 0.0).peaks((np.outer(a, a) + 0.8 * np.outer(b, b))[None].astype(np.float32), margin=0.5)
    np.testing.assert_allclose(found.height, 1, atol=0.01)
    np.testing.assert_allclose(found.second, 0.8, atol=0.01)
    alone = search(make_beams("gaussian", count=3), 0.0).peaks(np.ones((1, 3, 3), np.float32))
    assert alone.second[0] == NO_PEAK


@pytest.mark.parametrize("mirrored", [False, True])
def test_peak_behind_a_dip_that_falls_between_nodes_is_climbed(mirrored: bool) -> None:
    """Of two peaks a third of a beamwidth apart the grid shows the lower one; the other is beside a bend upwards."""
    line = np.array([9.0, 12.20, 12.376, 12.3676, 12.3645, 11.78, 9.0], np.float32)
    line = line[::-1].copy() if mirrored else line
    behind = [is_behind_a_dip(line, g) for g in range(len(line))]
    assert behind == [g == (2 if mirrored else 4) for g in range(len(line))]
    single = np.cos(np.linspace(-1.2, 1.2, 13)).astype(np.float32) ** 2
    assert not any(is_behind_a_dip(single, g) for g in range(2, 11))


def test_pixels_whose_highest_peak_may_be_beyond_the_array_are_all_told() -> None:
    """Of noise and of weak and strong targets around both ends; those far inside are left out, and too low ones."""
    rng, beams = np.random.default_rng(51), make_beams("jinc")
    offset = rng.uniform(-6, 6, (2000, 1))
    slc = target_slc(beams, offset, 2000, 4, 10.0, rng)
    slc[:, ::4] = circular(rng, slc[:, ::4].shape)
    pixels = np.einsum("mpk,npk->pmn", slc, slc.conj()).real.astype(np.float32)
    one, (first, last) = search(beams, 0.0), beams.span
    best = one.peaks(pixels)
    told = one.may_peak_beyond(pixels, beams.span, best.height)
    assert np.isin(np.flatnonzero((best.elevation < first) | (best.elevation > last)), told).all()
    inside = np.abs(offset[:, 0]) < 2
    inside[::4] = False
    assert np.mean(inside[told]) < 0.05 * np.mean(inside)
    assert not len(one.may_peak_beyond(pixels, beams.span, 2 * best.height))
