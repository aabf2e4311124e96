"""The strip: images of blocks that join without seam or gap, held against one long compression of all pulses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from helpers import (
    BEAMWIDTH,
    assert_one_sentence,
    bare_scatterers,
    circular,
    elevation_at,
    few,
    make_aperture,
    make_sensor,
    refused,
)
from scipy.spatial.transform import Rotation

from sal_height.errors import Rejected, UserError
from sal_height.geometry.frames import look_direction
from sal_height.geometry.grid import Grid, without_range_phase
from sal_height.geometry.trajectory import PlatformState, Trajectory
from sal_height.imaging.focus import ImageSettings, Slc
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.pixels import Processing
from sal_height.imaging.strip import GREATEST_DRIFT, SPARE_PULSES, SPARE_SHARE
from sal_height.imaging.strip_focus import StripFocuser
from sal_height.sensor.sensor import PhaseHistory, Sensor, processed_angle
from sal_height.settings import setting
from sal_height.simulation.gust import gust_motion
from sal_height.simulation.stripmap import simulate_block

REACH, SPEED, PRF, ODOMETRY = 5000.0, 50.0, 20e3, 200
WAY = SPEED / PRF
APERTURE = BEAMWIDTH * REACH
"""Length of a target's aperture: 0.775 m, 310 pulses."""


def strip_sensor(**changes: object) -> Sensor:
    values = {
        "mode": "stripmap",
        "pattern": "sinc",
        "pulse_repetition_frequency": PRF,
        "sample_count": 32,
        "elevation_boresights": tuple(elevation_at(np.array([-0.25, 0.25]))),
        "noise_power": (1.0, 1.0),
    }
    return make_sensor(**{**values, **changes})


