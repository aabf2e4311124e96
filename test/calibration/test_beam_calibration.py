"""Width and gains of the beams from scenes and targets, against the Cramer-Rao bound and the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from beam_tables import sample_pattern
from helpers import BEAMWIDTH, circular, elevation_at, few, make_beams, make_sensor, multilook

from sal_height.beams.array import Beams
from sal_height.beams.pattern import Pattern, pattern_named
from sal_height.calibration.beam_calibration import (
    BeamCalibration,
    calibrate_beams,
    calibrate_on_target,
    curve_of,
    variance_between,
    with_known_angles,
    with_unknown_angles,
)
from sal_height.elevation.array.likelihood import OBJECTIVES, peak_elevation
from sal_height.elevation.array.search import PeakSearches
from sal_height.elevation.looks.looks import Looks, covariance
from sal_height.errors import NotDetermined
from sal_height.sensor.channels import whitened_channels
from sal_height.sensor.sensor import Sensor

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]

NADIR = np.zeros(1)
DB = np.log(10) / 20
"""ln of an amplitude ratio of 1 dB."""


def draw_truth(
    rng: np.random.Generator, channels: int, width: float = 1.05, gain_db: float = 0.5, phase: float = np.radians(5)
) -> BeamCalibration:
    """Beams and gains wrong by that much (standard deviations), with the means 0 of a calibration."""
    amplitude, angle = gain_db * DB * rng.standard_normal(channels), phase * rng.standard_normal(channels)
    gains = np.exp(amplitude - amplitude.mean() + 1j * (angle - angle.mean()))
    return replace(BeamCalibration.as_described(channels), width_factor=width, gains=gains)


def beams_with(beams: Beams, calibration: BeamCalibration) -> Beams:
    """Beams wider by the width factor, of channels multiplied by the gains."""
    return beams.widened(calibration.width_factor).scaled(calibration.gains)


def draw_samples(rng: np.random.Generator, beams: Beams, elevation: Array, squint: Array, cnr: float, looks: int):
    """Speckle at some directions (pixels,) in unit noise, (pixels, looks, channels)."""
    amplitude = np.sqrt(cnr) * circular(rng, (len(elevation), looks, 1))
    noise = circular(rng, (len(elevation), looks, beams.count))
    return (amplitude * beams.response(elevation, squint)[:, None] + noise).astype(np.complex64)


def looks_of(samples: ComplexArray) -> Looks:
    """A column of pixels."""
    return Looks.of(covariance(samples, True)[:, None], samples.shape[1])


def draw_scene(rng: np.random.Generator, beams: Beams, pixels: int, cnr: float, looks: int = 4) -> Looks:
    """Speckle at elevations spread over the array."""
    first, last = beams.span
    elevation = rng.uniform(first, last, pixels)
    return looks_of(draw_samples(rng, beams, elevation, np.zeros(pixels), cnr, looks))


def errors(found: BeamCalibration, truth: BeamCalibration) -> Array:
    """Of ln w, ln |g| and arg g."""
    ratio = np.log(found.gains / truth.gains)
    return np.concatenate([[np.log(found.width_factor / truth.width_factor)], ratio.real, ratio.imag])


def sigmas(found: BeamCalibration) -> Array:
    return np.concatenate([[found.width_sigma / found.width_factor], found.gain_sigmas, found.phase_sigmas])


@cache
def trials(count: int) -> tuple[Array, Array]:
    """Errors of calibrations of 8 jinc beams from 10 000 pixels at 10 dB, and what they were stated to be."""
    rows = []
    for seed in range(count):
        rng, beams = np.random.default_rng(seed), make_beams("jinc", 8)
        truth = draw_truth(rng, 8)
        found = calibrate_beams(draw_scene(rng, beams_with(beams, truth), 10_000, 10.0), beams)
        rows.append((errors(found, truth), sigmas(found)))
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])


@pytest.mark.thorough
def test_errors_are_as_large_as_stated() -> None:
    """15 free parameters in 20 trials: the standard error of their rms is 4 % (independent) to 16 % (all alike)."""
    error, sigma = trials(20)
    assert np.sqrt(np.mean((error / sigma) ** 2)) == pytest.approx(1, abs=0.12)


@pytest.mark.thorough
def test_stated_errors_know_what_rows_have_in_common() -> None:
    """Every pixel four times in its column, as where layover or sidelobes fill neighbours: errors are twice as great.

    The rms of 16 trials as above; taken for independent pixels, it would be 2.
    """
    ratios = []
    for seed in range(16):
        rng, beams = np.random.default_rng([1, seed]), make_beams("jinc", 8)
        truth = draw_truth(rng, 8)
        first, last = beams.span
        samples = draw_samples(
            rng, beams_with(beams, truth), rng.uniform(first, last, 2000), np.zeros(2000), 10.0, looks=4
        )
        columns = covariance(samples, True).reshape(20, 100, 8, 8).repeat(4, axis=0)
        found = calibrate_beams(Looks.of(columns, 4), beams)
        ratios.append(errors(found, truth) / sigmas(found))
    assert np.sqrt(np.mean(np.array(ratios) ** 2)) == pytest.approx(1, abs=0.14)


def test_rows_that_repeat_each_other_state_no_smaller_errors() -> None:
    """Every pixel once, or four times in its column: four times independent pixels would halve the errors."""
    rng, beams = np.random.default_rng(3), make_beams("jinc", 4)
    elevation = rng.uniform(*beams.span, 2000)
    samples = draw_samples(rng, beams, elevation, np.zeros(2000), 10.0, looks=4)
    columns = covariance(samples, True).reshape(20, 100, 4, 4)
    once, repeated = (
        sigmas(calibrate_beams(Looks.of(pixels, 4), beams)) for pixels in (columns, columns.repeat(4, axis=0))
    )
    assert repeated / once == pytest.approx(1, abs=0.15)


def test_variance_between_groups_is_that_of_their_sums() -> None:
    """40 000 groups of three scores, one of them common to the group: 1 + 2^2, within 2 %."""
    rng = np.random.default_rng(2)
    common = rng.standard_normal((40_000, 2))
    scores = np.concatenate([rng.standard_normal((40_000, 2)), common, common])
    found = variance_between(scores, np.tile(np.arange(40_000), 3)) / 40_000
    assert found == pytest.approx(np.diag([5.0, 5.0]), abs=0.1)


@pytest.mark.parametrize("count", few(1, [5, 20]))
def test_unknown_angles_do_not_bias_the_width(count: int) -> None:
    """The mean of all errors has a standard error of 1; left uncorrected, that of 20 would be at -9, of 5 at -3.4."""
    error, sigma = trials(count)
    assert abs(np.sum(error[:, 0] / sigma[:, 0])) / np.sqrt(count) < 3


def test_errors_are_a_tenth_of_what_they_were() -> None:
    """5 %, .5 dB and 5 degrees at 15 dB; the benchmark measures 200 000 pixels of 16 detectors."""
    rng, beams = np.random.default_rng(1), make_beams("sinc", 8)
    truth = draw_truth(rng, 8)
    found = calibrate_beams(draw_scene(rng, beams_with(beams, truth), 10_000, 10**1.5), beams)
    error = errors(found, truth)
    assert abs(error[0]) < 0.005
    assert np.sqrt(np.mean(error[1:9] ** 2)) < 0.05 * DB
    assert np.sqrt(np.mean(error[9:] ** 2)) < np.radians(0.5)
    assert abs(np.sum(np.log(np.abs(found.gains)))) < 1e-12
    assert abs(np.sum(np.angle(found.gains))) < 1e-12


@pytest.mark.parametrize(("pattern", "channels"), [("sinc", 4), ("jinc", 8)])
def test_stated_errors_are_at_the_bound(pattern: str, channels: int) -> None:
    """Within 6 %: pixels that are too dark, some 3 %, and weights that take CNR as great are not in the bound."""
    rng, beams = np.random.default_rng(2), make_beams(pattern, channels)
    found = calibrate_beams(draw_scene(rng, beams, 5_000, 10**1.5), beams)
    assert sigmas(found) / cramer_rao_bound(beams, 5_000, 10**1.5, 4) == pytest.approx(1, abs=0.06)


def cramer_rao_bound(beams: Beams, pixels: int, cnr: float, looks: int) -> Array:
    """Standard deviations of ln w, ln |g| and arg g, by K tr(S^-1 dS S^-1 dS) without the pixels' angle and power.

    Slepian-Bangs, for speckle spread evenly over the array, from differences of the covariance S.
    """
    size, step = 2 * beams.count + 1, 1e-5

    def model(elevation: float, values: Array) -> Array:
        width, amplitude, phase = values[2], values[3 : beams.count + 3], values[beams.count + 3 :]
        moved = elevation + values[0] * BEAMWIDTH
        described = replace(beams, beamwidth=BEAMWIDTH * (1 + width)).response(moved, 0.0)
        response = np.exp(amplitude + 1j * phase) * described
        return cnr * np.exp(values[1]) * np.outer(response, response.conj()) + np.eye(beams.count)

    total, first, last = np.zeros((size, size)), *beams.span
    elevations = np.linspace(first, last, 201)
    for elevation in elevations:
        inverse = np.linalg.inv(model(elevation, np.zeros(size + 2)))
        moves = step * np.eye(size + 2)
        changes = [(model(elevation, move) - model(elevation, -move)) / (2 * step) for move in moves]
        whitened = [inverse @ change for change in changes]
        information = looks * np.array([[np.trace(a @ b).real for a in whitened] for b in whitened])
        own, shared, crossed = information[:2, :2], information[2:, 2:], information[2:, :2]
        total += (shared - crossed @ np.linalg.solve(own, crossed.T)) * pixels / len(elevations)
    basis = np.zeros((size, size - 2))
    basis[0, 0] = 1
    differences = np.linalg.svd(np.ones((1, beams.count)))[2][1:].T
    basis[1 : beams.count + 1, 1 : beams.count] = basis[beams.count + 1 :, beams.count :] = differences
    return np.sqrt(np.diag(basis @ np.linalg.inv(basis.T @ total @ basis) @ basis.T))


def test_score_is_the_derivative_of_the_likelihood() -> None:
    rng, beams, gains = np.random.default_rng(3), make_beams("jinc", 4), np.array([1.1, 0.9, 1.0, 1.2])
    elevation, squint = elevation_at([0.3, -0.6]), np.array([0.1, 0.2]) * BEAMWIDTH
    pixels = covariance(draw_samples(rng, beams, elevation, squint, 30.0, 3), True)

    def likelihood(values: Array) -> float:
        wide = replace(beams, beamwidth=BEAMWIDTH * np.exp(values[0]))
        response = gains * np.exp(values[1:5] + 1j * values[5:]) * wide.response(elevation, squint)
        unit = response / np.linalg.norm(response, axis=-1, keepdims=True)
        return float(np.einsum("pm,pmn,pn->", unit.conj(), pixels.astype(np.complex128), unit).real)

    moves = 1e-4 * np.eye(9)
    differences = [(likelihood(move) - likelihood(-move)) / 2e-4 for move in moves]
    found = with_known_angles(curve_of(beams, gains, elevation, squint), pixels, np.full(2, 3.0))
    assert found.score == pytest.approx(differences, abs=1e-4 * np.abs(differences).max())


def with_phase(pattern: Pattern) -> Pattern:
    """The pattern with a phase that is not straight over elevation."""

    def turn(e: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        return np.exp(1j * (0.7 * np.asarray(e) + 0.9 * np.asarray(e) ** 2))

    return replace(
        pattern,
        amplitude=lambda e, a: pattern.amplitude(e, a) * turn(e),
        slope=lambda e, a: (pattern.slope(e, a) + 1j * (0.7 + 1.8 * np.asarray(e)) * pattern.amplitude(e, a)) * turn(e),
    )


@pytest.mark.parametrize("kind", ["real", "complex"])
def test_curvature_is_that_of_the_curve(kind: str) -> None:
    """The unit vector a little further on, and back, with the phases that bring both nearest to it."""
    beams = make_beams("jinc", 4)
    if kind == "complex":
        beams = replace(beams, patterns=(with_phase(beams.patterns[0]),))
    gains, here, far = np.linspace(0.9, 1.1, beams.count), elevation_at([0.2]), 2e-3
    middle, before, after = (
        curve_of(beams, gains, here + step * BEAMWIDTH, np.zeros(1)).unit[0] for step in (0, -far, far)
    )
    before, after = (unit * np.exp(-1j * np.angle(middle.conj() @ unit)) for unit in (before, after))
    tangent = after - before
    tangent -= middle * (middle.conj() @ tangent)
    speed = np.linalg.norm(tangent) / (2 * far)
    tangent /= np.linalg.norm(tangent)
    bend = (after + before - 2 * middle) / far**2
    bend -= middle * (middle.conj() @ bend)
    bend -= tangent * (tangent.conj() @ bend).real
    found = curve_of(beams, gains, here, np.zeros(1)).curvature[0]
    assert np.linalg.norm(found) > 0.1
    assert found == pytest.approx(bend / speed**2, abs=1e-4 * np.linalg.norm(found))


def test_information_is_that_of_turning_unit_vectors() -> None:
    """2 (e^H R e - K) Re(de^H de), de without its part along e; and none of its part along de/dtheta."""
    beams = make_beams("jinc", 4)
    beams = replace(beams, patterns=(with_phase(beams.patterns[0]),))
    here, gains, step = elevation_at([0.2]), np.array([1.1, 0.9, 1.0, 1.2]), 1e-5

    def unit(values: Array) -> npt.NDArray[np.complex128]:
        wide = replace(beams, beamwidth=BEAMWIDTH * np.exp(values[0]))
        response = gains * np.exp(values[1:5] + 1j * values[5:9]) * wide.response(here + values[9] * BEAMWIDTH, 0.0)[0]
        return response / np.linalg.norm(response)

    moves, middle = step * np.eye(10), unit(np.zeros(10))
    turns = np.array([(unit(move) - unit(-move)) / (2 * step) for move in moves])
    turns -= (turns @ middle.conj())[:, None] * middle
    gram = (turns.conj() @ turns.T).real
    curve, pixels = curve_of(beams, gains, here, np.zeros(1)), 50 * np.outer(middle, middle.conj())[None]
    known = with_known_angles(curve, pixels, np.full(1, 4.0)).information
    unknown = with_unknown_angles(curve, pixels, np.full(1, 4.0)).information
    assert known == pytest.approx(2 * 46 * gram[:9, :9], abs=1e-3)
    assert unknown == pytest.approx(2 * 46 * (gram - np.outer(gram[9], gram[9]) / gram[9, 9])[:9, :9], abs=1e-3)


def test_correction_is_the_curvature_times_what_the_tangent_lacks() -> None:
    """Without noise or spread the likelihood is stationary, and the score is the correction of one look alone."""
    beams, elevation = make_beams("sinc", 4), elevation_at([0.2, -0.4])
    curve = curve_of(beams, np.ones(4), elevation, np.zeros(2))
    pixels = np.einsum("pm,pn->pmn", curve.unit, curve.unit.conj())
    found = with_unknown_angles(curve, pixels, np.ones(2)).score
    expected = np.sum((curve.curvature.conj() * curve.wider).real)
    assert found[0] == pytest.approx(expected, rel=1e-9)
    assert found[1:5] == pytest.approx(np.sum((curve.curvature.conj() * curve.unit).real, axis=0), rel=1e-9)


def test_elevations_that_spread_within_a_pixel_do_not_draw_the_curve() -> None:
    """Scatterers 0.1 beamwidths to each side, 20 dB over the noise: scores cancel but for the fourth order."""
    beams = make_beams("jinc", 8)
    curve = curve_of(beams, np.ones(8), elevation_at([0.2]), np.zeros(1))
    sides = beams.response(elevation_at([0.1, 0.3]), 0.0)
    norm = np.sum(sides**2) / 2
    seen = np.eye(8) * 4 + 400 * np.einsum("km,kn->mn", sides, sides) / norm / 2
    noise = with_unknown_angles(curve, np.eye(8)[None] * 4 + 400 * _outer(curve.unit), np.full(1, 4.0)).score
    spread = with_unknown_angles(curve, seen[None].astype(complex), np.full(1, 4.0)).score
    drawn = 400 * 0.01 * np.sum((curve.curvature.conj() * curve.wider).real) * _speed(beams) ** 2
    assert abs(drawn) > 1
    assert np.abs(spread - noise)[0] < 0.1 * abs(drawn)


def _outer(unit: Array) -> Array:
    return np.einsum("pm,pn->pmn", unit, unit.conj())


def _speed(beams: Beams) -> float:
    """Change of the unit vector at 0.2 beamwidths, per beamwidth."""
    before, after = (beams.response(elevation_at([0.2 + step]), 0.0)[0] for step in (-1e-4, 1e-4))
    return float(np.linalg.norm(after / np.linalg.norm(after) - before / np.linalg.norm(before)) / 2e-4)


def test_elevations_lose_their_bias() -> None:
    """In beamwidths: means of 4000 errors have the standard error 2e-4 at 20 dB; the calibration's own is 1e-3."""
    rng, beams = np.random.default_rng(4), make_beams("jinc", 8)
    truth = beams_with(beams, draw_truth(rng, 8))
    found = calibrate_beams(draw_scene(rng, truth, 20_000, 10**1.5), beams)
    described, calibrated = [], []
    for offset in (-1.3, 0.1, 1.4):
        target = np.full(4000, elevation_at(offset))
        seen = looks_of(draw_samples(rng, truth, target, np.zeros(4000), 100.0, 4))
        for biases, used in ((described, beams), (calibrated, beams_with(beams, found))):
            elevation = peak_elevation(seen, used, OBJECTIVES["normalised"], 0.0)
            biases.append(float(np.mean(elevation - target[0])) / BEAMWIDTH)
    assert np.max(np.abs(described)) > 0.01
    assert np.max(np.abs(calibrated)) < 0.002


