"""A stage whose dwells are supplied when a test says so, and a host with a clock that the test moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from driven import Driven, accept, advance, nothing_before
from helpers import make_sensor

from sal_height.engine.dwells import SENSOR_PORT, DwellStage, WholeDwell
from sal_height.engine.results import DwellKey, Product, Result
from sal_height.engine.settings import ChannelSettings
from sal_height.engine.stage import Job, Port
from sal_height.errors import Rejected
from sal_height.sensor import Sensor
from sal_height.topics import SENSOR_INFO

SENSOR = make_sensor()
FRAMES = "frames"
SUPPLIES = "supplies"
MEGABYTE = 1_000_000
TICK_S = 0.125


def another(number: int) -> Sensor:
    """Another sensor."""
    return replace(SENSOR, name=f"sensor {number}", config_hash="")


@dataclass(frozen=True)
class Message:
    """A message of a channel."""

    key: DwellKey
    channel: int
    size: int = MEGABYTE
    is_blank: bool = False

    def blank(self, channel: int) -> Message:
        return replace(self, channel=channel, is_blank=True)


class Gate(DwellStage):
    """A stage of which dwells get what the port of supplies has brought last; "wait" is nothing."""

    usual_name = "gate"
    settings = ChannelSettings
    dwell_port = FRAMES
    changeable = ("supply",)

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self.supply: Any = "supplied"
        self.rehearsed: list[str] = []

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        return [SENSOR_PORT, Port(FRAMES, Message, "messages", per_channel=True, counted=True), Port(SUPPLIES, str, "")]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        return [Port("whole", WholeDwell, "dwells")]

    def check(self, message: Message, sensor: Sensor) -> None:
        """Every message will do."""

    def supplies(self, key: DwellKey, messages: Any, sensor: Sensor) -> Any:  # noqa: ARG002
        if self.supply == "wait":
            raise Rejected("no supply", f"Dwell {key.number}: nothing was supplied.")
        return self.supply

    def receive_other(self, port: str, item: str) -> None:  # noqa: ARG002
        self.supply = item
        self.hand_over_complete()

    def rehearse_for(self, sensor: Sensor, settings: Any) -> None:  # noqa: ARG002
        self.rehearsed.append(sensor.name)

    def work_on(self, whole: WholeDwell, job: Job) -> Iterator[Result]:
        yield Product("whole", (whole, job.settings))


class Gated(Driven):
    """A gate, and what has become of its dwells; messages of a dwell are a second apart from those of the next one."""

    def __init__(self, **settings: Any) -> None:
        stage = Gate(ChannelSettings(**settings))
        super().__init__(stage, stage)
        self.now_s = 1000.0

    def key(self, dwell: int, sensor: Sensor = SENSOR, stamp: float | None = None) -> DwellKey:
        return DwellKey(sensor.config_hash, dwell, round(1e9 * (1000.0 + (dwell if stamp is None else stamp))))

    def feed(self, dwell: int, *channels: int, sensor: Sensor = SENSOR, stamp: float | None = None) -> None:
        """Messages of a dwell arrive."""
        for channel in channels:
            self.do(accept(FRAMES, Message(self.key(dwell, sensor, stamp), channel), self.now_s))

    def describe(self, sensor: Sensor = SENSOR) -> None:
        """The description of a sensor arrives."""
        self.do(accept(SENSOR_INFO, sensor, self.now_s))

    def supply(self, what: str) -> None:
        """Supplies arrive, or must be waited for."""
        self.do(accept(SUPPLIES, what, self.now_s))

    def wait(self, seconds: float, *, busy: bool = False) -> None:
        """Time passes by the ticks of a host."""
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            self.do(advance(self.now_s, busy=busy))

    def announce(self, stamp: float, port: str = FRAMES) -> None:
        """The source announces that nothing with an earlier stamp will arrive."""
        self.do(nothing_before(port, round(1e9 * (1000.0 + stamp))))

    @property
    def whole(self) -> list[tuple[int, list[int], Any]]:
        """Of each dwell that became a job its number, the channels that are not blank, and its supplies."""
        return [
            (one.key.number, [message.channel for message in one.messages if not message.is_blank], one.supplies)
            for one, _ in (made.item for made in self.made)
        ]

    @property
    def waiting(self) -> int:
        """Messages that wait in the stage."""
        return sum(dwell.count for dwell in self.stage._assembler.unfinished()) + len(self.stage._early)
