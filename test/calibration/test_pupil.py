"""Aberrations of the pupil from scenes: found with their errors, and heights as if they were not there."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, circular, few, make_beams, refused

from sal_height.beams.array import Beams
from sal_height.beams.pupil import ZERNIKE
from sal_height.calibration.calibration import CalibrationSettings
from sal_height.calibration.pupil import calibrate_pupil
from sal_height.elevation.array.estimate import Validity
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.looks.looks import Looks, covariance
from sal_height.errors import NotDetermined

ROWS, COLS, COUNT = 110, 8, 4
SETTINGS = CalibrationSettings(pupil_prior_waves=0.1)
SQUINTS = np.linspace(-0.5, 0.5, COLS) * BEAMWIDTH


def only(name: str, waves: float) -> tuple[float, ...]:
    return tuple(waves * (term == name) for term in ZERNIKE)


def draw(rng: np.random.Generator, beams: Beams, cnr: float, squint: np.ndarray) -> tuple[Looks, np.ndarray]:
    """Speckle at elevations spread over the array; the looks, and the elevations (rows, cols)."""
    elevation = rng.uniform(*beams.span, (ROWS, COLS))
    response = beams.response(elevation, squint)
    field = np.sqrt(cnr) * circular(rng, (ROWS, COLS, COUNT, 1)) * response[:, :, None]
    samples = (field + circular(rng, (ROWS, COLS, COUNT, beams.count))).astype(np.complex64)
    pixels = covariance(samples.reshape(-1, COUNT, beams.count), True)
    return Looks.of(pixels.reshape(ROWS, COLS, beams.count, beams.count), COUNT, squint), elevation


@pytest.mark.parametrize("name", few(1, ["defocus", "coma"]))
def test_heights_are_as_without_aberrations(name: str) -> None:
    """.07 waves rms, 880 pixels of 20 dB: standard errors of the shares .006 and .016."""
    rng, described = np.random.default_rng(5), make_beams("jinc", 16)
    true = described.aberrated(only(name, 0.07))
    found = calibrate_pupil(draw(rng, true, 100.0, SQUINTS)[0], described, SETTINGS)
    assert np.max(np.abs(found.coefficients - only(name, 0.07)) / found.sigma) < 4
    assert np.max(found.sigma) < 0.01
    assert found.misfit == pytest.approx(1, abs=0.01)
    assert found.p_value > 0.001
    looks, elevation = draw(rng, true, 100.0, SQUINTS)
    measured = described.aberrated(tuple(found.coefficients)).widened(found.width_factor).scaled(found.gains)
    before, after = (ml_elevation(looks, beams, MlSettings()) for beams in (described, measured))
    valid = after.validity == Validity.OK
    assert np.mean(valid) > 0.97
    assert np.mean(valid) > np.mean(before.validity == Validity.OK) + 0.2
    error = ((after.elevation - elevation) / after.sigma)[valid]
    assert np.mean(np.abs(error) < 1) == pytest.approx(0.683, abs=0.05)
    assert abs(np.mean(error)) < 0.1


def test_one_squint_leaves_terms_that_it_does_not_show_at_their_prior() -> None:
    rng, described = np.random.default_rng(6), make_beams("jinc", 8)
    true = described.aberrated(only("coma", 0.05))
    found = calibrate_pupil(draw(rng, true, 100.0, np.zeros(COLS))[0], described, SETTINGS)
    known = dict(zip(ZERNIKE, found.sigma, strict=True))
    assert known["oblique_astigmatism"] == pytest.approx(0.1, rel=0.01)
    assert known["coma_beside"] == pytest.approx(0.1, rel=0.01)
    assert known["coma"] < 0.002
    assert found.coefficients[list(ZERNIKE).index("coma")] == pytest.approx(0.05, abs=4 * known["coma"])


def test_what_does_not_determine_the_pupil_is_refused() -> None:
    rng = np.random.default_rng(7)
    pair, eight = make_beams("jinc", 2), make_beams("jinc", 8)
    with refused(NotDetermined, "three"):
        calibrate_pupil(draw(rng, pair, 100.0, SQUINTS)[0], pair, SETTINGS)
    with refused(NotDetermined, "mix detectors"):
        calibrate_pupil(draw(rng, eight, 100.0, SQUINTS)[0], eight.combined(np.eye(8) + np.eye(8, k=1)), SETTINGS)
    with refused(NotDetermined, "needs"):
        calibrate_pupil(draw(rng, eight, 1e-3, SQUINTS)[0], eight, SETTINGS)
