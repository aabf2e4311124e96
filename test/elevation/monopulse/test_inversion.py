"""The discriminant of a pair against closed forms, its domain, and its inversion: at rest, turned and moving."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, elevation_at, make_beams, offset_of, phased, refused
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import jv

from sal_height.beams.apertures import GAUSSIAN_WIDTH
from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS, Pattern
from sal_height.elevation.monopulse import inversion
from sal_height.elevation.monopulse.discriminant import (
    LEAST_CLEARANCE,
    LEAST_SLOPE,
    discriminant,
    discriminant_domain,
    discriminant_slope,
    moving_squint,
)
from sal_height.elevation.monopulse.inversion import Reason, invert
from sal_height.errors import UserError

JINC_NULL = 1.2196698912665045
TURNS = pytest.mark.parametrize("turn", [0.0, 15.0, -40.0], ids="{:g} deg".format)
SQUINTS = pytest.mark.parametrize("squint", [0.0, 0.3, -0.5], ids="{:g} beamwidths".format)


def turned_pair(pattern: str, turn: float, count: int = 2, lower: int = 0, pitch: float = 0.5) -> Beams:
    """Two of `count` detectors on an axis turned by so many degrees around the middle of them all."""
    return replace(make_beams(pattern, count, pitch), rotation=np.deg2rad(turn)).pair(lower)


def bounded(low: float, high: float) -> Pattern:
    """The jinc, known between two offsets only: NaN beyond."""
    plain = PATTERNS["jinc"]

    def known(function: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
        return lambda e, a: np.where((low <= np.asarray(e)) & (np.asarray(e) <= high), function(e, a), np.nan)

    functions = known(plain.amplitude), known(plain.slope), known(plain.azimuth_slope)
    return Pattern("bounded", *functions, plain.main_lobe, (low, high))


PAIRS = {
    **{name: (PATTERNS[name],) for name in sorted(PATTERNS)},
    "unequal": (PATTERNS["jinc"], PATTERNS["gaussian"]),
    "complex": (phased(PATTERNS["jinc"], 0.9, 0.3), phased(PATTERNS["jinc"], 1.1 * np.exp(0.5j), -0.2)),
    "table": (bounded(-0.9, 1.4),),
}
"""Patterns of pairs: alike, different, with phases, and known in part."""


# --- closed forms ---------------------------------------------------------------------------------------------------


def test_sinc_pair_half_a_beamwidth_apart_in_closed_form() -> None:
    pair = turned_pair("sinc", 0.0)
    t = np.array([-0.45, -0.1, 0.0, 0.1, 0.24, 0.35])
    closed = (4 * t - np.tan(np.pi * t)) / (1 - 4 * t * np.tan(np.pi * t))
    np.testing.assert_allclose(discriminant(pair, elevation_at(t), 0.2 * BEAMWIDTH), closed, atol=3e-12)
    np.testing.assert_allclose(discriminant(pair, elevation_at([-0.5, 0.5]), 0.0), [-0.5, 0.5], atol=3e-12)
    assert discriminant(pair, elevation_at(0.25), 0.0) == pytest.approx(0.22203, abs=5e-6)


def test_gaussian_pair_is_a_hyperbolic_tangent() -> None:
    t = np.linspace(-9, 9, 73)
    mu = discriminant(turned_pair("gaussian", 0.0), elevation_at(t), 0.3 * BEAMWIDTH)
    np.testing.assert_allclose(mu, np.tanh(0.25 * t / GAUSSIAN_WIDTH**2), atol=3e-12)


@pytest.mark.parametrize(
    ("pattern", "pitch", "slope"),
    [
        ("gaussian", 0.5, 0.25 / GAUSSIAN_WIDTH**2),
        ("sinc", 0.5, 4 - np.pi),
        ("jinc", 0.5, np.pi * jv(2, np.pi / 4) / jv(1, np.pi / 4)),
        ("jinc", 0.6, np.pi * jv(2, 0.3 * np.pi) / jv(1, 0.3 * np.pi)),
    ],
)
def test_slope_between_the_beams_in_closed_form(pattern: str, pitch: float, slope: float) -> None:
    """-h'(q) / h(q) with q half the pitch; elevations are good to 1e-12 beamwidths."""
    pair = turned_pair(pattern, 0.0, pitch=pitch)
    assert discriminant_slope(pair, np.pi / 4, 0.0) * BEAMWIDTH == pytest.approx(slope, rel=1e-11)


