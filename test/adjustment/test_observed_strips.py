"""What errors of navigation and mounting do to images of strips: as foretold, against images made with these errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from helpers import refused
from stated_errors import ERRORS, Error, displaced, foretold, layout_of

from sal_height.adjustment import AdjustmentSettings, ObservedDwell
from sal_height.adjustment.observed import own_priors, placement_in_strip
from sal_height.elevation import ESTIMATORS
from sal_height.errors import Rejected
from sal_height.geometry import PlatformState, Trajectory
from sal_height.imaging import ImageSettings, Placement, Slc
from sal_height.numeric import F64, vertex
from sal_height.pipeline import Compressor, heights
from sal_height.relief import HeightField
from sal_height.sensor import PhaseHistory
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.simulation.preset import MountingSettings, Passes

HEADING = {"east": 0, "west": 1}
BLOCKS = 4
LAYOUT = layout_of(0.0)

STATED = {"nothing": (0.0, 0.0), "attitude": (1e-6, 4e-5), "both": (0.004, 4e-5)}
"""Standard deviations that odometry states of velocity (m/s) and attitude (rad)."""


@dataclass(frozen=True, eq=False)
class Image:
    """The last image of a strip."""

    slc: Slc
    field: HeightField
    seen: ObservedDwell
    off: F64


@cache
def flown() -> SimulatedFlight:
    """Strips of four blocks, one eastwards and one westwards, of a sensor with an arm, in an exact flight."""
    preset = load_preset("sal_stripmap")
    mounting = MountingSettings(lever_arm_m=(1.0, -0.5, -0.8), boresight_rad=(0.02, 0.0, 0.1))
    flight = replace(preset.flight, passes=Passes(2, 60.0))
    sensor = replace(preset.sensor, mounting=mounting)
    return flight_of(replace(preset, dwells=2 * BLOCKS, flight=flight, sensor=sensor), 4)


@cache
def history_of(dwell: int) -> PhaseHistory:
    return flown().phase_history(dwell)


def states_of(strip: int, error: Error | None, stated: str) -> list[PlatformState]:
    """Odometry of a pass."""
    track = flown().track(strip * BLOCKS)
    for dwell in range(strip * BLOCKS, (strip + 1) * BLOCKS):
        track = track.followed_by(flown().track(dwell))
    velocity, attitude = STATED[stated]
    pose, spread = np.diag([0.0] * 3 + [attitude**2] * 3), velocity**2 * np.eye(3)
    states = error.states(track.states) if error else track.states
    return [replace(state, covariance=pose, velocity_covariance=spread) for state in states]


@cache
def imaged(strip: int, name: str | None, autofocus: str, stated: str = "nothing") -> Image:
    """The last image of a strip, made with an error; seconds count from the middle of its odometry."""
    flight, ml, error = flown(), ESTIMATORS["ml"], ERRORS[name] if name else None
    sensor = error.sensor(flight.sensor) if error else flight.sensor
    states = states_of(strip, error, stated)
    settings = ImageSettings(air="none", rows=46, cols=128, autofocus=autofocus)
    compressor, track = Compressor(), Trajectory(states)
    for dwell in range(strip * BLOCKS, (strip + 1) * BLOCKS):
        slc = compressor.add(history_of(dwell), track, sensor, settings)
    assert slc
    field = heights(slc, sensor, ml, ml.settings(range_looks=1, azimuth_looks=16))
    middle_ns = (states[0].stamp_ns + states[-1].stamp_ns) // 2
    seen = ObservedDwell.of(field, slc, sensor, track, history_of(dwell), middle_ns)
    unknowns = error.unknowns if error else ()
    return Image(slc, field, seen, foretold(displaced(0, seen, sensor.mounting, LAYOUT), unknowns))


def shift_along(one: Slc, other: Slc) -> float:
    """How far one image lies from another along the flight, m: where the powers of their pixels are most alike."""
    powers = [np.sum(np.abs(slc.images) ** 2, axis=0) for slc in (one, other)]
    powers = [power / power.mean() - 1 for power in powers]
    cols, spacing = powers[0].shape[1], other.grid.col_spacing
    alike = [
        np.mean(powers[0][:, max(0, lag) : cols + min(0, lag)] * powers[1][:, max(0, -lag) : cols - max(0, lag)])
        for lag in range(-cols // 2, cols // 2 + 1)
    ]
    top = int(np.argmax(alike[1:-1])) + 1
    lag = top - cols // 2 + vertex(*np.array(alike[top - 1 : top + 2]))[0]
    return float((one.grid.origin - other.grid.origin) @ other.aperture.direction + lag * spacing)


def test_strips_are_seen_when_the_antenna_was_abeam() -> None:
    """Odometry says where it was then: within a tenth of a millimetre."""
    flight, image = flown(), imaged(1, None, "never")
    track = Trajectory(states_of(1, None, "nothing")).mounted(flight.sensor.mounting)
    stamp_ns = (track.states[0].stamp_ns + track.states[-1].stamp_ns) // 2
    there = track.positions(stamp_ns + round(1e9 * image.seen.seconds), np.zeros(1))[0]
    np.testing.assert_allclose(there, image.slc.aperture.position, atol=1e-4)
    assert image.seen.seconds < track.states[-1].stamp_ns * 1e-9 - stamp_ns * 1e-9 - 0.01


NAVIGATED = [
    name for name in ERRORS if not name.startswith(("velocity", "attitude", "boresight")) or name.endswith("x")
]


@pytest.mark.parametrize("heading", HEADING)
@pytest.mark.parametrize("name", [name for name in NAVIGATED if name != "velocity x"])
def test_surfaces_move_as_foretold(name: str, heading: str) -> None:
    """Of strips whose phases are left alone; within 4 mm, a twentieth of a pixel, and 3 %."""
    exact, wrong = (imaged(HEADING[heading], one, "never") for one in (None, name))
    moved = (wrong.field.first.positions - exact.field.first.positions).reshape(-1, 3)
    assert np.linalg.norm(wrong.off) > 0.1
    np.testing.assert_allclose(np.nanmedian(moved, axis=0), wrong.off, atol=0.004 + 0.03 * np.abs(wrong.off).max())


@pytest.mark.parametrize("heading", HEADING)
@pytest.mark.parametrize("name", ERRORS)
def test_images_move_along_the_flight_as_foretold(name: str, heading: str) -> None:
    """Within 4 mm, by errors of the velocity, and not at all by where the beams look."""
    exact, wrong = (imaged(HEADING[heading], one, "never") for one in (None, name))
    along = exact.slc.aperture.direction
    assert shift_along(wrong.slc, exact.slc) == pytest.approx(float(wrong.off @ along), abs=0.004)
    if name in {"velocity y", "velocity z"}:
        assert abs(wrong.off @ along) > 0.1


@pytest.mark.parametrize("stated", STATED)
@pytest.mark.parametrize("name", ["velocity x", "velocity y", "velocity z", "attitude y", "attitude z", "boresight z"])
def test_images_without_phase_errors_follow_their_beams(name: str, stated: str) -> None:
    """Within 4 mm, and 2 % of 25 cm: whatever their share of what the Doppler centroid of the first block tells."""
    exact, wrong = (imaged(1, one, "always", stated) for one in (None, name))
    along = exact.slc.aperture.direction
    expected = float((wrong.off - exact.off) @ along)
    assert shift_along(wrong.slc, exact.slc) == pytest.approx(expected, abs=0.004, rel=0.02)
    assert wrong.seen.placement.by_beams


@pytest.mark.parametrize("removed", [False, True])
def test_strips_of_which_some_blocks_have_their_phase_removed_lie_nowhere(removed: bool) -> None:
    placement = Placement(0.0, 0.0, 0.0, by_beams=not removed)
    with refused(Rejected, "set autofocus to auto"):
        placement_in_strip(placement, phase_removed=removed)
    assert placement_in_strip(placement, phase_removed=not removed) == placement


def test_beams_are_known_as_well_as_jitter_and_autofocus_let_them() -> None:
    """15 mm by 3 urad at 5 km, and 20 mm by .2 mm/s at 50 m/s."""
    image = imaged(1, None, "always").seen
    image = replace(image, placement=replace(image.placement, beams_error=2e-4))
    (prior,) = own_priors({0: image}, LAYOUT, AdjustmentSettings(jitter_rad=3e-6), 0.0, {})
    np.testing.assert_allclose(np.sqrt(1 / np.diag(prior.information)), [0.025, 3e-6], rtol=1e-3)
