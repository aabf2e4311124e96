"""Beam patterns against the physics of their apertures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from beam_tables import sample_pattern
from helpers import BEAMWIDTH, refused
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import sici

from sal_height.beams.apertures import GAUSSIAN_WIDTH, JINC_NULL
from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS, Pattern, aperture_pattern, detector_pattern, pattern_named
from sal_height.beams.table import BeamTable, tabulated_pattern
from sal_height.errors import UserError

NAMES = sorted(PATTERNS)
SIZES = [(0.5, 0.0), (0.6, 1.2), (0.0, 0.7), (1e-6, 1e-6)]


def pupil_transform(name: str, e: float, a: float) -> float:
    """Amplitude pattern from its aperture: integral of cos(2 pi u e) over a pupil of diameter (or side) 1."""

    def chord(u: float) -> float:
        half = np.sqrt(0.25 - u * u) if name == "jinc" else 0.5
        return 2 * half * np.sinc(2 * half * a) * np.cos(2 * np.pi * u * e)

    area = np.pi / 4 if name == "jinc" else 1.0
    return quad(chord, -0.5, 0.5, epsabs=1e-12, limit=200)[0] / area


@pytest.mark.parametrize("name", ["jinc", "sinc"])
@pytest.mark.parametrize(("e", "a"), [(0.0, 0.0), (0.3, 0.0), (0.7, 0.2), (-1.4, -0.5), (0.2, 1.9)])
def test_pattern_is_the_fourier_transform_of_the_pupil(name: str, e: float, a: float) -> None:
    assert PATTERNS[name].amplitude(e, a) == pytest.approx(pupil_transform(name, e, a), abs=1e-9)


@pytest.mark.parametrize(("name", "width"), [("sinc", 0.88589), ("jinc", 1.02899), ("gaussian", 1.02899)], ids=str)
def test_half_power_width(name: str, width: float) -> None:
    half = brentq(lambda e: float(PATTERNS[name].amplitude(e, 0.0)) ** 2 - 0.5, 0.1, 0.9)
    assert 2 * half == pytest.approx(width, abs=6e-6)  # the widths are rounded to five digits


@pytest.mark.parametrize(("name", "null"), [("sinc", 1.0), ("jinc", 1.219670)])
def test_first_null(name: str, null: float) -> None:
    assert brentq(lambda e: float(PATTERNS[name].amplitude(e, 0.0)), 0.8, 1.5) == pytest.approx(null, abs=1e-6)


@pytest.mark.parametrize(("name", "slope"), [("gaussian", 0.65464), ("sinc", 4 - np.pi), ("jinc", 0.633342)])
def test_slope_of_a_pair_half_a_beamwidth_apart(name: str, slope: float) -> None:
    pattern = PATTERNS[name]
    assert -pattern.slope(0.25, 0.0) / pattern.amplitude(0.25, 0.0) == pytest.approx(slope, abs=6e-6)


@pytest.mark.parametrize("name", NAMES)
def test_slope_is_the_derivative_of_the_amplitude(name: str) -> None:
    pattern = PATTERNS[name]
    e = np.concatenate([np.linspace(-3, 3, 241), [1e-9, 5e-5, 9.99e-5, 1.001e-4, -2e-4, 1.2197]])[:, None]
    a = np.array([0.0, 0.2, -0.7])
    step = 1e-5  # error of the central difference: step^2 / 6 * |h'''| < 1e-9, rounding 1e-11
    difference = (pattern.amplitude(e + step, a) - pattern.amplitude(e - step, a)) / (2 * step)
    np.testing.assert_allclose(pattern.slope(e, a), difference, atol=2e-9)


@pytest.mark.parametrize("name", NAMES)
def test_boresight_has_amplitude_one_and_no_slope(name: str) -> None:
    assert PATTERNS[name].amplitude(0.0, 0.0) == 1.0
    assert PATTERNS[name].slope(0.0, 0.0) == 0.0


def test_circular_patterns_depend_on_the_distance_alone() -> None:
    turn = np.linspace(0, 2 * np.pi, 13)
    for name in ("gaussian", "jinc"):
        around = PATTERNS[name].amplitude(0.8 * np.cos(turn), 0.8 * np.sin(turn))
        np.testing.assert_allclose(around, PATTERNS[name].amplitude(0.8, 0.0), atol=1e-14)


def test_gaussian_has_the_stated_width() -> None:
    assert PATTERNS["gaussian"].amplitude(GAUSSIAN_WIDTH, GAUSSIAN_WIDTH) == pytest.approx(np.exp(-1), abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_pattern_is_found_by_its_name(name: str) -> None:
    assert pattern_named(name).name == name


def test_unknown_pattern_is_refused_with_those_allowed() -> None:
    with refused(UserError, "'cosine'", "gaussian, jinc, sinc"):
        pattern_named("cosine")


def mean_over_detector(point: Callable[[float, float], float], size: tuple[float, float], e: float, a: float) -> float:
    """Mean of a function over the detector, one axis after the other."""

    def across(x: float) -> float:
        return quad(lambda t: float(point(x, a + t * size[1] / 2)) / 2, -1, 1, epsabs=1e-11)[0]

    return quad(lambda t: across(e + t * size[0] / 2) / 2, -1, 1, epsabs=1e-11)[0]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_detector_has_the_mean_of_the_point_pattern(name: str, size: tuple[float, float]) -> None:
    """Amplitudes, not powers; the removable singularities at 0 and at half a width are among the places."""
    pattern, point = detector_pattern(name, size), PATTERNS[name]
    assert pattern.name == name
    for e, a in [(0.0, 0.0), (0.25, 0.0), (-0.3, 0.6), (1.4, -0.5)]:
        for kind in ("amplitude", "slope", "azimuth_slope"):
            expected = mean_over_detector(getattr(point, kind), size, e, a)
            assert getattr(pattern, kind)(e, a) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_small_detector_is_a_point(name: str) -> None:
    assert detector_pattern(name, (0.0, 0.0)) is PATTERNS[name]
    e, a = np.linspace(-3, 3, 61)[:, None], np.array([0.0, 0.4, -2.0])
    small = detector_pattern(name, (1e-5, 1e-5))
    np.testing.assert_allclose(small.amplitude(e, a), PATTERNS[name].amplitude(e, a), atol=2e-10)


@pytest.mark.parametrize("size", [(-0.1, 0.0), (0.5, np.nan), (np.inf, 1.0), (64.1, 1.0)], ids=str)
def test_size_out_of_range_is_refused(size: tuple[float, float]) -> None:
    with refused(UserError, str(size), "from 0 to 64"):
        detector_pattern("jinc", size)


def test_detector_of_an_unknown_aperture_is_refused() -> None:
    with refused(UserError, "'cosine'", "gaussian, jinc, sinc"):
        detector_pattern("cosine", (0.6, 1.2))


def pair_of(pattern: Pattern, pitch: float) -> Beams:
    """Two detectors `pitch` beamwidths apart."""
    return Beams((pattern,), np.pi / 4 + np.array([-0.5, 0.5]) * pitch * BEAMWIDTH, BEAMWIDTH)


def sum_and_difference(pair: Beams, offset: float) -> tuple[float, float]:
    """Upper plus lower, and upper minus lower, `offset` beamwidths above the middle of a pair."""
    lower, upper = pair.response(np.pi / 4 + offset * BEAMWIDTH, 0.0)
    return upper + lower, upper - lower


def slope_of_discriminant(pair: Beams) -> float:
    """In the middle of a pair, per beamwidth."""
    lower, upper = pair.slope(np.pi / 4, 0.0) * BEAMWIDTH
    return (upper - lower) / sum_and_difference(pair, 0.0)[0]


@pytest.mark.parametrize("width", [0.1, 0.5, 0.6, 1.0])
def test_touching_detectors_of_the_one_dimensional_model(width: float) -> None:
    """SAL paper, section 2: the discriminant in sine integrals, and its slope pi (1 - sinc b) / Si(b)."""
    pair = pair_of(detector_pattern("sinc", (width, 0.0)), width)
    b = np.pi * width
    for offset in (0.1, -0.25, 0.5, 0.9):
        total, difference = sum_and_difference(pair, offset)
        middle, above, below = sici(np.pi * offset + np.array([0, b, -b]))[0]
        assert difference / total == pytest.approx((2 * middle - above - below) / (above - below), abs=1e-10)
    assert slope_of_discriminant(pair) == pytest.approx(np.pi * (1 - np.sin(b) / b) / sici(b)[0], abs=1e-10)


PAIRS = [
    ("gaussian", (0.0, 0.0), 0.5, (0.06537, 0.16221, 0.31611), 0.65464),
    ("sinc", (0.0, 0.0), 0.5, (0.08630, 0.22203, 0.50000), 0.85841),
    ("jinc", (0.0, 0.0), 0.5, (0.06354, 0.16164, 0.34613), 0.63334),
    ("jinc", (0.0, 0.0), 0.6, (0.07714, 0.19580, 0.41544), 0.76923),
    ("jinc", (0.6, 1.2), 0.6, (0.07806, 0.19821, 0.42127), 0.77833),
    ("sinc", (0.5, 0.0), 0.5, (0.08370, 0.21498, 0.48036), 0.83282),
    ("sinc", (0.6, 0.0), 0.6, (0.10083, 0.25792, 0.56594), 1.00404),
]
"""Pattern, size and pitch; the discriminant at .1, .25 and .5 beamwidths, and its slope in the middle."""


@pytest.mark.parametrize(("name", "size", "pitch", "values", "slope"), PAIRS)
def test_discriminant_of_a_pair(
    name: str, size: tuple[float, float], pitch: float, values: tuple[float, ...], slope: float
) -> None:
    """Known values to their last digit; elevations near pi/4 are rounded to 1e-12 beamwidths only."""
    pair = pair_of(detector_pattern(name, size), pitch)
    for offset, value in zip((0.1, 0.25, 0.5), values, strict=True):
        total, difference = sum_and_difference(pair, offset)
        assert difference / total == pytest.approx(value, abs=5.1e-6)
    assert slope_of_discriminant(pair) == pytest.approx(slope, abs=5.1e-6)


@pytest.mark.parametrize(
    ("name", "size", "pitch", "one", "null"),
    [
        ("sinc", (0.0, 0.0), 0.5, 0.75, 1.07287),
        ("jinc", (0.0, 0.0), 0.5, 0.9697, 1.30662),
        ("jinc", (0.0, 0.0), 0.6, 0.9197, 1.35224),
        ("jinc", (0.6, 1.2), 0.6, 0.9088, 1.3395),
        ("sinc", (0.5, 0.0), 0.5, 0.7716, 1.0975),
        ("sinc", (0.6, 0.0), 0.6, 0.7317, 1.1515),
    ],
)
def test_where_the_discriminant_of_a_pair_is_one_and_ends(
    name: str, size: tuple[float, float], pitch: float, one: float, null: float
) -> None:
    """Where one detector has its null, and where the sum has one: for sinc, tan(pi t) = 1 / (4 t)."""
    pair = pair_of(detector_pattern(name, size), pitch)
    assert brentq(lambda t: float(np.subtract(*sum_and_difference(pair, t))), 0.5, 1.05) == pytest.approx(one, abs=5e-5)
    assert brentq(lambda t: sum_and_difference(pair, t)[0], 0.8, 1.6) == pytest.approx(null, abs=5.1e-5)


STEPS = np.arange(-60, 61) * 0.05
"""Offsets of a table in beamwidths."""


def table_of(pattern: Pattern, azimuth: np.ndarray = STEPS, elevation: np.ndarray = STEPS) -> BeamTable:
    return sample_pattern(pattern, elevation * BEAMWIDTH, azimuth * BEAMWIDTH, BEAMWIDTH)


def test_table_of_a_formula_gives_the_formula() -> None:
    """A cubic spline errs by 5/384 step^4 of the fourth derivative, here 12.2 at the most (pi^4 / 8), in each axis."""
    jinc = PATTERNS["jinc"]
    pattern = tabulated_pattern(table_of(jinc), BEAMWIDTH)
    e, a = np.random.default_rng(1).uniform(-2.7, 2.7, (2, 2000))
    assert pattern.name == "table"
    assert pattern.amplitude(e, a).dtype == np.float64
    np.testing.assert_allclose(pattern.amplitude(e, a), jinc.amplitude(e, a), atol=2e-6, rtol=0)
    np.testing.assert_allclose(pattern.slope(e, a), jinc.slope(e, a), atol=6e-5, rtol=0)  # 12.2 step^3 / 24
    np.testing.assert_allclose(pattern.azimuth_slope(e, a), jinc.azimuth_slope(e, a), atol=6e-5, rtol=0)


def complex_pattern(phase: float = 0.8) -> Pattern:
    """Three shifted circular beams with phases: neither real nor even, with slopes by differences."""
    jinc = PATTERNS["jinc"].amplitude

    def amplitude(e: npt.ArrayLike, a: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        e, a = np.asarray(e), np.asarray(a)
        return jinc(e, a) + np.exp(1j * phase) * jinc(e - 0.4, a + 0.1) / 3 + 0.4j * jinc(e + 0.2, a - 0.3)

    return aperture_pattern("complex", amplitude, JINC_NULL)


def test_table_of_a_complex_beam() -> None:
    pattern = tabulated_pattern(table_of(complex_pattern(), STEPS[30:91], STEPS[:100]), BEAMWIDTH)
    rng = np.random.default_rng(2)
    e, a = rng.uniform(-2.7, 1.6, 100), rng.uniform(-1.2, 1.2, 100)
    assert pattern.amplitude(e, a).dtype == np.complex128
    np.testing.assert_allclose(pattern.amplitude(e, a), complex_pattern().amplitude(e, a), atol=3e-6, rtol=0)
    assert pattern.domain == pytest.approx((-3.0, 1.95), abs=1e-12)


@pytest.mark.parametrize("azimuths", [1, 30], ids=["line", "surface"])
@pytest.mark.parametrize("imaginary", [0.0, 1.0], ids=["real", "complex"])
def test_slopes_are_those_of_the_spline_through_the_table(azimuths: int, imaginary: float) -> None:
    """Random amplitudes at unequal steps: no smooth function would forgive the slope of another one."""
    rng = np.random.default_rng(3)
    elevation, azimuth = (np.cumsum(rng.uniform(0.05, 0.1, count)) for count in (40, azimuths))
    values = rng.normal(size=(40, azimuths)) + 1j * imaginary * rng.normal(size=(40, azimuths))
    parts = (tuple(part.ravel().tolist()) for part in (values.real, values.imag))
    table = BeamTable(tuple(elevation * BEAMWIDTH), tuple(azimuth * BEAMWIDTH), *parts)
    pattern = tabulated_pattern(table, BEAMWIDTH)
    np.testing.assert_allclose(pattern.amplitude(elevation[:, None], azimuth), values, atol=1e-11)
    e, a = rng.uniform(*elevation[[1, -2]], 300), rng.uniform(*azimuth[[min(1, azimuths - 1), -min(2, azimuths)]], 300)
    step = 1e-6  # error of the central difference: 1e-12 times a third derivative of 1e6, and rounding of 1e-10
    for slope, (x, y) in ((pattern.slope, (step, 0)), (pattern.azimuth_slope, (0, step))):
        difference = (pattern.amplitude(e + x, a + y) - pattern.amplitude(e - x, a - y)) / (2 * step)
        np.testing.assert_allclose(slope(e, a), difference, atol=1e-4)
        assert slope(e, a).dtype == pattern.amplitude(e, a).dtype


def test_nothing_is_received_beyond_a_table() -> None:
    pattern = tabulated_pattern(table_of(PATTERNS["gaussian"], STEPS[40:81]), BEAMWIDTH)
    for function in (pattern.amplitude, pattern.slope, pattern.azimuth_slope):
        outside = function([3.001, -3.001, 0.3, 0.3, 9.0], [0.2, 0.2, 1.001, -1.001, 9.0])
        np.testing.assert_array_equal(outside, 0.0)
        assert np.all(function([2.999, -2.999, 0.3, 0.3], [0.2, 0.2, 0.999, -0.999]) != 0)
        assert np.isnan(function([np.nan, 0.1], [0.1, np.nan])).all()


@pytest.mark.parametrize("azimuth", [np.zeros(1), STEPS], ids=["line", "surface"])
def test_edge_of_a_table_belongs_to_it_though_rounded(azimuth: np.ndarray) -> None:
    """An elevation near pi/4 is rounded to 1e-12 beamwidths."""
    gaussian = PATTERNS["gaussian"]
    pattern = tabulated_pattern(table_of(gaussian, azimuth, STEPS[30:91]), BEAMWIDTH)
    for edge in (1.5 * (1 + 1e-12), -1.5 * (1 + 1e-12)):
        assert pattern.amplitude(edge, 0.0) == pytest.approx(gaussian.amplitude(1.5, 0.0), abs=1e-9)


def test_table_without_azimuths_holds_at_all() -> None:
    pattern = tabulated_pattern(table_of(PATTERNS["sinc"], np.array([0.3])), BEAMWIDTH)
    e, a = STEPS[:, None], np.array([-40.0, 0.0, 7.0])
    expected = np.broadcast_to(PATTERNS["sinc"].amplitude(e, 0.3), (len(e), 3))
    np.testing.assert_allclose(pattern.amplitude(e, a), expected, atol=1e-12)
    np.testing.assert_array_equal(pattern.azimuth_slope(e, a), np.zeros((len(e), 3)))


def test_unequal_complex_tables_through_beams() -> None:
    """Every detector has the beam of its own table, extent and steps, at its own boresight."""
    patterns = [complex_pattern(0.1), complex_pattern(-2.0), PATTERNS["jinc"]]
    extents = [STEPS, STEPS[10:], np.arange(-40, 45) * 0.06]
    tables = [table_of(pattern, x, x) for pattern, x in zip(patterns, extents, strict=True)]
    boresights = np.pi / 4 + np.array([-0.5, 0.0, 0.5]) * BEAMWIDTH
    beams = Beams(tuple(tabulated_pattern(table, BEAMWIDTH) for table in tables), boresights, BEAMWIDTH)
    offset, squint = np.random.default_rng(4).uniform(-1.2, 1.2, (2, 100))
    response = beams.response(np.pi / 4 + offset * BEAMWIDTH, squint * BEAMWIDTH)
    slope = beams.slope(np.pi / 4 + offset * BEAMWIDTH, squint * BEAMWIDTH) * BEAMWIDTH
    assert response.shape == (100, 3)
    assert response.dtype == np.complex128
    for i, (pattern, shift) in enumerate(zip(patterns, (0.5, 0.0, -0.5), strict=True)):
        np.testing.assert_allclose(response[:, i], pattern.amplitude(offset + shift, squint), atol=1e-5, rtol=0)
        np.testing.assert_allclose(slope[:, i], pattern.slope(offset + shift, squint), atol=3e-4, rtol=0)
    low, high = beams.domain(9 * BEAMWIDTH)
    # The last table begins 2.4 below its boresight, the first ends 3 above its own.
    assert (low - np.pi / 4) / BEAMWIDTH == pytest.approx(-1.9, abs=1e-9)
    assert (high - np.pi / 4) / BEAMWIDTH == pytest.approx(2.5, abs=1e-9)
    assert np.all(beams.response(np.array([low, high]), 0.0) != 0)


def test_tables_that_do_not_overlap_are_refused() -> None:
    """Beams of 0.5 beamwidths: with boresights 0.49 apart, the middle 0.01 are known to both."""
    pattern = tabulated_pattern(table_of(PATTERNS["jinc"], np.zeros(1), STEPS[55:66]), BEAMWIDTH)
    common = (np.array(pair_of(pattern, 0.49).domain(0.0)) - np.pi / 4) / BEAMWIDTH
    assert common == pytest.approx([-0.005, 0.005], abs=1e-9)
    with refused(UserError, "2 detectors", "must overlap"):
        pair_of(pattern, 0.51).domain(0.0)


def test_power_on_a_detector_has_nearly_twice_the_slope_that_amplitude_has() -> None:
    """What the autocorrelation of the pupil, as of imaging with intensities, would make of detectors 0.6 x 1.2 wide."""
    jinc = PATTERNS["jinc"].amplitude

    def line(e: float) -> float:
        return quad(lambda a: float(jinc(e, a)) ** 2, -0.6, 0.6, epsabs=1e-12)[0]

    by_power = (line(0.0) - line(0.6)) / quad(line, 0.0, 0.6, epsabs=1e-10)[0]
    assert by_power == pytest.approx(1.41282, abs=5e-6)
    pattern = detector_pattern("jinc", (0.6, 1.2))
    by_amplitude = -float(pattern.slope(0.3, 0.0) / pattern.amplitude(0.3, 0.0))
    assert by_amplitude == pytest.approx(0.77833, abs=5e-6)


@pytest.mark.parametrize(("name", "null"), [("sinc", 1.0), ("jinc", JINC_NULL)])
def test_main_lobe_is_the_first_null_in_azimuth(name: str, null: float) -> None:
    """As the registry states it, and as it is found in a table that reaches into the sidelobes."""
    assert PATTERNS[name].main_lobe == pytest.approx(null, abs=1e-12)
    assert tabulated_pattern(table_of(PATTERNS[name]), BEAMWIDTH).main_lobe == pytest.approx(null, abs=1e-5)
    aside = aperture_pattern("aside", lambda e, a: PATTERNS[name].amplitude(e, np.asarray(a) - 0.1), null)
    assert tabulated_pattern(table_of(aside), BEAMWIDTH).main_lobe == pytest.approx(null + 0.1, abs=1e-5)


def test_main_lobe_of_a_table_without_a_null_is_its_extent() -> None:
    gaussian = PATTERNS["gaussian"]
    assert tabulated_pattern(table_of(gaussian, STEPS[30:81]), BEAMWIDTH).main_lobe == pytest.approx(1.5, abs=1e-12)
    assert tabulated_pattern(table_of(gaussian, np.zeros(1)), BEAMWIDTH).main_lobe == 1.0


@pytest.mark.parametrize("width", [0.6, 1.2, 2.0])
def test_main_lobe_of_a_finite_detector_ends_where_its_mean_is_zero(width: float) -> None:
    """Si(pi (a + w/2)) = Si(pi (a - w/2)), beyond the null of a point and before that of the detector's edge."""

    def mean(a: float) -> float:
        return float(np.diff(sici(np.pi * (a + np.array([-0.5, 0.5]) * width))[0])[0])

    null = brentq(mean, 1.0, 1.0 + width / 2)
    assert detector_pattern("sinc", (0.3, width)).main_lobe == pytest.approx(null, abs=1e-6)
