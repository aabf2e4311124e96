"""Movers in simulated strips: found without being told their velocity, with place, height and sigmas that are right."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import few
from scipy.spatial.transform import Rotation

from sal_height.errors import UserError
from sal_height.geometry import PlatformState, Trajectory
from sal_height.imaging import ImageSettings, Slc
from sal_height.movers import Looked, Mover, MoverSettings, StripMovers, search_strip
from sal_height.movers.detection import Driving, is_in_focus
from sal_height.movers.likelihood import _cached
from sal_height.movers.mover import without_ambiguities
from sal_height.movers.search import Search
from sal_height.movers.spectrum import Bins
from sal_height.pipeline import Compressor, movers, strip_with_movers
from sal_height.simulation.flight import SimulatedFlight, flight_of
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scene import PointScatterer

EAST, NORTH, HEIGHT = 0.05, 1.0, 1.0


def drifted(states: list[PlatformState], away: float) -> list[PlatformState]:
    """As odometry has them that believes to fly towards what it sees by so much (m/s) less fast."""
    velocity = away * np.array([0.0, np.sqrt(0.5), np.sqrt(0.5)])
    return [
        replace(state, velocity=state.velocity + velocity, position=state.position + 1e-9 * state.stamp_ns * velocity)
        for state in states
    ]


@cache
def strip(
    seed: int, *points: PointScatterer, dwells: int = 4, wrong: float = 0.0, erring: float = 0.0
) -> tuple[SimulatedFlight, list[Slc]]:
    """The street of sal_stripmap with other targets, and its images by odometry with a wrong velocity (m/s).

    It states an error of the velocity (m/s) that it may have besides.
    """
    errors = OdometryErrors(velocity_mps=erring, attitude_rad=2e-6 if erring else 0.0)
    preset = replace(load_preset("sal_stripmap"), dwells=dwells, impairments=Impairments(odometry=errors))
    flight = flight_of(preset, seed)
    flight = replace(flight, scene=replace(flight.scene, points=points))
    settings = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols)
    compressor, states, images = Compressor(), [], []
    for dwell in range(dwells):
        states += drifted(flight.platform_states(dwell), -wrong)
        slc = compressor.add(
            flight.phase_history(dwell), Trajectory(states, accuracy=flight.odometry_accuracy), flight.sensor, settings
        )
        images += [slc] if slc else []
    return flight, images


def looked(seed: int, *points: PointScatterer, rate: float = 1e-2, dwells: int = 4) -> list[Looked]:
    """Results of the search in each image with those before and after."""
    flight, images = strip(seed, *points, dwells=dwells)
    search = StripMovers[int](MoverSettings(false_alarm_rate=rate))
    found = []
    for number, slc in enumerate(images):
        found += search.add(strip_with_movers(slc, flight.sensor, MoverSettings()), number)
    found += search.end()
    assert [number for number, _ in found] == list(range(len(images)))
    return [one for _, one in found if one]


def mover(radial: float, power_db: float, east: float = EAST) -> PointScatterer:
    return PointScatterer(east, NORTH, HEIGHT, 10 ** (power_db / 10), radial_velocity=radial)


@pytest.mark.parametrize("radial", few(1, [-7e-3, 4e-3]))
def test_a_mover_gets_place_height_and_velocity(radial: float) -> None:
    """Ten times as bright as the ground: its image lies up to .7 m from it, which half of the beam's footprint is."""
    east = EAST + 100 * radial  # so that its image is in the middle of the strip
    errors = []
    for seed in range(3):
        found = [one for seen in looked(seed, mover(radial, 30.0, east)) for one in seen.movers]
        assert len(found) == 1
        (one,) = found
        truth = np.array([east, NORTH, HEIGHT, radial])
        sigmas = np.sqrt([*np.diag(one.covariance), one.velocity_sigma**2])
        errors.append(np.array([*one.position, one.radial_velocity]) - truth)
        assert np.all(np.abs(errors[-1]) < 4 * sigmas)
        assert one.height == pytest.approx(HEIGHT, abs=0.02)
        assert one.ambiguity == pytest.approx(15.5e-3)
        assert abs(one.position[0] - (east - 100 * radial)) > 0.35
    assert np.sqrt(np.mean(np.square(errors), axis=0))[0] < 0.02


