"""SPECAN against backprojection: the same image, the same invalid pixels, and an error that is known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from former_scenes import EAST, Case, chosen, db, difference_db, dwell
from helpers import flat_scene, refused
from scipy.constants import speed_of_light

from sal_height.errors import UserError
from sal_height.geometry.frames import ApertureState
from sal_height.imaging.formers.choice import ALLOWED_ERROR
from sal_height.imaging.formers.specan import expected_error, focus_spotlight
from sal_height.imaging.pixels import Processing, ground_plane_grid, slant_plane_grid
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.preset import load_preset

CLIMBING = np.array([1.0, 0.3, 0.05])


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"gust": 1.0},
        {"gust": 10.0},
        {"jitter": 2e-6},
        {"direction": CLIMBING},
        {"direction": np.array([-0.2, -1.0, -0.1]), "look_side": -1},
        {"shift": (7.3, 4.6)},
        {"spread": (0.3, 0.7)},
        {"pulse_count": 47, "sample_count": 63, "rows": 37, "cols": 11},
        {"rows": 1, "cols": 1},
        {"rows": 1, "cols": 9},
        {"rows": 9, "cols": 1},
        {"processing": Processing("rectangular")},
        {"elevation_boresights": (0.785,), "noise_power": (1.0,)},
        {"bandwidth": 5e9, "sample_count": 128, "rows": 100, "length": 0.1, "pulse_count": 80},
    ],
    ids=str,
)
def test_image_is_that_of_backprojection(changes: dict) -> None:
    """-60 dB on speckle, where -40 are asked for: a lidar's dwell on level, climbing, gusty and trembling tracks."""
    case = dwell(np.random.default_rng(70), **changes)
    image, reference = case.image(focus_spotlight), case.image()
    assert image.dtype == np.complex64
    assert image.shape == reference.shape
    assert difference_db(image, reference) < -60


def peak(image: np.ndarray) -> np.ndarray:
    """Row and column of the peak: vertices of the parabolas through the greatest sample and its neighbours."""
    power = np.abs(image) ** 2
    top = np.unravel_index(int(np.argmax(power)), power.shape)
    where = []
    for axis, index in enumerate(top):
        low, middle, high = np.moveaxis(power, axis, 0)[index - 1 : index + 2, top[1 - axis]]
        where.append(index + (low - high) / (2 * (low - 2 * middle + high)))
    return np.array(where)


@pytest.mark.parametrize("changes", [{}, {"gust": 5.0}, {"direction": CLIMBING}], ids=str)
@pytest.mark.parametrize("offset", [(0.0, 0.0), (11.37, 4.61), (-16.2, -5.4), (15.9, -4.05)])
def test_point_peaks_within_a_128th_of_the_resolution_of_where_it_is(changes: dict, offset: tuple) -> None:
    """With its amplitude, on pixels 16 times as dense; the point lies far from the middle of the image."""
    case, dense = dwell(np.random.default_rng(72), **changes), 16
    half = dense * (np.ceil(np.abs(offset)).astype(int) + 1)
    grid = case.grid
    corner = (np.array(grid.shape) - 1) / 2 - half / dense
    grid = replace(
        grid, origin=grid.points(*corner), rows=int(2 * half[0] + 1), cols=int(2 * half[1] + 1),
        row_spacing=grid.row_spacing / dense, col_spacing=grid.col_spacing / dense,
    )  # fmt: skip
    pixel = half + dense * np.array(offset)
    case = replace(case.with_targets(grid.points(*pixel)[None], [[1.7j]]), grid=grid)
    image = case.image(focus_spotlight)[0]
    np.testing.assert_allclose(peak(image), pixel, atol=dense / 128)
    assert np.nanmax(np.abs(image)) == pytest.approx(1.7, rel=5e-3)


def test_amplitude_ratios_between_detectors_survive() -> None:
    """Every detector gets the same filter: bit for bit where the gain is a power of two, else to the rounding."""
    case = dwell(np.random.default_rng(73), elevation_boresights=tuple(0.785 + 1e-4 * np.arange(5)),
                 noise_power=(1.0,) * 5)  # fmt: skip
    gains = np.array([1.0, 0.5, -0.31, 0.05 + 0.4j, 0.9])
    samples = (gains[:, None, None] * case.history.samples[0].astype(complex)).astype(np.complex64)
    image = replace(case, history=replace(case.history, samples=samples)).image(focus_spotlight)
    np.testing.assert_array_equal(image[1], image[0] * np.float32(0.5))
    scale = np.abs(image[0]).max()
    for detector, gain in enumerate(gains):
        np.testing.assert_allclose(image[detector], gain * image[0], atol=1e-6 * scale)


def test_detectors_together_are_each_alone() -> None:
    """More detectors than workers, and not a multiple of them."""
    count = 5
    case = dwell(np.random.default_rng(74), elevation_boresights=tuple(0.785 + 1e-4 * np.arange(count)),
                 noise_power=(1.0,) * count)  # fmt: skip
    together = case.image(focus_spotlight)
    for detector in range(count):
        alone = replace(case.history, samples=case.history.samples[[detector]])
        image = replace(case, history=alone).image(focus_spotlight)
        np.testing.assert_allclose(image[0], together[detector], atol=1e-6 * np.abs(together).max())


