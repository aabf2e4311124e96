"""A sensor whose channels are made of its detectors, from its frames to heights, and what cannot be taken apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from chain_fixture import DETECTORS, Chain, next_dwell_is_exact, same_heights
from helpers import assert_one_sentence
from scipy.linalg import dft

from sal_height import messages
from sal_height.messages.types import HeightImage
from sal_height.nodes.transport.graph import Graph
from sal_height.simulation.flight import SimulatedFlight

BUTLER = dft(DETECTORS, scale="sqrtn")
"""A lossless network that makes all channels of all detectors."""


def flown_with(flight: SimulatedFlight, matrix: np.ndarray, in_antenna: bool) -> SimulatedFlight:
    """The same flight with channels made by `matrix`."""
    rows = tuple(tuple(row) for row in matrix.astype(complex).tolist())
    sensor = replace(flight.sensor, channel_matrix=rows, matrix_in_antenna=in_antenna, config_hash="")
    return SimulatedFlight(flight.preset, sensor, flight.scene, flight.dwells, flight.seed)


def seen(chain: Chain) -> Mapping[tuple[str, int], HeightImage]:
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    return chain.heights


def compared(ours: HeightImage, theirs: HeightImage) -> np.ndarray:
    """Differences of height (m) where both images have one, in most of the pixels of theirs."""
    heights, expected = np.array(ours.surfaces[0].height), np.array(theirs.surfaces[0].height)
    both = np.isfinite(heights) & np.isfinite(expected)
    assert both.sum() > 0.8 * np.isfinite(expected).sum() > 0
    return (heights - expected)[both]


def lossy() -> np.ndarray:
    """Sum and difference of every two neighbours, 1 dB lost of the upper one and of the difference."""
    loss = np.diag([1, 10 ** (-1 / 20)])
    return np.kron(np.eye(DETECTORS // 2), loss @ [[1, 1], [-1, 1]] @ loss) / np.sqrt(2)


@pytest.mark.parametrize("network", [BUTLER, lossy()], ids=["Butler", "lossy"])
def test_any_network_behind_the_receivers_gives_the_same_heights(
    graph: Graph, flight: SimulatedFlight, reference: Any, network: np.ndarray
) -> None:
    heights = seen(Chain(graph, flown_with(flight, network, in_antenna=False), missing_after_s=30.0))
    for estimator in ("ml", "monopulse"):
        assert np.array_equal(heights[estimator, 0].validity, reference[estimator, 0].validity)
        np.testing.assert_allclose(compared(heights[estimator, 0], reference[estimator, 0]), 0, atol=1e-3)


def test_the_same_network_in_the_antenna_changes_the_noise_alone(
    graph: Graph, flight: SimulatedFlight, reference: Any
) -> None:
    """Two independent errors: the median magnitude of their difference is .95 sigma."""
    heights = seen(Chain(graph, flown_with(flight, BUTLER, in_antenna=True), missing_after_s=30.0))
    for estimator in ("ml", "monopulse"):
        difference = compared(heights[estimator, 0], reference[estimator, 0])
        sigma = np.nanmedian(np.array(reference[estimator, 0].surfaces[0].sigma))
        assert np.median(np.abs(difference)) < 1.3 * sigma


def constants() -> np.ndarray:
    """Complex gains of the detectors that spread by 1 dB and 30 degrees."""
    rng = np.random.default_rng(3)
    return 10 ** (rng.normal(0, 1, DETECTORS) / 20) * np.exp(1j * np.radians(rng.normal(0, 30, DETECTORS)))


def test_calibration_constants_change_nothing_when_described(
    graph: Graph, flight: SimulatedFlight, reference: Any
) -> None:
    heights = seen(Chain(graph, flown_with(flight, np.diag(constants()), in_antenna=False), missing_after_s=30.0))
    for estimator in ("ml", "monopulse"):
        np.testing.assert_allclose(compared(heights[estimator, 0], reference[estimator, 0]), 0, atol=1e-3)


def test_calibration_constants_spoil_heights_when_not_described(chain: Chain, reference: Any) -> None:
    frames = chain.frames(0)
    for frame, gain in zip(frames, constants(), strict=True):
        samples = np.frombuffer(frame.samples, np.complex64) * np.complex64(gain)
        frame.samples = messages.to_bytes(samples.view(np.uint8))
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    chain.await_heights(0)
    valid = [
        np.count_nonzero(np.isfinite(np.array(images["ml", 0].surfaces[0].height)))
        for images in (chain.heights, reference)
    ]
    assert valid[0] < 0.7 * valid[1]  # some of the others pass for extended surfaces


def test_a_network_that_is_not_lossless_leaves_pairs_out_and_names_another_way(
    graph: Graph, flight: SimulatedFlight, reference: Any
) -> None:
    chain = Chain(graph, flown_with(flight, lossy(), in_antenna=True), missing_after_s=30.0)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_drops("monopulse", "mixed channels", DETECTORS)
    assert_one_sentence(
        chain.stages["monopulse"].last_rejection.partition(": ")[2], "ml_height", "sum_difference_height"
    )
    chain.wait(lambda: ("ml", 0) in chain.heights, "the heights")
    difference = compared(chain.heights["ml", 0], reference["ml", 0])
    assert np.median(np.abs(difference)) < 1.3 * np.nanmedian(np.array(reference["ml", 0].surfaces[0].sigma))


def test_a_dead_channel_of_a_mixture_leaves_no_detectors(graph: Graph, flight: SimulatedFlight) -> None:
    chain = Chain(graph, flown_with(flight, BUTLER, in_antenna=True), missing_after_s=30.0)
    frames = chain.frames(0)
    frames[3].samples = messages.to_bytes(np.zeros(len(frames[3].samples), np.uint8))
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    for stage in ("monopulse", "ml_height"):
        chain.await_drops(stage, "dead channels", DETECTORS)
        assert_one_sentence(chain.stages[stage].last_rejection.partition(": ")[2], "Channels [3]")


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(DETECTORS, dtype=complex).ravel()[:-1].view(float),
        np.eye(DETECTORS, dtype=complex).ravel().view(float)[:-1],
        np.ones(DETECTORS**2, dtype=complex).view(float),
        np.full(2 * DETECTORS**2, np.nan),
    ],
    ids=["short", "odd", "singular", "NaN"],
)
def test_a_matrix_that_cannot_be_used_leaves_the_good_description_in_force(
    chain: Chain, reference: Any, matrix: np.ndarray
) -> None:
    useless = chain.sensor_info()
    useless.channels.matrix = matrix.tolist()
    chain.publish(useless)
    for stage in chain.stages:
        chain.wait(lambda s=stage: chain.accounts()[s].get("ignored.sensor info") == 1, "the count")
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    assert same_heights(chain.heights["ml", 0], reference["ml", 0])
    next_dwell_is_exact(chain, reference)
