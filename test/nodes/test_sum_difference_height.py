"""Sum and difference channels through the stages, from frames to heights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chain_fixture import StageChain
from helpers import assert_one_sentence
from stage_graph import StageGraph

from sal_height import messages
from sal_height.elevation.array.estimate import Validity
from sal_height.errors import UserError
from sal_height.messages.types import HeightImage
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import HybridSettings, load_preset
from sal_height.simulation.scenes import load_scene

WITH_SUM_DIFFERENCE = ("monopulse", "ml", "sum_difference")


def flown(pattern: str = "jinc", **hybrid: Any) -> SimulatedFlight:
    """Two beams a beamwidth apart over the street, with a hybrid."""
    small = load_preset("small")
    sensor = replace(small.sensor, detectors=2, pitch_beamwidths=1.0, pattern=pattern, hybrid=HybridSettings(**hybrid))
    preset = replace(small, sensor=sensor)
    return SimulatedFlight(preset, preset.make_sensor(), load_scene(preset.scene), preset.dwells, seed=7)


def connected(**hybrid: Any) -> StageChain:
    """A chain that knows the sensor, and has seen dwell 0."""
    chain = StageChain(flown(**hybrid), estimators=WITH_SUM_DIFFERENCE)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    return chain


def valid(image: HeightImage) -> np.ndarray:
    return np.array(image.validity) == Validity.OK


def in_both(field: str, one: HeightImage, other: HeightImage) -> tuple[np.ndarray, np.ndarray]:
    """Values of a field of both images, in the pixels that are valid in both: some 20, as two beams see no more."""
    both = valid(one) & valid(other)
    assert np.count_nonzero(both) > 15
    return np.array(getattr(one.surfaces[0], field))[both], np.array(getattr(other.surfaces[0], field))[both]


@pytest.mark.parametrize("place", ["antenna", "receiver"])
def test_heights_are_those_of_the_pair_that_the_hybrid_was_made_of(place: str) -> None:
    """The exact maximum likelihood is that of two detectors by total least squares, and the array's for a pair."""
    chain = connected(place=place)
    chain.await_heights(0)
    ours, pair, array = (chain.heights[name, 0] for name in ("sum_difference", "monopulse", "ml"))
    for theirs in (pair, array):
        np.testing.assert_allclose(*in_both("height", ours, theirs), atol=2e-3)
    np.testing.assert_allclose(*in_both("sigma", ours, pair), rtol=1e-3)
    np.testing.assert_allclose(*in_both("cnr_db", ours, pair), atol=0.01)


def test_the_published_ratio_and_its_linear_inverse_can_be_had_at_run_time() -> None:
    chain = connected(place="antenna")
    chain.await_heights(0)
    chain.stages["sum_difference_height"].set(discriminant="ratio", inverse="linear")
    chain.publish(*chain.odometry(1), *chain.frames(1))
    chain.await_heights(1)
    ours = chain.heights["sum_difference", 1]
    before = chain.heights["sum_difference", 0]
    for name, value in (("discriminant", "ratio"), ("inverse", "linear")):
        assert messages.stages_of(ours.provenance.parameters)["sum_difference_height"][name] == value
        assert messages.stages_of(before.provenance.parameters)["sum_difference_height"].get(name) != value
    linear, exact = in_both("height", ours, chain.heights["monopulse", 1])
    assert np.abs(linear - exact).max() > 5e-3  # twice what the exact ones differ by


@pytest.mark.parametrize(
    "hybrid", [{"delta_gain_db": 3.0, "delta_phase_rad": 0.5}, {"coupling": 1.0}, {"loss_db": 2.0}], ids=str
)
def test_heights_agree_with_those_of_the_array_whatever_the_hybrid(hybrid: dict[str, float]) -> None:
    chain = connected(place="antenna", **hybrid)
    chain.await_heights(0)
    np.testing.assert_allclose(
        *in_both("height", chain.heights["sum_difference", 0], chain.heights["ml", 0]), atol=2e-3
    )


def test_channels_that_are_no_sum_and_difference_are_refused_by_this_node_alone(
    flight: SimulatedFlight, reference: Any
) -> None:
    chain = StageChain(flight, estimators=WITH_SUM_DIFFERENCE)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_drops("sum_difference_height", "no sum and difference", 8)
    chain.wait(lambda: ("ml", 0) in chain.heights, "ML heights")
    assert np.array_equal(chain.heights["ml", 0].validity, reference["ml", 0].validity)
    assert "forms no sum and difference" in chain.stages["sum_difference_height"].last_rejection


def test_a_dead_sum_channel_gives_no_height_and_ends_nothing() -> None:
    chain = StageChain(flown(place="antenna"), estimators=WITH_SUM_DIFFERENCE)
    frames = chain.frames(0)
    frames[0].samples = messages.to_bytes(np.zeros(len(frames[0].samples), np.uint8))
    chain.publish(chain.sensor_info(), *chain.odometry(0), *frames)
    chain.await_drops("sum_difference_height", "dead detectors", 2)
    chain.publish(*chain.odometry(1), *chain.frames(1))
    chain.await_heights(1)
    assert valid(chain.heights["sum_difference", 1]).any()


def test_a_measured_characteristic_gives_the_heights_of_the_beams(tmp_path: Path) -> None:
    """Of beams whose ratio is the same at all squints: a table has only one."""
    flight = flown("sinc", place="antenna")
    beams = flight.sensor.beams
    angle = np.linspace(-0.49, 0.49, 99) * flight.sensor.beamwidth
    lower, upper = beams.response(np.pi / 4 + angle, 0.0).T
    table = tmp_path / "slope.csv"
    rows = zip(angle.tolist(), ((upper - lower) / (upper + lower)).tolist(), strict=True)
    table.write_text("angle_rad,gamma\n" + "".join(f"{a},{g}\n" for a, g in rows))
    own = {"sum_difference": {"slope_table": str(table)}}
    chain = StageChain(flight, estimators=WITH_SUM_DIFFERENCE, own=own)
    chain.publish(chain.sensor_info(), *chain.odometry(0), *chain.frames(0))
    chain.await_heights(0)
    np.testing.assert_allclose(
        *in_both("height", chain.heights["sum_difference", 0], chain.heights["monopulse", 0]), atol=2e-4
    )


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (None, ["cannot be read"]),
        ("angle,gamma\n0,0\n1,1\n", ["begins with 'angle,gamma'", "angle_rad,gamma"]),
        ("angle_rad,gamma\n0,0\n1,one\n", ["not two numbers"]),
        ("angle_rad,gamma\n0,0\n1\n", ["not two numbers"]),
        ("angle_rad,gamma\n", ["0 angles", "2 or more"]),
        ("angle_rad,gamma\n-1,-1\n0,0\n1,-0.5\n", ["changes sign between 0 and 1 rad"]),
    ],
)
def test_a_slope_table_that_cannot_be_used_is_refused_at_the_start(
    tmp_path: Path, text: str | None, parts: list[str]
) -> None:
    table = tmp_path / "slope.csv"
    if text is not None:
        table.write_text(text)
    with pytest.raises(UserError) as refused:
        StageGraph().add("sum_difference_height", slope_table=str(table))
    assert_one_sentence(str(refused.value), *parts)