def test_what_stands_still_is_none() -> None:
    """A street with a bright point; at a rate of 5 % of what is looked at, the measured one has a standard error."""
    flight, images = strip(1, PointScatterer(EAST, NORTH, HEIGHT, 1e3), dwells=6)
    seen = [movers(slc, flight.sensor, MoverSettings(false_alarm_rate=0.05, prominence_db=5.0)) for slc in images]
    candidates = sum(one.candidates for one in seen)
    assert candidates > 300
    assert sum(len(one.movers) for one in seen) <= 0.05 * candidates + 3 * np.sqrt(0.05 * candidates)


def test_slow_ones_are_not_told() -> None:
    """A fifth of a beamwidth cannot be told from two scatterers in a cell."""
    assert not [one for seen in looked(2, mover(1e-3, 30.0), rate=1e-3) for one in seen.movers]


def yawed(slc: Slc, stated: float) -> Slc:
    """The image by odometry that states an error of the yaw, rad."""
    return replace(slc, aperture=replace(slc.aperture, covariance=np.diag([0.0, 0, 0, 0, 0, stated**2])))


@pytest.mark.parametrize("wrong", [0.0, -3e-3])
def test_the_ground_tells_where_the_beam_is(wrong: float) -> None:
    """Odometry that errs in the velocity along the line of sight: velocity is that over the ground's."""
    flight, images = strip(0, mover(5e-3, 30.0, EAST + 0.5), wrong=wrong)
    width, speed = flight.sensor.beams.track_beamwidth, 50.0
    found: list[Mover] = []
    for slc in images:
        seen = movers(yawed(slc, width), flight.sensor, MoverSettings(false_alarm_rate=1e-2))
        lag, sigma = seen.ground_lag
        assert abs(lag - wrong / speed) < 4 * sigma
        assert 0 < sigma < 0.1 * width
        found += seen.movers
    (one,) = found
    assert one.radial_velocity == pytest.approx(5e-3, abs=4 * one.velocity_sigma)
    assert 1e-4 < one.velocity_sigma < 9e-4


def test_power_over_the_ground_is_told_however_bright() -> None:
    """Ten dB more are 10 dB more, within 1 dB of the ground that adds to it."""
    low, high = (
        max(one.cnr_db for seen in looked(0, mover(6e-3, power, EAST + 0.6)) for one in seen.movers)
        for power in (30.0, 40.0)
    )
    assert high - low == pytest.approx(10, abs=1)


def test_what_lies_beyond_the_outer_beams_has_no_height_and_is_not_told() -> None:
    """Of the upper four channels, whose beams see the mover through their sidelobes only."""
    flight, images = strip(0, mover(5e-3, 50.0, EAST + 0.5))
    sensor, upper = flight.sensor, np.arange(4, 8)
    settings = MoverSettings(false_alarm_rate=1e-2)
    for chosen, expected in ((np.arange(8), 1), (upper, 0)):
        beams = sensor.beams.detectors(chosen)
        found = [
            search_strip(slc.images[chosen], beams, slc, sensor, settings, (0, slc.grid.cols))[0] for slc in images
        ]
        assert sum(len(one.movers) for one in found) == expected
        assert sum(one.candidates for one in found) > 0


def test_up_to_half_a_pitch_beyond_the_outer_beams_a_mover_is_found() -> None:
    """It lies 1.48 m from the middle of the beams, the outer boresight 1.36 m, and half a pitch beyond is 1.55 m."""
    beyond = PointScatterer(EAST + 0.5, -1.0, 1.1, 1e3, radial_velocity=5e-3)
    flight, images = strip(0, beyond)
    seen = [movers(slc, flight.sensor, MoverSettings(false_alarm_rate=1e-2)) for slc in images]
    (one,) = [one for each in seen for one in each.movers]
    assert abs(one.height - beyond.height) < 4 * one.sigma
    assert one.sigma < 0.1


def crabbed(slc: Slc, angle: float) -> Slc:
    """The image of a body that is turned by so much (rad) against the flight."""
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    return replace(slc, aperture=replace(slc.aperture, rotation=turn @ slc.aperture.rotation))