def test_columns_have_their_squint() -> None:
    """Beams in their own direction only: at squint 0 the width would be 3 % wrong."""
    rng, beams = np.random.default_rng(5), make_beams("jinc", 6)
    truth = draw_truth(rng, 6)
    squint = np.linspace(-0.6, 0.6, 40) * BEAMWIDTH
    first, last = beams.span
    across = np.tile(squint, 250)
    samples = draw_samples(rng, beams_with(beams, truth), rng.uniform(first, last, 10_000), across, 30.0, 2)
    slc = samples.reshape(250, 80, 6).transpose(2, 0, 1)
    found = calibrate_beams(multilook(slc, 1, 2, hermitian=True, squint=squint), beams)
    assert np.max(np.abs(errors(found, truth) / sigmas(found))) < 4


def test_noise_power_is_the_unit() -> None:
    rng, beams = np.random.default_rng(6), make_beams("sinc", 4)
    looks = draw_scene(rng, beams, 2000, 30.0)
    louder = replace(looks, covariance=looks.covariance[:] * np.float32(4), noise_powers=np.full(4, 4.0))
    one, four = calibrate_beams(looks, beams), calibrate_beams(louder, beams)
    assert errors(four, one) == pytest.approx(np.zeros(9), abs=1e-6)
    assert sigmas(four) == pytest.approx(sigmas(one), rel=1e-4)