@pytest.mark.parametrize("patterns", PAIRS.values(), ids=PAIRS.keys())
@TURNS
def test_slope_is_the_derivative(patterns: tuple[Pattern, ...], turn: float) -> None:
    """By a central difference, good to step^2 / 6 of the third derivative."""
    pair = replace(turned_pair("jinc", turn), patterns=patterns)
    t, squint, step = np.linspace(-0.5, 0.5, 21)[:, None], np.array([0.0, 0.3]) * BEAMWIDTH, 1e-4
    above, below = (discriminant(pair, elevation_at(t + shift), squint) for shift in (step, -step))
    slope = discriminant_slope(pair, elevation_at(t), squint) * BEAMWIDTH
    np.testing.assert_allclose(slope, (above - below) / (2 * step), atol=3e-8)


@pytest.mark.parametrize("pattern", sorted(PATTERNS))
@pytest.mark.parametrize("lower", [0, 1, 2])
@TURNS
@SQUINTS
def test_turned_pair_is_balanced_where_both_boresights_are_as_far(
    pattern: str, lower: int, turn: float, squint: float
) -> None:
    """At -squint tan psi from a pair in the middle; the other pairs lie (lower - 1) / 2 beamwidths along the axis."""
    pair = turned_pair(pattern, turn, count=4, lower=lower)
    psi = np.deg2rad(turn)
    balanced = -squint * np.tan(psi) + (lower - 1) * 0.5 / np.cos(psi)
    assert discriminant(pair, elevation_at(balanced), squint * BEAMWIDTH) == pytest.approx(0, abs=1e-11)
    assert offset_of(invert(pair, 0.0, squint * BEAMWIDTH).elevation) == pytest.approx(balanced, abs=1e-10)


# --- the domain -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pattern", "squint", "end"),
    [
        ("sinc", 0.4, 0.75),
        ("jinc", 0.0, JINC_NULL - 0.25),
        ("jinc", -0.4, np.sqrt(JINC_NULL**2 - 0.4**2) - 0.25),
        ("gaussian", 0.4, GAUSSIAN_WIDTH**2 / 0.25 * np.arctanh(np.sqrt(1 - LEAST_SLOPE * GAUSSIAN_WIDTH**2 / 0.25))),
    ],
)
def test_domain_ends_in_the_null_of_the_farther_beam_or_with_the_slope(pattern: str, squint: float, end: float) -> None:
    low, high = discriminant_domain(turned_pair(pattern, 0.0), squint * BEAMWIDTH)
    np.testing.assert_allclose(offset_of([low, high]), [-end, end], atol=1e-10 if pattern != "gaussian" else 1e-8)


def test_gaussian_discriminant_is_followed_to_one_less_eight_millionths() -> None:
    """The slope q / s^2 (1 - mu^2) is 1e-5 at 1 - mu = 7.64e-6."""
    pair = turned_pair("gaussian", 0.0)
    mu = discriminant(pair, discriminant_domain(pair, 0.0), 0.0)
    np.testing.assert_allclose(1 - np.abs(mu), 7.64e-6, atol=1e-8)


@SQUINTS
def test_domain_of_a_turned_pair_ends_where_the_farther_beam_has_its_null(squint: float) -> None:
    """On a circle of radius 1.2197 around its boresight, which the line of constant squint cuts."""
    psi = np.deg2rad(15)
    low, high = discriminant_domain(turned_pair("jinc", 15.0), squint * BEAMWIDTH)
    for end, side in ((low, 1), (high, -1)):  # the null is that of the upper beam below, and the other way round
        boresight = side * 0.25 * np.array([np.cos(psi), np.sin(psi)])
        across = np.sqrt(JINC_NULL**2 - (squint - boresight[1]) ** 2)
        assert offset_of(end) == pytest.approx(boresight[0] - side * across, abs=1e-10)


@TURNS
@SQUINTS
def test_domain_stays_where_the_patterns_are_known(turn: float, squint: float) -> None:
    """The beams are known from -0.9 to 1.4 beamwidths along the axis: together from -0.65 to 1.15 of the middle."""
    psi, squints = np.deg2rad(turn), squint * BEAMWIDTH
    plain = turned_pair("jinc", turn)
    low, high = (offset_of(end) for end in discriminant_domain(plain, squints))
    known = (np.array([-0.65, 1.15]) - squint * np.sin(psi)) / np.cos(psi)
    found = discriminant_domain(replace(plain, patterns=PAIRS["table"]), squints)
    np.testing.assert_allclose(offset_of(found), [max(low, known[0]), min(high, known[1])], atol=1e-9)


