"""Conversion of messages on the air: FluidPressure, Temperature and RelativeHumidity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from sal_height.engine.air import AirSample
from sal_height.errors import Rejected
from sal_height.imaging import CorrectionSettings
from sal_height.messages.basics import to_ns
from sal_height.messages.types import FluidPressure, Header, RelativeHumidity, Temperature, Time
from sal_height.settings import settings_of


class AirQuantity(NamedTuple):
    """A quantity of the air, as messages and parameters have it.

    Attributes:
        message_type: class of its messages.
        field: name of the field of the message.
        unit: unit of the field, after a space; empty: none.
        parameter: name of the parameter of the same quantity.
        offset: number to add to the field for the unit of the parameter.
    """

    message_type: type[Any]
    field: str
    unit: str
    parameter: str
    offset: float = 0.0

    @property
    def type_name(self) -> str:
        """Name of the type of its messages."""
        return str(self.message_type.__msgtype__)


AIR: Mapping[str, AirQuantity] = {
    "air/pressure": AirQuantity(FluidPressure, "fluid_pressure", " Pa", "air_pressure_pa"),
    "air/temperature": AirQuantity(Temperature, "temperature", " degrees Celsius", "air_temperature_k", 273.15),
    "air/humidity": AirQuantity(RelativeHumidity, "relative_humidity", "", "air_humidity"),
}
"""The quantities by their topic."""

AIR_TYPES = {quantity.type_name for quantity in AIR.values()}


def air_to_messages(values: Mapping[str, float], stamp: Time) -> dict[str, Any]:
    """Messages on the air, by topic.

    Args:
        values: values of all quantities, by the names of their parameters.
        stamp: time of the measurement.
    """
    return {
        topic: one.message_type(header=Header(stamp=stamp), **{one.field: values[one.parameter] - one.offset})
        for topic, one in AIR.items()
    }


def read_air(topic: str, message: Any) -> AirSample:
    """A measurement of the quantity that is published on a topic of `AIR`.

    Raises:
        Rejected: the value is not one that the parameter of the quantity allows.
    """
    quantity = AIR[topic]
    value, limits = float(getattr(message, quantity.field)), settings_of(CorrectionSettings)[quantity.parameter]
    low, high = (float(limit or 0.0) - quantity.offset for limit in (limits.minimum, limits.maximum))
    if not low <= value <= high:
        raise Rejected(
            "wrong air",
            f"{quantity.message_type.__name__} on {topic} has {quantity.field} {value:g}; it must be from {low:g} to "
            f"{high:g}{quantity.unit}.",
        )
    return AirSample(to_ns(message.header.stamp), value + quantity.offset)