def test_what_does_not_depend_on_the_image_is_computed_once() -> None:
    """Bodies that are turned by parts of a bin against the flight have different aspects, and the same likelihoods."""
    flight, (slc, *_) = strip(1)
    held: list[int] = []
    for angle in (0.0, 1e-6, -1e-6):
        before = _cached.cache_info().misses
        movers(crabbed(slc, angle), flight.sensor, MoverSettings())
        held.append(_cached.cache_info().misses - before)
    assert held[1:] == [0, 0]
    assert not np.array_equal(
        Bins.of(slc, flight.sensor, 32).aspects, Bins.of(crabbed(slc, 1e-6), flight.sensor, 32).aspects
    )


def test_the_beam_sees_the_bins_of_all_images_under_the_same_angles() -> None:
    """Lags make up for aspects; spacings are rounded to 0.25 %, a thousandth of a beam over 11 bins."""
    flight, (slc, *_) = strip(1)
    width = flight.sensor.beams.track_beamwidth
    turned = crabbed(slc, 1.5e-6)
    bins = Bins.of(turned, flight.sensor, 32)
    search = Search(turned.images, flight.sensor.beams, bins)
    assert abs(bins.aspects[bins.middle]) > 0.005 * width
    angles = search._nominal.aspects + search._lags[:, None]
    np.testing.assert_allclose(bins.aspects + search.lags[:, None], angles, atol=1.1e-3 * width)


def test_pixels_without_data_do_no_harm() -> None:
    """Two rows behind the mover and all beyond are not there."""
    flight, images = strip(0, mover(5e-3, 30.0, EAST + 0.5))
    settings = MoverSettings(false_alarm_rate=1e-2)
    ((number, whole),) = [
        (number, one) for number, slc in enumerate(images) for one in movers(slc, flight.sensor, settings).movers
    ]
    cut = images[number].images.copy()
    cut[:, whole.row + 2 :] = np.nan
    (one,) = movers(yawed(replace(images[number], images=cut), 1e-6), flight.sensor, settings).movers
    assert one.radial_velocity == pytest.approx(whole.radial_velocity, abs=2e-4)
    np.testing.assert_allclose(one.position, whole.position, atol=0.03)


def test_a_bright_point_that_stands_still_is_none() -> None:
    """So bright that what the image former leaves is far above the noise."""
    assert not [one for seen in looked(0, mover(0.0, 80.0), rate=1e-3) for one in seen.movers]


def test_what_is_too_fast_for_the_beam_gets_no_wrong_place() -> None:
    """Its ambiguities, which may be published, have its place within the stated error."""
    east = EAST + 0.95
    seen = looked(0, mover(9.5e-3, 30.0, east))
    assert sum(one.candidates for one in seen) > 0
    for one in [one for each in seen for one in each.movers]:
        assert abs(one.position[0] - east) < 4 * np.sqrt(one.covariance[0, 0]) < 0.6


def test_the_same_place_counts_once() -> None:
    def at(east: float, ratio: float) -> Mover:
        covariance = 1e-4 * np.eye(3)
        return Mover(
            np.array([east, 0, 0]),
            covariance,
            0.0,
            0.01,
            0.005,
            1e-4,
            0.0155,
            0.0,
            0.5,
            np.nan,
            np.nan,
            False,
            ratio,
            20.0,
            1,
            1,
        )

    kept = without_ambiguities([at(0.0, 20.0), at(0.05, 30.0), at(0.5, 25.0)])
    assert [one.likelihood_ratio for one in kept] == [30.0, 25.0]


def test_a_body_that_does_not_fly_straight_ahead_has_its_beam_abeam_of_it() -> None:
    """A crab angle of 10 mrad, 64 beamwidths: bins are those around it, and their aspects in the body are the same."""
    flight, (slc, *_) = strip(1)
    straight = Bins.of(slc, flight.sensor, 32)
    turned = Bins.of(crabbed(slc, 0.01), flight.sensor, 32)
    width = flight.sensor.beams.track_beamwidth
    assert abs(len(turned.numbers) - len(straight.numbers)) <= 1
    assert np.all(np.abs(turned.aspects) < 0.5 * width)
    assert np.all(np.diff(turned.aspects) > 0)


def test_what_cannot_be_used_is_refused() -> None:
    flight, (slc, *_) = strip(1)
    spotlight = load_preset("sal_spotlight").make_sensor()
    blanked = replace(flight.sensor, blanked_ranges=((0, 4990.0, 4999.0),))
    clipped = replace(slc, saturated_share=np.full(8, 0.01))
    narrow = replace(slc, images=slc.images[..., :15], grid=replace(slc.grid, cols=15))
    for image, sensor, said in (
        (slc, spotlight, "stripmap only"),
        (slc, blanked, "do not receive"),
        (clipped, flight.sensor, "0.01 of its samples clipped"),
        (narrow, flight.sensor, "15 columns; 16"),
    ):
        with pytest.raises(UserError, match=said):
            movers(image, sensor, MoverSettings())