def test_patterns_with_no_angle_in_common_are_refused() -> None:
    pair = replace(turned_pair("jinc", 0.0), patterns=(bounded(-1.0, 0.1), bounded(-0.1, 1.0)))
    with refused(UserError, "2 detectors", "overlap"):
        invert(pair, 0.0, 0.0)


def test_pair_seen_in_a_sidelobe_has_no_domain() -> None:
    """Past the jinc's null its modulus grows away from the boresight, and mu falls."""
    squint = np.array([0.0, 1.3]) * BEAMWIDTH
    low, high = discriminant_domain(turned_pair("jinc", 0.0), squint)
    np.testing.assert_array_equal(np.isfinite([low, high]), [[True, False]] * 2)
    result = invert(turned_pair("jinc", 0.0), 0.1, squint)
    np.testing.assert_array_equal(result.reason, [Reason.INSIDE, Reason.NO_DOMAIN])


def test_domain_ends_at_a_null_of_both_beams() -> None:
    """Beside a turned pair of sincs: at an azimuth of 1 beamwidth both vanish, though their ratio is known."""
    squint, psi = -0.8, np.deg2rad(15)
    high = discriminant_domain(turned_pair("sinc", 15.0), squint * BEAMWIDTH)[1]
    null = (squint * np.cos(psi) + 1) / np.sin(psi)
    assert offset_of(high) == pytest.approx(null - LEAST_CLEARANCE, abs=5e-6)  # of second order


def test_domain_does_not_end_where_a_phase_common_to_both_beams_has_turned() -> None:
    """2 rad per beamwidth of it: 1.9 rad between the crossing and the null of the farther beam."""
    pair = replace(turned_pair("jinc", 0.0), patterns=(phased(PATTERNS["jinc"], tilt=2.0),))
    end = JINC_NULL - 0.25
    np.testing.assert_allclose(offset_of(discriminant_domain(pair, 0.0)), [-end, end], atol=1e-9)


def test_domain_of_a_stripmap_image_holds_for_all_its_aspects() -> None:
    """Between -0.35 and 0.35 beamwidths along the axis under aspects of -0.4 to 0.5."""
    psi = np.deg2rad(15)
    pair = replace(turned_pair("jinc", 15.0), patterns=(replace(PATTERNS["jinc"], domain=(-0.6, 0.6)),))
    pair = pair.averaged(np.array([-0.4, 0.0, 0.5]) * BEAMWIDTH, np.ones(3))
    known = np.array([-0.35 + 0.4 * np.sin(psi), 0.35 - 0.5 * np.sin(psi)]) / np.cos(psi)
    np.testing.assert_allclose(offset_of(discriminant_domain(pair, 0.0)), known, atol=1e-9)


def test_domain_is_found_from_the_crossing_under_the_mean_aspect() -> None:
    """Far from that at the squint itself: 1.3 beamwidths, where the pair has no domain of its own."""
    pair = turned_pair("jinc", 40.0)
    aside = pair.averaged(np.array([1.5 * BEAMWIDTH]), np.ones(1))
    found = discriminant_domain(aside, -1.5 * BEAMWIDTH)
    np.testing.assert_allclose(offset_of(found), offset_of(discriminant_domain(pair, 0.0)), atol=1e-10)


# --- the inversion --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("patterns", PAIRS.values(), ids=PAIRS.keys())
@TURNS
@SQUINTS
def test_inversion_undoes_the_discriminant_over_its_whole_domain(
    patterns: tuple[Pattern, ...], turn: float, squint: float
) -> None:
    pair = replace(turned_pair("jinc", turn), patterns=patterns)
    low, high = discriminant_domain(pair, squint * BEAMWIDTH)
    share = np.concatenate([np.geomspace(1e-9, 1e-2, 50), np.linspace(0, 1, 401)])
    elevation = np.concatenate([low + share * (high - low), high - share * (high - low)])
    result = invert(pair, discriminant(pair, elevation, squint * BEAMWIDTH), squint * BEAMWIDTH)
    assert np.all(result.reason == Reason.INSIDE)
    assert result.reason.dtype == np.uint8
    np.testing.assert_allclose(offset_of(result.elevation), offset_of(elevation), rtol=0, atol=1e-9)
    exact = discriminant_slope(pair, elevation, squint * BEAMWIDTH)
    np.testing.assert_allclose(result.slope * BEAMWIDTH, exact * BEAMWIDTH, rtol=1e-5, atol=1e-7)
    assert np.all(result.slope * BEAMWIDTH > 0.99 * LEAST_SLOPE)


