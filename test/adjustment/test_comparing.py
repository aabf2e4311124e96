"""Which chains are compared with each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sal_height.adjustment import UNKNOWN_GROUND, AdjustmentSettings, ObservedDwell, Stated
from sal_height.adjustment.comparing import ROUGH_POINTS, Chain, compared, joined, whole
from sal_height.adjustment.matching import Match
from sal_height.adjustment.network import Comparison, Network
from sal_height.imaging import Placement
from sal_height.rehearsal import made_up_heights
from sal_height.simulation import load_preset

SETTINGS = AdjustmentSettings(boresight_sigma_rad=0.0, lever_arm_sigma_m=0.0, strip_dwells=1)


def compared_after(seconds: float, *, sliding: bool, of: Callable[[Match], Match] = whole) -> list[Comparison]:
    """Comparisons of two images of level ground, one so long after the other."""
    sensor = load_preset("sal_stripmap").make_sensor()
    network = Network(sensor.mounting, SETTINGS)
    for time in (0.0, seconds):
        field, aperture = made_up_heights(np.random.default_rng(0))
        stated = Stated(time, 1e-4 * np.eye(6), 1e-6 * np.eye(3))
        aperture = replace(aperture, sliding=sliding)
        network.add(ObservedDwell.seen_from(aperture, field, Placement(0.0, 0.0, 0.0), stated, sensor))
    chains = joined(network.dwells, SETTINGS)
    known = network.solved(chains)
    first, second = (Chain.of(chain, network, known) for chain in chains)
    return list(compared(second, [second], [first], network, known, UNKNOWN_GROUND, ROUGH_POINTS, of))


@pytest.mark.parametrize(("seconds", "sliding", "count"), [(0.9, True, 0), (1.1, True, 1), (0.9, False, 1)])
def test_a_strip_is_not_compared_with_what_it_goes_on_from(seconds: float, sliding: bool, count: int) -> None:
    """Within `strip_s`, 1 s, its images show other ground; dwells of spotlight may show the same."""
    assert len(compared_after(seconds, sliding=sliding)) == count


def test_comparisons_tell_what_of_a_match_is_wanted() -> None:
    """On level ground all that it says is of the height."""
    every, place, height = (
        compared_after(60.0, sliding=True, of=of)[0].equation for of in (whole, Match.of_place, Match.of_height)
    )
    np.testing.assert_allclose(place.right, every.right)
    assert place.information[2, 2] < 1e-3
    assert height.information[2, 2] == pytest.approx(every.information[2, 2], rel=1e-3)
