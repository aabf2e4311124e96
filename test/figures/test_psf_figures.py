"""Figures of the PSF paper: a wrong theory is noticed, what the figures show, and the closed forms themselves.

That theory holds at every point is tried with all other figures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import circular, few
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.signal import windows

from sal_height.figures import psf_point_targets as psf
from sal_height.figures import psf_speckle
from sal_height.figures.curve import Curve, check_of, holds, rows_of
from sal_height.figures.psf_estimators import generators
from sal_height.figures.psf_point_targets import PSF_FIGURES
from sal_height.figures.psf_theory import (
    azimuth_psf,
    chip_transform,
    cosine_beam,
    range_psf,
    relative_variance,
    swung_modulus,
    taylor_coefficients,
    through_fejer,
    tied,
)
from sal_height.figures.synthetic_tape import RangeFault
from sal_height.numeric.transforms import frequencies
from sal_height.response.impulse import OVERSAMPLING, cut_response
from sal_height.response.linearity import superposition
from sal_height.response.point_spread import cut_through
from sal_height.response.transfer_function import centred

TRIALS, SEED = 1000, 1


def failed(curves: Iterator[Curve]) -> list[dict[str, Any]]:
    checks = [check_of(row) for curve in curves for row in rows_of("figure", curve)]
    return [check for check in checks if check is not None and not holds(check)]


def is_noticed(name: str) -> bool:
    """Whether a curve of a figure is off; the first is enough."""
    return any(failed(iter([curve])) for curve in PSF_FIGURES[name].curves(TRIALS, SEED))


@pytest.mark.parametrize(
    ("name", "module", "theory", "wrong"),
    few(
        3,
        [
            ("psf_range", psf, "range_psf", lambda place, fault: psf.taylor_psf(place, fault) + 0j),
            ("psf_recovery", psf, "relative_variance", lambda *given: 2 * relative_variance(*given)),
            ("psf_superposition", psf_speckle, "through_fejer", lambda power, size: power[:: len(power) // size]),
            ("psf_azimuth", psf, "azimuth_psf", lambda place, fault: azimuth_psf(place, replace(fault, quartic=1.65))),
            (
                "psf_cut",
                psf,
                "range_psf",
                lambda place, fault: range_psf(place, RangeFault(sawtooth=fault.sawtooth / 2)),
            ),
            ("psf_recovery", psf, "tied", lambda response: (np.full(len(response), 0.7),) * 2),
            ("psf_speckle", psf_speckle, "through_fejer", lambda power, size: power[:: len(power) // size]),
            ("psf_speckle", psf_speckle, "cosine_beam", lambda size: 1 + 0.9 * np.cos(2 * np.pi * frequencies(size))),
            ("psf_speckle", psf_speckle, "swung_modulus", lambda size, _swing: np.sqrt(cosine_beam(size))),
            ("psf_superposition", psf_speckle, "chip_transform", lambda chip: 1 + chip_transform(chip)),
        ],
    ),
)
def test_a_wrong_closed_form_is_noticed(
    name: str, module: Any, theory: str, wrong: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No sawtooth; a factor; no Fejer kernel; 10 % of a phase; half a depth; no swing; a target's response lifted."""
    monkeypatch.setattr(psf, "DEPTHS", np.array([psf.CUT_DEPTH]))
    monkeypatch.setattr(psf_speckle, "NOISES", np.array([psf_speckle.SHOWN_NOISE]))
    monkeypatch.setattr(module, theory, wrong)
    assert is_noticed(name)


