"""Tables of inverse discriminants against the inversion by the beams."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, make_beams

from sal_height.beams import PATTERNS, Beams, detector_pattern
from sal_height.elevation.looks.looks import DwellColumns, Looks
from sal_height.elevation.monopulse._kernels import INSIDE, NO_DOMAIN, UNKNOWN
from sal_height.elevation.monopulse.inverse_table import (
    ALLOWED_ERROR,
    CELLS,
    SQUINT_STEP,
    inverse_table,
    invert_pairs,
    squint_step,
)
from sal_height.elevation.monopulse.inversion import PairElevation, Reason, invert
from sal_height.elevation.monopulse.pairs import strongest_pairs

PASSAGE = np.linspace(-0.5, 0.5, 8) * BEAMWIDTH


def arrays() -> dict[str, Beams]:
    plain = {name: make_beams(name, count=4) for name in sorted(PATTERNS)}
    gains = np.array([0.8, 1.0, 1.3, 0.9])
    return {
        **plain,
        **{f"{name}, turned": replace(beams, rotation=np.deg2rad(20)) for name, beams in plain.items()},
        "finite detectors": plain["jinc"].patterned((detector_pattern("jinc", (0.6, 1.2)),)),
        "long antenna": replace(plain["sinc"], rotation=np.deg2rad(20), azimuth_beamwidth=0.2 * BEAMWIDTH),
        "unequal": plain["jinc"].scaled(gains),
        "phases": plain["jinc"].scaled(gains * np.exp([0.1j, 0.2j, 0, -0.3j])),
        "aberrated": plain["jinc"].aberrated((0.02, 0.01, 0, 0.01, 0, 0.01)),
        "passage": replace(plain["jinc"], rotation=np.deg2rad(20)).averaged(PASSAGE, np.ones(8)),
    }


def drawn(rng: np.random.Generator, reach: float = 0.5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Discriminants, pairs and the squints of columns (rad), up to `reach` beamwidths."""
    mu = rng.uniform(-1.1, 1.1, (60, 12))
    return mu, rng.integers(0, 3, mu.shape), rng.uniform(-reach, reach, 12) * BEAMWIDTH


def of_one(squint: np.ndarray) -> DwellColumns:
    """Columns of a single dwell."""
    return DwellColumns(1, len(squint))


def by_beams(beams: Beams, mu: np.ndarray, pair: np.ndarray, squint: np.ndarray) -> PairElevation:
    angle = np.broadcast_to(squint, mu.shape)
    parts: dict[str, np.ndarray] = {}
    for lower in range(beams.count - 1):
        here = pair == lower
        found = PairElevation.of(beams.pair(lower), invert(beams.pair(lower), mu[here], angle[here]), angle[here])
        for one in fields(found):
            values = getattr(found, one.name)
            parts.setdefault(one.name, np.empty(mu.shape, values.dtype))[here] = values
    return PairElevation(**parts)


@pytest.mark.parametrize("name", arrays())
def test_tables_give_what_the_beams_give(name: str) -> None:
    """Times its slope, elevation is right to ALLOWED_ERROR, where one look at 60 dB leaves 7e-4; slopes to 2e-4."""
    beams = arrays()[name]
    mu, pair, squint = drawn(np.random.default_rng(18))
    found, exact = invert_pairs(beams, mu, pair, squint, of_one(squint)), by_beams(beams, mu, pair, squint)
    np.testing.assert_array_equal(found.reason, exact.reason)
    inside = exact.reason == Reason.INSIDE
    assert 0.3 < inside.mean() < 0.99
    steep = np.minimum(exact.slope * BEAMWIDTH, 1.0)[inside]
    error = np.abs(found.elevation - exact.elevation)[inside] / BEAMWIDTH * steep
    assert error.max() < ALLOWED_ERROR
    np.testing.assert_allclose(found.slope, exact.slope, rtol=2e-4)
    np.testing.assert_allclose(found.sum_gain[inside], exact.sum_gain[inside], rtol=2e-4, atol=1e-6)
    np.testing.assert_allclose(found.modulus[inside], exact.modulus[inside], rtol=1e-5, atol=1e-6)
    assert np.isnan(found.elevation[~inside]).all()


def test_nearly_all_steps_of_squint_of_an_image_are_tabulated() -> None:
    """Up to half a beamwidth: the inversion by the beams takes a hundred times as long."""
    for name, beams in arrays().items():
        if name != "long antenna":
            assert np.mean(inverse_table(beams, 0).kind == INSIDE) > 0.9, name


@pytest.mark.parametrize("pattern", ["sinc", "jinc"])
def test_where_a_main_lobe_ends_the_beams_are_asked(pattern: str) -> None:
    beams = make_beams(pattern, count=4)
    mu, pair, squint = drawn(np.random.default_rng(19), reach=2.5)
    found, exact = invert_pairs(beams, mu, pair, squint, of_one(squint)), by_beams(beams, mu, pair, squint)
    np.testing.assert_array_equal(found.reason, exact.reason)
    np.testing.assert_allclose(found.elevation, exact.elevation, rtol=0, atol=1e-5 * BEAMWIDTH)
    pages = {round(page) for page in np.floor(squint / BEAMWIDTH + 0.5).tolist()}
    kinds = {int(kind) for page in pages for kind in np.unique(inverse_table(beams, page).kind)}
    assert kinds == ({INSIDE, UNKNOWN, NO_DOMAIN} if pattern == "jinc" else {INSIDE})


