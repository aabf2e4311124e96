"""Which measurements of the air are used for a dwell, and which are refused."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence, make_sensor

from sal_height.engine.air import SAMPLES_KEPT, AirHistory, AirSample, air_of_dwell, may_have_air, needed_air
from sal_height.engine.compression import CompressionSettings
from sal_height.engine.provenance import Provenance, flat_values
from sal_height.engine.results import DwellKey
from sal_height.engine.stage import FOREVER_NS
from sal_height.engine.tracker import Tracker, _series_of
from sal_height.errors import Rejected
from sal_height.geometry import PlatformState
from sal_height.sensor import Sensor

SECOND = 1_000_000_000
DWELL_NS = 1_700_000_000 * SECOND
PRESSURE, TEMPERATURE, HUMIDITY = "air/pressure", "air/temperature", "air/humidity"
HEARD = CompressionSettings(air="topics", map_height_m=500.0)
KEY = DwellKey("hash", 7, DWELL_NS)

RADIO = make_sensor(wavelength=0.03)


def history_of(pressure: float = 70_000.0, **ages_s: float) -> AirHistory:
    """Air at 3 km, measured so long before the dwell: 1 s, but for the quantities that are named."""
    history = AirHistory()
    for name, value in (("pressure", pressure), ("temperature", 268.15), ("humidity", 0.4)):
        history.add(f"air/{name}", AirSample(DWELL_NS - round(ages_s.get(name, 1.0) * SECOND), value))
    return history


def air_of(
    history: AirHistory, sensor: Sensor | None = None, settings: CompressionSettings = HEARD, height: float = 2500.0
) -> dict[str, float]:
    """The air of a dwell whose platform is at some height of the map."""
    frame: Any = SimpleNamespace(key=KEY)
    place, level = np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 0.0, 1.0])
    state = PlatformState(DWELL_NS, place, level, np.zeros(3), np.zeros((6, 6)))
    found = air_of_dwell(history, frame, sensor or make_sensor(), [state], settings)
    assert found is not None
    return dict(found)


def test_of_what_has_arrived_for_certain_the_last_is_used_in_whatever_order_it_arrived() -> None:
    """A message that is stamped less than a second before the dwell may have been on its way in flight."""
    stamps = [DWELL_NS - 5 * SECOND, DWELL_NS - SECOND, DWELL_NS - SECOND + 1, DWELL_NS + SECOND]
    for order in permutations(stamps):
        history = AirHistory()
        for stamp_ns in order:
            history.add(TEMPERATURE, AirSample(stamp_ns, float(stamps.index(stamp_ns))))
        assert history.at(TEMPERATURE, DWELL_NS) == AirSample(DWELL_NS - SECOND, 1.0)
        assert history.at(TEMPERATURE, DWELL_NS - 5 * SECOND) == AirSample(stamps[0], 0.0), "the first of all"
        assert history.at(PRESSURE, DWELL_NS) is None


def test_of_two_with_one_stamp_the_later_one_is_used() -> None:
    history = AirHistory()
    for value in (270.0, 280.0):
        history.add(TEMPERATURE, AirSample(DWELL_NS - SECOND, value))
    assert history.at(TEMPERATURE, DWELL_NS) == AirSample(DWELL_NS - SECOND, 280.0)


def test_no_more_than_the_last_thousand_are_kept() -> None:
    history = AirHistory()
    for number in range(SAMPLES_KEPT + 5):
        history.add(TEMPERATURE, AirSample(number * SECOND, 280.0))
    assert len(history._samples[TEMPERATURE]) == SAMPLES_KEPT == 1000
    assert history.at(TEMPERATURE, 0) == AirSample(5 * SECOND, 280.0)


def test_a_clock_that_starts_again_costs_nothing() -> None:
    """Although all that is kept has later stamps."""
    history = AirHistory()
    for number in range(SAMPLES_KEPT):
        history.add(TEMPERATURE, AirSample(DWELL_NS + number * SECOND, 280.0))
    history.add(TEMPERATURE, AirSample(3 * SECOND, 290.0))
    assert history.at(TEMPERATURE, 5 * SECOND) == AirSample(3 * SECOND, 290.0)


def test_a_probe_on_the_platform_is_at_its_height_and_another_where_it_is_said_to_be() -> None:
    expected = {"air_pressure_pa": 70_000.0, "air_temperature_k": 268.15}
    assert air_of(history_of()) == {"air_height_m": 3000.0, **expected}
    station = HEARD.changed(air_probe="fixed", air_height_m=2900.0)
    assert air_of(history_of(), settings=station) == {"air_height_m": 2900.0, **expected}


def test_humidity_is_needed_for_radio_waves_only() -> None:
    assert needed_air(make_sensor().wavelength) == [PRESSURE, TEMPERATURE]
    assert needed_air(RADIO.wavelength) == [PRESSURE, TEMPERATURE, HUMIDITY]
    assert air_of(history_of(), RADIO)["air_humidity"] == 0.4
    dry = history_of()
    dry._samples[HUMIDITY].clear()
    assert "air_humidity" not in air_of(dry)
    with pytest.raises(Rejected) as missing:
        air_of(dry, RADIO)
    assert_one_sentence(str(missing.value), "Dwell 7", "nothing was received on air/humidity", "standard or measured")


def test_all_that_is_missing_is_named() -> None:
    with pytest.raises(Rejected) as missing:
        air_of(AirHistory(), RADIO)
    assert missing.value.reason == "no air"
    assert_one_sentence(str(missing.value), "air/pressure, air/temperature, air/humidity")


@pytest.mark.parametrize("age_s", [60.0, -60.0])
def test_what_was_measured_too_long_ago_or_later_is_refused(age_s: float) -> None:
    """In spite of what is nearer of the other quantities; to the microsecond."""
    assert air_of(history_of(pressure=70_000.0, temperature=age_s))["air_temperature_k"] == 268.15
    with pytest.raises(Rejected) as old:
        air_of(history_of(temperature=math.copysign(60.000001, age_s)))
    when = "before" if age_s > 0 else "after"
    assert_one_sentence(str(old.value), "air/temperature is stamped 60 s", when, "60 s are allowed (air_max_age_s)")
    assert air_of(history_of(temperature=2 * age_s), settings=HEARD.changed(air_max_age_s=120.0))


def test_another_clock_is_named() -> None:
    with pytest.raises(Rejected) as apart:
        air_of(history_of(pressure=70_000.0, temperature=2e5))
    assert_one_sentence(str(apart.value), "frames and air have different clocks")


@pytest.mark.parametrize(
    ("pascal", "height"),
    [(700.0, 2500.0), (101_325.0, 6000.0), (30_000.0, -400.0)],
    ids=["in hPa", "of the ground", "of another height"],
)
def test_a_pressure_that_no_air_has_at_that_height_is_refused(pascal: float, height: float) -> None:
    with pytest.raises(Rejected) as odd:
        air_of(history_of(pascal), height=height)
    assert_one_sentence(str(odd.value), f"{pascal:g} Pa at {height + 500:.0f} m above sea level", "in Pa", "air_probe")


@pytest.mark.parametrize(("pascal", "height"), [(108_500.0, -450.0), (87_000.0, -500.0), (23_000.0, 10_000.0)])
def test_pressures_that_were_measured_on_earth_are_used(pascal: float, height: float) -> None:
    assert air_of(history_of(pascal), height=height)["air_pressure_pa"] == pascal


def test_a_block_of_a_strip_has_the_air_of_a_dwell() -> None:
    assert air_of(history_of(), replace(make_sensor(), mode="stripmap")) == air_of(history_of(), make_sensor())


def test_air_that_changes_does_not_end_a_series_of_dwells_that_are_tracked() -> None:
    """Other settings do."""

    def series(temperature: float, rows: int) -> Any:
        stated = {"rows": rows, "heard_air": {"air_temperature_k": temperature}}
        provenance = Provenance(parameters=flat_values(stated, "sar_compression."))
        return _series_of(SimpleNamespace(provenance=provenance, estimator="ml"), Tracker.settings())

    assert series(280.0, 46) == series(281.0, 46) != series(280.0, 45)


def test_a_dwell_may_have_air_as_long_as_a_message_that_it_would_use_can_arrive() -> None:
    sensor, latest_ns = make_sensor(), DWELL_NS + 60 * SECOND
    assert may_have_air(AirHistory(), {}, KEY, sensor, HEARD)
    assert may_have_air(AirHistory(), {PRESSURE: latest_ns, TEMPERATURE: latest_ns}, KEY, sensor, HEARD)
    assert not may_have_air(AirHistory(), {PRESSURE: latest_ns + 1}, KEY, sensor, HEARD)
    assert may_have_air(history_of(), {PRESSURE: FOREVER_NS}, KEY, sensor, HEARD)
    assert not may_have_air(
        history_of(pressure=100.0), {PRESSURE: FOREVER_NS, TEMPERATURE: FOREVER_NS}, KEY, sensor, HEARD
    )
    assert not may_have_air(history_of(temperature=61.0), {TEMPERATURE: FOREVER_NS}, KEY, sensor, HEARD)


def test_humidity_that_will_not_arrive_concerns_radio_waves_only() -> None:
    history = history_of()
    history._samples[HUMIDITY].clear()
    assert may_have_air(history, {HUMIDITY: FOREVER_NS}, KEY, make_sensor(), HEARD)
    assert not may_have_air(history, {HUMIDITY: FOREVER_NS}, KEY, RADIO, HEARD)