@pytest.mark.parametrize(("radial", "along"), few(1, [(5e-3, 2.0), (-6e-3, -3.0), (8.003, 4.0)]))
def test_what_drives_along_the_flight_is_focused(radial: float, along: float) -> None:
    """Its image is smeared over 13 to 27 cells; unfocused, velocities err by up to 1 mm/s, migrations by 3 m/s."""
    period = 15.5e-3
    remainder = radial - period * round(radial / period)
    point = PointScatterer(EAST + 100 * remainder, NORTH, HEIGHT, 10**3.4, radial, along)
    (one,) = [mover for seen in looked(0, point, rate=1e-3) for mover in seen.movers]
    assert abs(one.along_velocity - along) < 4 * one.along_sigma < 1.0
    off = one.radial_velocity - radial
    assert abs(off - period * round(off / period)) < 4 * one.velocity_sigma < 2e-3
    assert abs(one.position[0] - point.east) < 4 * np.sqrt(one.covariance[0, 0]) < 0.2
    assert one.height == pytest.approx(HEIGHT, abs=0.05)
    if one.walks:
        assert abs(one.walk_velocity - radial) < 4 * one.walk_sigma


@pytest.mark.parametrize(
    ("radial", "along", "power_db"),
    few(1, [(-2e-3, 17.88, 30.0), (3.6e-3, 10.0, 20.0), (-7.503, -9.0, 17.0), (0.0, 6.0, 25.0), (4.2, -15.0, 20.0)]),
)
def test_what_drives_fast_along_the_flight_is_found(radial: float, along: float, power_db: float) -> None:
    """Its image is smeared over up to 220 cells, more than an image has, and dimmer than the ground."""
    period = 15.5e-3
    remainder = radial - period * round(radial / period)
    point = PointScatterer(100 * remainder / (1 - along / 50), 0.3, 0.9, 10 ** (power_db / 10), radial, along)
    (one,) = [each for seen in looked(1, point, rate=1e-3, dwells=6) for each in seen.movers]
    assert one.walks
    assert abs(one.along_velocity - along) < 4 * one.along_sigma < 2.0
    assert abs(one.walk_velocity - radial) < 4 * one.walk_sigma
    off = one.radial_velocity - radial
    assert abs(off - period * round(off / period)) < 4 * one.velocity_sigma
    assert abs(one.position[0] - point.east) < 4 * np.sqrt(one.covariance[0, 0]) < 0.4
    assert one.height == pytest.approx(0.9, abs=0.05)


def test_a_strip_that_breaks_off_starts_again() -> None:
    """Without the image between, a mover is looked for in each image alone."""
    flight, images = strip(1, dwells=6)
    search = StripMovers[int](MoverSettings())
    first, _, third, fourth = (strip_with_movers(slc, flight.sensor, MoverSettings()) for slc in images)
    assert search.add(first, 0) == []
    assert search.unpublished == 1
    ((number, alone),) = search.add(third, 2)
    assert number == 0
    assert alone is not None
    assert alone.candidates == movers(images[0], flight.sensor, MoverSettings()).candidates
    assert search.add(fourth, 3) == []
    assert [number for number, _ in search.end()] == [2, 3]
    assert search.unpublished == 0


def test_what_passes_more_slowly_has_greater_aspects() -> None:
    """The beam sees it under the angle that the Doppler frequency has at the speed with which they pass each other."""
    flight, (slc, *_) = strip(0)
    bins = Bins.of(slc, flight.sensor, 32)
    slowed = bins.slowed(0.9)
    assert slowed.aspects == pytest.approx(bins.aspects / 0.9)
    assert slowed.frequencies == pytest.approx(bins.frequencies)
    assert slowed.cell == pytest.approx(bins.cell)


def test_what_recedes_only_has_no_velocity_along_the_flight() -> None:
    (one,) = [seen for each in looked(0, mover(6e-3, 34.0, EAST + 0.6)) for seen in each.movers]
    assert np.isnan(one.along_velocity)
    assert np.isnan(one.along_sigma)