def test_bad_pixels_and_layover_are_left_out() -> None:
    """A third of the pixels hold a second scatterer; what cannot be told from one moves the width by .2 % or less."""
    rng, beams = np.random.default_rng(7), make_beams("jinc", 8)
    first, last = beams.span
    target, zero = rng.uniform(first, last, (2, 12_000)), np.zeros(12_000)
    samples = draw_samples(rng, beams, target[0], zero, 30.0, 4)
    samples[::3] += draw_samples(rng, beams, target[1], zero, 15.0, 4)[::3]
    looks = looks_of(samples)
    looks.finite[:1000] = False
    found = calibrate_beams(looks, beams)
    assert 6500 < found.pixels < 8500
    assert found.width_factor == pytest.approx(1, abs=0.004)


def test_scatterers_beyond_the_boresights_are_left_out() -> None:
    """Of elevations over twice the array half are used; the standard error of 4000 is 1.2 %."""
    rng, beams = np.random.default_rng(13), make_beams("sinc", 6)
    elevation = elevation_at(rng.uniform(-2.5, 2.5, 4000))
    looks = looks_of(draw_samples(rng, beams, elevation, np.zeros(4000), 100.0, 4))
    assert calibrate_beams(looks, beams).pixels == pytest.approx(2000, rel=0.06)