@pytest.mark.parametrize("pulse", [None, 0, 7])
def test_pixels_beyond_the_range_window_are_those_of_backprojection(pulse: int | None) -> None:
    """Also where it is one pulse alone that does not reach them, neither the first nor the last nor the middle one."""
    case = dwell(np.random.default_rng(75), rows=70, cols=5, gust=3.0)
    if pulse is not None:
        reference = case.history.reference_range.copy()
        reference[pulse] += case.sensor.range_window / 4
        case = replace(case, history=replace(case.history, reference_range=reference))
    image, expected = case.image(focus_spotlight), case.image()
    assert 0.05 < np.mean(np.isnan(expected)) < 0.4
    np.testing.assert_array_equal(np.isnan(image), np.isnan(expected))


def random_dwell(rng: np.random.Generator) -> Case:
    """From light to X-band, centimetres to metres, wide and narrow, straight and trembling."""
    wavelength, reach = 10 ** rng.uniform(-6, -1.5), 10 ** rng.uniform(3, 4.7)
    resolution = 10 ** rng.uniform(-1.3, 1)
    return dwell(
        rng, reach=reach, length=min(wavelength * reach / (2 * resolution * rng.uniform(0.7, 3)), reach / 5),
        rows=int(rng.integers(5, 60)), cols=int(rng.integers(3, 50)), wavelength=wavelength,
        bandwidth=min(speed_of_light / (2 * resolution), 0.2 * speed_of_light / wavelength), aperture=1000 * wavelength,
        elevation_boresights=(np.pi / 4,), noise_power=(1.0,), pulse_count=int(rng.integers(30, 70)),
        jitter=wavelength * rng.choice([0, 0.3]),
    )  # fmt: skip


def test_expected_error_bounds_the_measured_one_on_any_dwell() -> None:
    """It is that of the worst pixel: the image errs by less, and by no more than 16 dB less."""
    rng, seen = np.random.default_rng(76), []
    while len(seen) < 24:
        case = random_dwell(rng)
        expected = db(expected_error(case.antenna, case.sensor, case.grid))
        if -80 < expected < -10:
            seen.append(difference_db(case.image(focus_spotlight), case.image()) - expected)
    assert max(seen) < 0
    assert min(seen) > -16


def test_dwell_on_which_it_would_err_is_refused_in_a_sentence_and_one_just_allowed_is_below_40_db() -> None:
    """The columns of an X-band dwell: the azimuth phase of a point bends with its distance from the middle."""
    rng = np.random.default_rng(77)
    radar = {"wavelength": 0.03, "bandwidth": 3e7, "aperture": 1.9, "reach": 20e3, "length": 60.0}
    cases = [dwell(rng, cols=cols, rows=20, **radar) for cols in range(1, 80, 2)]
    errors = [expected_error(case.antenna, case.sensor, case.grid) for case in cases]
    assert np.all(np.diff(errors) > 0)
    last = int(np.searchsorted(errors, ALLOWED_ERROR)) - 1
    assert 0 < last < len(cases) - 1
    assert difference_db(cases[last].image(focus_spotlight), cases[last].image()) < -40
    with refused(UserError, "specan", "-40 dB", "backprojection"):
        chosen(cases[last + 1], "specan")


def test_ground_plane_is_not_what_it_is_for() -> None:
    case = dwell(np.random.default_rng(78))
    aperture = ApertureState(case.antenna.mean(axis=0), 50 * EAST, np.eye(3), 0.08, np.zeros((6, 6)))
    ground = ground_plane_grid(case.sensor, aperture, 5000.0, 40, 40, 0.07)
    squinted = replace(case.grid, col_direction=CLIMBING / np.linalg.norm(CLIMBING))
    assert expected_error(case.antenna, case.sensor, case.grid) < 1e-6
    assert expected_error(case.antenna, case.sensor, squinted) > ALLOWED_ERROR
    assert expected_error(case.antenna, case.sensor, replace(ground, rows=400, cols=400)) > ALLOWED_ERROR


@pytest.mark.parametrize("gust_mps", [1.0, 5.0])
def test_gusts_do_not_spoil_a_dwell_on_the_pixels_that_the_node_makes(gust_mps: float) -> None:
    """The velocity is tens of mrad off the beam; columns lie across the line of sight all the same."""
    preset = load_preset("sal_spotlight")
    preset = replace(preset, flight=replace(preset.flight, gust_mps=gust_mps))
    sensor = preset.make_sensor()
    flight = SimulatedFlight(preset, sensor, flat_scene(), 4, seed=1)
    aperture = flight.aperture(1)
    antenna = flight.position(flight.dwell_start_ns(1) * 1e-9 + flight.pulse_times)
    grid = slant_plane_grid(sensor, aperture, preset.flight.slant_range_m, preset.image.rows, preset.image.cols, 1.34)
    assert np.linalg.norm(np.cross(aperture.direction, aperture.forward)) > 0.005
    assert expected_error(antenna, sensor, grid) < 10**-6
