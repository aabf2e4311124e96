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
    settings = ImageSettings(rows=preset.image.rows, cols=preset.image.cols)
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
        ({"count": 17}, "flight.passes.count is 17; it must be at most dwells, 16"),
        ({"count": 2, "interval_s": 0.5}, "flight.passes.interval_s is 0.5; a pass takes 0.093 s, so it must be 1.09"),
        ({"count": 0}, "flight.passes.count"),
    ],
)
def test_passes_that_cannot_be_flown_are_refused(changes: dict[str, float], says: str) -> None:
    content = asdict(load_preset("sal_spotlight"))
    content["flight"]["passes"] = changes
    with pytest.raises(UserError, match=says):
        parse_preset(content, "test")


def test_a_strip_has_one_pass() -> None:
    content = asdict(load_preset("sal_stripmap"))
    content["flight"]["passes"] = {"count": 2}
    with pytest.raises(UserError, match=r"flight\.passes\.count is 2; in stripmap it must be 1"):
        parse_preset(content, "test")


def test_dwells_beyond_a_flight_continue_it() -> None:
    """Strips ask for the ground of blocks before the first and after the last."""
    flight = flight_of(load_preset("sal_stripmap"), 1)
    starts = [flight.dwell_start_ns(dwell) for dwell in range(-3, flight.dwells + 3)]
    np.testing.assert_allclose(np.diff(starts), starts[4] - starts[3], atol=1)
