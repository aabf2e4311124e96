"""Beams against their definition, detector by detector and aspect by aspect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, elevation_at, make_beams, refused

from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS
from sal_height.errors import UserError

JINC, SINC = PATTERNS["jinc"], PATTERNS["sinc"]
E, A = np.array([0.3, -1.2, 0.0]), np.array([0.4, -0.2, 0.9])
"""Targets, beamwidths above and ahead of the middle."""

STEP = 1e-4 * BEAMWIDTH
"""Of central differences: their error is STEP^2 / 6 |h'''| < 1e-7 of a slope."""


@pytest.mark.parametrize("rotation", [0.0, np.pi / 12, -0.7])
def test_a_target_is_seen_where_it_lies_along_the_turned_axis(rotation: float) -> None:
    beams = replace(make_beams("sinc", count=3), rotation=rotation)
    for i, place in enumerate((-0.5, 0.0, 0.5)):
        along = E * np.cos(rotation) + A * np.sin(rotation)
        beside = A * np.cos(rotation) - E * np.sin(rotation)
        expected = np.sinc(along - place) * np.sinc(beside)
        np.testing.assert_allclose(beams.response(elevation_at(E), A * BEAMWIDTH)[:, i], expected, atol=1e-11)


def test_a_circular_array_of_one_detector_does_not_show_its_rotation() -> None:
    still, turned = (replace(make_beams("jinc", count=1), rotation=rotation) for rotation in (0.0, 1.1))
    sight = elevation_at(E), A * BEAMWIDTH
    np.testing.assert_allclose(turned.response(*sight), still.response(*sight), atol=1e-11)


@pytest.mark.parametrize("rotation", [0.0, np.pi / 12, -0.7])
@pytest.mark.parametrize("pattern", sorted(PATTERNS))
def test_slope_is_the_derivative_over_elevation(pattern: str, rotation: float) -> None:
    beams = replace(make_beams(pattern, count=4), rotation=rotation).averaged(
        np.array([-0.2, 0.3]) * BEAMWIDTH, np.array([1.0, 2.0])
    )
    squint = A * BEAMWIDTH
    higher, lower = (beams.response(elevation_at(E) + step, squint) for step in (STEP, -STEP))
    difference = (higher - lower) / (2 * STEP) * BEAMWIDTH
    np.testing.assert_allclose(beams.slope(elevation_at(E), squint) * BEAMWIDTH, difference, atol=1e-6)


def test_a_pair_keeps_the_axis_of_its_array() -> None:
    beams = replace(make_beams("jinc", count=5), rotation=0.4)
    sight = elevation_at(E), A * BEAMWIDTH
    for i in range(4):
        np.testing.assert_allclose(beams.pair(i).response(*sight), beams.response(*sight)[:, i : i + 2], atol=1e-15)


def test_every_detector_has_its_own_pattern() -> None:
    beams = Beams((JINC, SINC, JINC), make_beams(count=3).boresights, BEAMWIDTH)
    sight = elevation_at(E), A * BEAMWIDTH
    circular, square = (make_beams(name, count=3).response(*sight) for name in ("jinc", "sinc"))
    np.testing.assert_array_equal(beams.response(*sight), np.stack([circular[:, 0], square[:, 1], circular[:, 2]], -1))
    np.testing.assert_array_equal(beams.pair(1).response(*sight), beams.response(*sight)[:, 1:])


@pytest.mark.parametrize("gains", [np.array([2.0, 0.1, 3.0]), np.array([1j, 0.3, -2.0]), np.full(3, 0.7)])
@pytest.mark.parametrize("names", [("jinc",), ("jinc", "sinc", "gaussian")])
def test_gains_scale_the_detectors_one_by_one(names: tuple[str, ...], gains: np.ndarray) -> None:
    beams = replace(make_beams(count=3), patterns=tuple(PATTERNS[name] for name in names), rotation=0.26)
    beams = beams.averaged(np.array([-0.3, 0.4]) * BEAMWIDTH, np.array([1.0, 2.0]))
    sight = elevation_at(np.linspace(-1, 1, 7)), 0.2 * BEAMWIDTH
    for function in ("response", "slope"):
        scaled, plain = (getattr(some, function)(*sight) for some in (beams.scaled(gains), beams))
        np.testing.assert_allclose(scaled, gains * plain, rtol=1e-13, atol=1e-11)
    assert beams.scaled(gains).is_complex == np.iscomplexobj(gains)


@pytest.mark.parametrize("names", [("jinc",), ("jinc", "sinc", "gaussian", "sinc")])
def test_some_detectors_keep_the_axis_of_their_array(names: tuple[str, ...]) -> None:
    beams = replace(make_beams(count=4), patterns=tuple(PATTERNS[name] for name in names), rotation=0.26)
    sight = elevation_at(np.linspace(-1, 1, 7)), 0.2 * BEAMWIDTH
    some = beams.detectors(np.array([1, 3]))
    np.testing.assert_allclose(some.response(*sight), beams.response(*sight)[:, [1, 3]], atol=1e-15)
    assert some.span == (beams.boresights[1], beams.boresights[3])


def test_aspects_are_averaged_with_their_weights() -> None:
    still = make_beams("jinc", count=3)
    beams = still.averaged(np.array([-0.3, 0.1]) * BEAMWIDTH, np.array([1.0, 3.0]))
    one, other = (still.response(elevation_at(E), (A + aspect) * BEAMWIDTH) for aspect in (-0.3, 0.1))
    np.testing.assert_allclose(beams.response(elevation_at(E), A * BEAMWIDTH), one / 4 + other * 3 / 4, atol=1e-12)


def test_domain_ends_where_a_pattern_does() -> None:
    known = replace(SINC, domain=(-1.0, 2.0))
    beams = Beams((known,), make_beams(count=3).boresights, BEAMWIDTH)
    low, high = beams.domain(3 * BEAMWIDTH)
    assert (low - elevation_at(0)) / BEAMWIDTH == pytest.approx(-0.5, abs=1e-9)
    assert (high - elevation_at(0)) / BEAMWIDTH == pytest.approx(1.5, abs=1e-9)


def test_patterns_without_a_common_elevation_are_refused() -> None:
    known = replace(SINC, domain=(-0.2, 0.2))
    with refused(UserError, "3 detectors have no elevation in common", "must overlap"):
        Beams((known,), make_beams(count=3).boresights, BEAMWIDTH).domain(0.0)
