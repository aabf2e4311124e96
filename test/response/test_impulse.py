"""Measuring focused images of known responses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from alos import forest
from helpers import circular, direct_history, few, make_aperture, make_sensor, refused
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.io import loadmat
from scipy.optimize import brentq, minimize_scalar

from sal_height.errors import UserError
from sal_height.geometry.grid import Grid, without_range_phase
from sal_height.imaging.formers.backprojection import backproject
from sal_height.imaging.pixels import Processing, ground_plane_grid
from sal_height.numeric.windows import window
from sal_height.response.impulse import REACH, CutResponse, ImpulseResponse, measure_brightest, measure_windows
from sal_height.sensor.sensor import PhaseHistory

ROWS, COLS = 90, 120

# A sinc's width at half power (resolution cells), its greatest sidelobe, and the energy beside its main lobe.
HALF_POWER = 2 * brentq(lambda x: np.sinc(x) ** 2 - 0.5, 0.1, 0.9)
PSLR_DB = 10 * np.log10(-minimize_scalar(lambda x: -(np.sinc(x) ** 2), bounds=(1.1, 1.9), method="bounded").fun)
ENERGY = [quad(lambda x: np.sinc(x) ** 2, *limits, limit=200)[0] for limits in ((0, 1), (1, REACH * HALF_POWER))]
ISLR_DB = 10 * np.log10(ENERGY[1] / ENERGY[0])


def response(
    row: float, col: float, cells: tuple[float, float] = (1.7, 2.3), carrier: tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """A point's image: resolution cells of `cells` pixels, band centred on `carrier` (cycles per pixel)."""
    down, across = np.arange(ROWS) - row, np.arange(COLS) - col
    return np.outer(
        np.sinc(down / cells[0]) * np.exp(2j * np.pi * carrier[0] * down),
        np.sinc(across / cells[1]) * np.exp(2j * np.pi * carrier[1] * across),
    )


def numbers(response: ImpulseResponse) -> list[float]:
    """All numbers of a response."""
    return [
        *dataclasses.astuple(response)[:2],
        *dataclasses.astuple(response.row_cut),
        *dataclasses.astuple(response.col_cut),
    ]


PLACES = [(40.0, 60.0), (44.37, 71.81), (42.5, 62.5)]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("carrier", [(0.0, 0.0), (0.31, -0.44), (0.5, 0.25)], ids=["baseband", "shifted", "folded"])
def test_a_point_is_measured_as_theory_has_it(place: tuple[float, float], carrier: tuple[float, float]) -> None:
    measured = measure_brightest(response(*place, carrier=carrier))
    assert measured.row == pytest.approx(place[0], abs=1 / 512)
    assert measured.col == pytest.approx(place[1], abs=1 / 512)
    for cut, cell in ((measured.row_cut, 1.7), (measured.col_cut, 2.3)):
        assert cut.width == pytest.approx(cell * HALF_POWER, rel=1e-3)
        assert cut.pslr_db == pytest.approx(PSLR_DB, abs=0.01)
        assert cut.islr_db == pytest.approx(ISLR_DB, abs=0.02)


def test_theory_is_what_the_books_say() -> None:
    assert pytest.approx(HALF_POWER, abs=1e-3) == 0.886
    assert pytest.approx(PSLR_DB, abs=0.01) == -13.26
    endless = 10 * np.log10(0.5 / ENERGY[0] - 1)
    assert endless == pytest.approx(-9.68, abs=0.01)
    assert endless - 1 < ISLR_DB < endless


@pytest.mark.parametrize("cell", [1.02, 1.2, 3.0, 6.0])
def test_figures_are_those_of_the_response_however_finely_it_is_sampled(cell: float) -> None:
    rows = np.sinc((np.arange(201) - 100.3) / cell)
    measured = measure_brightest(np.outer(rows, rows).astype(complex))
    assert measured.row == pytest.approx(100.3, abs=1 / 256)
    assert measured.row_cut.width == pytest.approx(cell * HALF_POWER, rel=2e-3)
    assert measured.row_cut.pslr_db == pytest.approx(PSLR_DB, abs=0.05)
    assert measured.row_cut.islr_db == pytest.approx(ISLR_DB, abs=0.05)


