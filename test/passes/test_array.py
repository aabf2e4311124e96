"""Phases of passes against exact ranges, and what an array of them resolves against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from pass_scenes import array_of, flown

from sal_height.elevation import ESTIMATORS, Looks, conditional_crb
from sal_height.errors import UserError
from sal_height.geometry import locate_at_elevation
from sal_height.numeric import window
from sal_height.passes import GOTCHA_ELEVATIONS, Circle, PassArray, Steering, ambiguity_of, simulated_passes
from sal_height.passes.array import resolution


@pytest.fixture(scope="module")
def array() -> PassArray:
    return array_of(flown(np.random.default_rng(0), np.zeros((1, 3))))


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (40.0, -45.0, 3.0)])
def test_phases_are_those_of_exact_ranges(array: PassArray, place: tuple[float, float, float]) -> None:
    """All pulses in extended precision, 6 m across from the pixel: 2000 rad that all share, 50 that differ."""
    point = np.array(place)
    steering = array.steering(point, -6.0, 6.0)
    slant_range, along, elevation = array.seen(point)
    for metres in (-6.0, -1.3, 0.4, 6.0):
        offset = metres / float(slant_range)
        there = locate_at_elevation(elevation + offset, slant_range, along, array.reference, array.look_side)
        exact = []
        for one in array.passes:
            antenna = one.antenna.astype(np.longdouble)
            longer = np.linalg.norm(there - antenna, axis=-1) - np.linalg.norm(point - antenna, axis=-1)
            weights = window(array.azimuth_window, len(antenna))
            exact.append(float(-one.wavenumber * (weights @ longer) / weights.sum()))
        fitted = steering.phase(offset / steering.beamwidth)
        assert np.ptp(exact) > 5 * abs(metres)  # what differs between passes is not small
        assert fitted - fitted.mean() == pytest.approx(np.array(exact) - np.mean(exact), abs=2e-4)


def test_a_far_field_would_not_do(array: PassArray) -> None:
    """The phases of the scene's middle are off by .1 rad for a point 2 m high at its edge."""
    middle, edge = (array.steering(np.array(at), -2.0, 2.0) for at in ((0.0, 0.0, 0.0), (50.0, 0.0, 0.0)))
    metres = 2.0 / np.sin(middle.elevation)
    there = [one.phase(metres / resolution(one)) for one in (middle, edge)]
    off = there[0] - there[1]
    assert np.abs(off - off.mean()).max() > 0.1


def test_slopes_are_derivatives(array: PassArray) -> None:
    steering = array.steering(np.zeros(3), -3.0, 3.0)
    beams = steering.beams()
    step = 1e-4
    x = np.array([-2.5, 0.3, 4.0])
    differences = (steering.phase(x + step) - steering.phase(x - step)) / (2 * step)
    assert steering.slope(x) == pytest.approx(differences, rel=1e-6)
    elevation = steering.elevation + x * steering.beamwidth
    by = step * steering.beamwidth
    slope = (beams.response(elevation + by, 0.0) - beams.response(elevation - by, 0.0)) / (2 * by)
    assert beams.slope(elevation, 0.0) * steering.beamwidth == pytest.approx(slope * steering.beamwidth, rel=1e-6)
    assert np.abs(beams.response(elevation, 0.0)) == pytest.approx(1.0)


def test_the_resolution_is_that_of_the_outermost_passes(array: PassArray) -> None:
    """Wavelength over twice the angle between them, across; times the sine of the middle elevation in height."""
    apart = np.ptp(GOTCHA_ELEVATIONS)
    steering = array.steering(np.zeros(3), -1.0, 1.0)
    assert resolution(steering) == pytest.approx(0.0312284 / (2 * apart), rel=2e-3)


def test_single_scatterers_reach_the_bound(array: PassArray) -> None:
    """One look at 20 dB: 600 estimates; their standard deviation has a standard error of 3 %."""
    rng = np.random.default_rng(1)
    trials, cnr = 600, 100.0
    beams = array.steering(np.zeros(3), -2.0, 2.0).beams()
    low, high = beams.span
    elevation = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), trials)
    response = beams.response(elevation, 0.0)
    noise = rng.standard_normal((trials, beams.count, 2)) @ np.array([1.0, 1j]) / np.sqrt(2)
    samples = np.sqrt(cnr) * np.exp(2j * np.pi * rng.uniform(size=(trials, 1))) * response + noise
    covariance = (samples[..., None] * samples[:, None].conj())[None].astype(np.complex64)
    ml = ESTIMATORS["ml"]
    found = ml.estimate(Looks.of(covariance, 1.0), beams, ml.settings(layover=False))
    good = found.validity[0] == 0
    assert good.mean() > 0.99
    bound = conditional_crb(beams, elevation, 0.0, cnr, 1)[good]
    errors = (found.elevation[0] - elevation)[good] / bound
    assert errors.std() == pytest.approx(1.0, abs=0.09)
    assert np.median(found.sigma[0][good] / bound) == pytest.approx(1.0, abs=0.05)