def test_what_is_found_depends_on_the_pixel_alone() -> None:
    """Value for value, in any order, alone or with others, and after other tables were made."""
    beams, again = (make_beams("jinc", count=4) for _ in range(2))
    mu, pair, squint = drawn(np.random.default_rng(20), reach=0.9)
    found, order = invert_pairs(beams, mu, pair, squint, of_one(squint)), np.random.default_rng(21).permutation(12)
    shuffled = invert_pairs(again, mu[:, order], pair[:, order], squint[order], of_one(squint))
    np.testing.assert_array_equal(shuffled.elevation, found.elevation[:, order])
    for column in range(0, 12, 5):
        one = slice(column, column + 1)
        alone = invert_pairs(beams, mu[3:4, one], pair[3:4, one], squint[one], DwellColumns(1, 1))
        np.testing.assert_array_equal(alone.elevation, found.elevation[3:4, one])
        np.testing.assert_array_equal(alone.slope, found.slope[3:4, one])


def test_dwells_side_by_side_are_inverted_as_each_alone() -> None:
    """Value for value, also by the beams, whose table is as fine as the squints of the dwell that need it are few."""
    beams = make_beams("jinc", count=4)
    mu, pair, squint = drawn(np.random.default_rng(24), reach=2.5)
    columns, one = DwellColumns(3, 4), DwellColumns(1, 4)
    together = invert_pairs(beams, mu, pair, squint, columns)
    apart = [invert_pairs(beams, mu[:, part], pair[:, part], squint[part], one) for part in columns.slices]
    expected, as_one = PairElevation.side_by_side(apart), invert_pairs(beams, mu, pair, squint, of_one(squint))
    for field in fields(PairElevation):
        np.testing.assert_array_equal(getattr(together, field.name), getattr(expected, field.name))
    assert np.nanmax(np.abs(as_one.slope - together.slope)) > 0  # the table of all at once is another


def test_without_a_discriminant_or_a_squint_there_is_no_elevation() -> None:
    beams, squint = make_beams("jinc", count=4), np.array([0.0, 0.1 * BEAMWIDTH, np.nan])
    mu, columns = np.array([[0.1, np.nan, 0.1], [np.inf, -np.inf, 0.2]]), of_one(squint)
    found = invert_pairs(beams, mu, np.zeros((2, 3), int), squint, columns)
    none = int(Reason.NOT_FINITE)
    assert found.reason.tolist() == [[0, none, none], [none, none, none]]
    assert np.isnan(found.elevation).sum() == 5
    assert invert_pairs(beams, np.empty((0, 3)), np.empty((0, 3), int), squint, columns).elevation.shape == (0, 3)


def test_steps_of_squint_are_a_share_of_the_narrower_beam() -> None:
    beams = make_beams("jinc", count=2)
    assert inverse_table(beams, 0).kind.shape == (1, CELLS)
    turned = replace(beams, rotation=np.pi / 2, azimuth_beamwidth=5 * BEAMWIDTH)
    wide = replace(turned, rotation=0.0)
    assert squint_step(turned) == pytest.approx(SQUINT_STEP * BEAMWIDTH)
    assert squint_step(wide) == pytest.approx(5 * SQUINT_STEP * BEAMWIDTH)
    assert ALLOWED_ERROR < 7e-4 / 50


@pytest.mark.parametrize("hermitian", [False, True])
def test_the_pair_with_the_most_power_in_sigma_is_found(hermitian: bool) -> None:
    """The compiled loop, and its formula in NumPy."""
    samples = circular(np.random.default_rng(22), (60, 70, 6, 3))
    covariance = np.einsum("rcmk,rcnk->rcmn", samples, samples.conj())
    covariance = covariance.astype(np.complex64) if hermitian else covariance.real.astype(np.float32)
    pair, sums = strongest_pairs(Looks.of(covariance, 3))
    power = np.diagonal(covariance, axis1=2, axis2=3).real.astype(np.float64)
    beside = np.diagonal(covariance, 1, axis1=2, axis2=3).astype(np.complex128)
    total = power[..., :-1] + power[..., 1:] + 2 * beside.real
    np.testing.assert_array_equal(pair, np.argmax(total, axis=-1))
    np.testing.assert_allclose(sums.sum_power, total.max(axis=-1), rtol=1e-12)
    chosen = np.take_along_axis(beside, pair[..., None], axis=-1)[..., 0]
    np.testing.assert_allclose(sums.cross_power.imag, -2 * chosen.imag, rtol=1e-12)
    difference = np.take_along_axis(np.diff(power, axis=-1), pair[..., None], axis=-1)[..., 0]
    np.testing.assert_allclose(sums.cross_power.real, difference, rtol=1e-12)