def test_a_band_that_fills_the_sampling_is_taken_to_be_centred() -> None:
    """Noise would else tell where a band lies that has no edges, and cut it in two."""
    rng = np.random.default_rng(33)
    for place in (40.0, 40.3, 40.5):
        down = np.sinc(np.arange(80) - place)
        measured = measure_brightest(np.outer(down, down) + 3e-3 * circular(rng, (80, 80)))
        assert measured.row == pytest.approx(place, abs=1 / 128)
        assert measured.row_cut.width == pytest.approx(HALF_POWER, rel=0.015)


def clutter_of_blocks(rng: np.random.Generator, side: int, band: float, carrier: float) -> np.ndarray:
    """Speckle of which fields of 8 x 8 pixels differ in brightness (a town), within a band of the rows' frequencies."""
    brightness = np.kron(rng.exponential(size=(side // 8, side // 8)) ** 2, np.ones((8, 8)))
    inside = np.abs(np.fft.fftfreq(side)) <= band / 2
    speckle = np.fft.ifft(np.fft.fft(brightness * circular(rng, (side, side)), axis=0) * inside[:, None], axis=0)
    return speckle * np.exp(2j * np.pi * carrier * np.arange(side))[:, None]


@pytest.mark.parametrize("carrier", [0.0, 0.27, -0.5])
def test_clutter_does_not_move_a_band_that_nearly_fills_the_sampling(carrier: float) -> None:
    """A point 33 dB over clutter: sigma of its row is sqrt(3 / (2 pi^2 B^2 C)), 0.0094 pixels; 12 trials: +- 20 %."""
    rng, side, band, contrast = np.random.default_rng(3), 128, 0.93, 2000.0
    errors, levels = [], []
    for _ in range(12):
        clutter = clutter_of_blocks(rng, side, band, carrier)
        place = side // 2 + rng.uniform(-0.5, 0.5)
        down, across = np.arange(side) - place, np.arange(side) - side // 2
        waves = np.exp(2j * np.pi * (np.outer(down, np.fft.fftfreq(side)) + carrier * down[:, None]))
        point = np.outer(waves[:, np.abs(np.fft.fftfreq(side)) <= band / 2].mean(axis=1), np.sinc(across / 2.3))
        around = np.mean(np.abs(clutter[32:96, 32:96]) ** 2)
        found = measure_brightest(point * np.sqrt(contrast * around) + clutter, near=(side // 2, side // 2))
        errors.append(found.row - place)
        levels.append(found.row_cut.pslr_db)
    sigma = np.sqrt(3 / (2 * np.pi**2 * band**2 * contrast))
    assert np.sqrt(np.mean(np.square(errors))) < 1.5 * sigma
    assert np.median(levels) == pytest.approx(PSLR_DB, abs=0.7)


def parking_lot(shared_data: Callable[[str], Path]) -> tuple[np.ndarray, float]:
    """AFRL Gotcha: range profiles of all pulses, of 424 frequencies in 456."""
    paths = sorted(shared_data("afrl_gotcha").glob("*.mat"))
    history = np.concatenate([loadmat(path)["data"][0][0]["fp"] for path in paths], axis=1)
    profiles = np.fft.fftshift(np.fft.ifft(history, 456, axis=0), axes=0)
    return profiles * np.exp(-2j * np.pi * np.arange(456) * 211.5 / 456)[:, None], 424 / 456


@pytest.mark.parametrize("scene", few(1, [forest, parking_lot]))
def test_a_point_in_real_clutter(
    scene: Callable[..., tuple[np.ndarray, float]], shared_data: Callable[[str], Path]
) -> None:
    """33 dB over the clutter: rms of 40 places 0.0085 and 0.0094 pixels (bound 0.0100 and 0.0094), +- 11 %.

    PSLR is -12.7 and -13.0 dB in the median. With the centre of gravity of the spectrum as the middle of the band, the
    rms in the parking lot was 0.049 pixels, the largest error 0.128.
    """
    image, band = scene(shared_data)
    frequency = np.fft.fftfreq(512)
    waves = frequency[np.abs(frequency) < band / 2]
    rng, errors, levels = np.random.default_rng(7), [], []
    for _ in range(24):
        row, col = (int(rng.integers(half, size - half)) for half, size in zip((128, 64), image.shape, strict=True))
        part, place = image[row - 128 : row + 128, col - 64 : col + 64].astype(complex), rng.uniform(-0.5, 0.5)
        around = np.mean(np.abs(part[96:160, 32:96]) ** 2)
        down = np.exp(2j * np.pi * np.outer(np.arange(-128, 128) - place, waves)).mean(axis=1)
        point = np.outer(down, np.sinc(np.arange(-64, 64) / 2.3)) * np.exp(2j * np.pi * rng.uniform())
        found = measure_brightest(part + np.sqrt(2000 * around) * point, near=(128, 64))
        errors.append(found.row - 128 - place)
        levels.append(found.row_cut.pslr_db)
    assert np.sqrt(np.mean(np.square(errors))) < 1.45 * np.sqrt(3 / (2 * np.pi**2 * band**2 * 2000))
    assert np.max(np.abs(errors)) < 0.03
    assert np.median(levels) == pytest.approx(PSLR_DB, abs=0.6)


def test_positions_follow_a_point_in_small_steps() -> None:
    """A window keeps the response inside the image, so that nothing is cut off."""
    for step in np.linspace(0, 1, 13):
        row, col = 40 + step, 61 - 0.7 * step
        measured = measure_brightest(response(row, col) * np.exp(-((np.arange(COLS) - col) ** 2) / 800))
        assert abs(measured.row - row) < 1 / 1024
        assert abs(measured.col - col) < 1 / 1024


@pytest.mark.parametrize("place", [(3.0, 60.0), (40.0, 116.0), (87.0, 2.0)], ids=["top", "right", "bottom left"])
def test_point_near_the_edge_of_the_image(place: tuple[float, float]) -> None:
    measured = measure_brightest(response(*place))
    # The response is cut off beside the peak: the interpolation rings.
    assert_allclose((measured.row, measured.col), place, atol=0.1)
    assert measured.row_cut.width == pytest.approx(1.7 * HALF_POWER, rel=0.02)
    assert measured.col_cut.width == pytest.approx(2.3 * HALF_POWER, rel=0.02)


def test_what_an_edge_hides_is_not_a_number() -> None:
    reach = REACH * 1.7 * HALF_POWER
    complete = measure_brightest(response(np.ceil(reach), 60.0)).row_cut
    assert complete.islr_db == pytest.approx(ISLR_DB, abs=0.1)
    part = measure_brightest(response(np.floor(reach), 60.0)).row_cut
    assert np.isnan(part.islr_db)
    assert part.pslr_db == pytest.approx(PSLR_DB, abs=0.1)
    main_lobe = measure_brightest(response(3.0, 60.0)).row_cut
    assert np.isnan([main_lobe.pslr_db, main_lobe.islr_db]).all()
    assert np.isnan(dataclasses.astuple(measure_brightest(response(0.0, 60.0)).row_cut)).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (2, 2), (3, 40)])
def test_image_too_small_to_show_a_response(shape: tuple[int, int]) -> None:
    image = response(shape[0] / 2, shape[1] / 2)[: shape[0], : shape[1]]
    measured = measure_brightest(image)
    assert np.isnan([measured.row_cut.pslr_db, measured.row_cut.islr_db]).all()
    assert abs(measured.row - shape[0] / 2) <= 0.5
    assert np.isfinite([measured.row, measured.col, measured.entropy]).all()


def test_the_brightest_of_several_points_is_measured_unless_another_is_named() -> None:
    image = response(30.0, 40.0) + 1.5 * response(60.0, 80.0, cells=(1.7, 3.1))
    measured = measure_brightest(image)
    assert_allclose((measured.row, measured.col), (60, 80), atol=0.02)
    assert measured.col_cut.width == pytest.approx(3.1 * HALF_POWER, rel=0.02)
    other = measure_brightest(image, near=(33, 45))
    assert_allclose((other.row, other.col), (30, 40), atol=0.02)
    assert other.col_cut.width == pytest.approx(2.3 * HALF_POWER, rel=0.02)
    assert other.peak_over_median_db == pytest.approx(measured.peak_over_median_db - 20 * np.log10(1.5), abs=0.05)


def test_pixels_that_are_not_finite_do_not_count() -> None:
    """A border of NaN changes nothing but what lies in it, and hides what it covers."""
    image = response(45.0, 60.0)
    image[:5] = np.nan
    image[80:, 3] = np.inf
    measured = measure_brightest(image)
    assert_allclose((measured.row, measured.col), (45, 60), atol=1 / 128)
    assert measured.row_cut.islr_db == pytest.approx(ISLR_DB, abs=0.05)
    assert np.isfinite(numbers(measured)).all()
    image[:31] = np.nan
    hidden = measure_brightest(image)
    assert np.isnan(hidden.row_cut.islr_db)
    assert hidden.row_cut.pslr_db == pytest.approx(PSLR_DB, abs=0.1)


@pytest.mark.parametrize(("scale", "dtype"), [(1e-30, "c8"), (1e30, "c8"), (1e-200, "c16"), (1e200, "c16")])
def test_the_unit_of_the_samples_does_not_matter(scale: float, dtype: str) -> None:
    image = response(45.2, 60.7) + 0.01
    scaled = (image * scale).astype(dtype)
    assert_allclose(numbers(measure_brightest(scaled)), numbers(measure_brightest(image)), rtol=1e-5)


@pytest.mark.parametrize(
    ("image", "near", "said"),
    [
        (np.zeros((4, 5), complex), None, "4 x 5 pixels has none that is finite"),
        (np.full((4, 5), np.nan + 0j), None, "4 x 5 pixels has none that is finite"),
        (np.eye(30, dtype=complex), (29, 5), "within 8 pixels of row 29, column 5"),
        (np.eye(30, dtype=complex), (300, 300), "within 8 pixels of row 300, column 300"),
    ],
)
def test_nothing_to_measure_is_said(image: np.ndarray, near: tuple[int, int] | None, said: str) -> None:
    with refused(UserError, said):
        measure_brightest(image, near)


def test_peak_over_median_in_decibels() -> None:
    """The median of exponential power is ln 2 of its mean."""
    noise = circular(np.random.default_rng(31), (ROWS, COLS)) * 1e-2
    noise[45, 60] = 30.0
    expected = 10 * np.log10(30.0**2 / (1e-4 * np.log(2)))
    standard_error = 10 / np.log(10) / (np.log(2) * np.sqrt(ROWS * COLS))  # dB: of the median, 1 / sqrt(n) of the mean
    assert measure_brightest(noise).peak_over_median_db == pytest.approx(expected, abs=3.5 * standard_error)
    assert np.isnan(measure_brightest(np.eye(9, dtype=complex)).peak_over_median_db)


def test_entropy_of_known_shares() -> None:
    """One pixel: 0; n equal ones: ln n; speckle: ln n less 1 - Euler's constant."""
    image = np.zeros((20, 30), complex)
    image[4, 5] = 3j
    assert measure_brightest(image).entropy == 0
    image[8:10, 7:14] = -3
    image[0] = np.nan
    assert measure_brightest(image).entropy == pytest.approx(np.log(15), abs=1e-12)
    speckle = circular(np.random.default_rng(32), (300, 300))
    # With x exponential of mean 1, the standard deviation of (2 - Euler's constant) x - x ln x is 0.54.
    standard_error = 0.54 / 300
    expected = np.log(90_000) - 1 + np.euler_gamma
    assert measure_brightest(speckle).entropy == pytest.approx(expected, abs=3.5 * standard_error)


@pytest.mark.parametrize(
    ("name", "pslr_db", "width"), [("rectangular", -13.26, 0.886), ("taylor", -35.2, 1.188), ("hamming", -42.7, 1.303)]
)
def test_windows_have_the_known_figures(name: str, pslr_db: float, width: float) -> None:
    figures = measure_windows()[name]
    assert figures.response.pslr_db == pytest.approx(pslr_db, abs=0.1)
    assert figures.response.width == pytest.approx(width, rel=0.005)
    assert figures.response.width == pytest.approx(figures.broadening * HALF_POWER, rel=1e-3)
    weights = window(name, 1024)
    assert figures.noise_gain == pytest.approx(len(weights) * np.sum(weights**2) / np.sum(weights) ** 2, rel=1e-12)


def test_phase_of_range_is_removed_so_that_a_focused_point_can_be_interpolated() -> None:
    """Away from the middle of the image a lidar's phase winds several times per pixel."""
    sensor, aperture = make_sensor(), make_aperture()
    times = np.arange(sensor.pulse_count) / sensor.pulse_repetition_frequency
    antenna = aperture.position + (times - times[-1] / 2)[:, None] * aperture.velocity
    grid = ground_plane_grid(sensor, aperture, 5000.0, 220, 90, 0.02)
    point = grid.points(109.3, 60.6)
    reference = np.full(len(antenna), 5000.0)
    samples = direct_history(sensor, point[None], [1.0], antenna, reference)[None].astype(np.complex64)
    history = PhaseHistory(0, times, reference, samples)
    image = backproject(history, antenna, sensor, Processing("taylor"), grid)[0]
    measured = measure_brightest(without_range_phase(image, grid, aperture, sensor.wavelength))
    assert_allclose(grid.points(measured.row, measured.col), point, atol=2e-3)
    known = measure_windows()
    resolutions = (sensor.range_resolution * np.sqrt(2), sensor.wavelength * 5000 / (2 * aperture.length))
    for cut, name, resolution in zip(
        (measured.row_cut, measured.col_cut), ("taylor", "rectangular"), resolutions, strict=True
    ):
        assert cut.width * 0.02 == pytest.approx(known[name].response.width * resolution, rel=0.01)
        assert cut.pslr_db == pytest.approx(known[name].response.pslr_db, abs=0.2)
    as_stored = measure_brightest(image).row_cut
    assert as_stored.pslr_db > known["taylor"].response.pslr_db + 3


def test_phase_of_range_of_a_sliding_aperture_is_that_from_abeam() -> None:
    aperture = dataclasses.replace(make_aperture(), sliding=True)
    grid = Grid(np.array([-40.0, -3550.0, 0.0]), np.array([0.0, -1.0, 0.0]), np.array([-1.0, 0.0, 0.0]), 0.5, 0.2, 7, 9)
    wavelength = 0.03
    abeam = np.hypot(grid.pixels()[..., 1], aperture.position[2])
    middle = grid.points(0, 4)[0] - aperture.position[0]  # the middle column lies ahead of the pose by so much
    distance = np.hypot(abeam, middle)
    freed = without_range_phase(np.exp(4j * np.pi / wavelength * distance), grid, aperture, wavelength)
    assert_allclose(freed, np.ones(grid.shape), atol=1e-6)


@pytest.fixture(scope="module")
def corner_reflector(shared_data: Callable[[str], Path]) -> np.ndarray:
    """ALOS PALSAR, HH, (azimuth, range), complex64."""
    h5py = pytest.importorskip("h5py")
    (path,) = shared_data("alos_palsar").glob("calib_RSLC*.h5")
    with h5py.File(path) as file:
        stored = file["science/LSAR/RSLC/swaths/frequencyA/HH"][()]
    return (stored["r"].astype(np.float32) + 1j * stored["i"].astype(np.float32)).astype(np.complex64)


def test_a_real_corner_reflector(corner_reflector: np.ndarray) -> None:
    measured = measure_brightest(corner_reflector)
    assert_allclose((measured.row, measured.col), (50, 25), atol=0.5)
    assert measured.peak_over_median_db == pytest.approx(37.3, abs=0.3)
    known = {"azimuth": CutResponse(1.30, -14.8, -14.7), "range": CutResponse(1.07, -12.6, -9.8)}
    for cut, published in zip((measured.row_cut, measured.col_cut), known.values(), strict=True):
        assert cut.width == pytest.approx(published.width, rel=0.03)
        assert cut.pslr_db == pytest.approx(published.pslr_db, abs=0.3)
        assert cut.islr_db == pytest.approx(published.islr_db, abs=0.3)
