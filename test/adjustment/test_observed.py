"""What errors of navigation and mounting do to a dwell: as foretold, against images made with these errors."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stated_errors import ERRORS, Error, S, displaced, foretold, layout_of, squeezed

from sal_height.adjustment import AdjustmentSettings, ObservedDwell
from sal_height.adjustment.observed import (
    BORESIGHT,
    COMMON,
    DELAY,
    EDGES,
    GROUND,
    LEVER_ARM,
    PITCH,
    centroid,
    own_priors,
)
from sal_height.elevation import ESTIMATORS
from sal_height.geometry import Trajectory, locate_at_elevation, look_direction, sphere_coordinates
from sal_height.imaging import ImageSettings, Slc
from sal_height.numeric import F64, vertex
from sal_height.pipeline import Compressor, heights
from sal_height.relief import HeightField, turn_jacobian
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.simulation.preset import MountingSettings, Passes, TargetSettings

DWELL = {"east": 0, "west": 1}
LAYOUT = layout_of(0.0, 60.0)


@cache
def flown() -> SimulatedFlight:
    """Two dwells, one eastwards and one westwards, of a sensor with an arm, in an exact flight past a bright target."""
    target = TargetSettings(east_m=0.05, north_m=0.3, height_m=0.1, power_db=45.0)
    preset = replace(load_preset("sal_spotlight"), targets=(target,))
    mounting = MountingSettings(lever_arm_m=(1.0, -0.5, -0.8), boresight_rad=(0.02, 0.0, 0.1))
    flight = replace(preset.flight, passes=Passes(2, 60.0))
    return flight_of(replace(preset, dwells=2, flight=flight, sensor=replace(preset.sensor, mounting=mounting)), 4)


@cache
def history_of(dwell: int) -> PhaseHistory:
    return flown().phase_history(dwell)


def imaged(dwell: int, error: Error | None, **settings: object) -> tuple[Slc, HeightField, Sensor]:
    flight, ml = flown(), ESTIMATORS["ml"]
    states, sensor = flight.track(dwell).states, flight.sensor
    if error:
        states, sensor = error.states(states), error.sensor(sensor)
    image = ImageSettings(air="none", rows=184, cols=12, **{"autofocus": "never", **settings})
    track = Trajectory(states, accuracy=flight.odometry_accuracy)
    slc = Compressor().add(history_of(dwell), track, sensor, image)
    assert slc
    return slc, heights(slc, sensor, ml, ml.settings(range_looks=2, azimuth_looks=2)), sensor


def observed(dwell: int, slc: Slc, field: HeightField) -> ObservedDwell:
    flight = flown()
    return ObservedDwell.of(field, slc, flight.sensor, flight.track(dwell), history_of(dwell))


MOVING = [name for name in ERRORS if not name.startswith(("velocity", "attitude", "boresight")) or name.endswith("x")]


@pytest.mark.parametrize("heading", DWELL)
@pytest.mark.parametrize("name", [name for name in MOVING if name != "velocity x"])
def test_surfaces_move_as_foretold(name: str, heading: str) -> None:
    """Within 4 mm, a twentieth of a pixel, and 3 %."""
    dwell, error = DWELL[heading], ERRORS[name]
    slc, exact, sensor = imaged(dwell, None)
    _, wrong, _ = imaged(dwell, error)
    form = displaced(dwell, observed(dwell, slc, exact), sensor.mounting, LAYOUT)
    moved = (wrong.first.positions - exact.first.positions).reshape(-1, 3)
    expected = foretold(form, error.unknowns)
    assert np.linalg.norm(expected) > 0.1
    np.testing.assert_allclose(np.nanmedian(moved, axis=0), expected, atol=0.004 + 0.03 * np.abs(expected).max())


@pytest.mark.parametrize("heading", DWELL)
@pytest.mark.parametrize("name", [name for name in ERRORS if name not in MOVING] + ["velocity x"])
def test_a_target_moves_along_the_flight_as_foretold(name: str, heading: str) -> None:
    """Within 4 mm, by errors of the velocity, and not at all by where the beams look."""
    dwell, error = DWELL[heading], ERRORS[name]
    (slc, exact, sensor), (wrong, _, _) = imaged(dwell, None), imaged(dwell, error)
    form = displaced(dwell, observed(dwell, slc, exact), sensor.mounting, LAYOUT)
    moved = (peak_of(wrong) - peak_of(slc)) @ slc.aperture.direction
    expected = foretold(form, error.unknowns) @ slc.aperture.direction
    if name in {"velocity y", "velocity z"}:
        assert abs(expected) > 0.1
    assert moved == pytest.approx(expected, abs=0.004)


@pytest.mark.parametrize("by_beams", [False, True])
@pytest.mark.parametrize(("course", "drift", "climb"), [(0.0, 0.0, -5.0), (2.1, 0.1, 0.0), (np.pi, -0.2, 3.0)])
def test_an_aircraft_that_sinks_or_drifts_sees_errors_as_foretold(
    course: float, drift: float, climb: float, by_beams: bool
) -> None:
    """By finite differences at its range, Doppler and elevation, to 1 %: velocity, or where the beams look."""
    slc, field, sensor = imaged(0, None)
    body = Rotation.from_euler("ZYX", [course + drift, 0.03, 0.02])
    velocity = np.array([50 * np.cos(course), 50 * np.sin(course), climb])
    true = replace(slc.aperture, velocity=velocity, rotation=body.as_matrix())
    side, slant_range, elevation = sensor.look_side, 5000.0, 0.79
    sight = true.rotation @ look_direction(elevation, 0.0, side)
    place = true.position + slant_range * sight
    there = replace(observed(0, slc, field).points, place=np.stack(sphere_coordinates(place))[None])
    placement = replace(slc.placement, by_beams=by_beams, pointing=0.0)
    dwell = replace(observed(0, slc, field), points=there, aperture=true, placement=placement)
    form = displaced(0, dwell, sensor.mounting, LAYOUT)

    def seen(error: F64) -> F64:
        """Where the surface seems to be if that is stated beyond the velocity, or beyond where the beams look."""
        stated = true if by_beams else replace(true, velocity=velocity + error)
        along = float(velocity @ sight) / np.linalg.norm(stated.velocity)
        if by_beams:
            along = float((sight + np.cross(error, sight)) @ true.direction)
        return locate_at_elevation(elevation, slant_range, slant_range * along, stated, side)

    # An attitude that errs turns the plane of elevation, too; where the image lies along the flight is what is new.
    first = 6 if by_beams else 3
    own = turn_jacobian(place, true) if by_beams else np.zeros((3, 3))
    size = 1e-6 if by_beams else 1e-4
    found = np.column_stack([(seen(size * axis) - seen(-size * axis)) / (2 * size) for axis in np.eye(3)])
    expected = form.values[:, first : first + 3] - own
    np.testing.assert_allclose(found, expected, atol=0.01 * np.abs(found).max())


def peak_of(slc: Slc) -> F64:
    """Place in the slant plane of the brightest target, by parabolas through the logarithm of the power."""
    power = np.log(np.sum(np.abs(slc.images) ** 2, axis=0))
    row, col = np.unravel_index(np.argmax(power[1:-1, 1:-1]), (power.shape[0] - 2, power.shape[1] - 2))
    row, col = row + 1, col + 1
    (down, _), (right, _) = vertex(*power[row - 1 : row + 2, col]), vertex(*power[row, col - 1 : col + 2])
    return slc.grid.points(row + down, col + right)


def test_pitch_of_beams_stretches_what_is_seen() -> None:
    slc, exact, sensor = imaged(0, None)
    _, wrong, _ = imaged(0, Error((), lambda states: states, lambda one: squeezed(one, 0.02)))
    moved = (wrong.first.positions - exact.first.positions).reshape(-1, 3)
    there = np.isfinite(moved).all(axis=1)
    middle = observed(0, slc, exact)
    for half in (slice(0, there.sum() // 3), slice(2 * there.sum() // 3, None)):
        numbers = np.flatnonzero(there)[half]
        place = exact.first.positions.reshape(-1, 3)[numbers]
        part = replace(middle.points, place=np.stack(sphere_coordinates(place), axis=-1))
        form = displaced(0, replace(middle, points=part), sensor.mounting, LAYOUT)
        expected = foretold(form, ((S + PITCH, 0.02),))
        assert np.linalg.norm(expected) > 0.01
        np.testing.assert_allclose(np.median(moved[numbers], axis=0), expected, atol=0.006)


@pytest.mark.parametrize("heading", DWELL)
@pytest.mark.parametrize("name", ["velocity y", "velocity z", "attitude z", "attitude y", "boresight z"])
def test_centroid_is_off_as_foretold(name: str, heading: str) -> None:
    """Within .4 mm/s, 5 % of a beam, and 3 % of the error."""
    dwell, error = DWELL[heading], ERRORS[name]
    found = [imaged(dwell, one, autofocus="always") for one in (None, error)]
    told = []
    for slc, field, _ in found:
        equation = centroid(dwell, observed(dwell, slc, field), LAYOUT, AdjustmentSettings())
        assert equation is not None
        told.append(equation)
    named = np.concatenate([LAYOUT.drift.knots[dwell].columns, LAYOUT.common])
    values = {int(named[number]): size for number, size in error.unknowns}
    expected = told[0].values @ [values.get(column, 0.0) for column in told[0].columns.tolist()]
    assert told[1].right - told[0].right == pytest.approx(expected, abs=4e-4, rel=0.03)


def one_dwell() -> ObservedDwell:
    slc, field, _ = imaged(0, None)
    return observed(0, slc, field)


def test_vibration_leaves_open_where_a_dwell_lies_along_the_flight() -> None:
    """By its lever, slant range over speed: 0.8 m at 5 km, 50 m/s and 8 mm/s; jitter is known apart."""
    dwell = one_dwell()
    (prior,) = own_priors({0: dwell}, LAYOUT, AdjustmentSettings(jitter_rad=3e-6), 0.008, {})
    assert dwell.lever == pytest.approx(dwell.slant_range / dwell.speed)
    np.testing.assert_allclose(np.sqrt(1 / np.diag(prior.information)), [0.008 * dwell.lever, 3e-6])


def test_velocity_of_a_knot_moves_the_dwells_after_it() -> None:
    """By what the knot's position changes until the dwell."""
    dwell, mounting = one_dwell(), flown().sensor.mounting
    at, later = (
        displaced(0, replace(dwell, stated=replace(dwell.stated, seconds=seconds)), mounting, LAYOUT).values
        for seconds in (0.0, 2.5)
    )
    np.testing.assert_allclose((later - at)[:, 3:6], 2.5 * np.eye(3), atol=1e-12)


