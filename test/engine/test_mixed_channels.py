"""A sensor whose channels are made of its detectors, from its frames to heights, and what cannot be taken apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chained import DETECTORS, Chained, heights_of, reference
from flown_items import SENSOR_INFO, Item, frame_items, odometry_items, small_flight
from helpers import assert_one_sentence
from scipy.linalg import dft

from sal_height.engine.frame_items import samples_of
from sal_height.engine.height_items import Heights
from sal_height.simulation import SimulatedFlight

BUTLER = dft(DETECTORS, scale="sqrtn")
"""A lossless network that makes all channels of all detectors."""


def flown_with(matrix: np.ndarray, *, in_antenna: bool) -> SimulatedFlight:
    """The small flight with channels made by `matrix`."""
    rows = tuple(tuple(row) for row in matrix.astype(complex).tolist())
    flight = small_flight()
    sensor = replace(flight.sensor, channel_matrix=rows, matrix_in_antenna=in_antenna, config_hash="")
    return SimulatedFlight(flight.preset, sensor, flight.scene, flight.dwells, flight.seed)


def compared(ours: Heights, theirs: Heights) -> np.ndarray:
    """Differences of height (m) where both images have one, in most of the pixels of theirs."""
    heights, expected = ours.surfaces[0].height, theirs.surfaces[0].height
    both = np.isfinite(heights) & np.isfinite(expected)
    assert both.sum() > 0.8 * np.isfinite(expected).sum() > 0
    return (heights - expected)[both]


def lossy() -> np.ndarray:
    """Sum and difference of every two neighbours, 1 dB lost of the upper one and of the difference."""
    loss = np.diag([1, 10 ** (-1 / 20)])
    return np.kron(np.eye(DETECTORS // 2), loss @ [[1, 1], [-1, 1]] @ loss) / np.sqrt(2)


def constants() -> np.ndarray:
    """Complex gains of the detectors that spread by 1 dB and 30 degrees."""
    rng = np.random.default_rng(3)
    return 10 ** (rng.normal(0, 1, DETECTORS) / 20) * np.exp(1j * np.radians(rng.normal(0, 30, DETECTORS)))


def with_gains(gains: np.ndarray, flight: SimulatedFlight) -> Chained:
    """The first dwell of a flight with other gains of the channels."""
    frames: list[Item] = []
    for port, frame in frame_items(flight, 0):
        samples = (samples_of(frame) * np.complex64(gains[frame.channel])).astype(np.complex64)
        frames.append((port, frame._replace(samples=samples.reshape(-1).view(np.uint8))))
    return Chained().feed([(SENSOR_INFO, flight.sensor), *odometry_items(flight, 0), *frames])


@pytest.mark.parametrize("network", [BUTLER, lossy()], ids=["Butler", "lossy"])
def test_any_network_behind_the_receivers_gives_the_same_heights(network: np.ndarray) -> None:
    heights = heights_of(flown_with(network, in_antenna=False)).heights
    for estimator in ("ml", "monopulse"):
        assert np.array_equal(heights[estimator, 0].validity, reference()[estimator, 0].validity)
        np.testing.assert_allclose(compared(heights[estimator, 0], reference()[estimator, 0]), 0, atol=1e-3)


def test_the_same_network_in_the_antenna_changes_the_noise_alone() -> None:
    """Two independent errors: the median magnitude of their difference is .95 sigma."""
    heights = heights_of(flown_with(BUTLER, in_antenna=True)).heights
    for estimator in ("ml", "monopulse"):
        difference = compared(heights[estimator, 0], reference()[estimator, 0])
        sigma = np.nanmedian(reference()[estimator, 0].surfaces[0].sigma)
        assert np.median(np.abs(difference)) < 1.3 * sigma


def test_calibration_constants_change_nothing_when_described() -> None:
    heights = heights_of(flown_with(np.diag(constants()), in_antenna=False)).heights
    for estimator in ("ml", "monopulse"):
        np.testing.assert_allclose(compared(heights[estimator, 0], reference()[estimator, 0]), 0, atol=1e-3)


def test_calibration_constants_spoil_heights_when_not_described() -> None:
    chained = with_gains(constants(), small_flight())
    valid = [
        np.count_nonzero(np.isfinite(images["ml", 0].surfaces[0].height)) for images in (chained.heights, reference())
    ]
    assert valid[0] < 0.7 * valid[1]  # some of the others pass for extended surfaces


def test_a_network_that_is_not_lossless_leaves_pairs_out_and_names_another_way() -> None:
    chained = heights_of(flown_with(lossy(), in_antenna=True))
    assert chained.lost("monopulse") == {"mixed channels": DETECTORS}
    assert_one_sentence(chained.hosts["monopulse"].last_drop, "ml_height", "sum_difference_height")
    difference = compared(chained.heights["ml", 0], reference()["ml", 0])
    assert np.median(np.abs(difference)) < 1.3 * np.nanmedian(reference()["ml", 0].surfaces[0].sigma)


def test_a_dead_channel_of_a_mixture_leaves_no_detectors() -> None:
    gains = np.ones(DETECTORS)
    gains[3] = 0
    chained = with_gains(gains, flown_with(BUTLER, in_antenna=True))
    for stage in ("monopulse", "ml_height"):
        assert chained.lost(stage) == {"dead channels": DETECTORS}
        assert_one_sentence(chained.hosts[stage].last_drop, "Channels [3]")
