"""Where a dwell lies along the flight: what data and navigation say of it, each for what it is worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import assert_one_sentence, few, make_aperture, refused
from scipy.spatial.transform import Rotation

from sal_height.elevation import ESTIMATORS, MlSettings, Validity
from sal_height.errors import Rejected
from sal_height.geometry import EXACT, PlatformState, Trajectory, look_direction
from sal_height.imaging import ImageSettings, Slc
from sal_height.imaging.autofocus.gradient import AutofocusSettings, autofocus, is_for_speckle, patch_centres
from sal_height.imaging.autofocus.placement import (
    Centroid,
    NavigationPrior,
    Placement,
    placed_by_centroid,
    placed_by_navigation,
    vibration_speed,
)
from sal_height.imaging.pixels import line_of_sight
from sal_height.pipeline import Compressor, heights
from sal_height.relief import pose_covariance
from sal_height.sensor.sensor import PhaseHistory
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.simulation.harmonics import Harmonics

SPEED, RANGE, AMBIGUITY = 50.0, 5000.0, 0.031


@pytest.fixture(scope="module")
def flight() -> SimulatedFlight:
    return flight_of(load_preset("sal_spotlight"), seed=5)


@pytest.fixture(scope="module")
def history(flight: SimulatedFlight) -> PhaseHistory:
    return flight.phase_history(7)


def track_of(
    flight: SimulatedFlight, speed: float, pointing: float, stated: tuple[float, float] = (0.0, 0.0)
) -> Trajectory:
    """Odometry whose velocity lacks `speed` (m/s) along the line of sight and whose attitude lacks `pointing` (rad).

    It states standard deviations of velocity and attitude.
    """
    aperture, middle = flight.aperture(7), flight.dwell_start_ns(7) + round(5e8 * flight.pulse_times[-1])
    sight = line_of_sight(flight.sensor, aperture)
    states = [
        replace(
            state,
            position=state.position - speed * (state.stamp_ns - middle) * 1e-9 * sight,
            velocity=state.velocity - speed * sight,
            covariance=np.diag([0.0] * 3 + [stated[1] ** 2] * 3),
            velocity_covariance=stated[0] ** 2 * np.eye(3),
        )
        for state in flight.track(7).states
    ]
    turned = [_turned(state, -pointing * np.cross(sight, aperture.direction)) for state in states]
    return Trajectory(turned, accuracy=EXACT)


def _turned(state: PlatformState, rotation: np.ndarray) -> PlatformState:
    return replace(
        state, orientation=(Rotation.from_rotvec(rotation) * Rotation.from_quat(state.orientation)).as_quat()
    )


def compressed(flight: SimulatedFlight, history: PhaseHistory, track: Trajectory, **settings: object) -> Slc:
    slc = Compressor().add(history, track, flight.sensor, ImageSettings(air="none", rows=184, cols=12, **settings))
    assert slc is not None
    return slc


def test_sum_is_divided_as_navigation_states_its_parts() -> None:
    """Equal parts: half each; the error that is left is that of the difference."""
    equal = NavigationPrior(0.003, 0.003 / SPEED, SPEED)
    placed = placed_by_centroid(Centroid(0.004, 1e-5), equal, AMBIGUITY)
    assert placed.speed == pytest.approx(0.002, rel=1e-4)
    assert SPEED * placed.pointing == pytest.approx(0.002, rel=1e-4)
    assert placed.speed_error == pytest.approx(0.003 / np.sqrt(2), rel=1e-3)
    exact_pointing = placed_by_centroid(Centroid(0.004, 1e-5), NavigationPrior(0.003, 0.0, SPEED), AMBIGUITY)
    assert (exact_pointing.speed, exact_pointing.pointing) == (pytest.approx(0.004, rel=1e-4), 0.0)
    assert exact_pointing.speed_error == pytest.approx(1e-5, rel=1e-3)
    unstated = placed_by_centroid(Centroid(0.004, 1e-5), NavigationPrior(0.0, 0.0, SPEED), AMBIGUITY)
    assert (unstated.speed, SPEED * unstated.pointing, unstated.speed_error) == (0.0, pytest.approx(0.004), 0.0)


def test_parts_are_those_of_drawn_errors() -> None:
    """10 000 draws, few or nearly all of them wrapped: errors of place have the standard deviation stated, to 3 %.

    The lit ground is where the velocity, and as many ambiguities as were wrapped, have it.
    """
    rng = np.random.default_rng(1)
    for speed, pointing in ((0.003, 2e-5), (0.01, 1e-4), (0.012, 3e-4), (0.03, 8.7e-3)):
        prior = NavigationPrior(speed, pointing, SPEED)
        drawn = np.stack([speed * rng.standard_normal(10_000), SPEED * pointing * rng.standard_normal(10_000)])
        found = drawn.sum(axis=0) + 1e-4 * rng.standard_normal(10_000)
        wraps = np.round(found / AMBIGUITY) * AMBIGUITY
        placed = [placed_by_centroid(Centroid(one, 1e-4), prior, AMBIGUITY) for one in (found - wraps).tolist()]
        error = np.array([one.speed for one in placed]) + wraps - drawn[0]
        stated = np.array([one.speed_error for one in placed])
        assert np.sqrt(np.mean(error**2)) == pytest.approx(np.sqrt(np.mean(stated**2)), rel=0.03)


@pytest.mark.parametrize(("speed", "pointing"), [(0.005, 0.0), (0.003, 6e-5)])
def test_own_errors_are_those_that_differ_from_dwell_to_dwell(speed: float, pointing: float) -> None:
    """10 000 dwells of one error of navigation, each with its own vibration and centroid: the deviation is that stated.

    To 3 %, four times its Monte Carlo error.
    """
    rng, error, vibration = np.random.default_rng(3), 1e-3, 2e-3
    prior = NavigationPrior(speed, pointing, SPEED)
    moved = 1.2 * speed + vibration * rng.standard_normal(10_000)
    found = moved - 0.7 * SPEED * pointing + error * rng.standard_normal(10_000)
    placed = [placed_by_centroid(Centroid(one, error, vibration), prior, AMBIGUITY) for one in found.tolist()]
    left = np.array([one.speed for one in placed]) - moved
    assert np.std(left) == pytest.approx(placed[0].own_error, rel=0.03)
    assert placed[0].own_error < 0.9 * placed[0].speed_error or not pointing


@pytest.mark.parametrize("velocity", [(50.0, 0.0, 0.0), (48.0, 15.0, -2.5), (-40.0, 0.0, 5.0)])
def test_an_aircraft_that_sinks_or_drifts_moves_surfaces_at_their_elevation(velocity: tuple[float, ...]) -> None:
    """What is open along the flight says nothing of height if the body is level; beams turn by what is stated."""
    aperture = make_aperture(velocity=velocity)
    sight = aperture.rotation @ look_direction(0.8, 0.0, 1)
    placement = Placement(0.0, 2e-4, 0.005)
    placed = placement.seen_from(aperture, sight, RANGE)
    covariance = pose_covariance(aperture.position + RANGE * sight, placed)
    speed = float(np.linalg.norm(velocity))
    assert np.sqrt(aperture.direction @ covariance @ aperture.direction) == pytest.approx(0.005 * RANGE / speed)
    assert np.sqrt(covariance[2, 2]) < 1e-9
    ahead = (placed.rotation @ look_direction(0.8, 0.0, 1) - sight) @ aperture.direction
    assert ahead == pytest.approx(2e-4, rel=1e-3)


def test_what_odometry_states_is_a_prior_and_zeros_count_as_exact(flight: SimulatedFlight) -> None:
    aperture = flight.aperture(7)
    sight = line_of_sight(flight.sensor, aperture)
    assert NavigationPrior.of(aperture, np.zeros((3, 3)), sight).spread == 0
    stated = NavigationPrior.of(replace(aperture, covariance=4e-8 * np.eye(6)), 9e-6 * np.eye(3), sight)
    assert (stated.speed, stated.pointing) == (pytest.approx(0.003), pytest.approx(2e-4))


@pytest.mark.parametrize(("speed", "pointing"), [(0.002, 0.0), (-0.012, 0.0), (0.0, 5e-5), (0.006, -1e-4)])
def test_centroid_tells_velocity_and_pointing_together(
    flight: SimulatedFlight, history: PhaseHistory, speed: float, pointing: float
) -> None:
    """To .15 mm/s, a hundredth of the beam; the image lies within 3 standard deviations of where it is."""
    stated = max(abs(speed), 1e-6), max(abs(pointing), 1e-9)
    truth = compressed(flight, history, flight.track(7))
    slc = compressed(flight, history, track_of(flight, speed, pointing, stated))
    sight = line_of_sight(flight.sensor, truth.aperture)
    found = sight @ (slc.aperture.velocity - truth.aperture.velocity)
    ahead = (line_of_sight(flight.sensor, slc.aperture) - sight) @ truth.aperture.direction
    assert found + SPEED * ahead == pytest.approx(0.0, abs=1.5e-4)
    if not (speed and pointing):
        assert found == pytest.approx(0.0, abs=1.5e-4)
        assert slc.aperture.covariance[0, 0] < 0.03**2
        assert not speed or slc.aperture.covariance[0, 0] > 0.005**2
    assert abs(found) <= 3 * np.sqrt(slc.aperture.covariance[0, 0]) * SPEED / RANGE + 1e-5


def test_velocity_that_is_stated_as_uncertain_no_longer_spoils_heights(
    flight: SimulatedFlight, history: PhaseHistory
) -> None:
    """3 mm/s: without autofocus fewer than half of the heights are within sigma; with it as many as with the truth."""
    good = share_within_sigma(flight, compressed(flight, history, flight.track(7)))
    wrong = track_of(flight, 0.003, 0.0, (0.003, 0.0))
    assert share_within_sigma(flight, compressed(flight, history, wrong, autofocus="never")) < 0.5
    assert share_within_sigma(flight, compressed(flight, history, wrong)) > good - 0.04


def share_within_sigma(flight: SimulatedFlight, slc: Slc) -> float:
    """Of the heights of a dwell of the street beside its kerb, against their median in each row of pixels."""
    field = heights(slc, flight.sensor, ESTIMATORS["ml"], MlSettings(range_looks=2, azimuth_looks=2))
    level = np.abs(field.first.height) / field.first.sigma
    return float(np.mean(level[field.validity == Validity.OK] < 1))


def test_navigation_that_is_contradicted_is_refused(flight: SimulatedFlight, history: PhaseHistory) -> None:
    with refused(Rejected, "m/s", "stated", reason="Doppler centroid contradicts navigation"):
        compressed(flight, history, track_of(flight, 0.004, 0.0, (2e-4, 0.0)))


def test_a_dwell_that_needs_autofocus_and_has_nothing_to_focus_on_is_refused(
    flight: SimulatedFlight, history: PhaseHistory
) -> None:
    rng = np.random.default_rng(6)
    noise = rng.standard_normal((2, *history.samples.shape)) * np.sqrt(flight.sensor.noise_power[0] / 2)
    empty = replace(history, samples=(noise[0] + 1j * noise[1]).astype(np.complex64))
    with refused(Rejected, "0.005 m/s", reason="autofocus"):
        compressed(flight, empty, track_of(flight, 0.0, 0.0, (0.005, 0.0)))


def test_without_autofocus_what_navigation_leaves_open_is_in_the_covariance(
    flight: SimulatedFlight, history: PhaseHistory
) -> None:
    slc = compressed(flight, history, track_of(flight, 0.0, 0.0, (0.002, 0.0)), autofocus="never")
    along = 0.002 * RANGE / SPEED
    np.testing.assert_allclose(slc.aperture.covariance[:3, :3], np.diag([along**2, 0, 0]), atol=1e-6)
    assert placed_by_navigation(NavigationPrior(0.002, 1e-3, SPEED)).speed_error == 0.002


@pytest.mark.parametrize(("lowest_hz", "highest_hz"), [(10.0, 2000.0), (40.0, 600.0)])
def test_mean_velocity_of_a_vibration_is_told_from_the_rest_of_its_phase(lowest_hz: float, highest_hz: float) -> None:
    """Lines of one velocity and of all octaves: velocities over what is told for them have a median of about 1."""
    rng, seconds, ratios = np.random.default_rng(9), 2.5e-5 * np.arange(64), []
    for _ in range(400):
        omega = 2 * np.pi * np.array([np.exp(rng.uniform(*np.log([lowest_hz, highest_hz])))])
        motion = Harmonics(omega, np.array([[0.003]]), rng.uniform(0, 2 * np.pi, (1, 1)))
        phase = 4 * np.pi / 1.55e-6 * motion.displacement(seconds)[:, 0]
        time = np.linspace(-1, 1, 64)
        trend = (time @ phase) / (time @ time)
        rest = phase - phase.mean() - trend * time
        speed = trend * 2 / (seconds[-1] - seconds[0]) * 1.55e-6 / (4 * np.pi)
        ratios.append(abs(speed) / vibration_speed(rest, seconds, 1.55e-6))
    assert 0.1 < np.median(ratios) < 1.5
    assert np.mean(np.array(ratios) > 10) < 0.25


def test_shapes_of_vibrations_are_those_of_sampled_waves() -> None:
    """The powers of 200 frequencies in a dwell, each projected on its polynomials by many pulses, within 1 %."""
    wavelength, seconds = 1.55e-6, np.linspace(0.0, 1.6e-3, 2001)
    shapes = np.polynomial.legendre.legvander(np.linspace(-1, 1, 2001), 3)
    omega = 2 * np.pi * np.geomspace(10.0, 2000.0, 200)
    waves = np.exp(1j * omega * (seconds - seconds.mean())[:, None]) / omega
    of_mean, of_trend, *of_curvature = np.mean(np.abs(np.linalg.lstsq(shapes, waves)[0]) ** 2, axis=1)
    assert of_mean > of_trend
    for order, power in zip((2, 3), of_curvature, strict=True):
        # A curvature of one order alone counts half, as the mean of both.
        told = np.sqrt(of_trend / power / 2) * 2 / 1.6e-3 * wavelength / (4 * np.pi)
        assert vibration_speed(shapes[:, order], seconds, wavelength) == pytest.approx(told, rel=0.01)


def test_beams_that_speckle_cannot_tell_the_place_of_need_no_autofocus() -> None:
    """Those of a radar whose echoes migrate by range cells, and those of a sensor whose noise is not known."""
    flight = flight_of(load_preset("xband_relief"), seed=1)
    sensor, antenna = flight.spectrum, flight.position(flight.pulse_times)
    assert is_for_speckle(sensor, antenna)
    assert not is_for_speckle(replace(sensor, bandwidth=100 * sensor.bandwidth, config_hash=""), antenna)
    assert not is_for_speckle(replace(sensor, noise_power=(0.0,) * sensor.detector_count, config_hash=""), antenna)


@pytest.mark.parametrize(("speed", "doubted"), [(0.0, False), (0.0005, False), (0.0015, True), (-0.003, True)])
def test_a_velocity_that_is_wrong_and_stated_as_exact_is_doubted(
    flight: SimulatedFlight, history: PhaseHistory, speed: float, doubted: bool
) -> None:
    """From a tenth of a beam on, which is 0.8 mm/s."""
    slc = compressed(flight, history, track_of(flight, speed, 0.0))
    assert bool(slc.doubts) == doubted
    if doubted:
        assert_one_sentence(slc.doubts[0].sentence, "of a beamwidth", "twist", "autofocus")
        assert not compressed(flight, history, track_of(flight, speed, 0.0), autofocus="always").doubts


@pytest.mark.parametrize(
    ("changes", "unknown"),
    [
        ({"velocity_covariance": -1e-4 * np.eye(3)}, "velocity"),
        ({"velocity_covariance": np.full((3, 3), np.nan)}, "velocity"),
        ({"covariance": np.diag([-1.0, 0, 0, 0, 0, 0])}, "position, roll and pitch, heading"),
        ({"velocity_covariance": 1e6 * np.eye(3)}, "velocity"),
        ({"covariance": 1e6 * np.eye(6)}, "position, roll and pitch, heading"),
    ],
)
def test_covariances_that_are_absurd_are_said_and_end_nothing(
    flight: SimulatedFlight, history: PhaseHistory, changes: dict[str, np.ndarray], unknown: str
) -> None:
    """They count as not stated: the image is where the odometry has it."""
    stated = {"covariance": 1e-12 * np.diag([1.0, 2, 3, 1, 2, 3]), "velocity_covariance": 1e-12 * np.diag([1.0, 2, 3])}
    track = Trajectory([replace(state, **{**stated, **changes}) for state in flight.track(7).states])
    slc = compressed(flight, history, track)
    (doubt,) = slc.doubts
    assumed = doubt.sentence.partition("standard deviations of ")[2].partition(". State")[0]
    for part in ("position", "roll and pitch", "heading", "velocity"):
        assert (part in assumed) == (part in unknown)
    assert np.linalg.eigvalsh(slc.aperture.covariance)[0] >= -1e-12 * np.abs(slc.aperture.covariance).max()
    assert np.linalg.norm(slc.aperture.velocity - flight.aperture(7).velocity) < 1.5e-4


def test_a_boresight_that_is_known_to_err_is_looked_for(flight: SimulatedFlight, history: PhaseHistory) -> None:
    """What odometry states as exact, and the mounting not: the beams are found, and the image stays."""
    track = track_of(flight, 0.0, 5e-5)
    assert compressed(flight, history, track).doubts
    slc = compressed(flight, history, track, boresight_sigma_rad=5e-5)
    ahead = line_of_sight(flight.sensor, slc.aperture) @ flight.aperture(7).direction
    assert ahead == pytest.approx(0.0, abs=3e-6)
    assert not slc.doubts


@pytest.mark.parametrize(
    ("name", "dwells"),
    few(1, [("sal_spotlight", 16), ("xband_relief", 16), ("woods", 6)]),
)
def test_scenes_of_presets_move_the_centroid_as_far_as_is_stated(name: str, dwells: int) -> None:
    """By their uneven ground: rms over what is stated, of so many dwells; and none of them is doubted."""
    flown = flight_of(load_preset(name), seed=2)
    image, ratios = flown.preset.image, []
    for number in range(dwells):
        track, pulses = flown.track(number), flown.phase_history(number)
        exact = Compressor().add(
            pulses, track, flown.sensor, ImageSettings(air="none", rows=image.rows, cols=image.cols)
        )
        assert exact is not None
        assert not exact.doubts
        aperture, antenna = flown.aperture(number), track.positions(pulses.stamp_ns, pulses.pulse_times)
        patches = patch_centres(flown.spectrum, aperture, exact.grid)
        found = autofocus(pulses, antenna, flown.spectrum, patches, AutofocusSettings())
        assert found.finds_beams
        ratios.append(found.trend / found.trend_error)
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < 1.4