@dataclass(frozen=True)
class Flown:
    """Pulses of a strip, and the odometry: 200 samples per second, from before the first pulse to after the last."""

    sensor: Sensor
    samples: np.ndarray
    states: list[PlatformState]
    reach: float = REACH

    @property
    def count(self) -> int:
        return self.samples.shape[1]

    def track(self, start_ns: int, end_ns: int) -> Trajectory:
        """Of odometry from the last sample before to the first after, as a node holds it."""
        step = round(1e9 / ODOMETRY)
        return Trajectory([s for s in self.states if start_ns - step < s.stamp_ns < end_ns + step])

    def history(self, first: int, last: int) -> PhaseHistory:
        """Pulses from `first` to before `last`."""
        prf = self.sensor.pulse_repetition_frequency
        times, ranges = np.arange(last - first) / prf, np.full(last - first, self.reach)
        return PhaseHistory(round(first / prf * 1e9), times, ranges, self.samples[:, first:last])

    def feed(self, focuser: StripFocuser, first: int, last: int, settings: ImageSettings) -> Slc | None:
        """The next block of a strip."""
        history = self.history(first, last)
        track = self.track(history.stamp_ns, history.stamp_of_last_pulse_ns)
        return focuser.focus_block(history, track, self.sensor, settings)

    def images(self, block: int, settings: ImageSettings, lost: tuple[int, ...] = ()) -> list[Slc]:
        """Of all blocks but those that are lost."""
        focuser = StripFocuser()
        slcs = [
            self.feed(focuser, number * block, (number + 1) * block, settings)
            for number in range(self.count // block)
            if number not in lost
        ]
        return [slc for slc in slcs if slc]

    def at_once(self, grid: Grid, settings: ImageSettings, count: int | None = None) -> np.ndarray:
        """One backprojection of all pulses."""
        history = self.history(0, count or self.count)
        antenna = Trajectory(self.states).positions(0, history.pulse_times)
        processing = Processing(settings.range_window, settings.azimuth_window, processed_angle(self.sensor))
        return backproject(history, antenna, self.sensor, processing, grid)


def odometry(
    seconds: float, gust: float = 0.0, wind: float = 0.0, yaw_rate: float = 0.0, heading: float = 0.0
) -> list[PlatformState]:
    """Eastwards at SPEED, with gusts, a steady drift northwards (m/s), and a body that turns left."""
    motion, states = gust_motion(gust, SPEED, np.random.default_rng(70)), []
    for number in range(-2, int(seconds * ODOMETRY) + 4):
        time = number / ODOMETRY
        mean = np.array([SPEED, wind, 0.0])
        states.append(
            PlatformState(
                stamp_ns=round(time * 1e9),
                position=make_aperture().position + mean * time + motion.displacement(time),
                orientation=(Rotation.from_euler("z", heading + yaw_rate * time) * motion.rotation(time)).as_quat(),
                velocity=mean + motion.velocity(time),
                covariance=np.zeros((6, 6)),
            )
        )
    return states


def noisy(pulses: int, sensor: Sensor | None = None, **flight: float) -> Flown:
    """Noise: every pulse tells on every pixel."""
    sensor = sensor or strip_sensor()
    rng = np.random.default_rng(71)
    shape = sensor.detector_count, pulses, sensor.sample_count
    return Flown(sensor, circular(rng, shape).astype(np.complex64), odometry(pulses / PRF, **flight))


@cache
def echoing(gust: float) -> Flown:
    """Scatterers strewn over the range window, lit by the beams."""
    sensor, rng, pulses = strip_sensor(), np.random.default_rng(72), 1500
    states = odometry(pulses / PRF, gust)
    antenna = Trajectory(states).positions(0, np.arange(pulses) / PRF)
    ranges, along = REACH + rng.uniform(-1, 1, 300), rng.uniform(-APERTURE, pulses * WAY + APERTURE, 300)
    points = antenna[0] + ranges[:, None] * look_direction(elevation_at(0.0), 0.0, 1)
    points[:, 0] += along
    rotation, reference = np.broadcast_to(np.eye(3), (pulses, 3, 3)), np.full(pulses, REACH)
    surface = bare_scatterers(points, np.ones(300), deterministic=True)
    return Flown(sensor, simulate_block(sensor, surface, circular(rng, (300,)), antenna, rotation, reference), states)


def joined(slcs: list[Slc]) -> tuple[np.ndarray, Grid]:
    grid = replace(slcs[0].grid, cols=sum(slc.grid.cols for slc in slcs))
    return np.concatenate([slc.images for slc in slcs], axis=-1), grid


def assert_one_lattice(slcs: list[Slc], cols: int) -> None:
    for before, after in pairwise(slcs):
        np.testing.assert_allclose(before.grid.points(0, before.grid.cols), after.grid.origin, atol=1e-9)
        for name in ("row_direction", "col_direction", "row_spacing", "col_spacing", "rows"):
            np.testing.assert_array_equal(getattr(before.grid, name), getattr(after.grid, name))
    assert all(slc.grid.cols % cols == 0 for slc in slcs)


@pytest.mark.parametrize("gust", [0.0, 1.0], ids=["calm", "gusts"])
@pytest.mark.parametrize(("block", "cols"), few(2, [(256, 0), (33, 20), (100, 37), (700, 64)]))
def test_images_are_those_of_one_long_compression_and_no_column_is_missing(gust: float, block: int, cols: int) -> None:
    """In blocks from a tenth to twice an aperture; pixels of all columns that the pulses fill, but for the last few.

    The pulse at the end of an aperture counts by its share within, for which a pulse's way is the mean of those held.
    """
    flown, settings = echoing(gust), ImageSettings(air="none", former="backprojection", cols=cols)
    slcs = flown.images(block, settings)
    cols = cols or block // 2
    assert_one_lattice(slcs, cols)
    image, grid = joined(slcs)
    assert grid.col_spacing == pytest.approx(0.005, rel=0.02)  # half the antenna, whatever the gusts
    around = replace(grid, origin=grid.points(0, -1), cols=grid.cols + 1 + cols)
    expected = flown.at_once(around, settings, flown.count // block * block)
    np.testing.assert_allclose(
        image, expected[..., 1 : 1 + grid.cols], rtol=0, atol=(3e-5 if gust else 1e-5) * np.nanmax(np.abs(expected))
    )
    filled = np.isfinite(expected).all(axis=(0, 1))
    assert not filled[0]
    assert np.count_nonzero(filled[1 + grid.cols :]) < cols


@pytest.mark.parametrize("gust", [0.0, 1.0], ids=["calm", "gusts"])
@pytest.mark.parametrize(("block", "cols"), [(256, 0), (100, 37)])
def test_fast_former_makes_the_same_strip(gust: float, block: int, cols: int) -> None:
    flown, settings = echoing(gust), ImageSettings(air="none", former="range_doppler", cols=cols)
    slcs = flown.images(block, settings)
    assert_one_lattice(slcs, cols or block // 2)
    image, grid = joined(slcs)
    expected = flown.at_once(grid, settings)
    error = np.mean(np.abs(image - expected) ** 2) / np.mean(np.abs(expected) ** 2)
    assert 10 * np.log10(error) < (-50 if gust else -80)  # in gusts, pulses are interpolated


@pytest.mark.parametrize("wind", [0.0, 8.0, 16.0])
def test_a_response_without_the_phase_of_range_does_not_turn_from_pixel_to_pixel(wind: float) -> None:
    """Wind drifts the antenna away from what it looks at, by up to 1.4 m while it passes the image."""
    sensor, pulses = strip_sensor(), 1800
    states = odometry(pulses / PRF, wind=wind)
    antenna = Trajectory(states).positions(0, np.arange(pulses) / PRF)
    point = antenna[pulses // 2] + REACH * look_direction(elevation_at(0.0), 0.0, 1)
    rotation, reference = np.broadcast_to(np.eye(3), (pulses, 3, 3)), np.full(pulses, REACH)
    surface = bare_scatterers(point[None], np.ones(1), deterministic=True)
    samples = simulate_block(sensor, surface, np.ones(1, np.complex64), antenna, rotation, reference)
    slcs = Flown(sensor, samples, states).images(900, ImageSettings(air="none", former="backprojection"))
    powers = [float(np.nanmax(np.abs(slc.images[0]))) for slc in slcs]
    slc = slcs[int(np.argmax(powers))]
    image = without_range_phase(slc.images[0], slc.grid, slc.aperture, sensor.wavelength)
    row, col = np.unravel_index(np.nanargmax(np.abs(image)), image.shape)
    response = image[row - 3 : row + 4, col - 6 : col + 7]
    along, across = response[:, 1:] * response[:, :-1].conj(), response[1:] * response[:-1].conj()
    assert abs(col - slc.grid.cols / 2) > 50, "far from the middle, where any distance would do"
    assert np.angle([along.sum(), across.sum()]) == pytest.approx([0, 0], abs=0.1)


def test_wide_beam_leaves_no_column_of_a_strip_empty() -> None:
    """A radar of 0.3 rad: half its aperture is the tangent of where the sine, not the angle, is 0.15."""
    sensor = strip_sensor(
        wavelength=0.03, aperture=0.1, bandwidth=1e8, pulse_repetition_frequency=1250.0, noise_power=(1.0,),
        elevation_boresights=(np.pi / 4,), sample_count=32,
    )  # fmt: skip
    samples = circular(np.random.default_rng(73), (1, 1500, 32)).astype(np.complex64)
    flown = Flown(sensor, samples, odometry(1.2), reach=100.0)
    settings = ImageSettings(air="none", former="backprojection", cols=16, rows=12)
    image, grid = joined(flown.images(150, settings))
    assert grid.cols > 350
    assert np.isfinite(image).all()
    before = replace(grid, origin=grid.points(0, -1), cols=1)
    assert np.isnan(flown.at_once(before, settings)).any()


def test_pulses_that_no_column_needs_are_dropped_with_their_times() -> None:
    """Also the odometry that is held begins later and later."""
    flown, focuser, block, cols = noisy(64 * 60, strip_sensor(sample_count=24)), StripFocuser(), 64, 10
    settings, held, begins = ImageSettings(air="none", former="backprojection", cols=cols, rows=1), [], []
    for first in range(0, flown.count, block):
        history = flown.history(first, first + block)
        flown.feed(focuser, first, first + block, settings)
        assert focuser._strip
        begins.append(history.stamp_ns - focuser._strip.track.epoch_ns)
        held.append(focuser._strip.history.samples.shape[1])
    aperture = APERTURE / WAY
    most = (1 + SPARE_SHARE) * aperture + SPARE_PULSES + 2 * (cols + 1)
    assert max(held[10:]) <= most
    assert max(begins) * 1e-9 <= most / PRF + 1 / ODOMETRY
    assert min(held[10:]) >= (1 + SPARE_SHARE) * aperture + SPARE_PULSES - 3
    assert min(begins[10:]) * 1e-9 >= aperture / PRF


@pytest.mark.parametrize("gust", [0.0, 5.0], ids=["calm", "gusts"])
def test_aperture_is_that_abeam_of_the_middle_column(gust: float) -> None:
    flown = noisy(1500, gust=gust)
    slcs, motion = (
        flown.images(300, ImageSettings(air="none", cols=20, rows=2)),
        gust_motion(gust, SPEED, np.random.default_rng(70)),
    )
    assert len(slcs) > 2
    for slc in slcs:
        aperture = slc.aperture
        assert aperture.sliding
        assert aperture.length == pytest.approx(APERTURE, rel=1e-9)
        middle = slc.grid.points(0, (slc.grid.cols - 1) / 2)
        assert (middle - aperture.position) @ slc.grid.col_direction == pytest.approx(0, abs=0.01 * WAY)
        time = aperture.position[0] / SPEED
        for _ in range(5):
            time = (aperture.position[0] - motion.displacement(time)[0]) / SPEED
        expected = make_aperture().position + np.array([SPEED, 0, 0]) * time + motion.displacement(time)
        np.testing.assert_allclose(aperture.position, expected, atol=0.01 * WAY)
        np.testing.assert_allclose(aperture.velocity, motion.velocity(time) + np.array([SPEED, 0, 0]), atol=2e-3)
        np.testing.assert_allclose(aperture.rotation, motion.rotation(time).as_matrix(), atol=1e-2 * BEAMWIDTH)


def assert_true(slcs: list[Slc], flown: Flown, settings: ImageSettings) -> None:
    """Every image is what one long compression has at its pixels, and none is empty."""
    for slc in slcs:
        expected = flown.at_once(slc.grid, settings)
        np.testing.assert_allclose(slc.images, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_columns_over_a_lost_block_are_not_published() -> None:
    flown, block, lost = noisy(2400), 150, 7
    settings = ImageSettings(air="none", former="backprojection", cols=10, rows=8)
    slcs = flown.images(block, settings, lost=(lost,))
    assert_true(slcs, flown, settings)
    places = np.concatenate([slc.grid.points(0, np.arange(slc.grid.cols))[:, 0] for slc in slcs])
    start, end = lost * block * WAY, (lost + 1) * block * WAY
    gap = (places > start - APERTURE / 2) & (places < end + APERTURE / 2 - WAY)
    assert not gap.any()
    spans = places[places < start].max() - places.min(), places.max() - places[places > end].min()
    assert min(spans) > 2 * 150 * WAY
    # Nearly all that both parts fill: what is left over are fewer columns than an image has.
    assert start - APERTURE / 2 - places[places < start].max() < 11 * 0.005
    assert places[places > end].min() - end - APERTURE / 2 < 2 * 0.005


@pytest.mark.parametrize("change", [{"rows": 6}, {"cols": 16}, {"azimuth_window": "rectangular"}])
def test_strip_begins_anew_where_another_image_is_wanted(change: dict[str, int]) -> None:
    flown, focuser, block = noisy(1500), StripFocuser(), 150
    first = ImageSettings(air="none", former="backprojection", cols=10, rows=8)
    second = first.changed(**change)
    before = [flown.feed(focuser, n * block, (n + 1) * block, first) for n in range(5)]
    after = [flown.feed(focuser, n * block, (n + 1) * block, second) for n in range(5, 10)]
    assert [slc is not None for slc in before] == [slc is not None for slc in after] == [False, False, *[True] * 3]
    assert all(slc.grid.rows == second.rows and slc.grid.cols % second.cols == 0 for slc in after if slc)
    assert_true([slc for slc in before if slc], flown, first)
    assert_true([slc for slc in after if slc], flown, second)


class NodeSettings(ImageSettings):
    """Settings of images, and one that says nothing of them."""

    patience: float = setting(1.0, "how long to wait", unit="s")


FORMERS = ["backprojection", "range_doppler", "auto", "range_doppler", "backprojection"]


@pytest.mark.parametrize(
    "each",
    [
        [NodeSettings(former="backprojection", cols=10, patience=1.0 + n) for n in range(5)],
        [ImageSettings(air="none", former=former, cols=10) for former in FORMERS],
    ],
    ids=["settings that do not describe images", "another former"],
)
def test_what_does_not_change_the_pixels_goes_on_with_the_strip(each: list[ImageSettings]) -> None:
    flown, focuser = echoing(0.0), StripFocuser()
    slcs = [flown.feed(focuser, n * 300, (n + 1) * 300, settings) for n, settings in enumerate(each)]
    assert_one_lattice([slc for slc in slcs if slc], 10)
    assert all(slc is not None for slc in slcs[1:])


@pytest.mark.parametrize("again", [4, 3, 0])
def test_block_that_is_not_later_than_the_last_is_rejected_and_the_strip_goes_on(again: int) -> None:
    """The last one once more, the one before it, the first; those between are still held, or not any more."""
    flown, focuser, block, slcs = noisy(1500), StripFocuser(), 150, []
    settings = ImageSettings(air="none", former="backprojection", cols=10, rows=8)
    for number in range(10):
        slcs.append(flown.feed(focuser, number * block, (number + 1) * block, settings))
        if number == 4:
            with refused(Rejected, "in order", reason="out of order"):
                flown.feed(focuser, again * block, (again + 1) * block, settings)
    images = [slc for slc in slcs if slc]
    assert len(images) == 8
    assert_one_lattice(images, 10)
    assert_true(images, flown, settings)


def assert_no_gap_along(slcs: list[Slc]) -> None:
    """Columns of the first row follow each other along the flight."""
    for before, after in pairwise(slcs):
        seam = after.grid.origin - before.grid.points(0, before.grid.cols)
        assert seam @ after.grid.col_direction == pytest.approx(0, abs=1e-9)


def test_drift_out_of_the_range_window_lays_the_lattice_anew_without_a_gap() -> None:
    """Crosswind of 16 m/s on a body that keeps its heading: the ground draws away by a range window in 0.2 s."""
    flown = noisy(3600, wind=16.0)
    settings = ImageSettings(air="none", former="backprojection", cols=20, rows=8)
    slcs = flown.images(300, settings)
    assert_true(slcs[::2], flown, settings)
    assert_no_gap_along(slcs)
    sideways = np.array([slc.grid.origin[1] for slc in slcs])
    laid = np.count_nonzero(np.diff(sideways) > 1e-6)
    window, drifted = flown.sensor.range_window, 16 * 3600 / PRF * np.sqrt(0.5)
    assert laid > 0.5 * drifted / (GREATEST_DRIFT * window)
    for slc in slcs:
        # Half an aperture behind the pulse at which the lattice was judged, and a block until it is judged again.
        middle = slc.grid.points((slc.grid.rows - 1) / 2, (slc.grid.cols - 1) / 2)
        off = np.linalg.norm(middle - slc.aperture.position) - REACH
        assert abs(off) < GREATEST_DRIFT * window + 16 * np.sqrt(0.5) * (300 + APERTURE / WAY) / PRF


def test_rows_that_drift_out_of_the_range_window_are_empty_whatever_the_former() -> None:
    """Rows that fill the window: those at its edges leave it, and must not show what lies at the other edge."""
    flown = noisy(1800, wind=8.0)
    slow, fast = (
        flown.images(300, ImageSettings(air="none", former=name, cols=20))
        for name in ("backprojection", "range_doppler")
    )
    (reference, grid), (image, _) = joined(slow), joined(fast)
    assert grid.rows == 23
    empty = np.isnan(reference).all(axis=0)
    assert 0.01 < empty.mean() < 0.12
    assert not empty[2:-2].any()
    assert np.mean(np.isnan(image).all(axis=0) != empty) < 1e-3


def test_body_that_turns_takes_the_lattice_with_it_without_a_gap() -> None:
    """By two beamwidths in 0.15 s, a fifth of one per aperture."""
    flown = noisy(3000, yaw_rate=2e-3)
    settings = ImageSettings(air="none", former="backprojection", cols=10, rows=8)
    slcs = flown.images(100, settings)
    assert_true(slcs[::4], flown, settings)
    assert_no_gap_along(slcs)
    for slc in slcs:
        middle = slc.grid.points((slc.grid.rows - 1) / 2, (slc.grid.cols - 1) / 2)
        ahead = (middle - slc.aperture.position) @ slc.aperture.forward / REACH
        assert abs(ahead) < 0.35 * BEAMWIDTH  # a tenth, and the turn in a block and half an aperture
    turned = slcs[-1].aperture.forward @ np.array([0.0, 1.0, 0.0]) - slcs[0].aperture.forward @ np.array(
        [0.0, 1.0, 0.0]
    )
    assert turned > 1.3 * BEAMWIDTH


@pytest.mark.parametrize("yaw_rate", [-7e-3, 7e-3])
def test_body_that_turns_too_fast_leaves_columns_out_rather_than_empty(yaw_rate: float) -> None:
    """By half a beamwidth from one block to the next."""
    flown = noisy(3000, yaw_rate=yaw_rate)
    settings = ImageSettings(air="none", former="backprojection", cols=10, rows=8)
    slcs = flown.images(200, settings)
    assert len(slcs) > 3
    assert all(np.isfinite(slc.images).all() for slc in slcs)


@pytest.mark.parametrize(("heading", "allowed"), [(1.0, True), (1.1, False), (-1.1, False), (np.pi, False)])
def test_flight_across_the_body_is_refused(heading: float, allowed: bool) -> None:
    flown, settings = noisy(100, heading=heading), ImageSettings(air="none", cols=10, rows=8)
    if allowed:
        assert flown.feed(StripFocuser(), 0, 100, settings) is None
        return
    with refused(Rejected, f"{abs(heading):.3g} rad", "1.05 rad", reason="flight not forward"):
        flown.feed(StripFocuser(), 0, 100, settings)


@pytest.mark.parametrize(
    ("change", "part"),
    [({"image_plane": "ground"}, "ground"), ({"former": "specan"}, "specan")],
)
def test_what_stripmap_does_not_allow_is_said_in_one_sentence(change: dict[str, object], part: str) -> None:
    settings = ImageSettings(air="none", cols=10, rows=8).changed(**change)
    with refused(UserError, part, "stripmap", "allow"):
        noisy(600).images(600, settings)


@pytest.mark.parametrize("window", ["rectangular", "taylor"])
def test_noise_of_an_image_is_what_it_states(window: str) -> None:
    powers = np.array([1.0, 3.0])
    sensor = strip_sensor(noise_power=tuple(powers))
    white = noisy(2800, sensor)
    flown = replace(white, samples=white.samples * np.sqrt(powers)[:, None, None].astype(np.float32))
    slcs = flown.images(
        400, ImageSettings(air="none", former="backprojection", range_window=window, azimuth_window=window)
    )
    image, _ = joined(slcs)
    measured = np.mean(np.abs(image) ** 2, axis=(1, 2))
    # Powers of neighbours, a resolution apart, correlate by 0.11 under the Taylor window, in both directions.
    standard_error = np.sqrt((1.22**2 if window == "taylor" else 1.0) / image[0].size)  # 1 %
    assert standard_error < 0.015
    for slc in slcs:
        np.testing.assert_allclose(measured / slc.noise_power, 1, atol=3.5 * standard_error)


def test_a_clock_that_begins_anew_begins_a_new_strip() -> None:
    """A bag played again: the same blocks, hours earlier, give the same images."""
    flown, focuser, settings = (
        noisy(900),
        StripFocuser(),
        ImageSettings(air="none", former="backprojection", cols=10, rows=8),
    )

    def fly() -> list[np.ndarray]:
        slcs = [flown.feed(focuser, number * 150, (number + 1) * 150, settings) for number in range(6)]
        return [slc.images for slc in slcs if slc]

    first = fly()
    focuser._strip = replace(
        focuser._strip, history=replace(focuser._strip.history, stamp_ns=focuser._strip.history.stamp_ns + 3600 * 10**9)
    )
    second = fly()
    assert len(first) == len(second) > 0
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_single_block_without_a_stated_width_has_the_columns_that_its_pulses_fill() -> None:
    """900 pulses of 2.5 mm, an aperture of 310 of them: 590 places, at the resolution of two pulses 295 columns."""
    flown, focuser, settings = noisy(1800), StripFocuser(), ImageSettings(air="none", former="backprojection", rows=8)
    first = flown.feed(focuser, 0, 900, settings)
    assert first is not None
    assert first.grid.cols == pytest.approx(590 / 2, abs=3)
    assert np.isfinite(first.images).all()
    assert focuser.shortfall == ""
    second = flown.feed(focuser, 900, 1800, settings)
    assert second is not None
    assert second.grid.cols == 900 // 2
    assert_one_lattice([first, second], 1)


@pytest.mark.parametrize(("pulses", "cols", "said"), [(300, 0, "0 of 150 columns"), (400, 100, "of 100 columns")])
def test_a_first_block_without_an_image_says_why(pulses: int, cols: int, said: str) -> None:
    flown, focuser = noisy(900), StripFocuser()
    settings = ImageSettings(air="none", former="backprojection", rows=8, cols=cols)
    assert flown.feed(focuser, 0, pulses, settings) is None
    assert_one_sentence(focuser.shortfall, said, f"{(pulses - 1) * SPEED / PRF:.4g} m", "later block")
    flown.feed(focuser, pulses, 900, settings)
    assert focuser.shortfall == ""


def test_what_navigation_does_not_know_of_the_velocity_is_an_error_along_the_flight() -> None:
    """Range over speed times the standard deviation along the line of sight."""
    flown, settings = noisy(600), ImageSettings(air="none", cols=10, rows=8, autofocus="never")
    stated = [replace(state, velocity_covariance=np.diag([0.0, 4e-6, 0.0])) for state in flown.states]
    plain, uncertain = (
        replace(flown, states=states).images(600, settings)[0].aperture.covariance for states in (flown.states, stated)
    )
    along = 2e-3 * np.sin(elevation_at(0.0)) * REACH / SPEED
    np.testing.assert_allclose(uncertain - plain, np.diag([along**2, 0, 0, 0, 0, 0]), atol=1e-3 * along**2)