def test_an_attitude_swings_the_antenna_on_its_arm() -> None:
    dwell, mounting = one_dwell(), flown().sensor.mounting
    with_arm, without = (
        displaced(0, dwell, one, LAYOUT).values[:, 6:9]
        for one in (mounting, replace(mounting, lever_arm=(0.0, 0.0, 0.0)))
    )
    body = dwell.aperture.rotation @ mounting.axes.inv().as_matrix()
    arm = body @ np.array(mounting.lever_arm)
    for number, turn in enumerate(np.eye(3)):
        np.testing.assert_allclose((with_arm - without)[:, number], np.cross(turn, arm), atol=1e-12)


def test_images_that_lie_where_the_beams_are_turn_with_them() -> None:
    """Along the flight by the range times the turn of the line of sight; velocity does not move them."""
    dwell, mounting = one_dwell(), replace(flown().sensor.mounting, lever_arm=(0.0, 0.0, 0.0))
    dwell = replace(dwell, placement=replace(dwell.placement, by_beams=True))
    values, f = displaced(0, dwell, mounting, LAYOUT).values, dwell.aperture.direction
    expected = [dwell.slant_range * f @ np.cross(turn, dwell.sight) for turn in np.eye(3)]
    np.testing.assert_allclose(f @ values[:, 6:9], expected, atol=1e-6 * dwell.slant_range)
    assert max(np.abs(expected)) > 0.5 * dwell.slant_range
    since = dwell.seconds - LAYOUT.drift.knots[0].seconds
    np.testing.assert_allclose(values[:, 3:6], since * np.eye(3), atol=1e-12)


def test_slices_name_all_that_dwells_share() -> None:
    numbers = np.arange(COMMON)
    named = [*numbers[BORESIGHT], *numbers[LEVER_ARM], DELAY, PITCH, EDGES, *numbers[GROUND]]
    assert named == list(range(COMMON))