@pytest.mark.parametrize("patterns", PAIRS.values(), ids=PAIRS.keys())
@TURNS
@SQUINTS
def test_discriminants_outside_the_domain_have_no_elevation(
    patterns: tuple[Pattern, ...], turn: float, squint: float
) -> None:
    """Beyond by 2e-9 beamwidths; nearer than that, rounding decides."""
    pair = replace(turned_pair("jinc", turn), patterns=patterns)
    ends = np.array(discriminant_domain(pair, squint * BEAMWIDTH))
    reach = 2e-9 * BEAMWIDTH * discriminant_slope(pair, ends, squint * BEAMWIDTH)
    below, above = discriminant(pair, ends, squint * BEAMWIDTH) + reach * np.array([-1, 1])
    result = invert(pair, [below, above, -5.0, 5.0, np.nan, np.inf], squint * BEAMWIDTH)
    reasons = [Reason.BELOW, Reason.ABOVE, Reason.BELOW, Reason.ABOVE, Reason.NOT_FINITE, Reason.NOT_FINITE]
    np.testing.assert_array_equal(result.reason, reasons)
    assert np.isnan(result.elevation).all()
    assert np.isnan(result.slope).all()


@pytest.mark.parametrize("pattern", ["jinc", "sinc"])
@pytest.mark.parametrize("turn", [0.0, 15.0], ids="{:g} deg".format)
def test_a_target_in_the_null_of_the_farther_beam_is_inside(pattern: str, turn: float) -> None:
    """Its discriminant is -1 or 1, whichever way the end of the domain was rounded."""
    pair, squint = turned_pair(pattern, turn), np.linspace(-0.4, 0.4, 101) * BEAMWIDTH
    result = invert(pair, np.array([[-1.0], [1.0]]), squint)
    np.testing.assert_allclose(offset_of(result.elevation), offset_of(discriminant_domain(pair, squint)), atol=1e-9)


def test_a_single_newton_step_is_not_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """What holds the error below 1e-9 beamwidths are the steps, not the tables of many squints alone."""
    pair, squint = turned_pair("gaussian", 0.0), np.linspace(-0.1, 0.1, 400) * BEAMWIDTH
    elevation = np.linspace(*discriminant_domain(pair, 0.0), 400)
    mu = discriminant(pair, elevation, squint)
    np.testing.assert_allclose(offset_of(invert(pair, mu, squint).elevation), offset_of(elevation), rtol=0, atol=1e-9)
    monkeypatch.setattr(inversion, "MOST_STEPS", 1)
    found = invert(pair, mu, squint).elevation
    assert 1e-9 < np.max(np.abs(offset_of(found) - offset_of(elevation))) < 1e-3


def test_inversion_broadcasts() -> None:
    pair, squint = turned_pair("jinc", 15.0), np.linspace(-0.4, 0.4, 7) * BEAMWIDTH
    mu = np.random.default_rng(1).uniform(-1.1, 1.1, (5, 7))
    result = invert(pair, mu, squint)
    each = [[invert(pair, value, angle) for value, angle in zip(row, squint, strict=True)] for row in mu]
    assert result.elevation.shape == (5, 7)
    np.testing.assert_array_equal(result.reason, [[one.reason for one in row] for row in each])
    alone = offset_of([[one.elevation for one in row] for row in each])
    np.testing.assert_allclose(offset_of(result.elevation), alone, atol=1e-10)
    of_columns = invert(pair, mu[:, :1], squint).elevation
    np.testing.assert_allclose(offset_of(of_columns[:, 0]), offset_of(result.elevation[:, 0]), atol=1e-10)
    assert invert(pair, np.zeros((0, 7)), squint).elevation.shape == (0, 7)


def test_a_pixel_whose_squint_is_not_known_has_no_elevation() -> None:
    result = invert(turned_pair("jinc", 15.0), 0.1, np.array([0.0, np.nan]))
    np.testing.assert_array_equal(result.reason, [Reason.INSIDE, Reason.NOT_FINITE])


# --- moving targets -------------------------------------------------------------------------------------------------

EXAMPLE = 31e-6
"""Beamwidth of the paper's example, rad: 1.55 um through 5 cm."""

RECEDING, SPEED = 0.5e-3, 50.0
"""m/s, of a slow target and of the platform."""


def example_pair(turn: float) -> Beams:
    return Beams((PATTERNS["jinc"],), np.array([-0.25, 0.25]) * EXAMPLE, EXAMPLE, np.deg2rad(turn))


