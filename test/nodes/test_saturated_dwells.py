"""Dwells of receivers that saturate, from the simulator's frames to heights that say so."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from chain_fixture import START_NS, StageChain, heights_of_messages, same_heights
from helpers import assert_one_sentence

from sal_height import messages
from sal_height.messages.types import HeightImage
from sal_height.sensor.sensor import PhaseHistory, clipped
from sal_height.simulation.flight import SimulatedFlight, flight_of
from sal_height.simulation.preset import load_preset
from sal_height.simulation.receiver_noise import receiver_noise

USABLE = (HeightImage.OK, HeightImage.TWO_SCATTERERS)


def clipping_at(flight: SimulatedFlight, full_scale: float) -> SimulatedFlight:
    """The same flight with receivers of that full scale; its samples have an rms of about 2 in each part."""
    sensor = replace(flight.sensor, full_scale=full_scale, config_hash="")
    return SimulatedFlight(flight.preset, sensor, flight.scene, flight.dwells, flight.seed)


def seen(chain: StageChain) -> dict[tuple[str, int], HeightImage]:
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    return chain.heights


def test_receivers_of_a_high_full_scale_change_nothing(flight: SimulatedFlight, reference: Any) -> None:
    chain = StageChain(clipping_at(flight, 1e4))
    heights = seen(chain)
    assert all(same_heights(heights[name, 0], reference[name, 0]) for name in ("ml", "monopulse"))
    assert "ignored.saturated" not in chain.accounts()["ml_height"]


def test_a_strong_scene_at_a_low_full_scale_is_marked(flight: SimulatedFlight) -> None:
    chain = StageChain(clipping_at(flight, 4.0))
    heights = seen(chain)
    for name, stage in (("ml", "ml_height"), ("monopulse", "monopulse")):
        image = heights[name, 0]
        validity = np.array(image.validity)
        assert np.count_nonzero(validity == HeightImage.SATURATED) > 30
        assert not np.isin(validity, USABLE).any()
        assert not any(np.isfinite(np.array(surface.height)).any() for surface in image.surfaces)
        chain.wait(lambda s=stage: chain.accounts()[s].get("ignored.saturated") == 1, "the count")
        assert_one_sentence(chain.stages[stage].last_rejection.partition(": ")[2], "Dwell 0", "max_saturated_fraction")
    assert same_heights(heights_of_messages(chain), heights["ml", 0])


@pytest.mark.parametrize(("limit", "marked"), [(1.0, False), (0.0, True)])
def test_users_choose_how_much_may_be_clipped(flight: SimulatedFlight, limit: float, marked: bool) -> None:
    chain = StageChain(clipping_at(flight, 4.0), heights={"max_saturated_fraction": limit})
    assert marked == (HeightImage.SATURATED in np.array(seen(chain)["ml", 0].validity))


def test_a_clipped_block_is_told_by_the_images_of_a_strip_that_its_pulses_are_in() -> None:
    """Block 3: an image takes its own 256 pulses and 310 of an aperture, from the block it comes with and two before.

    Pulses are held a little longer than needed, so that one image more may be said to have some.
    """
    flight = clipping_at(flight_of(replace(load_preset("sal_stripmap"), dwells=8), seed=3), 100.0)
    sensor, bad = flight.sensor, 3
    chain = StageChain(flight, image={"rows": 46, "cols": 128})
    chain.publish(chain.sensor_info())
    for block in range(flight.dwells):
        samples = receiver_noise(sensor, sensor.pulse_count, np.random.default_rng(block))
        if block == bad:
            samples[5] = clipped(1e5 * samples[5], sensor.full_scale)
        start = flight.dwell_start_ns(block)
        reference = np.full(sensor.pulse_count, flight.preset.flight.slant_range_m)
        history = PhaseHistory(start, flight.pulse_times, reference, samples)
        frames = messages.history_to_messages(history, sensor, block, messages.to_stamp(START_NS + start))
        chain.publish(*chain.odometry(block), *frames)
    shares = {(image.dwell, image.channel): image.saturated_share for image in chain.graph.heard["slc"]}
    assert {dwell for dwell, _ in shares} == set(range(2, flight.dwells))
    told = {key for key, share in shares.items() if share}
    assert {(dwell, 5) for dwell in (3, 4, 5)} <= told <= {(dwell, 5) for dwell in (3, 4, 5, 6)}
    assert shares[bad, 5] > 0.99
