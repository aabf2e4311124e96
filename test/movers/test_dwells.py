"""Movers over simulated spotlight dwells: found without being told their velocity, with sigmas that are right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from helpers import few

from sal_height.errors import UserError
from sal_height.geometry import ApertureState, Grid, sphere_point
from sal_height.imaging import ImageSettings, Slc
from sal_height.movers import DwellMovers, Looked, Mover, MoverSettings, dwell_detection
from sal_height.movers.dwell_detection import MoverTrack, ShownDwell
from sal_height.movers.dwell_images import COLUMN_STEPS, DwellImage
from sal_height.movers.dwell_paths import DwellPaths, Lobes
from sal_height.movers.likelihood import MODEL_ERROR, ratio_in_dwells, ratio_over_rows
from sal_height.pipeline import Compressor, dwell_with_movers
from sal_height.simulation.flight import SimulatedFlight, flight_of
from sal_height.simulation.preset import load_preset
from sal_height.simulation.scene import PointScatterer

PERIOD = 23.25e-3
"""Radial velocity that the pulses of preset small do not tell from none, m/s."""

NORTH, HEIGHT = 0.5, 0.8
DWELLS = 5


@lru_cache(maxsize=32)
def flown(
    seed: int, *points: PointScatterer, name: str = "small", dwells: int = DWELLS
) -> tuple[SimulatedFlight, tuple[Slc, ...]]:
    """The street of a preset with other targets, and its images with a column for each Doppler frequency."""
    preset = replace(load_preset(name), dwells=dwells)
    flight = flight_of(preset, seed)
    flight = replace(flight, scene=replace(flight.scene, points=points))
    settings = ImageSettings(air="none", rows=preset.image.rows, cols=preset.sensor.pulse_count)
    images = []
    for dwell in range(dwells):
        slc = Compressor().add(flight.phase_history(dwell), flight.track(dwell), flight.sensor, settings)
        assert slc is not None
        images.append(slc)
    return flight, tuple(images)


def found_in(
    flight: SimulatedFlight, images: Sequence[Slc], settings: MoverSettings, seconds: Sequence[float] = ()
) -> list[Looked | None]:
    """What is found in dwells at these times, or at those of the flight."""
    movers, found = DwellMovers(settings), []
    for dwell, slc in enumerate(images):
        at = seconds[dwell] if seconds else 1e-9 * flight.dwell_start_ns(dwell)
        found += movers.add(dwell_with_movers(slc, at, flight.sensor, settings), dwell)
    found += movers.end()
    assert [number for number, _ in found] == list(range(len(images)))
    return [looked for _, looked in found]


def movers_of(seed: int, *points: PointScatterer, rate: float = 1e-3) -> list[Mover]:
    found = found_in(*flown(seed, *points), MoverSettings(false_alarm_rate=rate))
    assert len(found) == DWELLS
    return [one for looked in found if looked for one in looked.movers]


def target(radial: float, power_db: float = 30.0, east: float = 0.1, along: float = 0.0) -> PointScatterer:
    return PointScatterer(east, NORTH, HEIGHT, 10 ** (power_db / 10), radial, along)


@pytest.mark.parametrize(
    ("radial", "east"),
    few(2, [(-12.003, 0.1), (-2.5, -0.3), (4.008, 0.29), (9.011, 0.0)]),
    ids=lambda value: f"{value:g}",
)
def test_a_car_gets_place_height_and_speed(radial: float, east: float) -> None:
    """From dwell to dwell, 11.6 ms, it migrates by 0.29 to 1.4 rows of 10 cm; where two dwells see it alike, once."""
    (one,) = movers_of(0, target(radial, east=east))
    assert one.walks
    assert abs(one.walk_velocity - radial) < 4 * one.walk_sigma < 1.0
    remainder = radial - PERIOD * round(radial / PERIOD)
    off = one.radial_velocity - remainder
    assert abs(off - PERIOD * round(off / PERIOD)) < 4 * one.velocity_sigma < 1e-3
    truth = sphere_point(east, NORTH, HEIGHT)
    assert np.all(np.abs(one.position - truth) < 4 * np.sqrt(np.diag(one.covariance)))
    assert one.height == pytest.approx(HEIGHT, abs=0.02)
    assert one.ambiguity == pytest.approx(PERIOD)


@pytest.mark.parametrize("radial", [-9e-3, 6e-3])
def test_what_moves_by_millimetres_is_told_by_the_beam(radial: float) -> None:
    """Its image lies 0.6 to 0.9 m from it, about a beamwidth, and in the same row of all dwells."""
    (one,) = movers_of(1, target(radial))
    assert not one.walks
    assert abs(one.walk_velocity) < 4 * one.walk_sigma
    assert abs(one.radial_velocity - radial) < 4 * one.velocity_sigma < 1e-3
    assert one.position[0] == pytest.approx(0.1, abs=0.03)
    assert one.height == pytest.approx(HEIGHT, abs=0.03)


@pytest.mark.parametrize(
    ("radial", "along", "east"),
    few(2, [(6.003, 10.0, 0.1), (9e-3, -13.0, 0.25), (-3.0, 2.3, -0.2), (0.0, 7.0, 0.2)]),
    ids=lambda value: f"{value:g}",
)
def test_a_car_may_drive_along_the_flight(radial: float, along: float, east: float) -> None:
    """Its image lies 1 to 6 columns farther in each dwell; where it was abeam, and what is radial there, are told."""
    (one,) = movers_of(0, target(radial, east=east, along=along))
    assert one.walks
    assert abs(one.along_velocity - along) < 4 * one.along_sigma < 2.0
    assert abs(one.walk_velocity - radial) < 4 * one.walk_sigma < 1.0
    off = one.radial_velocity - radial
    assert abs(off - PERIOD * round(off / PERIOD)) < 4 * one.velocity_sigma < 1e-3
    truth = sphere_point(east, NORTH, HEIGHT)
    assert np.all(np.abs(one.position - truth) < 4 * np.sqrt(np.diag(one.covariance)))
    assert np.sqrt(one.covariance[0, 0]) < 0.1
    assert one.height == pytest.approx(HEIGHT, abs=0.03)


def test_what_drives_along_the_flight_is_not_told_if_that_is_not_looked_for() -> None:
    flight, images = flown(0, target(9e-3, east=0.25, along=-13.0))
    found = found_in(flight, images, MoverSettings(fastest_mps=0.0))
    assert not [mover for one in found if one for mover in one.movers if mover.walks]


def test_an_image_drifts_by_what_the_velocity_along_the_flight_says() -> None:
    """Against the place of the image written out: where what stands still has the same Doppler frequency."""
    flight, images = flown(0)
    dwells = [dwell_with_movers(slc, 0.0, flight.sensor, MoverSettings()) for slc in images]
    shown = [replace(one.image, seconds=1e-9 * flight.dwell_start_ns(number)) for number, one in enumerate(dwells)]
    paths = DwellPaths.of(shown, 2, dwells[2].beams, images[2], flight.sensor, 20.0)
    speed, reach, start = 50.0, paths.reach, 0.3
    for along in (-12.0, 5.0):
        driving = paths.driving(along)
        ahead = start + (along - speed) * paths.seconds  # of the antenna
        doppler = -ahead / reach * (along - speed)  # radial velocity towards it
        still = doppler * reach / speed + speed * paths.seconds  # in map, but for where the antenna was at first
        assert driving.drifts == pytest.approx(still - still[2], abs=1e-9)
        assert driving.along_of(driving.drift) == pytest.approx(along)
        squints = ahead / reach + np.array([speed * t / reach for t in paths.seconds])
        extra = driving.lobes.ahead - paths.lobes.ahead
        assert extra == pytest.approx(squints - squints[2], abs=1e-9)
    assert np.isnan(paths.along_of(51.0))


def test_beams_that_are_turned_are_those_of_the_direction() -> None:
    """To the nearest of the squints, which is half a step off."""
    flight, images = flown(0)
    dwell = dwell_with_movers(images[0], 0.0, flight.sensor, MoverSettings())
    width = dwell.beams.track_beamwidth
    ahead, turn = width * np.array([-0.7, 0.0, 0.7]), width * np.array([-0.2, 0.0, 0.15])
    lobes = Lobes.of(dwell.beams, ahead, np.zeros(3)).turned(turn)
    exact = Lobes.of(dwell.beams, ahead + turn, np.zeros(3))
    inner = np.abs(exact.squints) < 2 * width
    np.testing.assert_allclose(lobes.amplitudes[inner], exact.amplitudes[inner], rtol=0, atol=1e-6)
    assert np.array_equal(lobes.known[inner], exact.known[inner])
    assert lobes.ahead == pytest.approx(exact.ahead)


@pytest.mark.thorough
def test_errors_are_those_that_are_stated() -> None:
    """The rms over sigma of 5 targets, whose own standard error is a third of it; sigmas may be too great."""
    over = []
    for seed in range(5):
        rng = np.random.default_rng([3, seed])
        radial, east = (-1) ** seed * rng.uniform(3.0, 15.0), rng.uniform(-0.5, 0.5)
        found = movers_of(seed, target(radial, power_db=25.0, east=east))
        (one,) = [mover for mover in found if mover.cnr_db > 25]  # a bright pixel of the street may be a false alarm
        over.append(
            (
                (one.position[0] - east) / np.sqrt(one.covariance[0, 0]),
                (one.height - HEIGHT) / one.sigma,
                (one.walk_velocity - radial) / one.walk_sigma,
            )
        )
    assert np.all(np.sqrt(np.mean(np.square(over), axis=0)) < 1.7)
    assert np.all(np.abs(over) < 4)


def test_what_stands_still_is_none() -> None:
    """Of some hundred bright pixels 5 % may be taken for movers, and three standard errors more."""
    points = [
        PointScatterer(east, 0.3 * number - 0.6, 0.5, 10 ** (2.4 + 1.0 * number))
        for number, east in enumerate((-0.7, -0.3, 0.0, 0.45))
    ]
    settings = MoverSettings(false_alarm_rate=0.05, prominence_db=5.0)
    found = [one for seed in (1, 2) for one in found_in(*flown(seed, *points), settings) if one]
    candidates = sum(one.candidates for one in found)
    assert candidates > 120
    assert sum(len(one.movers) for one in found) <= 0.05 * candidates + 3 * np.sqrt(0.05 * candidates)
    assert not [mover for one in found for mover in one.movers if mover.walks]


def test_slow_ones_are_not_told() -> None:
    """A fortieth of a beamwidth is that of the columns."""
    assert not movers_of(2, target(0.2e-3))


def test_speeds_that_are_not_searched_for_do_not_migrate() -> None:
    flight, images = flown(0, target(9.011, east=0.0))
    found = found_in(flight, images, MoverSettings(fastest_mps=0.0))
    assert [one.fastest for one in found if one] == [0.0] * DWELLS
    assert not [mover for one in found if one for mover in one.movers if mover.walks]


def test_a_car_is_told_where_the_beam_sees_it_and_not_through_a_sidelobe() -> None:
    """The dwell before sees it in a sidelobe, and bright pixels of the ground lie in the columns of its image."""
    car = PointScatterer(0.553, 1.523, 0.562, 750.0, radial_velocity=-5.092)
    found = [one for one in found_in(*flown(7, car, name="sal_spotlight", dwells=6), MoverSettings()) if one]
    (one,) = [mover for looked in found for mover in looked.movers]
    assert one.position[0] == pytest.approx(0.553, abs=0.02)
    assert one.height == pytest.approx(0.562, abs=0.02)
    assert abs(one.walk_velocity + 5.092) < 4 * one.walk_sigma < 0.2


@pytest.mark.parametrize(
    ("seed", "car"),
    few(
        1,
        [
            (3, PointScatterer(0.0949745, -2.147305, 0.4875123, 2036.68, -13.601267, -5.782986)),
            (6, PointScatterer(-0.3131008, 1.5778904, 1.3460518, 656.705, 0.0061409, 14.622081)),
        ],
    ),
    ids=["beside bright ground", "between two columns"],
)
def test_a_car_that_drives_is_told_once_and_by_what_is_its_own(seed: int, car: PointScatterer) -> None:
    """A bright pixel of the ground, paired with the car in another dwell, is none; nor do its sidelobes steer it."""
    found = [one for one in found_in(*flown(seed, car, name="sal_spotlight", dwells=6), MoverSettings()) if one]
    (one,) = [mover for looked in found for mover in looked.movers]
    assert one.position[0] == pytest.approx(car.east, abs=0.03)
    assert one.along_velocity == pytest.approx(car.along_velocity, abs=0.5)
    assert abs(one.walk_velocity - car.radial_velocity) < 4 * one.walk_sigma < 0.3


def test_sigmas_count_what_beams_are_not_known_by() -> None:
    """However bright a car is: its place along the flight is known to a tenth of a column, 5.2 cm, and more."""
    (one,) = movers_of(3, target(6.0, power_db=55.0))
    assert one.cnr_db > 30
    assert np.sqrt(one.covariance[0, 0]) > 0.005
    assert 0.0125 < one.sigma < 0.03
    assert 0.08 < one.walk_sigma < 0.3


def off(slc: Slc, error: float, stated: float) -> Slc:
    """An image that lies, with the beam in it, farther along the flight (m) than it is thought to, as is stated (m)."""
    aperture, grid = slc.aperture, slc.grid
    shift = error * aperture.direction
    own = stated * 50.0 / float(np.linalg.norm(grid.middle - aperture.position))
    return replace(
        slc,
        grid=replace(grid, origin=grid.origin - shift),
        aperture=replace(aperture, position=aperture.position - shift),
        placement=replace(slc.placement, own_error=own),
    )


@pytest.mark.parametrize("radial", [-2.5, 9e-3])
def test_images_that_lie_beside_their_place_do_not_spoil_what_is_told(radial: float) -> None:
    """By up to 3 cm from dwell to dwell, which would be 1 m/s along the flight; each is known to 4 cm."""
    flight, images = flown(0, target(radial, east=-0.1))
    errors = np.array([0.015, -0.01, 0.02, -0.01, 0.015])
    moved = [off(slc, error, 0.04) for slc, error in zip(images, errors, strict=True)]
    (one,) = [mover for looked in found_in(flight, moved, MoverSettings()) if looked for mover in looked.movers]
    assert abs(one.along_velocity) < 3 * one.along_sigma
    assert 1.0 < one.along_sigma < 5.0
    beyond = one.radial_velocity - radial
    assert abs(beyond - PERIOD * round(beyond / PERIOD)) < 4 * one.velocity_sigma < 2e-3


def test_a_velocity_along_the_flight_that_is_not_known_is_not_told() -> None:
    flight, images = flown(0, target(-2.5, east=-0.1))
    moved = [off(slc, 0.0, 0.2) for slc in images]
    (one,) = [mover for looked in found_in(flight, moved, MoverSettings()) if looked for mover in looked.movers]
    assert np.isnan(one.along_velocity)
    assert np.isnan(one.along_sigma)
    assert abs(one.walk_velocity + 2.5) < 4 * one.walk_sigma
    assert one.position[0] == pytest.approx(-0.1, abs=4 * np.sqrt(one.covariance[0, 0]))


def test_a_track_covers_what_is_less_sure_and_in_its_pixel_in_one_of_the_dwells() -> None:
    """Eight columns farther in the second dwell: a target that drives so far, and one that comes out of its pixel."""
    flight, images = flown(0, target(6.003, along=10.0))
    (seen,) = [one for looked in found_in(flight, images, MoverSettings()) if looked for one in looked.movers]
    first, second = (
        dwell_with_movers(images[n], 1e-9 * flight.dwell_start_ns(n), flight.sensor, MoverSettings()).image
        for n in (1, 2)
    )
    apart = second.seconds - first.seconds
    here, drift = np.asarray(second.grid.middle), 8 * second.grid.col_spacing / apart
    ahead = here + drift * apart * second.aperture.direction
    weak = replace(seen, position=seen.position + 100.0, likelihood_ratio=1.0)
    surer = {speed: MoverTrack(seen, here, 0.0, speed, first.seconds) for speed in (0.0, drift)}
    weaker = {speed: MoverTrack(weak, ahead, 0.0, speed, second.seconds) for speed in (0.0, drift)}
    assert surer[drift].covers(weaker[0.0], [second])
    assert not surer[0.0].covers(weaker[0.0], [first, second])
    assert surer[0.0].covers(weaker[drift], [first, second])
    assert not surer[0.0].covers(weaker[drift], [second])
    assert not weaker[0.0].covers(surer[drift], [first, second])


def test_two_cars_are_two() -> None:
    slow, fast = (
        replace(target(speed, east=east), north=north) for speed, east, north in ((-4.0, 0.2, -0.8), (8.0, -0.2, 0.6))
    )
    speeds = sorted(one.walk_velocity for one in movers_of(4, slow, fast))
    assert speeds == pytest.approx([-4.0, 8.0], abs=0.5)


def test_the_ground_tells_where_the_beam_is() -> None:
    """Odometry states that it does not know the yaw to half a beamwidth: the car's velocity is that over the ground."""
    flight, images = flown(0, target(4.008, east=0.29))
    width = flight.sensor.beams.track_beamwidth
    unsure = [
        replace(slc, aperture=replace(slc.aperture, covariance=np.diag([0.0] * 5 + [(0.5 * width) ** 2])))
        for slc in images
    ]
    found = [one for one in found_in(flight, unsure, MoverSettings()) if one]
    lags = np.array([one.ground_lag for one in found])
    assert np.all(np.abs(lags[:, 0]) < 0.2 * width)
    assert np.all((lags[:, 1] > 0) & (lags[:, 1] < 0.2 * width))
    (one,) = [mover for looked in found for mover in looked.movers]
    assert abs(one.walk_velocity - 4.008) < 4 * one.walk_sigma


