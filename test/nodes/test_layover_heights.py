"""Layover through the nodes: ground and a roof in one pixel, at the same range, both with their height."""

from __future__ import annotations

import numpy as np
import pytest
from chain_fixture import StageChain

from sal_height import messages
from sal_height.messages.types import HeightImage
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scene import Scene

ROOF = 0.7
"""Height of the roof, m: 1.28 beamwidths above ground of the same range."""

EDGE = -0.4
"""Where it begins, m north: seen from the north it lies over the ground from there to 0.7 m before it."""


@pytest.fixture(scope="module")
def roofed() -> SimulatedFlight:
    """A flight past a roof whose wall is dark."""
    nodes = np.arange(-400, 401) * 0.02
    height = np.where(nodes[:, None] < EDGE, ROOF, 0.0) * np.ones(len(nodes))
    dark = np.abs(nodes[:, None] - EDGE) < 0.03
    scene = Scene("roof", nodes, nodes, height, np.where(dark, 0.0, 1.0) * np.ones(len(nodes)))
    preset = load_preset("small")
    return SimulatedFlight(preset, preset.make_sensor(), scene, 2, seed=3)


@pytest.mark.parametrize("layover", [True, False])
def test_ground_and_roof_have_their_heights(roofed: SimulatedFlight, layover: bool) -> None:
    """34 pixels of four looks: their means have the standard errors that the spread shows, 5 and 7 mm."""
    chain = StageChain(roofed, own={"ml": {"layover": layover}})
    chain.publish(chain.sensor_info())
    heights, sigmas = [], []
    for dwell in range(roofed.dwells):
        chain.publish(*chain.odometry(dwell), *chain.frames(dwell))
        chain.await_heights(dwell)
        image = chain.heights["ml", dwell]
        assert messages.stages_of(image.provenance.parameters)["ml_height"]["layover"] is layover
        two = np.array(image.validity) == HeightImage.TWO_SCATTERERS
        if not layover:
            assert not two.any()
            assert len(image.surfaces) == 1
            continue
        assert np.count_nonzero(two) > 12
        both, sigma = (
            np.stack([np.array(getattr(surface, name)) for surface in image.surfaces[:2]], axis=-1)
            for name in ("height", "sigma")
        )
        assert np.isfinite(both[two, 1]).all()
        order = np.argsort(both[two], axis=-1)  # ground first
        heights.append(np.take_along_axis(both[two], order, axis=-1))
        sigmas.append(np.take_along_axis(sigma[two], order, axis=-1))
    if layover:
        error = np.concatenate(heights) - [0.0, ROOF]
        assert np.all(np.abs(error.mean(axis=0)) < 4 * error.std(axis=0) / np.sqrt(len(error)))
        assert np.all(np.std(error / np.concatenate(sigmas), axis=0) < 2)  # four looks: tails beyond the bound's
