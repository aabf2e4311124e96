"""Messages on the air: their values in the units of the parameters, and which of them are refused."""

from __future__ import annotations

import math
from typing import Any

import pytest
from air_messages import humidity_at, pressure_at, temperature_at
from helpers import refused

from sal_height.errors import Rejected
from sal_height.messages import AirSample, read_air

PRESSURE, TEMPERATURE, HUMIDITY = "air/pressure", "air/temperature", "air/humidity"


def test_values_come_in_the_units_of_the_parameters() -> None:
    assert read_air(PRESSURE, pressure_at(5, 65_000.0)) == AirSample(5, 65_000.0)
    assert read_air(TEMPERATURE, temperature_at(6, -7.5)) == AirSample(6, 265.65)
    assert read_air(HUMIDITY, humidity_at(7, 0.25)) == AirSample(7, 0.25)


@pytest.mark.parametrize(
    ("topic", "message", "said"),
    [
        (TEMPERATURE, temperature_at(0, 288.15), "temperature 288.15; it must be from -93.15 to 66.85 degrees Celsius"),
        (TEMPERATURE, temperature_at(0, -93.2), "from -93.15"),
        (TEMPERATURE, temperature_at(0, math.nan), "temperature nan"),
        (PRESSURE, pressure_at(0, 101.325), "fluid_pressure 101.325; it must be from 500 to 120000 Pa"),
        (PRESSURE, pressure_at(0, math.inf), "fluid_pressure inf"),
        (PRESSURE, pressure_at(0, 120_001.0), "to 120000 Pa"),
        (HUMIDITY, humidity_at(0, 55.0), "relative_humidity 55; it must be from 0 to 1"),
        (HUMIDITY, humidity_at(0, -0.01), "from 0 to 1"),
    ],
)
def test_values_that_no_air_has_are_refused(topic: str, message: Any, said: str) -> None:
    with refused(Rejected, topic, said):
        read_air(topic, message)
