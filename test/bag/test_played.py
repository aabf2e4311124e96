"""What of a bag is played: chosen dwells, and the odometry around them."""

from __future__ import annotations

from typing import Any

from air_messages import pressure_at, temperature_at
from played_bag import odometry
from written_bag import frame, key

from sal_height.bag.played import DwellRange, chosen, part_of, read_contents
from sal_height.bag.reader import BagMessage
from sal_height.messages import serialize
from sal_height.messages.types import ChannelFrame, FluidPressure, Odometry, SensorInfo, Temperature

NAMES = {
    Odometry: ("/platform/odometry", "nav_msgs/msg/Odometry"),
    ChannelFrame: ("/phase_history", "sal_height_msgs/msg/ChannelFrame"),
    SensorInfo: ("/sensor_info", "sal_height_msgs/msg/SensorInfo"),
    FluidPressure: ("/air/pressure", "sensor_msgs/msg/FluidPressure"),
    Temperature: ("/air/temperature", "sensor_msgs/msg/Temperature"),
}


def lasting(dwell: int, seconds: float) -> ChannelFrame:
    message = frame(dwell)
    message.pulse_time = [0.0, seconds]
    return message


def played(dwells: DwellRange, *recorded: Any) -> list[float | str]:
    """What is played of messages: the times of odometry, and the numbers of dwells as a text."""
    bag = [BagMessage(*NAMES[type(m)], serialize(m), n, n) for n, m in enumerate(recorded)]
    found: list[float | str] = []
    for one, content in chosen(read_contents(iter(bag)), dwells):
        if content.part:
            found.append(str(content.part.dwell.number))
        elif one.topic == "/sensor_info":
            found.append("info")
        elif content.air_ns is not None:
            found.append(f"{one.topic[5]}{content.air_ns * 1e-9:g}")
        else:
            found.append((content.odometry_ns or 0) * 1e-9)
    return found


def test_a_frame_says_its_dwell_and_its_last_pulse() -> None:
    message = lasting(7, 0.5)
    part = part_of(BagMessage(*NAMES[ChannelFrame], serialize(message), 0, 0))
    assert part is not None
    assert part.dwell == key(7)
    assert part.end_ns == 7_500_000_000
    assert part.provenance is None


def test_odometry_far_from_the_chosen_dwells_is_left_out() -> None:
    """Of a long flight it would be thousands of samples at once, and some would get lost."""
    samples = [odometry(t / 2) for t in range(40)]
    before = [SensorInfo(), *samples[:12], *(frame(n) for n in range(5)), *samples[12:22]]
    order = [*before, lasting(10, 0.4), *samples[22:], frame(15), SensorInfo()]
    assert played(DwellRange(10, 10), *order) == ["info", 8.5, 9.0, 9.5, 10.0, 10.5, "10", 11.0, "info"]


def test_the_last_sample_before_and_the_first_after_are_played_however_far_they_are() -> None:
    order = [*map(odometry, (0.0, 1.0, 2.0, 90.0)), frame(1), frame(50), *map(odometry, (91.0, 95.0, 96.0)), frame(99)]
    assert played(DwellRange(50, 50), *order) == [2.0, 90.0, "50"]
    late = [*map(odometry, (0.0, 1.0, 2.0)), frame(1), frame(50), frame(51), *map(odometry, (90.0, 95.0)), frame(99)]
    assert played(DwellRange(50, 50), *late) == [2.0, "50", 90.0]


def test_air_that_is_broken_behind_its_stamp_is_broken() -> None:
    """Through nodes as by calls: it is left out, and counted."""
    topic, type_name = NAMES[FluidPressure]
    cdr = serialize(pressure_at(3, 65_000.0))
    recorded = (BagMessage(topic, type_name, one, 0, 0) for one in (cdr, cdr[:20]))
    whole, cut = (one.content for one in read_contents(recorded))
    assert (whole.air_ns, whole.fault) == (3, "")
    assert cut.air_ns is None
    assert cut.fault


def test_the_air_that_chosen_dwells_have_is_played_whatever_else_is() -> None:
    """Of each quantity the last message that was stamped a second or more before, and those that follow it."""
    pressures = [pressure_at(round(t * 1e9), 1e5) for t in (1.0, 20.0, 48.0, 49.0, 49.5, 51.5)]
    temperatures = [temperature_at(round(t * 1e9), 10.0) for t in (2.0, 3.0)]
    order = [*temperatures, *pressures[:5], *map(odometry, (0.0, 32.0, 49.5)), frame(1), frame(50), pressures[5]]
    assert played(DwellRange(50, 50), *order) == ["t3", "p48", "p49", "p49.5", 32.0, 49.5, "50", "p51.5"]


def test_dwells_are_chosen_by_number_and_by_stamp() -> None:
    assert key(3) in DwellRange()
    assert key(3) in DwellRange(3, 3, 3_000_000_000, 3_000_000_000)
    for dwells in (DwellRange(4), DwellRange(last=2), DwellRange(start_ns=3_000_000_001), DwellRange(end_ns=2)):
        assert key(3) not in dwells