def test_where_autofocus_finds_the_beam_its_error_is_that_of_velocities() -> None:
    """The same echo does not tell it once more: an error of .3 mm/s is stated of the car, whatever odometry states."""
    flight, images = flown(0, target(0.008, east=0.29))
    unsure = [
        replace(
            slc,
            placement=replace(slc.placement, beams_error=3e-4),
            aperture=replace(slc.aperture, covariance=np.diag([0.0] * 5 + [1e-10])),
        )
        for slc in images
    ]
    found = [one for one in found_in(flight, unsure, MoverSettings()) if one]
    np.testing.assert_allclose([one.ground_lag for one in found], [(0.0, 3e-4 / 50)] * len(found))
    (one,) = [mover for looked in found for mover in looked.movers]
    assert one.velocity_sigma == pytest.approx(3e-4, rel=0.1)
    assert abs(one.radial_velocity - 0.008) < 3e-4


def test_a_dwell_that_overlaps_with_none_tells_nothing() -> None:
    """Dwells that are not where the flight would have them by their times belong to other flights."""
    flight, images = flown(0, target(9.011, east=0.0))
    later = [1e-9 * flight.dwell_start_ns(dwell) + 100.0 * (dwell >= 3) for dwell in range(DWELLS)]
    settings = MoverSettings()
    apart = found_in(flight, images, settings, later)
    assert len(apart) == DWELLS
    assert all(one is not None for one in apart)
    alone = found_in(flight, images[::4], settings, [0.0, 4 * 0.011625])
    assert alone == [None, None]


