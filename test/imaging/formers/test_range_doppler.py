"""Range-Doppler against backprojection on strips: of a lidar, in which nothing migrates, and of a radar."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from former_scenes import SAL, XBAND, chosen, db, difference_db, on_the_ground, strip
from helpers import circular, few, refused

from sal_height.errors import UserError
from sal_height.geometry.grid import Grid
from sal_height.imaging.formers.choice import ALLOWED_ERROR
from sal_height.imaging.formers.range_doppler import (
    _doppler_first,
    _range_first,
    expected_error,
    filters_of,
    focus_stripmap,
)
from sal_height.imaging.pixels import Processing

RADAR = {**XBAND, "pulses": 1000, "targets": 30}

WIDE = {
    **XBAND, "aperture": 0.3, "reach": 1000.0, "spacing": 0.075, "pulses": 1900, "targets": 25, "rows": 300,
    "frequencies": 448, "gains": (1.0,), "fold": 4, "processing": Processing("taylor", "hamming"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "below"),
    few(
        8,
        [
            ({}, -60),
            ({"processing": Processing("rectangular", "rectangular"), "row_spacing": 1.0}, -50),
            ({"processing": Processing("taylor", "hamming")}, -60),
            ({"fold": 1}, -55),
            ({"fold": 3}, -60),
            ({"fold": 1.4}, -50),
            ({"fold": 1.98}, -50),
            ({"fold": 0.3}, -50),
            ({"offset": 0.0}, -52),
            ({"drift": 0.02}, -45),
            ({"gust": 1.0}, -50),
            ({"gust": 10.0}, -50),
            ({"crab": 0.05}, -60),
            ({"look_side": -1}, -60),
            ({"rows": 1}, -60),
            ({"pulses": 481, "frequencies": 63, "rows": 39, "gains": (1.0,)}, -50),
            ({"margin": -0.5, "rows": 60}, -50),
        ],
    ),
    ids=str,
)
def test_image_of_a_lidar_strip_is_that_of_backprojection(changes: dict, below: float) -> None:
    case = strip(np.random.default_rng(90), **SAL, **changes)
    image, reference = case.image(focus_stripmap), case.image()
    assert image.dtype == np.complex64
    np.testing.assert_array_equal(np.isnan(image), np.isnan(reference))
    assert difference_db(image, reference) < below


@pytest.mark.parametrize("gust", [0.0, 1.0], ids=["calm", "gusts"])
def test_where_nothing_migrates_range_may_be_compressed_before_the_azimuth_fft(gust: float) -> None:
    """The order matters to rounding alone; with migration the range transforms of the Dopplers are not alike."""
    case = strip(np.random.default_rng(92), **SAL, gust=gust)
    filters = filters_of(case.history, case.antenna, case.sensor, case.processing, case.grid)
    assert filters.range.is_common
    assert (filters.resampling is None) == (gust == 0)
    samples = case.history.samples[0]
    swapped = np.fft.fft(_range_first(samples, filters), filters.azimuth.shape[1])
    ordinary = _doppler_first(samples, filters)
    assert difference_db(swapped[None], ordinary[None]) < -115
    radar = strip(np.random.default_rng(92), **{**RADAR, "targets": 1})
    assert not filters_of(radar.history, radar.antenna, radar.sensor, radar.processing, radar.grid).range.is_common


@pytest.mark.parametrize(
    "changes",
    [{}, {"drift": 0.01, "fold": 1}, {"gust": 0.5}, {"look_side": -1, "offset": 0.0}, {"pulses": 1001, "rows": 33}],
    ids=str,
)
def test_image_of_a_radar_strip_is_that_of_backprojection(changes: dict) -> None:
    """Targets come more than a cell nearer in the aperture; -40 dB are what far sidelobes leave."""
    case = strip(np.random.default_rng(91), **{**RADAR, **changes})
    assert case.sensor.beamwidth**2 * RADAR["reach"] / 8 > 1.3 * case.sensor.range_resolution
    image, reference = case.image(focus_stripmap), case.image()
    np.testing.assert_array_equal(np.isnan(image), np.isnan(reference))
    assert difference_db(image, reference) < -40


CLOSE_PULSES = {
    "wavelength": 1.0, "aperture": 2.0, "bandwidth": 3e6, "reach": 1000.0, "spacing": 0.2, "pulses": 5000, "rows": 20,
    "frequencies": 32, "fold": 4, "gains": (1.0,), "targets": 20, "processing": Processing("taylor", "hamming"),
}  # fmt: skip


def test_pulses_closer_than_a_quarter_of_the_wavelength_do_not_spoil_the_image() -> None:
    """A fifth of the Dopplers that they sample belong to no real angle."""
    case = strip(np.random.default_rng(103), **CLOSE_PULSES)
    assert CLOSE_PULSES["spacing"] < case.sensor.wavelength / 4
    image, reference = case.image(focus_stripmap), case.image()
    np.testing.assert_array_equal(np.isnan(image), np.isnan(reference))
    assert difference_db(image, reference) < -45


@pytest.mark.parametrize(("aperture", "fits"), [(0.559, True), (0.558, False)])
def test_a_processed_angle_up_to_the_evanescent_waves_is_refused(aperture: float, fits: bool) -> None:
    """Sine of half the angle at the lowest frequency, half a percent below the middle one: 1 / (2 aperture) / 0.995."""
    case = strip(np.random.default_rng(104), **{**CLOSE_PULSES, "targets": 1, "pulses": 60, "margin": -1.0})
    sensor = replace(case.sensor, elevation_diameter=aperture, azimuth_diameter=aperture, config_hash="")
    lowest = 1 - sensor.bandwidth / 2 * sensor.wavelength / 299_792_458
    assert (1 / (2 * aperture) < 0.9 * lowest) == fits
    assert np.isfinite(expected_error(case.antenna, sensor, case.grid)) == fits


def test_rows_far_from_the_middle_have_the_migration_of_their_own_range() -> None:
    """A swath of a fifth of the range: with the middle's migration its edges would be off by a quarter of a cell."""
    case = strip(np.random.default_rng(92), **WIDE)
    half_swath = case.grid.rows * case.grid.row_spacing / 2
    assert case.sensor.beamwidth**2 * half_swath / 8 > 0.24 * case.sensor.range_resolution
    assert difference_db(case.image(focus_stripmap), case.image()) < -40