def test_the_order_in_which_threads_finish_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks of pixels are taken in order, then backwards; the id of a calibration depends on its bits."""
    rng, beams = np.random.default_rng(8), make_beams("sinc", 4)
    scene = draw_scene(rng, beams_with(beams, draw_truth(rng, 4)), 20_000, 10.0)
    forwards = calibrate_beams(scene, beams)
    each, blocks = PeakSearches.each, []

    def backwards(searches: PeakSearches, squint: Array, rows: int, work: Callable[..., object]) -> None:
        calls: list[tuple[object, ...]] = []
        each(searches, squint, rows, lambda *call: calls.append(call))
        blocks.append(len(calls))
        for call in sorted(calls, key=lambda call: [int(part[0]) for part in call[1]], reverse=True):
            work(*call)

    monkeypatch.setattr(PeakSearches, "each", backwards)
    again = calibrate_beams(scene, beams)
    assert min(blocks) > 5
    assert again.gains.tobytes() == forwards.gains.tobytes()
    assert (again.width_factor, again.width_sigma) == (forwards.width_factor, forwards.width_sigma)


def test_two_detectors_tell_their_phase() -> None:
    rng, beams = np.random.default_rng(8), make_beams("jinc", 2)
    truth = draw_truth(rng, 2, width=1.0, gain_db=0.0)
    looks = draw_scene(rng, beams_with(beams, truth), 4000, 30.0)
    found = calibrate_beams(looks, beams)
    assert np.abs(np.angle(found.gains / truth.gains)) == pytest.approx(np.zeros(2), abs=4 * found.phase_sigmas[0])
    assert 0 < found.phase_sigmas[0] < 1e-3
    assert np.abs(found.gains) == pytest.approx(np.ones(2), abs=1e-12)
    assert found.width_factor == 1
    assert np.isnan(found.width_sigma)
    assert np.isnan(found.gain_sigmas).all()


def test_scenes_that_do_not_tell() -> None:
    rng, beams = np.random.default_rng(9), make_beams("gaussian", 6)
    with pytest.raises(NotDetermined, match="determine a combination of width and gains"):
        calibrate_beams(draw_scene(rng, beams, 3000, 30.0), beams)
    beams = make_beams("sinc", 4)
    with pytest.raises(NotDetermined, match=r"^1[0-9][0-9] pixels"):
        calibrate_beams(draw_scene(rng, beams, 150, 30.0), beams)
    with pytest.raises(NotDetermined, match=r"^0 pixels"):
        calibrate_beams(draw_scene(rng, beams, 2000, 0.1), beams)
    looks = draw_scene(rng, beams, 2000, 30.0)
    with pytest.raises(NotDetermined, match=r"^0 pixels"):
        calibrate_beams(replace(looks, finite=np.zeros_like(looks.finite)), beams)
    same = looks_of(draw_samples(rng, beams, np.full(3000, elevation_at(0.2)), np.zeros(3000), 30.0, 4))
    with pytest.raises(NotDetermined, match="elevations"):
        calibrate_beams(same, beams)


def test_a_scan_tells_width_and_gains() -> None:
    """5 parameters in 60 trials of two detectors, with any phases: the standard error of their rms is 5 %."""
    beams, elevation, found = make_beams("sinc", 2), elevation_at(np.linspace(-0.8, 0.8, 21)), []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        truth = draw_truth(rng, 2, phase=1.0)
        target = np.repeat(elevation, 4)
        samples = draw_samples(rng, beams_with(beams, truth), target, np.zeros(84), 300.0, 1)[:, 0]
        result = calibrate_on_target(samples, beams, target, np.zeros(84), 1.0)
        error = errors(result, truth)
        error[3:] = np.angle(np.exp(1j * (error[3:] - error[3]))) - np.angle(np.exp(1j * (error[4] - error[3]))) / 2
        found.append(error / sigmas(result))
    free = np.array(found)[:, [0, 1, 3]]
    assert np.sqrt(np.mean(free**2, axis=0)) == pytest.approx(np.ones(3), abs=0.3)
    assert np.abs(np.mean(free, axis=0)) * np.sqrt(60) == pytest.approx(np.zeros(3), abs=3.5)


def test_one_position_tells_the_gains() -> None:
    """Where the width is as described, amplitudes over the beams are the gains."""
    beams, elevation = make_beams("jinc", 4), elevation_at([0.1])
    truth = draw_truth(np.random.default_rng(11), 4, width=1.0)
    bright = 1e3 * beams_with(beams, truth).response(elevation, 0.0)
    found = calibrate_on_target(bright, beams, elevation, np.zeros(1), 1.0)
    assert found.gains == pytest.approx(truth.gains, abs=1e-5)
    assert found.width_factor == 1
    assert np.isnan(found.width_sigma)
    with pytest.raises(NotDetermined):
        calibrate_on_target(1e-3 * bright, beams, elevation, np.zeros(1), 1.0)


def sensor_with(sensor: Sensor, calibration: BeamCalibration) -> Sensor:
    """The sensor with beams of that width, and the gains in its channel matrix."""
    matrix = tuple(map(tuple, (calibration.gains[:, None] * sensor.mixing).tolist()))
    return replace(sensor.widened(calibration.width_factor), channel_matrix=matrix)


@pytest.mark.parametrize("kind", ["jinc", "table"])
def test_sensor_has_the_beams(kind: str) -> None:
    truth = draw_truth(np.random.default_rng(12), 3)
    sensor = make_sensor()
    if kind == "table":
        angles = np.linspace(-3, 3, 61) * BEAMWIDTH
        table = sample_pattern(pattern_named("jinc"), angles, angles, sensor.beamwidth)
        sensor = make_sensor(pattern="table", beam_tables=(table,))
    changed = sensor_with(sensor, truth)
    made = changed.beams.combined(changed.mixing)
    elevation, squint = elevation_at(np.linspace(-1, 1, 9)), 0.2 * BEAMWIDTH
    assert made.response(elevation, squint) == pytest.approx(
        beams_with(sensor.beams, truth).response(elevation, squint), abs=1e-9
    )
    offset = (elevation[0] - sensor.elevation_boresights[0]) / (1.05 * sensor.beamwidth)
    direct = truth.gains[0] * pattern_named("jinc").amplitude(offset, 0.2 * BEAMWIDTH / (1.05 * sensor.beamwidth))
    assert made.response(elevation[0], squint)[0] == pytest.approx(direct, abs=1e-3 if kind == "table" else 1e-9)


def test_nothing_is_left_to_calibrate() -> None:
    """Channels of unequal noise, made as the height nodes make them: once with the sensor as described, once corrected.

    The first time something is wrong by 20 standard deviations or more, the second nothing by a tenth of one.
    """
    rng, count = np.random.default_rng(14), 6
    steps = (np.arange(count) - 2.5) / 2
    described = make_sensor(
        elevation_boresights=tuple(elevation_at(steps).tolist()),
        noise_power=tuple(np.linspace(1, 2, count).tolist()),
        channel_matrix=tuple(map(tuple, np.diag(np.exp(2j * steps)).tolist())),
    )
    actual = sensor_with(described, draw_truth(rng, count))
    first, last = described.beams.span
    target = np.repeat(rng.uniform(first, last, 12_000), 4)
    seen = 6 * circular(rng, (48_000, 1)) * actual.beams.combined(actual.mixing).response(target, 0.0)
    noise = np.sqrt(described.noise_power) * circular(rng, (48_000, count))
    slc = (seen + noise).reshape(120, 400, count).transpose(2, 0, 1).astype(np.complex64)

    def calibrated(sensor: Sensor) -> BeamCalibration:
        channels = whitened_channels(sensor.noise_covariance, sensor.mixing)
        looks = multilook(slc, 1, 4, True, channels.transform, noise_power=channels.noise_powers)
        beams = sensor.beams.combined(channels.matrix)
        return calibrate_beams(looks, beams)

    found = calibrated(described)
    left = calibrated(sensor_with(described, found))
    for result, least, most in ((found, 20.0, np.inf), (left, 0.0, 0.1)):
        worst = np.max(np.abs(errors(result, BeamCalibration.as_described(count))) / sigmas(result))
        assert least <= worst <= most
    again = sensor_with(described, found)
    assert again.elevation_diameter == pytest.approx(actual.elevation_diameter, rel=0.003)
    relative = np.diag(again.mixing / np.where(np.eye(count) > 0, actual.mixing, 1))
    assert relative == pytest.approx(np.ones(count), abs=0.02)
