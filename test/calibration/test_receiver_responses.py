"""Receivers that differ are found by the cross-spectra of what all of them see."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from sal_height.calibration.receiver_responses import (
    CrossSpectra,
    _information,
    differential_response,
    remove_range_phase,
)
from sal_height.errors import NotDetermined
from sal_height.geometry.trajectory import Trajectory
from sal_height.imaging.focus import ImageSettings, focus_dwell
from sal_height.simulation.flight import flight_of
from sal_height.simulation.preset import load_preset

CHANNELS, COUNT = 5, 64
DWELLS = 12
GRID = (np.arange(COUNT) - COUNT // 2) / COUNT


def coherent(scale: float = 10.0) -> np.ndarray:
    """Covariance of the signals of channels whose beams overlap."""
    apart = np.subtract.outer(np.arange(CHANNELS), np.arange(CHANNELS))
    return scale * np.exp(-(apart**2) / 4) * np.exp(0.3j * apart)


def drawn(response: np.ndarray, columns: int, rng: np.random.Generator, noise: float = 1.0) -> CrossSpectra:
    """Cross-spectra of `columns` columns of speckle behind receivers of that response, (frequencies, channels)."""

    def circular() -> np.ndarray:
        parts = rng.standard_normal((2, COUNT, CHANNELS, columns))
        return (parts[0] + 1j * parts[1]) / np.sqrt(2)

    seen = response[:, :, None] * (np.linalg.cholesky(coherent()) @ circular()) + np.sqrt(noise) * circular()
    return CrossSpectra(seen @ seen.conj().transpose(0, 2, 1), noise * columns * np.eye(CHANNELS), columns)


class Found(NamedTuple):
    """What `differential_response` returns."""

    response: np.ndarray
    sigma: np.ndarray


def estimate(spectra: CrossSpectra, echo_significance: float = 3.5) -> Found:
    return Found(*differential_response(spectra, echo_significance))


def echoes_of(found: Found) -> np.ndarray:
    """Number of lags of each channel that the response is made of, shape (channels,)."""
    return np.count_nonzero(np.abs(np.fft.ifft(np.log(found.response), axis=1)) > 1e-9, axis=1)


def one_channel(of_it: np.ndarray) -> np.ndarray:
    response = np.ones((COUNT, CHANNELS), dtype=complex)
    response[:, 1] = of_it
    return response


def sawtooth(depth: float = 0.1, teeth: int = 8) -> np.ndarray:
    """Its mean over the band, in dB, is 0."""
    phase = teeth * GRID
    amplitude = 1 + 2 * depth * (phase - np.floor(phase + 0.5))
    return amplitude / np.exp(np.mean(np.log(amplitude)))


@pytest.mark.parametrize("fault", [sawtooth(), np.exp(0.2j * np.cos(2 * np.pi * 3 * GRID))], ids=["amplitude", "phase"])
def test_one_receiver_that_differs_is_found_and_no_other(fault: np.ndarray) -> None:
    """Its error is that of the lags that are kept, sigma sqrt(kept / lags): chi-square of 2 kept, 5 sigma."""
    found = estimate(drawn(one_channel(fault), 3000, np.random.default_rng(1)))
    error = np.sqrt(np.mean(np.abs(found.response[1] - fault) ** 2))
    kept = echoes_of(found)[1]
    assert 2 <= kept <= 9
    assert error < found.sigma[1] * np.sqrt(kept / COUNT) * (1 + 5 / np.sqrt(2 * 2 * kept)) + 0.001
    assert np.all(echoes_of(found)[[0, 2, 3, 4]] == 0)
    np.testing.assert_array_equal(found.response[[0, 2, 3, 4]], 1)


def test_sigma_is_the_spread_of_single_frequencies(monkeypatch: pytest.MonkeyPatch) -> None:
    """All lags kept: 30 trials of 64 frequencies, standard error of the rms 1.2 %; the bound is first order in it."""
    monkeypatch.setattr("sal_height.calibration.receiver_responses._beyond_median", lambda echoes: echoes)
    rng = np.random.default_rng(2)
    found = [estimate(drawn(np.ones((COUNT, CHANNELS)), 400, rng), 0.0) for _ in range(30)]
    spread = np.sqrt(np.mean([np.abs(np.log(one.response)) ** 2 for one in found], axis=(0, 2)))
    np.testing.assert_allclose(spread / np.mean([one.sigma for one in found], axis=0), 1, atol=0.06)


def test_speckle_alone_makes_no_response() -> None:
    rng = np.random.default_rng(3)
    found = [estimate(drawn(np.ones((COUNT, CHANNELS)), 200, rng)) for _ in range(40)]
    assert sum(int(echoes_of(one).sum()) for one in found) <= 2


def test_what_all_receivers_share_is_not_theirs_to_tell() -> None:
    found = estimate(drawn(np.tile(sawtooth()[:, None], CHANNELS), 3000, np.random.default_rng(4)))
    assert not echoes_of(found).any()


def test_what_cannot_be_told_is_said() -> None:
    rng = np.random.default_rng(5)
    with pytest.raises(NotDetermined, match="There are 8 columns of images; responses of 5 channels need 10 or more"):
        estimate(drawn(np.ones((COUNT, CHANNELS)), 8, rng))
    dark = np.ones((COUNT, CHANNELS))
    dark[:, 3] = 1e-6
    for seed in range(4):  # power less noise is as often above 0 as below
        with pytest.raises(NotDetermined, match=r"power of channels \[3\] is not above their noise"):
            estimate(drawn(dark, 200, np.random.default_rng(seed)))


def test_spectra_of_images_are_those_of_the_frames() -> None:
    """A receiver that differs in the phase history is found in the images, at its frequencies."""
    flight = flight_of(replace(load_preset("small"), dwells=DWELLS), seed=1)
    sensor = flight.sensor
    phase = 8 * (np.arange(sensor.sample_count) - (sensor.sample_count - 1) / 2) / sensor.sample_count
    fault = np.exp(0.5j * np.sin(2 * np.pi * phase))
    track = Trajectory([state for dwell in range(DWELLS) for state in flight.platform_states(dwell)])
    shape = sensor.detector_count, sensor.detector_count
    spectra = CrossSpectra(np.zeros((sensor.sample_count, *shape), complex), np.zeros(shape, complex), 0)
    for dwell in range(DWELLS):
        history = flight.phase_history(dwell)
        samples = history.samples.copy()
        samples[3] *= fault.astype(np.complex64)
        history = replace(history, samples=samples)
        slc = focus_dwell(
            history,
            track,
            sensor,
            ImageSettings(air="none", range_window="rectangular", azimuth_window="rectangular", cols=12),
        )
        spectra.add(remove_range_phase(slc, sensor), sensor, slc.noise_power)
    found = estimate(spectra)
    assert echoes_of(found)[3] >= 2
    assert echoes_of(found)[[0, 1, 2, 4, 5, 6, 7]].sum() <= 1
    assert np.sqrt(np.mean(np.abs(found.response[3] - fault) ** 2)) < 0.15 * 0.5 / np.sqrt(2)


def test_weighted_images_are_refused() -> None:
    flight = flight_of(load_preset("small"), seed=1)
    track = Trajectory(flight.platform_states(0))
    slc = focus_dwell(flight.phase_history(0), track, flight.sensor, ImageSettings(air="none", cols=12))
    with pytest.raises(NotDetermined, match="range_window rectangular in the slant plane"):
        remove_range_phase(slc, flight.sensor)


def test_information_is_that_of_the_wishart_distribution() -> None:
    """tr(A dS A dS'), with derivatives of the covariance by differences."""
    signal = coherent()
    weight = np.linalg.inv(signal + np.diag([1.0, 2.0, 1.0, 0.5, 1.0]))

    def covariance(logarithms: np.ndarray) -> np.ndarray:
        response = np.exp(logarithms[:CHANNELS] + 1j * logarithms[CHANNELS:])
        return response[:, None] * signal * response.conj()

    steps = 1e-6 * np.eye(2 * CHANNELS)
    slopes = [(covariance(step) - covariance(-step)) / 2e-6 for step in steps]
    expected = [[np.trace(weight @ one @ weight @ other).real for other in slopes] for one in slopes]
    np.testing.assert_allclose(_information(signal, weight), expected, rtol=1e-6, atol=1e-8)