@pytest.mark.parametrize("base", [SAL, RADAR], ids=["lidar", "radar"])
@pytest.mark.parametrize("changes", [{}, {"gust": 0.5}], ids=str)
@pytest.mark.parametrize("place", [(0.1, 0.12), (0.85, 0.9)])
def test_point_peaks_within_a_128th_of_the_resolution_of_where_it_is(base: dict, changes: dict, place: tuple) -> None:
    """On 16 pixels to a cell along rows and columns through it, in two corners of an image."""
    case = strip(np.random.default_rng(94), **{**base, "targets": 1, **changes})
    grid, dense = case.grid, 16
    resolution = case.sensor.range_resolution, case.sensor.wavelength / (2 * case.sensor.beamwidth)
    point = grid.points(place[0] * grid.rows, place[1] * grid.cols)
    case = case.with_targets(point[None], [[1.0]])
    for axis in (0, 1):
        # The cut is as long as from one end of the image to the other, so that the point is not its middle.
        length = (grid.rows * grid.row_spacing, 4 * resolution[1])[axis]
        count = int(length / resolution[axis] * dense)
        before = int((place[0], 0.4)[axis] * count)
        spacing = [float(step) for step in resolution]
        spacing[axis] /= dense
        direction = (grid.row_direction, grid.col_direction)[axis]
        origin = point - before * spacing[axis] * direction
        cut = Grid(
            origin, grid.row_direction, grid.col_direction, spacing[0], spacing[1], *((count, 1), (1, count))[axis]
        )
        image = np.abs(replace(case, grid=cut).image(focus_stripmap)[0].ravel()) ** 2
        top = int(np.argmax(image))
        low, middle, high = image[top - 1 : top + 2]
        assert top + (low - high) / (2 * (low - 2 * middle + high)) == pytest.approx(before, abs=dense / 128)


def test_amplitude_ratios_between_detectors_survive() -> None:
    """Every detector gets the same filter; with targets so weak and strong that nothing of it could hide."""
    gains = np.array([1.0, 0.5, -0.31, 0.05 + 0.4j, 0.9])
    case = strip(np.random.default_rng(95), **SAL, gains=(1.0,) * 5)
    samples = (gains[:, None, None] * case.history.samples[0].astype(complex)).astype(np.complex64)
    image = replace(case, history=replace(case.history, samples=samples)).image(focus_stripmap)
    np.testing.assert_array_equal(image[1], image[0] * np.float32(0.5))
    scale = np.abs(image[0]).max()
    for detector, gain in enumerate(gains):
        np.testing.assert_allclose(image[detector], gain * image[0], atol=1e-6 * scale)


def test_detectors_together_are_each_alone() -> None:
    case = strip(np.random.default_rng(96), **SAL, gains=(1.0,) * 3)
    noise = circular(np.random.default_rng(97), case.history.samples.shape).astype(np.complex64)
    case = replace(case, history=replace(case.history, samples=noise))
    together = case.image(focus_stripmap)
    for detector in range(3):
        alone = replace(case, history=replace(case.history, samples=noise[[detector]])).image(focus_stripmap)
        np.testing.assert_allclose(alone[0], together[detector], atol=1e-6 * np.abs(together).max())


