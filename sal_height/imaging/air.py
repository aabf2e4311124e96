"""The air between sensor and ground: its effect on echoes, and the uncertainty of that effect.

The delay is the mean refractivity of the path times its length, the bend that mean less the refractivity at the sensor,
times the tangent of the angle off nadir. Whatever is not known of the air therefore changes both at once, and the two
changes cancel in part: twice the vapour moves an X-band radar's delay from 25 km by 13 cm, and its heights by less than
a millimetre at 45°. Each error of the air (`errors_of_air`) is one shift of the antenna along the line of sight and one
turn about the flight, together.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sal_height.geometry import (
    PRESSURES_PA,
    STANDARD_ATMOSPHERE,
    TEMPERATURES_K,
    TOP_M,
    AirPath,
    ApertureState,
    Atmosphere,
    Trajectory,
    electron_delay,
    height_of,
    path_through_air,
    refractivities,
)
from sal_height.imaging.pixels import aim_point
from sal_height.numeric import F64
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.settings import Settings, setting

VACUUM, UNKNOWN_AIR, STANDARD_AIR, MEASURED_AIR = "none", "unknown", "standard", "measured"
"""Values of the parameter air."""

MEASUREMENTS = "air_temperature_k", "air_pressure_pa", "air_humidity", "air_height_m"
"""Settings that state the measurements of the air, and their height."""

NEAR_SENSOR_K = 3.0
"""Standard deviation of the temperature at the sensor against that of the whole path, K, by layers of other air."""

UNSTATED_HEIGHT_M = 100.0
"""Standard deviation of the height of the map above sea level if it is not stated, m. So far sea level is from the
ellipsoid, above which satellite navigation gives heights; a map whose origin is on a mountain must state it."""


class StatedAir(Settings):
    """The air between sensor and ground, as parameters state it."""

    air: str = setting(
        STANDARD_AIR,
        "air that delays and bends the path of echoes, in addition to the two offsets; standard: the standard "
        "atmosphere; measured: as the parameters air_... say; none: vacuum, or ranges that are corrected already; "
        "unknown: either ranges are corrected or they are not, and all of the effect is uncertain",
        choices=(VACUUM, UNKNOWN_AIR, STANDARD_AIR, MEASURED_AIR),
    )
    air_temperature_k: float = setting(
        288.15,
        "temperature that was measured in the air",
        unit="K",
        minimum=TEMPERATURES_K[0],
        maximum=TEMPERATURES_K[1],
    )
    air_pressure_pa: float = setting(
        101_325.0, "pressure that was measured there", unit="Pa", minimum=PRESSURES_PA[0], maximum=PRESSURES_PA[1]
    )
    air_humidity: float = setting(0.6, "relative humidity over water that was measured there", minimum=0.0, maximum=1.0)
    air_height_m: float = setting(
        0.0, "height above sea level at which all three were measured", unit="m", minimum=-1000.0, maximum=32_000.0
    )
    map_height_m: float = setting(
        0.0,
        "height of the map's origin above sea level, for the air; 0: not stated, and uncertain by 100 m (state 0.1 at "
        "the sea)",
        unit="m",
        minimum=-1000.0,
        maximum=10_000.0,
    )

    @property
    def atmosphere(self) -> Atmosphere | None:
        """The air that is taken out; None: none is."""
        if self.air == MEASURED_AIR:
            return Atmosphere.measured(
                self.air_height_m, self.air_temperature_k, self.air_pressure_pa, self.air_humidity
            )
        return STANDARD_ATMOSPHERE if self.air == STANDARD_AIR else None

    @property
    def other_atmospheres(self) -> Iterator[Atmosphere]:
        """The air with one of its errors each, of one standard deviation.

        The standard atmosphere is off by what seasons and weather change: 10 K, 1 % of the pressure, and half of the
        vapour, of which ITU-R P.835 has 3.5 to 14 g/m^3 in winter and summer where its mean is 7.5. A measurement
        leaves what the probe of an aircraft does, 1 K, 1 hPa and 5 % of humidity, and 20 % of the vapour elsewhere on
        the path.
        """
        if self.air == STANDARD_AIR:
            standard = STANDARD_ATMOSPHERE
            yield replace(standard, warmer=10.0)
            yield replace(standard, sea_level_pressure=1.01 * standard.sea_level_pressure)
            yield replace(standard, vapour=1.5 * standard.vapour)
        if self.air == MEASURED_AIR and (there := self.atmosphere):
            at, kelvin, pascal, humidity = (
                self.air_height_m,
                self.air_temperature_k,
                self.air_pressure_pa,
                self.air_humidity,
            )
            yield Atmosphere.measured(at, kelvin + 1.0, pascal, humidity)
            yield Atmosphere.measured(at, kelvin, pascal + 100.0, humidity)
            yield Atmosphere.measured(at, kelvin, pascal, humidity + 0.05)
            yield replace(there, vapour=1.2 * there.vapour)


class AirEffect(NamedTuple):
    """Effect of the air on echoes: delay of each pulse (m, shape (pulses,)), and the bend of the path (rad)."""

    delay: F64
    bend: float


def air_effect(history: PhaseHistory, track: Trajectory, sensor: Sensor, stated: StatedAir) -> AirEffect:
    """The effect of the air on echoes from the middle of all beams at the reference range.

    Args:
        history: phase history.
        track: track of the platform.
        sensor: sensor of the phase history.
        stated: air between sensor and ground.

    Raises:
        UserError: the air is unknown for this wavelength or height.
    """
    pulses = len(history.reference_range)
    if (atmosphere := stated.atmosphere) is None:
        return AirEffect(np.zeros(pulses), 0.0)
    mounted = track.mounted(sensor.mounting)
    aperture = mounted.aperture(history.stamp_ns, history.pulse_times)
    aim = aim_point(sensor, aperture, float(history.reference_range[pulses // 2]))
    ends = mounted.positions(history.stamp_ns, history.pulse_times[[0, -1]])
    first, last = (
        path_through_air(sensor.wavelength, *_sight(antenna, aim, stated.map_height_m), atmosphere) for antenna in ends
    )
    return AirEffect(np.linspace(first.delay, last.delay, pulses), (first.bend + last.bend) / 2)


def errors_of_air(aperture: ApertureState, middle: F64, sensor: Sensor, stated: StatedAir) -> F64:
    """The errors that the stated air leaves, each of one standard deviation and independent of the others.

    A delay that is longer than that which was taken out puts the antenna too near, a greater bend the beams too far off
    nadir.

    Args:
        aperture: aperture of the image.
        middle: middle of the image in map, m, shape (3,).
        sensor: sensor of the image.
        stated: air between sensor and ground.

    Returns:
        Shift of the antenna (m) and turn of the body about the axes of map (rad) by each, shape (errors, 6).
    """
    if stated.air == VACUUM:
        return np.zeros((0, 6))
    sight = middle - aperture.position
    away, turn = sight / np.linalg.norm(sight), sensor.look_side * aperture.forward
    path = _Path(sensor.wavelength, *_sight(aperture.position, middle, stated.map_height_m))
    errors = [np.concatenate([-one.delay * away, one.bend * turn]) for one in path.errors(stated)]
    return np.array(errors)


class _Path(NamedTuple):
    """The straight path from a sensor to the ground, with the effect of air to first order, within a few thousandths.

    Attributes:
        wavelength: wavelength, m.
        above: height of the sensor above sea level, m.
        ground: height of the ground above sea level, m.
        off_nadir: angle of the path off nadir, rad.
    """

    wavelength: float
    above: float
    ground: float
    off_nadir: float

    def errors(self, stated: StatedAir) -> Iterator[AirPath]:
        """Errors of delay and bend by the air that is stated, each of one standard deviation."""
        yield AirPath(electron_delay(self.wavelength, self.above) / math.cos(self.off_nadir), 0.0)
        atmosphere = stated.atmosphere
        if atmosphere is None:
            yield self.effect(STANDARD_ATMOSPHERE)
            return
        taken_out = self.effect(atmosphere)
        others = [self.effect(other) for other in stated.other_atmospheres]
        if not stated.map_height_m:
            above, ground = self.above + UNSTATED_HEIGHT_M, self.ground + UNSTATED_HEIGHT_M
            others.append(self._replace(above=above, ground=ground).effect(atmosphere))
        yield from (AirPath(one.delay - taken_out.delay, one.bend - taken_out.bend) for one in others)
        if self.above < TOP_M:
            there = np.array([self.above])
            kelvin, phase = atmosphere.at(there)[0], refractivities(there, self.wavelength, atmosphere)[0]
            yield AirPath(0.0, math.tan(self.off_nadir) * NEAR_SENSOR_K * float(phase[0] / kelvin[0]))

    def effect(self, atmosphere: Atmosphere) -> AirPath:
        """Delay and bend by the mean of the refractivity and its value at the sensor."""
        layers, top = 50, min(self.above, TOP_M)
        heights = self.ground + (top - self.ground) / layers * (np.arange(layers + 1, dtype=np.float64) + 0.5)
        heights[-1] = top
        phase, group = refractivities(heights, self.wavelength, atmosphere)
        there = 0.0 if self.above > TOP_M else float(phase[-1])
        mean = float(phase[:-1].mean()) * (top - self.ground) / (self.above - self.ground)
        delay = float(group[:-1].mean()) * (top - self.ground) / math.cos(self.off_nadir)
        return AirPath(delay, math.tan(self.off_nadir) * (mean - there))


def _sight(antenna: F64, point: F64, map_height: float) -> tuple[float, float, float]:
    """Heights above sea level of the antenna and a point of the ground (m, map axes), and the angle off nadir (rad)."""
    above, ground = (map_height + float(height_of(end)) for end in (antenna, point))
    return above, ground, math.acos(min(1.0, (above - ground) / float(np.linalg.norm(point - antenna))))