def test_what_cannot_be_used_is_refused() -> None:
    flight, (slc, *_) = flown(0, target(9.011, east=0.0))
    narrow = replace(slc, images=slc.images[..., :12], grid=replace(slc.grid, cols=12))
    level = replace(slc, grid=replace(slc.grid, row_direction=np.array([0.0, -1.0, 0.0])))
    clipped = replace(slc, saturated_share=np.full(8, 0.01))
    for image, said in (
        (narrow, "12 columns; .* 48 columns"),
        (level, "image_plane"),
        (clipped, "0.01 of its samples"),
    ):
        with pytest.raises(UserError, match=said):
            dwell_with_movers(image, 0.0, flight.sensor, MoverSettings())


def test_a_place_is_where_the_image_shows_it_whatever_its_doppler_is() -> None:
    """A period, 2 m, away it has the same column, and is farther as it is beside the middle of the dwell."""
    aperture = ApertureState(np.array([0.0, 0, 3e3]), np.array([50.0, 0, 0]), np.eye(3), 0.1, np.zeros((6, 6)))
    grid = Grid(np.array([-1.0, -4e3, 0.0]), np.array([0.0, -0.8, -0.6]), np.array([1.0, 0, 0]), 0.1, 0.05, 20, 40)
    image = DwellImage(np.zeros((2, 20, 40 * COLUMN_STEPS), np.complex64), grid, aperture, 0.0, 2.0, 1)
    for row, col in ((3.0, 4.0), (16.0, 31.5)):
        place = grid.points(row, col)
        assert image.shows(place) == (pytest.approx(row, abs=1e-6), round(col * COLUMN_STEPS))
        along = -1.0 + 0.05 * col
        farther = ((along + 2.0) ** 2 - along**2) / (2 * 5000.0 * 0.1)
        assert image.shows(place + np.array([2.0, 0.0, 0.0])) == (
            pytest.approx(row + farther, abs=1e-4),
            round(col * COLUMN_STEPS),
        )


