"""Refraction by air: the delay of the echo, and the bending of its path.

The air is the International Standard Atmosphere (ISO 2533) with the water vapour of the reference atmosphere of ITU-R
P.835, in plane layers; or one with the temperature, pressure and vapour measured at one height. Light has the
refractivity of dry air by Ciddor (Applied Optics 35, 1996), radio waves that of ITU-R P.453. Weather changes the delay
by a few percent; near the ground, and for radio waves, vapour changes it by more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.constants import speed_of_light

from sal_height.errors import UserError
from sal_height.numeric import F64

TEMPERATURES_K, PRESSURES_PA = (180.0, 340.0), (500.0, 120_000.0)
"""Ranges of temperature and pressure of air at the heights of the described atmosphere."""

LIGHT_M = 0.3e-6, 15e-6
"""Wavelengths of light for which the formula is used; it was measured up to 1.7 µm, and changes little beyond."""

RADIO_M = 1e-3
"""Least wavelength of radio waves; between light and them, air absorbs and its refractivity varies."""

LOWEST_M, TOP_M = -1000.0, 80_000.0
"""Heights above sea level (m) between which there is air. The air above has a hundred-thousandth of the refractivity
left, and delays an echo by 30 µm."""

_LAPSES = (
    (0.0, 288.15, -6.5e-3),
    (11_000.0, 216.65, 0.0),
    (20_000.0, 216.65, 1e-3),
    (32_000.0, 228.65, 2.8e-3),
    (47_000.0, 270.65, 0.0),
    (51_000.0, 270.65, -2.8e-3),
    (71_000.0, 214.65, -2e-3),
)
"""Base height (m), temperature (K) and change of it with height (K/m) of the layers of the standard atmosphere."""

_SEA_LEVEL_PA, _GRAVITY, _GAS_CONSTANT = 101_325.0, 9.80665, 287.053
_VAPOUR_KG_M3, _VAPOUR_SCALE_M, _VAPOUR_CONSTANT = 7.5e-3, 2000.0, 461.52


@dataclass(frozen=True)
class AirPath:
    """The path from a sensor to the ground through air, against the straight path through vacuum.

    Attributes:
        delay: excess of the slant range that is measured as time, m.
        bend: angle by which the echo arrives from farther off nadir than the target, rad.
    """

    delay: float
    bend: float


@dataclass(frozen=True)
class Atmosphere:
    """Air in hydrostatic equilibrium; by default the standard atmosphere.

    Attributes:
        warmer: excess of temperature over the standard atmosphere at all heights, K.
        sea_level_pressure: pressure at sea level, Pa.
        vapour: density of water vapour at sea level, which falls by 1/e in 2 km, kg/m^3.
    """

    warmer: float = 0.0
    sea_level_pressure: float = _SEA_LEVEL_PA
    vapour: float = _VAPOUR_KG_M3

    @classmethod
    def measured(cls, height: float, temperature: float, pressure: float, humidity: float) -> Self:
        """The air from a measurement at one height.

        Args:
            height: height above sea level, m.
            temperature: temperature there, K.
            pressure: pressure there, Pa.
            humidity: relative humidity over water, from 0 to 1.
        """
        there = np.array([height])
        warmer = temperature - float(STANDARD_ATMOSPHERE.at(there)[0][0])
        unscaled = float(cls(warmer, 1.0, 0.0).at(there)[1][0])
        density = humidity * _saturation(temperature) / (_VAPOUR_CONSTANT * temperature)
        return cls(warmer, pressure / unscaled, float(density * np.exp(height / _VAPOUR_SCALE_M)))

    def at(self, height: F64) -> tuple[F64, F64, F64]:
        """Temperature (K), pressure and partial pressure of vapour (Pa) at heights above sea level (m), up to TOP_M."""
        temperature, pressure = np.empty_like(height), np.empty_like(height)
        base_pressure = self.sea_level_pressure
        for number, (base, standard, lapse) in enumerate(_LAPSES):
            inside = np.ones_like(height, np.bool_) if not number else height >= base
            if not inside.any():
                break
            top = _LAPSES[number + 1][0] if number + 1 < len(_LAPSES) else TOP_M
            above, at_base = np.minimum(height, top) - base, standard + self.warmer
            temperature[inside] = at_base + lapse * above[inside]
            pressure[inside] = base_pressure * _pressure_ratio(above[inside], at_base, lapse)
            base_pressure *= float(_pressure_ratio(np.array(top - base), at_base, lapse))
        density = self.vapour * np.exp(-height / _VAPOUR_SCALE_M)
        return temperature, pressure, density * _VAPOUR_CONSTANT * temperature

    def humidity(self, height: float) -> float:
        """Relative humidity over water at a height above sea level (m); more than 1 where vapour would condense."""
        temperature, _, vapour = (float(values[0]) for values in self.at(np.array([height])))
        return vapour / _saturation(temperature)


STANDARD_ATMOSPHERE = Atmosphere()


def describe_implausible_pressure(height: float, temperature: float, pressure: float) -> str:
    """Fault of a pressure in another unit, or of another height, as part of a message; empty: plausible.

    Args:
        height: height of the measurement above sea level, m.
        temperature: temperature there, K.
        pressure: pressure there, Pa.
    """
    at_sea_level = Atmosphere.measured(height, temperature, pressure, 0.0).sea_level_pressure
    low, high = 70_000.0, 130_000.0  # the weather leaves 87 to 109 kPa, and its layers are not known exactly
    if low <= at_sea_level <= high:
        return ""
    return (
        f"{pressure:g} Pa at {height:.0f} m above sea level would be {at_sea_level:.0f} Pa at the sea, where "
        f"{low:g} to {high:g} are allowed"
    )


def _saturation(temperature: float) -> float:
    """Pressure of saturated water vapour (Pa) at a temperature (K), by ITU-R P.453."""
    celsius = temperature - 273.15
    return float(611.21 * np.exp(17.502 * celsius / (240.97 + celsius)))


def _pressure_ratio(above: F64, temperature: float, lapse: float) -> F64:
    """Pressure at some height above the base of a layer over that at its base, by hydrostatic equilibrium."""
    exponent = _GRAVITY / _GAS_CONSTANT
    if lapse:
        return np.asarray((1 + lapse * above / temperature) ** (-exponent / lapse))
    return np.asarray(np.exp(-exponent * above / temperature))


def refractivities(height: F64, wavelength: float, air: Atmosphere = STANDARD_ATMOSPHERE) -> tuple[F64, F64]:
    """Refractive index of the phase and of the group, each less 1, at heights above sea level (m).

    Args:
        height: heights above sea level, m.
        wavelength: wavelength in vacuum, m.
        air: state of the air.

    Raises:
        UserError: the wavelength is of neither light nor radio waves.
    """
    temperature, pressure, vapour = air.at(height)
    if wavelength >= RADIO_M:
        dry, wet = (pressure - vapour) / 100, vapour / 100  # hPa
        radio = 1e-6 * (77.6 * dry / temperature + 72.0 * wet / temperature + 3.75e5 * wet / temperature**2)
        return radio, radio
    if not LIGHT_M[0] <= wavelength <= LIGHT_M[1]:
        raise UserError(
            f"The refraction of air is not known for a wavelength of {wavelength:.3g} m; allowed are "
            f"{LIGHT_M[0]:g} to {LIGHT_M[1]:g} m, and {RADIO_M:g} m or more."
        )
    density = pressure / _SEA_LEVEL_PA * (_LAPSES[0][1] / temperature)
    wavenumber2 = (1e-6 / wavelength) ** 2  # 1/µm^2
    terms = ((238.0185, 5_792_105e-8), (57.362, 167_917e-8))
    phase = sum(strength / (pole - wavenumber2) for pole, strength in terms)
    group = sum(strength * (pole + wavenumber2) / (pole - wavenumber2) ** 2 for pole, strength in terms)
    return density * phase, density * group


def electron_delay(wavelength: float, sensor_height: float) -> float:
    """Delay by the free electrons of the ionosphere straight down, m, of 50 TECU (5e17 electrons/m^2) above the ground.

    It is 40.3 m^3/s^2 times their number below the sensor over the square of the frequency. They lie as in a layer of
    Chapman's around 350 km with a scale height of 60 km, so that there are none below an aircraft. 50 TECU are those of
    a day when the sun is active; a quiet night has 5.

    Args:
        wavelength: wavelength in vacuum, m.
        sensor_height: height of the sensor above sea level, m.
    """
    scale_heights = (sensor_height - 350e3) / 60e3
    below = 5e17 * math.erfc(math.exp(-scale_heights / 2) / math.sqrt(2))
    return 40.3 * below * (wavelength / speed_of_light) ** 2


def path_through_air(
    wavelength: float,
    sensor_height: float,
    ground_height: float,
    off_nadir: float,
    air: Atmosphere = STANDARD_ATMOSPHERE,
) -> AirPath:
    """Delay and bend of the path from a sensor to the ground.

    By Snell's law n sin(angle) is the same in all layers; the path to the target is found by Newton's method. Above the
    air it is straight.

    Args:
        wavelength: wavelength in vacuum, m.
        sensor_height: height of the sensor above sea level, m.
        ground_height: height of the ground above sea level, below the sensor and below the top of the air, m.
        off_nadir: angle of the straight line from sensor to target, from 0 to less than pi / 2, rad.
        air: state of the air between them.

    Raises:
        UserError: the ground is outside of the atmosphere, the sensor is not above it, or the wavelength is of neither
            light nor radio waves.
    """
    top = min(sensor_height, TOP_M)
    if not LOWEST_M <= ground_height < top:
        raise UserError(
            f"The air between a sensor at {sensor_height:g} m and ground at {ground_height:g} m above sea level is not "
            f"known; the ground must be at {LOWEST_M:g} to {TOP_M:g} m, and the sensor above it. State map_height_m, "
            "the height of the map's origin above sea level, or set air to none."
        )
    above_air = sensor_height - top
    layers = 2000  # the delay is then within a micrometre, or 0.1 mm from 80 km on
    step = (top - ground_height) / layers
    heights = ground_height + step * (np.arange(layers, dtype=np.float64) + 0.5)
    phase, group = refractivities(np.asarray(heights, dtype=np.float64), wavelength, air)
    there = refractivities(np.array([top]), wavelength, air)[0][0] if not above_air else 0.0
    ratio = (1 + there) / (1 + phase)
    goal = (sensor_height - ground_height) * np.tan(off_nadir)
    sine = np.sin(off_nadir)
    most_iterations = 8
    for _ in range(most_iterations):
        steep, free = 1 / np.sqrt(1 - (ratio * sine) ** 2), 1 / np.sqrt(1 - sine**2)
        reached = step * np.sum(ratio * sine * steep) + above_air * sine * free
        change = (reached - goal) / (step * np.sum(ratio * steep**3) + above_air * free**3)
        sine -= change
        if abs(change) < 1e-15:
            break
    steep, free = 1 / np.sqrt(1 - (ratio * sine) ** 2), 1 / np.sqrt(1 - sine**2)
    straight = (sensor_height - ground_height) / np.cos(off_nadir)
    delay = step * np.sum(group * steep) + (step * np.sum(steep) + above_air * free - straight)
    return AirPath(float(delay), float(np.arcsin(sine) - off_nadir))
