"""Topics of the air: which of these a bag has, and whether those that the compression needs are there."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.errors import UserError
from sal_height.graph.catalogue import NodeParameters
from sal_height.sensor import Sensor


def air_in(reader: BagReader) -> list[str]:
    """Topics of a bag with air data, as nodes know them."""
    return [
        topic
        for topic, quantity in messages.AIR.items()
        if f"/{topic}" in reader.topics
        and reader.topics[f"/{topic}"].count
        and reader.topics[f"/{topic}"].type_name == quantity.type_name
    ]


def check_air(parameters: NodeParameters, sensors: Iterable[Sensor], topics: Collection[str], source: str) -> None:
    """Refuse a compression that is to read the air from topics that are absent, or one of strips.

    Args:
        parameters: parameters of the nodes.
        sensors: sensors whose dwells are compressed.
        topics: topics with air data, of those that nodes know.
        source: source of the messages, as the start of the message to the user.

    Raises:
        UserError: something is missing.
    """
    if parameters.get("sar_compression", {}).get("air") != messages.AIR_OF_TOPICS:
        return
    for sensor in sensors:
        if missing := [topic for topic in messages.needed_air(sensor.wavelength) if topic not in topics]:
            raise UserError(
                f"{source} has no messages on {', '.join(missing)}, which sar_compression takes the air from (its "
                "parameter air is topics); record these topics, or set air to standard, measured or none."
            )
