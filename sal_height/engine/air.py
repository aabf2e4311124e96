"""Air data received on ports, and the values used for each dwell."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from sal_height.engine.frame_items import Frame
from sal_height.engine.results import DwellKey
from sal_height.engine.stage import Port
from sal_height.errors import Rejected
from sal_height.geometry import RADIO_M, PlatformState, describe_implausible_pressure, height_of
from sal_height.imaging import CorrectionSettings
from sal_height.sensor import Sensor
from sal_height.settings import setting, settings_of

USED_AIR = "heard_air"
"""Prefix of the names of a dwell's air in its provenance, in addition to the parameters of the compression."""

SAMPLES_KEPT = 1000
"""Messages of each quantity that are kept: 100 s of a probe at 10 Hz."""

OTHER_CLOCK_S = 86400.0
"""Difference from the frames' time beyond which the clock is another one, s."""

AIR_OF_TOPICS = "topics"
"""Value of the parameter air of the compression: the air is as messages state it."""

AIR_LATENCY_NS = 1_000_000_000
"""Least time from the stamp of a message on the air to a dwell that uses it, ns. A message that takes less time from
probe to node has arrived by then, so that a replay uses the same messages as the flight did."""


class AirSample(NamedTuple):
    """Time of a measurement (ns), and its value in the unit of its parameter."""

    stamp_ns: int
    value: float


AIR_PARAMETERS: Mapping[str, str] = {
    "air/pressure": "air_pressure_pa",
    "air/temperature": "air_temperature_k",
    "air/humidity": "air_humidity",
}
"""The parameter of the compression that states the same as the messages on a port."""

AIR_PORTS = (
    Port(
        "air/pressure",
        AirSample,
        "pressure of the air, sensor_msgs/FluidPressure in Pa, used if the parameter air is topics",
        optional=True,
    ),
    Port(
        "air/temperature",
        AirSample,
        "its temperature, sensor_msgs/Temperature in degrees Celsius, likewise",
        optional=True,
    ),
    Port(
        "air/humidity",
        AirSample,
        "its relative humidity, sensor_msgs/RelativeHumidity from 0 to 1, likewise, for radio waves",
        optional=True,
    ),
)

_KNOWN = settings_of(CorrectionSettings)["air"]


class AirSettings(CorrectionSettings):
    """Corrections with the air of messages, too."""

    air: str = setting(
        _KNOWN.default,
        f"{_KNOWN.description}; topics: as messages on the topics air/... state",
        choices=(*_KNOWN.choices, AIR_OF_TOPICS),
    )
    air_probe: str = setting(
        "platform",
        "where the air of messages was measured: platform is at the height of the platform, fixed is at air_height_m",
        choices=("platform", "fixed"),
    )
    air_max_age_s: float = setting(
        60.0,
        "longest time from a message on the air to a dwell that it is used for",
        unit="s",
        minimum=2.0,
        maximum=86400.0,
    )


def needed_air(wavelength: float) -> list[str]:
    """The ports whose air delays a wavelength (m): the humidity delays and bends radio waves only."""
    return [port for port in AIR_PARAMETERS if port != "air/humidity" or wavelength >= RADIO_M]


class AirHistory:
    """The last measurements of each quantity of the air, in whatever order they arrived."""

    def __init__(self) -> None:
        """Start without any."""
        self._samples = {port: deque[AirSample](maxlen=SAMPLES_KEPT) for port in AIR_PARAMETERS}

    def add(self, port: str, sample: AirSample) -> None:
        """Keep a measurement."""
        self._samples[port].append(sample)

    def at(self, port: str, stamp_ns: int) -> AirSample | None:
        """The measurement for a dwell that begins at a time: the last one that has arrived by then for certain.

        Before there is one it is the first; None without any measurement.
        """
        samples = self._samples[port]
        arrived = [one for one in reversed(samples) if one.stamp_ns <= stamp_ns - AIR_LATENCY_NS]
        return max(arrived, key=_stamp_of) if arrived else min(samples, key=_stamp_of, default=None)


