"""The air that messages tell of, as the compression takes it for a dwell."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from sal_height.errors import Rejected
from sal_height.geometry import PlatformState, describe_implausible_pressure, height_of
from sal_height.imaging import CorrectionSettings
from sal_height.messages import AIR, AIR_LATENCY_NS, HEARD_AIR, AirSample, ReceivedFrame, needed_air
from sal_height.nodes.role import Topics
from sal_height.sensor import Sensor
from sal_height.settings import setting, settings_of

USED_AIR = "heard_air"
"""Beginning of the names, beside the node's parameters, of the air of a dwell in its provenance."""

MOST_SAMPLES = 1000
"""Messages of each quantity that are held: 100 s of a probe at 10 Hz."""

OTHER_CLOCK_S = 86400.0
"""What is a day from the frames has another clock."""

AIR_TOPICS: Topics = {
    "air/pressure": "pressure of the air, sensor_msgs/FluidPressure in Pa, used if the parameter air is heard",
    "air/temperature": "its temperature, sensor_msgs/Temperature in degrees Celsius, likewise",
    "air/humidity": "its relative humidity, sensor_msgs/RelativeHumidity from 0 to 1, likewise, for radio waves",
}

_KNOWN = settings_of(CorrectionSettings)["air"]


class AirParameters(CorrectionSettings):
    """Corrections with the air of messages, too."""

    air: str = setting(
        _KNOWN.default,
        f"{_KNOWN.description}; heard: as messages on the topics air/... say",
        choices=(*_KNOWN.choices, HEARD_AIR),
    )
    air_probe: str = setting(
        "platform",
        "where the air that is heard was measured: platform is at the height of the platform, fixed is at air_height_m",
        choices=("platform", "fixed"),
    )
    air_held_s: float = setting(
        60.0,
        "longest time from a message on the air to a dwell that it is used for",
        unit="s",
        minimum=2.0,
        maximum=86400.0,
    )


class AirHistory:
    """The last messages of each quantity of the air, in whatever order they came."""

    def __init__(self) -> None:
        """Begin without any."""
        self._samples = {topic: deque[AirSample](maxlen=MOST_SAMPLES) for topic in AIR}

    def add(self, topic: str, sample: AirSample) -> None:
        """Take in a measurement."""
        self._samples[topic].append(sample)

    def at(self, topic: str, stamp_ns: int) -> AirSample | None:
        """The measurement for a dwell that begins at a time: the last one that has come by then for certain.

        Before there is one it is the first; None: there is none at all.
        """
        samples = self._samples[topic]
        come = [one for one in reversed(samples) if one.stamp_ns <= stamp_ns - AIR_LATENCY_NS]
        return max(come, key=_stamp_of) if come else min(samples, key=_stamp_of, default=None)


def heard_air(
    history: AirHistory,
    frame: ReceivedFrame,
    sensor: Sensor,
    states: list[PlatformState],
    parameters: AirParameters,
) -> Mapping[str, float] | None:
    """The air of a dwell, as values of the parameters that state a measured one; None: it is not to be heard.

    Args:
        history: of the messages.
        frame: any of the dwell.
        sensor: that took it.
        states: odometry, from before its first pulse on.
        parameters: of the compression.

    Raises:
        Rejected: a quantity has not come, or too long ago; or there is no such air.
    """
    if parameters.air != HEARD_AIR:
        return None
    found = {topic: history.at(topic, frame.stamp_ns) for topic in needed_air(sensor.wavelength)}
    values = {"air_height_m": _probe_height(states[0], parameters)}
    for topic, sample in found.items():
        if sample is None:
            silent = ", ".join(name for name, one in found.items() if one is None)
            raise _no_air(frame, f"nothing has come on {silent}; publish it, or set air to standard or measured.")
        _check_age(frame, topic, sample, parameters.air_held_s)
        values[AIR[topic].parameter] = sample.value
    _check_plausible(frame, values)
    return values


def _stamp_of(sample: AirSample) -> int:
    return sample.stamp_ns


def _probe_height(state: PlatformState, parameters: AirParameters) -> float:
    """Height above sea level at which the air was measured, m."""
    if parameters.air_probe == "fixed":
        return parameters.air_height_m
    return parameters.map_height_m + float(height_of(state.position))


def _check_age(frame: ReceivedFrame, topic: str, sample: AirSample, held_s: float) -> None:
    """Refuse a measurement that is too far from a dwell.

    Raises:
        Rejected: it is.
    """
    age_ns = frame.stamp_ns - sample.stamp_ns
    if abs(age_ns) > 1e9 * held_s:
        age_s = 1e-9 * age_ns
        clocks = "; frames and air have different clocks" if abs(age_s) > OTHER_CLOCK_S else ""
        raise _no_air(
            frame,
            f"the message for it on {topic} is stamped {abs(age_s):.6g} s {'before' if age_s > 0 else 'after'} its "
            f"first pulse, and {held_s:g} s are allowed (air_held_s){clocks}.",
        )


def _check_plausible(frame: ReceivedFrame, values: Mapping[str, float]) -> None:
    """Refuse a pressure in another unit, or of another height, which would go unnoticed.

    Raises:
        Rejected: there is no such air.
    """
    measured = (values[name] for name in ("air_height_m", "air_temperature_k", "air_pressure_pa"))
    if wrong := describe_implausible_pressure(*measured):
        raise _no_air(
            frame,
            f"{wrong}; give air/pressure in Pa, and the right height (air_probe, air_height_m, map_height_m).",
        )


def _no_air(frame: ReceivedFrame, what: str) -> Rejected:
    return Rejected("no air", f"Dwell {frame.dwell} needs the air of messages (air is {HEARD_AIR}), but {what}")
