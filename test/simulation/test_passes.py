"""Flights in passes to and fro over the same ground."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from sal_height.elevation import ESTIMATORS
from sal_height.errors import UserError
from sal_height.geometry import Trajectory
from sal_height.imaging import ImageSettings
from sal_height.imaging.pixels import aim_point
from sal_height.pipeline import Compressor, heights
from sal_height.simulation import Preset, flight_of, load_preset
from sal_height.simulation.preset import Passes, parse_preset

PASSES = Passes(count=3, interval_s=60.0)


def flown_to_and_fro(gust_mps: float = 0.0) -> Preset:
    """Two dwells in each of three passes."""
    preset = load_preset("sal_spotlight")
    return replace(preset, dwells=6, flight=replace(preset.flight, passes=PASSES, gust_mps=gust_mps))


def test_every_second_pass_sees_the_same_ground_from_the_other_side() -> None:
    flight = flight_of(flown_to_and_fro(), 1)
    apertures = [flight.aperture(dwell) for dwell in range(6)]
    starts = [flight.dwell_start_ns(dwell) * 1e-9 for dwell in range(6)]
    spacing_s = flight.preset.dwell_spacing_m / 50

    np.testing.assert_allclose(starts, [0, spacing_s, 60, 60 + spacing_s, 120, 120 + spacing_s], atol=1e-9)
    np.testing.assert_allclose([a.velocity[0] for a in apertures], [50, 50, -50, -50, 50, 50], atol=1e-12)
    np.testing.assert_allclose([a.rotation[0, 0] for a in apertures], [1, 1, -1, -1, 1, 1], atol=1e-12)
    aims = np.array([aim_point(flight.sensor, aperture, 5000.0) for aperture in apertures])
    half = flight.preset.dwell_spacing_m / 2
    np.testing.assert_allclose(aims[:, 0], [-half, half, half, -half, -half, half], atol=1e-6)
    np.testing.assert_allclose(aims[:, 1:], np.tile([0, flight.scene.reference_height], (6, 1)), atol=2e-3)
    np.testing.assert_allclose(apertures[2].position[1], -apertures[0].position[1])


@pytest.mark.parametrize("gust_mps", [0.0, 2.0])
def test_odometry_of_each_pass_covers_its_dwells_and_no_turn_between_them(gust_mps: float) -> None:
    flight = flight_of(flown_to_and_fro(gust_mps), 2)
    for dwell in (0, 2, 4):
        states = flight.platform_states(dwell) + flight.platform_states(dwell + 1)
        assert np.ptp([state.stamp_ns for state in states]) < 1e9
        track = Trajectory(states)
        for one in (dwell, dwell + 1):
            aperture = track.aperture(flight.dwell_start_ns(one), flight.pulse_times)
            np.testing.assert_allclose(aperture.position, flight.aperture(one).position, atol=1e-5)
            np.testing.assert_allclose(aperture.rotation, flight.aperture(one).rotation, atol=1e-6)


def test_a_pass_westwards_gives_the_heights_of_the_street() -> None:
    preset = flown_to_and_fro()
    flight, ml = flight_of(preset, 3), ESTIMATORS["ml"]
    settings = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols)
    slc = Compressor().add(flight.phase_history(2), flight.track(2), flight.sensor, settings)
    assert slc
    field = heights(slc, flight.sensor, ml, ml.settings(range_looks=2, azimuth_looks=2))
    places = field.first.positions[np.isfinite(field.first.height)]
    truth = flight.scene.heights(places[:, 0], places[:, 1])
    found = field.first.height[np.isfinite(field.first.height)]
    assert len(found) > 200
    assert np.median(np.abs(found - truth)) < 0.05


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"count": 17}, "dwells is 16 and flight.passes.count is 17; .* so give 17 dwells or more, or fewer passes"),
        ({"count": 2, "interval_s": 0.5}, "flight.passes.interval_s is 0.5; a pass takes 0.093 s, so it must be 1.09"),
        ({"count": 0}, "flight.passes.count"),
    ],
)
def test_passes_that_cannot_be_flown_are_refused(changes: dict[str, float], says: str) -> None:
    content = asdict(load_preset("sal_spotlight"))
    content["flight"]["passes"] = changes
    with pytest.raises(UserError, match=says):
        parse_preset(content, "test")


def strips_to_and_fro() -> Preset:
    """Four blocks of stripmap in each of two passes."""
    preset = load_preset("sal_stripmap")
    return replace(preset, dwells=8, flight=replace(preset.flight, passes=Passes(2, 60.0)))


def test_a_strip_westwards_gives_the_heights_of_the_street_in_places_that_the_other_has_seen() -> None:
    flight, ml, places = flight_of(strips_to_and_fro(), 3), ESTIMATORS["ml"], []
    settings = ImageSettings(air="none", rows=46, cols=128)
    for number in range(2):
        compressor = Compressor()
        for dwell in range(4 * number, 4 * number + 4):
            slc = compressor.add(flight.phase_history(dwell), flight.track(dwell), flight.sensor, settings)
        assert slc
        field = heights(slc, flight.sensor, ml, ml.settings(range_looks=1, azimuth_looks=16))
        there = np.isfinite(field.first.height)
        found, place = field.first.height[there], field.first.positions[there]
        assert len(found) > 150
        assert np.median(np.abs(found - flight.scene.heights(place[:, 0], place[:, 1]))) < 0.02
        places.append(place[:, 0])
    np.testing.assert_allclose(np.median(places[1]), -np.median(places[0]), atol=0.1)


def test_the_first_pass_of_strips_is_that_of_a_flight_of_one_pass() -> None:
    """To the last bit; the second one sees other speckle."""
    preset = strips_to_and_fro()
    alone = replace(preset, dwells=4, flight=replace(preset.flight, passes=Passes()))
    one, two = (flight_of(some, 3).phase_history(1).samples for some in (alone, preset))
    np.testing.assert_array_equal(one, two)
    flight = flight_of(preset, 3)
    grounds = [flight._ground((number, 1))[1] for number in range(2)]
    shared = min(len(ground) for ground in grounds)
    alike = np.vdot(*(ground[:shared] for ground in grounds))
    assert abs(alike) < 0.05 * np.prod([np.linalg.norm(ground) for ground in grounds])


def test_dwells_beyond_a_flight_continue_it() -> None:
    """Strips ask for the ground of blocks before the first and after the last."""
    flight = flight_of(load_preset("sal_stripmap"), 1)
    starts = [flight.dwell_start_ns(dwell) for dwell in range(-3, flight.dwells + 3)]
    np.testing.assert_allclose(np.diff(starts), starts[4] - starts[3], atol=1)