def air_of_dwell(
    history: AirHistory,
    frame: Frame,
    sensor: Sensor,
    states: list[PlatformState],
    settings: AirSettings,
) -> Mapping[str, float] | None:
    """The air of a dwell, as values of the parameters that state a measured one; None: messages are not used.

    Args:
        history: measurements.
        frame: any frame of the dwell.
        sensor: sensor that recorded it.
        states: odometry, from before its first pulse on.
        settings: settings of the compression.

    Raises:
        Rejected: a quantity has not arrived, or too long ago; or such air is impossible.
    """
    if settings.air != AIR_OF_TOPICS:
        return None
    found = {port: history.at(port, frame.key.stamp_ns) for port in needed_air(sensor.wavelength)}
    values = {"air_height_m": _probe_height(states[0], settings)}
    for port, sample in found.items():
        if sample is None:
            silent = ", ".join(name for name, one in found.items() if one is None)
            raise _no_air(frame, f"nothing was received on {silent}; publish it, or set air to standard or measured.")
        _check_age(frame, port, sample, settings.air_max_age_s)
        values[AIR_PARAMETERS[port]] = sample.value
    _check_plausible(frame, values)
    return values


def may_have_air(
    history: AirHistory, none_before: Mapping[str, int], key: DwellKey, sensor: Sensor, settings: AirSettings
) -> bool:
    """True if messages that arrive later can give a dwell the air that it lacks.

    Args:
        history: measurements.
        none_before: earliest stamp that messages which arrive later can have, ns, by port; absent: any.
        key: key of the dwell.
        sensor: sensor that records it.
        settings: settings of the compression.
    """
    held_ns, needed = round(1e9 * settings.air_max_age_s), needed_air(sensor.wavelength)
    found = {port: history.at(port, key.stamp_ns) for port in needed}
    unusable = {port for port, one in found.items() if one is None or abs(one.stamp_ns - key.stamp_ns) > held_ns}
    latest_ns = key.stamp_ns + held_ns
    closed = {port for port in needed if none_before.get(port, latest_ns) > latest_ns}
    return not (closed.issuperset(needed) or closed & unusable)


def _stamp_of(sample: AirSample) -> int:
    return sample.stamp_ns


def _probe_height(state: PlatformState, settings: AirSettings) -> float:
    """Height above sea level at which the air was measured, m."""
    if settings.air_probe == "fixed":
        return settings.air_height_m
    return settings.map_height_m + float(height_of(state.position))


def _check_age(frame: Frame, port: str, sample: AirSample, held_s: float) -> None:
    """Refuse a measurement that is too far from a dwell.

    Raises:
        Rejected: it is.
    """
    age_ns = frame.key.stamp_ns - sample.stamp_ns
    if abs(age_ns) > 1e9 * held_s:
        age_s = 1e-9 * age_ns
        clocks = "; frames and air have different clocks" if abs(age_s) > OTHER_CLOCK_S else ""
        raise _no_air(
            frame,
            f"the message for it on {port} is stamped {abs(age_s):.6g} s {'before' if age_s > 0 else 'after'} its "
            f"first pulse, and {held_s:g} s are allowed (air_max_age_s){clocks}.",
        )


def _check_plausible(frame: Frame, values: Mapping[str, float]) -> None:
    """Refuse a pressure in another unit, or of another height, which would go unnoticed.

    Raises:
        Rejected: such air is impossible.
    """
    measured = (values[name] for name in ("air_height_m", "air_temperature_k", "air_pressure_pa"))
    if wrong := describe_implausible_pressure(*measured):
        raise _no_air(
            frame,
            f"{wrong}; give air/pressure in Pa, and the right height (air_probe, air_height_m, map_height_m).",
        )


def _no_air(frame: Frame, what: str) -> Rejected:
    return Rejected(
        "no air", f"Dwell {frame.key.number} needs the air of messages (air is {AIR_OF_TOPICS}), but {what}"
    )
