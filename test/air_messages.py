"""Messages on the air as probes publish them."""

from __future__ import annotations

from typing import Any

from sal_height import messages
from sal_height.messages.types import FluidPressure, Header, RelativeHumidity, Temperature


def header_at(stamp_ns: int) -> Header:
    return Header(stamp=messages.to_stamp(stamp_ns))


def pressure_at(stamp_ns: int, pascal: float) -> FluidPressure:
    return FluidPressure(header=header_at(stamp_ns), fluid_pressure=pascal)


def temperature_at(stamp_ns: int, celsius: float) -> Temperature:
    return Temperature(header=header_at(stamp_ns), temperature=celsius)


def humidity_at(stamp_ns: int, share: float) -> RelativeHumidity:
    return RelativeHumidity(header=header_at(stamp_ns), relative_humidity=share)


def air_at(stamp_ns: int, celsius: float = -7.5, pascal: float = 65_000.0) -> list[Any]:
    """Of a lidar at 3.5 km, which needs no humidity."""
    return [pressure_at(stamp_ns, pascal), temperature_at(stamp_ns, celsius)]