def test_p_values_that_are_too_small_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A test that takes a linear system for one that is not, far too often."""
    monkeypatch.setattr(psf_speckle, "NOISES", np.array([psf_speckle.SHOWN_NOISE]))
    monkeypatch.setattr(psf_speckle, "superposition", lambda *given: replace(superposition(*given), p_value=0.01))
    assert is_noticed("psf_superposition")


def test_a_wrong_pointing_is_noticed() -> None:
    """By 0.02 of the band, 5 of its standard errors."""
    pointing = next(PSF_FIGURES["psf_speckle"].curves(TRIALS, SEED))
    wrong = Curve("p", "c", pointing.x, pointing.value, pointing.standard_error, pointing.closed_form + 0.02)
    assert len(failed(iter([wrong]))) >= 6


def test_taylor_weights_are_those_of_scipy() -> None:
    """Of its window, which is sampled in the middle of 4097 steps."""
    place = (np.arange(4097) - 2048) / 4097
    order = np.arange(1, 5)
    weights = 1 + 2 * taylor_coefficients(35.0, 5) @ np.cos(2 * np.pi * np.outer(order, place))
    assert_allclose(weights / weights.max(), windows.taylor(4097, nbar=5, sll=35.0, norm=True), rtol=1e-12)


def test_closed_form_of_the_echoes_is_the_transform_of_the_sawtooth() -> None:
    """Of 10 001 frequencies, so that neither teeth nor ends of the band fall on one."""
    fault, place = RangeFault(), np.linspace(-40, 40, 161)
    response = fault.response(10_001)
    waves = np.exp(2j * np.pi * np.outer(place, frequencies(10_001)))
    assert_allclose(range_psf(place, fault), waves @ response / response.sum(), atol=3e-4)


def test_fejers_kernel_is_the_triangle_over_lags() -> None:
    """Of one wave's spectrum, and of a cosine's."""
    power = 1 + np.cos(2 * np.pi * frequencies(512))
    assert_allclose(through_fejer(power, 64), cosine_beam(64), atol=1e-12)
    assert_allclose(swung_modulus(64, 0.0), np.sqrt(cosine_beam(64)), atol=1e-12)


def test_the_errors_of_a_tied_response_are_those_of_a_draw() -> None:
    """6000 draws; standard error of a variance 1.8 %."""
    rng = np.random.default_rng(3)
    response = RangeFault().response(64)
    response = response / response.mean()
    relative = 0.003 * circular(rng, (6000, 64))
    made = np.stack([centred(response * (1 + one)) for one in relative])
    band = np.abs(response) > 0.4
    modulus, phase = tied(response)
    error = made[:, band] / response[band]
    assert_allclose(np.var(np.abs(error), axis=0) / 0.003**2, modulus[band], rtol=0.08)
    assert_allclose(np.var(np.angle(error), axis=0) / 0.003**2, phase[band], rtol=0.08)


def test_tapes_are_as_many_as_trials_ask_for_within_limits() -> None:
    assert [len(generators(trials, 1, 1)) for trials in (100, 20_000, 1_000_000)] == [4, 20, 40]
    first, other = (generators(100, 1, figure)[0].uniform() for figure in (1, 2))
    assert first != other


def test_the_widths_of_the_tape_are_those_the_docs_tell() -> None:
    """Half power of the closed form, 2.71 and 1.23 pixels; with no sawtooth range is as wide within 1 %."""
    range_response, azimuth_response = (
        chip_transform(made)
        for made in (range_psf(psf.PIXELS, psf.RANGE), azimuth_psf(psf.PIXELS, replace(psf.AZIMUTH, quartic=0.0)))
    )
    for response, closed_form, width in (
        (range_response, lambda x: np.abs(range_psf(x, psf.RANGE)), 2.71),
        (azimuth_response, lambda x: np.abs(azimuth_psf(x, replace(psf.AZIMUTH, quartic=0.0))), 1.19),
    ):
        half = brentq(lambda x, of=closed_form: of(np.array(x)) ** 2 - 0.5, 0.1, 3)
        fine = np.abs(cut_through(response, OVERSAMPLING)) ** 2
        assert cut_response(fine, len(fine) // 2).width == pytest.approx(2 * half, rel=0.005)
        assert 2 * half == pytest.approx(width, abs=0.01)
    plain = brentq(lambda x: np.abs(range_psf(np.array(x), RangeFault(sawtooth=0.0))) ** 2 - 0.5, 0.1, 3)
    assert 2 * plain == pytest.approx(2.71, rel=0.01)