def errors_of(
    name: str, array: PassArray, looks: int, cnr_db: float, second: tuple[float, float] | None, trials: int = 600
) -> tuple[np.ndarray, float]:
    """Errors of some elevations over their sigma, where they are valid, and the share of these.

    Args:
        name: of the estimator.
        array: of the passes.
        looks: of each, whose scatterers have independent phases.
        cnr_db: of one look in a pass.
        second: distance of a second scatterer, beamwidths, and its power over that of the first, dB; None: there is
            none.
        trials: number of the elevations.
    """
    rng = np.random.default_rng([7, looks])
    beams = array.steering(np.zeros(3), -2.0, 2.0).beams()
    low, high = beams.span
    elevation = rng.uniform(low + 0.2 * (high - low), high - 0.2 * (high - low), trials)
    samples = rng.standard_normal((trials, looks, beams.count, 2)) @ np.array([1.0, 1j]) / np.sqrt(2)
    for apart, power_db in [(0.0, 0.0), *([second] if second else [])]:
        amplitude = 10 ** ((cnr_db + power_db) / 20) * np.exp(2j * np.pi * rng.uniform(size=(trials, looks, 1)))
        samples = samples + amplitude * beams.response(elevation + apart * beams.beamwidth, 0.0)[:, None]
    covariance = np.einsum("tki,tkj->tij", samples, samples.conj())[None].astype(np.complex64)
    estimator = ESTIMATORS[name]
    settings = estimator.settings(layover=name != "capon")
    found = estimator.estimate(Looks.of(covariance, float(looks)), beams, settings)
    good = found.validity[0] == 0
    return np.asarray(((found.elevation[0] - elevation) / found.sigma[0])[good]), float(good.mean())


@pytest.mark.parametrize("cnr_db", [10.0, 20.0])
@pytest.mark.parametrize("looks", [1, 4, 16])
def test_sigma_of_capon_is_the_scatter_of_single_scatterers(array: PassArray, looks: int, cnr_db: float) -> None:
    """600 trials: one standard error is 3 %."""
    errors, valid = errors_of("capon", array, looks, cnr_db, None)
    assert valid > 0.98
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("second", [(0.2, -10.0), (0.4, -15.0)], ids=str)
@pytest.mark.parametrize("looks", [4, 16])
def test_sigma_of_capon_holds_what_a_weak_neighbour_does(
    array: PassArray, looks: int, second: tuple[float, float]
) -> None:
    """In several looks: up to 1.75 sigma, instead of 5 if only noise is in it. What one look cannot tell is beyond."""
    errors, valid = errors_of("capon", array, looks, 20.0, second)
    assert valid > 0.98
    assert 0.6 < np.sqrt(np.mean(errors**2)) < 1.9
    assert np.mean(np.abs(errors) > 3) < 0.09


def test_maximum_likelihood_leaves_out_more_of_two_close_scatterers_than_capon() -> None:
    """One look at 20 dB, the second 0.4 beamwidths away, 10 dB weaker: 20 % have a height, of Capon's method 60 %.

    A share of 150 trials has a standard error of 4 %.
    """
    array = array_of(flown(np.random.default_rng(0), np.zeros((1, 3))))
    shares = [errors_of(name, array, 1, 20.0, (0.4, -10.0), 150)[1] for name in ("ml", "capon")]
    np.testing.assert_allclose(shares, [0.2, 0.6], atol=0.1)


def test_even_passes_have_a_grating_lobe() -> None:
    """At wavelength / (2 step) across: the phases of neighbours have turned once."""
    step = np.radians(0.3)
    circle = Circle(elevations=tuple(np.radians(44.0) + step * np.arange(-3, 4)), pulses=20, frequencies=64)
    array = array_of(simulated_passes(circle, np.zeros((0, 3)), np.zeros(0, complex), 1.0, np.random.default_rng(0)))
    steering = array.steering(np.zeros(3), -2.0, 2.0)
    climb = steering.metres * array.axes[2, 2]
    found = ambiguity_of(steering, climb, 5.0)
    assert found.sidelobe == pytest.approx(1.0, abs=1e-3)
    assert found.at == pytest.approx(0.0312284 / (2 * step) * array.axes[2, 2], rel=2e-3)
    assert found.first_false == pytest.approx(found.at)


def test_the_passes_of_gotcha_have_sidelobes() -> None:
    """The closed form for plane waves, over angles: within 5 m the greatest is .44 of the power, 1.2 m off."""
    offsets = np.arange(0.3, 5.0, 0.001)
    # Elevation angles are over the horizon: phases grow with the angle at which a height h moves across, h / cos.
    cross = np.multiply.outer(offsets / np.cos(np.mean(GOTCHA_ELEVATIONS)), np.array(GOTCHA_ELEVATIONS))
    response = np.abs(np.exp(4j * np.pi / 0.0312284 * cross).mean(axis=1)) ** 2
    array = array_of(flown(np.random.default_rng(0), np.zeros((1, 3))))
    steering: Steering = array.steering(np.zeros(3), -2.0, 2.0)
    found = ambiguity_of(steering, steering.metres * array.axes[2, 2], 5.0)
    assert found.sidelobe == pytest.approx(response.max(), abs=0.02)
    assert found.at == pytest.approx(offsets[np.argmax(response)], abs=0.02)
    assert np.isinf(found.first_false)


def test_passes_of_one_elevation_are_refused() -> None:
    circle = Circle(elevations=(0.76,) * 4, pulses=20, frequencies=64)
    passes = simulated_passes(circle, np.zeros((0, 3)), np.zeros(0, complex), 1.0, np.random.default_rng(0))
    with pytest.raises(UserError, match="differ by 0 degrees"):
        array_of(passes)
