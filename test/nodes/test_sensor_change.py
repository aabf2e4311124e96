"""A source that is started again with another sensor, an hour later or earlier, is followed; nothing else restarts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from chain_fixture import START_NS, Chain, same_heights

from sal_height import messages
from sal_height.messages.types import HeightImage
from sal_height.nodes.transport.domain import free_domain
from sal_height.nodes.transport.graph import Graph
from sal_height.simulation import SimulatedFlight, flight_of, load_preset

IMAGE = {"rows": 46, "cols": 12}
HOUR_NS = 3_600_000_000_000
STRIP_DWELLS = 4
"""Blocks of which the last completes an image of the strip."""


def six_detectors() -> SimulatedFlight:
    preset = load_preset("small")
    return flight_of(replace(preset, sensor=replace(preset.sensor, detectors=6)), seed=8)


def strip() -> SimulatedFlight:
    return flight_of(replace(load_preset("sal_stripmap"), dwells=STRIP_DWELLS), seed=9)


OTHERS = {"fewer detectors": (six_detectors, 2), "another mode": (strip, STRIP_DWELLS)}
"""What makes the flight of another sensor, and how many of its dwells are published."""


def source(flight: SimulatedFlight, dwells: int, later_ns: int) -> Iterator[Any]:
    """All that a source publishes from its start on, `later_ns` after the chain's own."""
    start_ns = START_NS + later_ns
    yield messages.sensor_to_message(flight.sensor, messages.to_stamp(start_ns))
    for dwell in range(dwells):
        for state in flight.platform_states(dwell):
            yield messages.state_to_message(state, messages.to_stamp(start_ns + state.stamp_ns))
        history = flight.phase_history(dwell)
        stamp = messages.to_stamp(start_ns + history.stamp_ns)
        yield from messages.history_to_messages(history, flight.sensor, dwell, stamp)


def heights_of(chain: Chain, flight: SimulatedFlight, dwells: int, later_ns: int) -> list[HeightImage]:
    """The heights of the last dwell, once all has come."""
    chain.heights.clear()
    chain.publish(*source(flight, dwells, later_ns))
    keys = [(name, dwells - 1) for name in chain.estimators]
    chain.wait(lambda: all(key in chain.heights for key in keys), "the heights")
    return [chain.heights[key] for key in keys]


@pytest.mark.parametrize("later_ns", [HOUR_NS, -HOUR_NS], ids=["later", "earlier"])
@pytest.mark.parametrize("other", OTHERS)
def test_another_sensor_is_followed_and_the_first_one_again(
    chain: Chain, flight: SimulatedFlight, reference: Any, other: str, later_ns: int
) -> None:
    make, dwells = OTHERS[other]
    changed = make()
    first = heights_of(chain, flight, 1, 0)
    made = heights_of(chain, changed, dwells, later_ns)
    again = heights_of(chain, flight, 1, 2 * later_ns)
    for images in (first, again):
        assert all(same_heights(image, reference[image.estimator, 0]) for image in images)
    assert not any(name.startswith("dropped") for account in chain.accounts().values() for name in account)
    with free_domain() as domain, Graph(domain) as graph:
        alone = heights_of(Chain(graph, changed, 30.0, image=IMAGE), changed, dwells, later_ns)
    assert all(same_heights(ours, theirs) for ours, theirs in zip(made, alone, strict=True))
    assert {image.provenance.config_hash for image in made} == {changed.sensor.config_hash}
