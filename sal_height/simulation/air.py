"""The air between a simulated platform and the ground: its effect on echoes, and the measurements of a probe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Le

from sal_height.configuration import Float, StrictKeys
from sal_height.geometry import PRESSURES_PA, TEMPERATURES_K, AirPath, Atmosphere, path_through_air

INTERVAL_NS = 1_000_000_000
"""Time between two measurements, ns; a dwell has the last one that is older than its first pulse by this time."""


class ProbedAir(NamedTuple):
    """Measurement of a probe at a time.

    Attributes:
        stamp_ns: time, ns.
        values: measured values by the names of the compression's parameters: air_temperature_k (K),
            air_pressure_pa (Pa) and air_humidity (relative, from 0 to 1).
    """

    stamp_ns: int
    values: dict[str, float]


@dataclass(frozen=True)
class SimulatedAir(StrictKeys):
    """Air in hydrostatic equilibrium, by its values at one height; by default those of the standard atmosphere.

    Attributes:
        temperature_k: temperature at `height_m`, K.
        pressure_pa: pressure at `height_m`, Pa.
        humidity: relative humidity at `height_m`.
        height_m: height of these values above sea level, m.
        map_height_m: height of the origin of map above sea level, m.
    """

    temperature_k: Annotated[Float, Ge(TEMPERATURES_K[0]), Le(TEMPERATURES_K[1])] = 288.15
    pressure_pa: Annotated[Float, Ge(PRESSURES_PA[0]), Le(PRESSURES_PA[1])] = 101_325.0
    humidity: Annotated[Float, Ge(0), Le(1)] = 0.0
    height_m: Annotated[Float, Ge(-1000), Le(32_000)] = 0.0
    map_height_m: Annotated[Float, Ge(-1000), Le(10_000)] = 0.0

    @property
    def atmosphere(self) -> Atmosphere:
        """The air at all heights."""
        return Atmosphere.measured(self.height_m, self.temperature_k, self.pressure_pa, self.humidity)

    def way(self, wavelength: float, slant_range: float, off_nadir: float, ground: float) -> AirPath:
        """Delay and bend of the path to ground at a height in map.

        Args:
            wavelength: wavelength, m.
            slant_range: slant range of the ground, m.
            off_nadir: angle of the straight line to it off nadir, rad.
            ground: height of the ground in map, m.

        Raises:
            UserError: the air is unknown for this wavelength or height.
        """
        below = self.map_height_m + ground
        above = below + float(slant_range * np.cos(off_nadir))
        return path_through_air(wavelength, above, below, off_nadir, self.atmosphere)

    def probed(self, stamp_ns: int, height: float) -> ProbedAir:
        """The measurement of a probe at a height in map (m)."""
        air, above = self.atmosphere, np.array([self.map_height_m + height])
        temperature, pressure, _ = (float(values[0]) for values in air.at(above))
        humidity = min(1.0, air.humidity(float(above[0])))
        values = {"air_temperature_k": temperature, "air_pressure_pa": pressure, "air_humidity": humidity}
        return ProbedAir(stamp_ns, values)