def test_it_is_the_likelihood_of_a_point_or_of_speckle() -> None:
    """Against densities written out: over phases for a point whose beam errs, Gaussian for speckle."""
    gains, phases = np.array([1.0, 0.5, 0.05]), np.exp(2j * np.pi * np.arange(720) / 720)
    for matched in (np.array([9.0, 5.1, 0.3]), np.array([30.0, 1.0, 0.5])):
        best = 0.0
        for decibels in range(-6, 55, 3):
            power = 10 ** (decibels / 10) * gains**2
            variance = 1 + MODEL_ERROR * power
            misfit = np.abs(matched - np.sqrt(power) * phases[:, None]) ** 2 / variance
            least = misfit.min(axis=0)
            point = np.sum(np.log(np.mean(np.exp(least - misfit), axis=0)) - least - np.log(variance) + matched**2)
            speckle = np.sum(-(matched**2) / (1 + power) - np.log(1 + power) + matched**2)
            best = max(best, point, speckle)
        assert float(ratio_in_dwells(matched, gains)) == pytest.approx(best, rel=1e-3)


def test_it_is_the_likelihood_of_a_cloud_that_is_spread_over_rows() -> None:
    matched, gains, shares = np.array([[3.0, 1.0], [0.5, 2.0]]), np.array([1.0, 0.5]), np.array([[0.7, 0.3]])
    best = 0.0
    for decibels in range(-6, 55, 3):
        power = 10 ** (decibels / 10) * gains[:, None] ** 2 * shares
        best = max(best, float(np.sum(matched**2 - matched**2 / (1 + power) - np.log(1 + power))))
    assert ratio_over_rows(matched, gains, shares) == pytest.approx(best)


def test_images_that_are_held_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dwells that all overlap, as of a platform that hovers: those that fill it are told, and the next begins anew."""
    flight, images = flown(0, target(9.0))
    dwells = [dwell_with_movers(images[0], 1e-4 * n, flight.sensor, MoverSettings()) for n in range(4)]
    crawling = [_moved(dwell, 1e-4 * n) for n, dwell in enumerate(dwells)]
    without, limited = DwellMovers(MoverSettings()), DwellMovers(MoverSettings())
    assert [len(without.add(dwell, None)) for dwell in crawling] == [0, 0, 0, 0]
    monkeypatch.setattr(dwell_detection, "MOST_BYTES", 2 * dwells[0].image.pixels.nbytes)
    assert [len(limited.add(dwell, None)) for dwell in crawling] == [0, 0, 0, 3]
    assert len(limited.end()) == 1


def _moved(dwell: ShownDwell, seconds: float) -> ShownDwell:
    """The dwell from where the antenna is so much later."""
    aperture = dwell.image.aperture
    later = replace(aperture, position=aperture.position + seconds * aperture.velocity)
    return replace(dwell, image=replace(dwell.image, aperture=later))