@pytest.mark.parametrize(("base", "below"), [(SAL, -50), (RADAR, -50)], ids=["lidar", "radar"])
def test_two_blocks_that_overlap_show_what_one_long_image_shows(base: dict, below: float) -> None:
    """Each from the pulses of its own columns' apertures; the second begins at an odd column."""
    case = strip(np.random.default_rng(98), **{**base, "margin": 1.03})
    whole = case.image(focus_stripmap)
    half = 1.01 * case.sensor.beamwidth * base["reach"] / 2
    along = case.antenna @ case.grid.col_direction
    cut = case.grid.cols // 2 + 1
    for columns in (slice(0, cut + 5), slice(cut, case.grid.cols)):
        grid = replace(case.grid, origin=case.grid.points(0, columns.start), cols=columns.stop - columns.start)
        ends = (case.grid.points(0, np.array([columns.start, columns.stop - 1]))) @ grid.col_direction
        pulses = np.flatnonzero((along > ends[0] - half) & (along < ends[1] + half))
        history = replace(
            case.history,
            pulse_times=case.history.pulse_times[pulses],
            reference_range=case.history.reference_range[pulses],
            samples=case.history.samples[:, pulses],
        )
        assert len(pulses) < 0.9 * len(along)
        image = replace(case, history=history, antenna=case.antenna[pulses], grid=grid).image(focus_stripmap)
        assert np.isfinite(image).all()
        assert difference_db(image, whole[..., columns]) < below


@pytest.mark.parametrize("base", [SAL, RADAR], ids=["lidar", "radar"])
@pytest.mark.parametrize(
    "changes", [{"margin": 0.5}, {"margin": -0.5}, {"rows": 71}, {"margin": 0.3, "rows": 70, "gust": 0.5}], ids=str
)
def test_pixels_without_a_filled_aperture_or_beyond_the_range_window_are_those_of_backprojection(
    base: dict, changes: dict
) -> None:
    """Also in an image much longer than the track."""
    case = strip(np.random.default_rng(99), **{**base, "targets": 2, **changes})
    image, expected = case.image(focus_stripmap), case.image()
    assert 0.1 < np.mean(np.isnan(expected)) < 0.95
    np.testing.assert_array_equal(np.isnan(image), np.isnan(expected))


def test_pulses_too_far_apart_for_the_aperture_are_refused_in_a_sentence() -> None:
    """An aperture of one beamwidth needs a pulse every half antenna; with just that many it is formed."""
    sparse, enough = (
        strip(np.random.default_rng(100), **{**SAL, "spacing": spacing, "pulses": 320, "targets": 1}, fold=1)
        for spacing in (5.05e-3, 4.95e-3)
    )
    assert np.isfinite(enough.image(focus_stripmap)).all()
    with refused(UserError, "0.00505 m", "0.005 m", "pulse repetition frequency"):
        sparse.image(focus_stripmap)


FLOOR = 10**-4.4
"""What far sidelobes leave of a radar's strip, with an azimuth window that has low ones."""


@pytest.mark.parametrize(
    "base", [SAL, {**RADAR, "processing": Processing("taylor", "hamming")}], ids=["lidar", "radar"]
)
def test_expected_error_bounds_the_measured_one_on_any_strip(base: dict) -> None:
    """Of tracks that are bent or not along the columns, and of pixels that are not in the slant plane."""
    short = {**base, "gains": (1.0,), "targets": 12, "margin": 1.2, "processing": Processing("taylor", "hamming")}
    rng, ratios = np.random.default_rng(101), []
    for changes in (
        {},
        {"gust": 3.0},
        {"gust": 10.0},
        {"crab": 0.02},
        {"crab": -0.06},
        {"drift": 0.1},
        "ground",
        "wide ground",
    ):
        if isinstance(changes, str):
            swath = {"rows": 200, "frequencies": 320} if "wide" in changes else {}
            case = on_the_ground(strip(rng, **{**short, **swath}), rng)
        else:
            case = strip(rng, **{**short, **changes})
        expected = expected_error(case.antenna, case.sensor, case.grid)
        measured = difference_db(case.image(focus_stripmap), case.image())
        assert measured < db(min(expected, 2.0) + FLOOR), changes
        if 1e-3 < expected < 0.3:
            ratios.append(measured - db(expected))
    assert ratios
    assert min(ratios) > -16


def test_strip_on_which_it_would_err_is_refused_in_a_sentence() -> None:
    rng = np.random.default_rng(102)
    for case in (strip(rng, **RADAR, gust=10.0), on_the_ground(strip(rng, **RADAR), rng)):
        assert expected_error(case.antenna, case.sensor, case.grid) > ALLOWED_ERROR
        with refused(UserError, "range_doppler", "-40 dB", "backprojection"):
            chosen(case, "range_doppler")
