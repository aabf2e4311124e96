"""Responses read from a table against those of the beams."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import BEAMWIDTH, beams_named, make_sensor, sensor_with_complex_beams

from sal_height.beams import Beams
from sal_height.sensor.sensor import Sensor
from sal_height.simulation.echoes import NODES_PER_BEAMWIDTH, _table, response_of
from sal_height.simulation.preset import load_preset

SENSORS = {
    "jinc": make_sensor(),
    "sinc": make_sensor(pattern="sinc"),
    "gaussian": make_sensor(pattern="gaussian"),
    "finite and turned": make_sensor(pattern="sinc", detector_size=(0.5, 0.3), detector_rotation=0.3),
    "long antenna": make_sensor(azimuth_diameter=0.03),
    "complex": sensor_with_complex_beams(),
    "measured": load_preset("xband_sumdiff").make_sensor(),
}


def directions(sensor: Sensor, reach: float, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(71)
    return rng.uniform(-reach, reach, count) * sensor.beamwidth, rng.uniform(
        -1.2, 1.2, count
    ) * sensor.azimuth_beamwidth


def error_of(beams: Beams, offset: np.ndarray, squint: np.ndarray) -> float:
    expected = beams.response(offset + beams.axis_middle, squint)
    seen = response_of(beams, offset, squint)
    assert np.iscomplexobj(seen) == np.iscomplexobj(expected)
    return float(np.abs(seen - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("name", SENSORS)
def test_table_has_the_responses_of_the_beams(name: str) -> None:
    """Also across the edges of a measured beam, where it becomes 0 at once."""
    offset, squint = directions(SENSORS[name], 9.0 if name == "measured" else 4.0)
    assert error_of(SENSORS[name].beams, offset, squint) < 8e-5


def test_value_does_not_depend_on_what_else_is_asked_for() -> None:
    beams = SENSORS["jinc"].beams
    offset, squint = directions(SENSORS["jinc"], 4.0)
    few = response_of(beams, offset[:3], squint[:3])
    np.testing.assert_array_equal(few, response_of(beams, offset, squint)[:3])


def test_tables_are_bounded_and_alike_dwells_share_one() -> None:
    _table.cache_clear()
    beams = SENSORS["sinc"].beams
    for number in range(20):
        response_of(beams, np.array([0.05 * number]) * BEAMWIDTH, np.zeros(1))
    assert _table.cache_info().currsize == 1
    for number in range(10):
        response_of(make_sensor(pattern="sinc").beams, np.zeros(number + 1), np.zeros(number + 1))
    assert _table.cache_info().currsize == 8


def test_what_lies_far_off_needs_no_large_table() -> None:
    beams = SENSORS["jinc"].beams
    offset, squint = (
        np.array([0.1, -300.0, 0.2, 90.0, 25.45]) * BEAMWIDTH,
        np.array([0.1, 0.2, 800, -0.1, 0]) * BEAMWIDTH,
    )
    assert error_of(beams, offset, squint) < 8e-5
    table = _table(beams, BEAMWIDTH / NODES_PER_BEAMWIDTH, 512, 512)[0][0]
    assert _table.cache_info().hits > 0
    np.testing.assert_allclose(
        response_of(beams, offset, squint)[[1, 3]],
        beams.response(offset + beams.axis_middle, squint)[[1, 3]],
        rtol=1e-6,
    )
    assert table.nbytes < 20e6


def test_beams_of_every_pattern_are_smooth_between_nodes() -> None:
    for name, pitch in (("jinc", 0.5), ("sinc", 0.5)):
        beams = beams_named(name)
        _, rough = _table(beams, beams.beamwidth / NODES_PER_BEAMWIDTH, 64, 32)
        assert not rough.any(), (name, pitch)