def brute_force(elevation: float, squint: float, turn: float) -> tuple[float, float]:
    """Lower and upper amplitude of the jinc pair of `example_pair`; all angles in beamwidths."""
    psi = np.deg2rad(turn)
    e = elevation * np.cos(psi) + squint * np.sin(psi)
    a = squint * np.cos(psi) - elevation * np.sin(psi)
    x = np.pi * np.hypot(np.array([e + 0.25, e - 0.25]), a)
    lower, upper = jv(0, x) + jv(2, x)  # 2 J1(x) / x
    return float(lower), float(upper)


def spotlight(elevation: float, squint: float, turn: float) -> float:
    lower, upper = brute_force(elevation, squint, turn)
    return (upper - lower) / (upper + lower)


def stripmap(elevation: float, squint: float, turn: float) -> float:
    """With both beams integrated over a beamwidth of aspects around the squint."""
    upper = quad(lambda aspect: brute_force(elevation, squint + aspect, turn)[1], -0.5, 0.5, epsabs=1e-13)[0]
    lower = quad(lambda aspect: brute_force(elevation, squint + aspect, turn)[0], -0.5, 0.5, epsabs=1e-13)[0]
    return (upper - lower) / (upper + lower)


def stripmap_pair(turn: float) -> Beams:
    aspects, weights = np.polynomial.legendre.leggauss(12)
    return example_pair(turn).averaged(aspects / 2 * EXAMPLE, weights)


@pytest.mark.parametrize("radial_velocity", [-0.8, 0.5])
@pytest.mark.parametrize("squint", [-0.01, 0.0, 0.02])
def test_moving_squint_is_where_the_target_is(radial_velocity: float, squint: float) -> None:
    """Its range is that of a target at rest at the squint where the image shows it; sin x = x to 3e-5 / 6."""
    time = np.array([-1e-4, 1e-4])
    seen = np.arcsin(np.sin(squint) - radial_velocity / SPEED)

    def closing(squint: float, radial_velocity: float) -> float:
        along, across = 5000 * np.sin(squint) - SPEED * time, 5000 * np.cos(squint)
        return float(np.diff(np.hypot(along, across) + radial_velocity * time)[0])

    assert closing(seen, 0.0) == pytest.approx(closing(squint, radial_velocity), abs=1e-11)
    assert moving_squint(seen, radial_velocity, SPEED) == pytest.approx(squint, abs=1e-5)


@pytest.mark.parametrize(
    ("pair_at", "discriminant_at"),
    [(example_pair, spotlight), (stripmap_pair, stripmap)],
    ids=["spotlight", "stripmap"],
)
@pytest.mark.parametrize("turn", [0.0, 15.0], ids="{:g} deg".format)
@pytest.mark.parametrize("elevation", [-0.4, 0.0, 0.25])
def test_elevation_of_a_mover_is_wrong_by_the_shift_and_right_with_its_velocity(
    pair_at: Callable[[float], Beams],
    discriminant_at: Callable[[float, float, float], float],
    turn: float,
    elevation: float,
) -> None:
    """Both against the patterns integrated and inverted by other means; quad is good to 1e-13, brentq to 1e-12."""
    pair, seen = pair_at(turn), -RECEDING / SPEED if discriminant_at is spotlight else 0.0
    mu = discriminant_at(elevation, seen / EXAMPLE + RECEDING / SPEED / EXAMPLE, turn)
    corrected = invert(pair, mu, moving_squint(seen, RECEDING, SPEED)).elevation / EXAMPLE
    assert corrected == pytest.approx(elevation, abs=1e-9)
    uncorrected = brentq(lambda x: discriminant_at(x, seen / EXAMPLE, turn) - mu, -0.8, 0.8, xtol=1e-12)
    assert invert(pair, mu, seen).elevation / EXAMPLE == pytest.approx(uncorrected, abs=1e-9)


def test_error_of_a_mover_in_spotlight_is_that_of_the_balance() -> None:
    """v_r / v tan psi at elevation 0, whatever the pattern: 0.0864 beamwidths in the paper's example at 15 degrees."""
    found = invert(example_pair(15.0), 0.0, -RECEDING / SPEED).elevation / EXAMPLE
    assert found == pytest.approx(RECEDING / SPEED / EXAMPLE * np.tan(np.deg2rad(15)), abs=1e-9)
    assert found == pytest.approx(0.0864, abs=5e-5)