@pytest.mark.parametrize("smear", [-20.0, 7.0])
def test_a_smear_is_a_velocity_along_the_flight(smear: float) -> None:
    flight, (slc, *_) = strip(0)
    bins = Bins.of(slc, flight.sensor, slc.grid.cols)
    driving = Driving.of(bins, slc, flight.sensor)
    assert driving.cells == pytest.approx(155, abs=5)
    share = (1 + smear / driving.cells) ** -0.5
    _, along, (migration, sigma) = driving.velocities((smear, 0.0), (10.0, 0.1))
    assert along is not None
    assert along[0] == pytest.approx(50.0 * (1 - share), abs=0.05)
    assert migration == pytest.approx(10.0 / (1 + smear / driving.cells), abs=0.02)
    assert sigma == pytest.approx(np.linalg.norm([0.3, 0.1 * share**2, share**2 * migration / driving.cells]))
    # Blocks that autofocus has placed to 15 mm each smear the whole image by as much.
    placed = replace(slc, placement=replace(slc.placement, beams_error=1.5e-4))
    _, unsure, (_, blurred) = Driving.of(bins, placed, flight.sensor).velocities((smear, 0.0), (10.0, 0.1))
    assert unsure is None
    assert blurred > 1.3 * sigma


def test_smears_are_those_of_velocities_up_to_the_fastest() -> None:
    flight, (slc, *_) = strip(0)
    driving = Driving.of(Bins.of(slc, flight.sensor, slc.grid.cols), slc, flight.sensor)
    smears = driving.smears(10.0, 1e3)
    assert smears[0] == pytest.approx(driving.cells * (1.2**-2 - 1), abs=6)
    assert smears[-1] == pytest.approx(driving.cells * (0.8**-2 - 1), abs=6)
    assert np.abs(driving.smears(10.0, 50.0)).max() <= 54


def test_the_blind_fraction_is_that_of_the_remainders_within_their_sigma() -> None:
    """It falls with the brightness, and the sigmas of movers that are found are like the stated one."""
    seen = looked(0, mover(6e-3, 30.0, EAST + 0.6))
    (one,) = [each for every in seen for each in every.movers]
    blind = seen[0].blind
    assert [each.cnr_db for each in blind] == [15.0, 20.0, 25.0, 30.0]
    fractions = [each.fraction for each in blind]
    assert fractions == sorted(fractions, reverse=True)
    for each in blind:
        assert each.fraction == pytest.approx(2 * each.sigma / 15.5e-3)
    assert 0.3 < one.velocity_sigma / blind[-1].sigma < 3


def test_what_autofocus_leaves_in_blocks_is_in_the_velocity_and_the_place() -> None:
    """A tenth of a beamwidth, which the image of a target does not show."""
    flight, images = strip(0, mover(5e-3, 30.0, EAST + 0.5))
    placed = [replace(slc, placement=replace(slc.placement, beams_error=1e-6)) for slc in images]
    (alone,), (left,) = (
        [one for slc in seen for one in movers(slc, flight.sensor, MoverSettings()).movers] for seen in (images, placed)
    )
    of_blocks = 0.1 * flight.sensor.beams.track_beamwidth * 50.0
    assert left.velocity_sigma == pytest.approx(np.hypot(alone.velocity_sigma, of_blocks), rel=0.01)
    added = 100.0 * of_blocks  # of the place along the flight, by range over speed
    assert np.sqrt(left.covariance[0, 0] - alone.covariance[0, 0]) == pytest.approx(added, rel=0.05)


@pytest.mark.parametrize(("smear", "focused"), [(0.0, True), (1.0, True), (40.0, False)])
def test_what_has_not_the_image_of_a_point_is_out_of_focus(smear: float, focused: bool) -> None:
    """A point is smeared over 40 cells, of which 32 pixels show 23."""
    flight, (slc, *_) = strip(0)
    bins = Bins.of(slc, flight.sensor, 32)
    search = Search(np.zeros((8, slc.grid.rows, slc.grid.cols), np.complex128), flight.sensor.beams, bins)
    elevation = float(np.mean(flight.sensor.beams.span))
    point = np.exp(1j * np.pi * smear * bins.frequencies**2)
    spectra = point[:, None] * flight.sensor.beams.response(elevation, bins.aspects)
    assert is_in_focus(search, spectra, elevation) == focused
