"""What a report says of ground, strips and surfaces, on estimates with known errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import blocks, few
from matplotlib.backends.backend_agg import FigureCanvasAgg

from sal_height import messages
from sal_height.elevation import ESTIMATORS
from sal_height.elevation.looks.looks import look_grid
from sal_height.errors import UserError
from sal_height.geometry.frames import aperture_at
from sal_height.geometry.trajectory import locate_at_elevation
from sal_height.imaging import ImageSettings, Processing, image_beams
from sal_height.imaging.pixels import azimuth_resolution, slant_plane_grid
from sal_height.messages import to_floats
from sal_height.messages.types import ComplexImage, HeightImage, Provenance
from sal_height.pipeline import Compressor, heights
from sal_height.relief import GroundEstimate, GroundKind
from sal_height.relief.heights import HeightField, Surface
from sal_height.runs.truth import surface_report
from sal_height.runs.truth.comparison import PublishedErrors, compare
from sal_height.runs.truth.height_picture import draw_heights
from sal_height.runs.truth.pictures import draw_ground
from sal_height.runs.truth.report import TrueGround, ground_statistics, read_accuracy, read_images
from sal_height.runs.truth.surface_report import as_flown, height_bound, judged, surface_statistics, true_surfaces
from sal_height.simulation import flight_of, load_preset
from sal_height.simulation.flight import SimulatedFlight
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.lit_surfaces import LitSurfaces, truth_image
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.preset import Preset
from sal_height.simulation.scene import Scene

SHAPE = (40, 50)
SEED = 3  # of the recorded flight


def a_ground() -> tuple[GroundEstimate, TrueGround]:
    """Level ground with a step of 1 m at row 20, a tenth of the cells 0.2 m too high, and shadow in the last rows."""
    rng = np.random.default_rng(1)
    terrain = np.where(np.arange(SHAPE[0]) < 20, 1.0, 0.0)[:, None] * np.ones(SHAPE)
    height = terrain + rng.normal(0.0, 0.01, SHAPE)
    height[20] = 1.0  # the edge, one cell off
    height[:, :5] += 0.2
    kind = np.full(SHAPE, GroundKind.MEASURED, np.uint8)
    kind[:, 45:] = GroundKind.INTERPOLATED
    kind[36:] = GroundKind.SHADOW
    height[36:] = np.nan
    sigma = np.where(np.isnan(height), np.nan, 0.01)
    shadow = np.zeros(SHAPE, dtype=bool)
    shadow[36:] = True
    estimate = GroundEstimate(0.0, 0.0, 0.05, height, sigma, kind, np.ones(SHAPE, np.uint32))
    return estimate, TrueGround(terrain, ~shadow, shadow)


def test_errors_are_counted_by_what_heights_rest_on() -> None:
    estimate, truth = a_ground()
    found = ground_statistics(estimate, truth, 0.06)
    assert found["right"] == pytest.approx(0.9 * 35 / 36, abs=0.001)  # an edge that is one cell off is wrong
    assert found["lit"] == {"measured": 0.9, "interpolated": 0.1, "shadow": 0.0, "unseen": 0.0}
    assert found["shadow"]["shadow"] == 1.0
    assert found["measured"]["cells"] == 36 * 45
    assert found["measured"]["beyond_5_sigma"] == pytest.approx(1 - 8 / 9 * 35 / 36, abs=0.005)
    assert found["interpolated"]["within_1_sigma"] == pytest.approx(0.68, abs=0.1)  # 180 cells: standard error 0.035


def test_the_picture_is_written(tmp_path: Path) -> None:
    draw_ground(*a_ground(), tmp_path / "ground.png")
    assert (tmp_path / "ground.png").stat().st_size > 10_000


def test_ground_with_too_many_cells_is_left_out_of_the_report(
    recorded: Path, two_dwells: Preset, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A single height far off may stretch the ground; the rest of the report is made all the same."""
    flight = flight_of(two_dwells, SEED)
    whole = read_accuracy(recorded / "bag", flight, ["ml_height"]).statistics["ml"]
    assert "ground" in whole
    monkeypatch.setattr("sal_height.runs.truth.report.MAX_CELLS", 100)
    without = read_accuracy(recorded / "bag", flight, ["ml_height"]).statistics["ml"]
    assert without == {name: value for name, value in whole.items() if name != "ground"}
    (said,) = caplog.messages
    assert "ml" in said
    assert "100" in said


def test_titles_of_the_heights_are_not_cut_off(
    recorded: Path, two_dwells: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown, cut = [], []

    class Canvas(FigureCanvasAgg):
        def draw(self) -> None:
            super().draw()
            titles = [axis.title for axis in self.figure.axes]
            shown.extend(title.get_text() for title in titles)
            cut.extend(title.get_text() for title in titles if title.get_text() and title.get_window_extent().x0 < 0)

    monkeypatch.setattr("sal_height.picture.FigureCanvasAgg", Canvas)
    judgements = read_accuracy(recorded / "bag", flight_of(two_dwells, SEED), ["ml_height"]).heights
    draw_heights(judgements, read_images(recorded / "bag")["ml"], two_dwells, tmp_path / "height.png")
    assert any("of lit ground" in title for title in shown)
    assert cut == []


def errors_with(position_m: float, name: str, seed: int) -> PublishedErrors:
    """Of an image of the street whose odometry errs by a constant of this size in each coordinate, and says so."""
    preset = load_preset(name)
    preset = replace(preset, impairments=Impairments(odometry=OdometryErrors(position_m=position_m)))
    flight, estimator = flight_of(preset, seed), ESTIMATORS["ml"]
    settings, compressor = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols), Compressor()
    for dwell in range(3):
        slc = compressor.add(flight.phase_history(dwell), flight.track(dwell), flight.sensor, settings)
    assert slc
    looks = estimator.settings(range_looks=preset.looks[0], azimuth_looks=preset.looks[1])
    field = heights(slc, flight.sensor, estimator, looks)
    processing = Processing(settings.range_window, settings.azimuth_window)
    seen, aperture = as_flown(field, slc.aperture, flight, 2)
    truth = true_surfaces(seen, aperture, processing, preset.looks, flight, flight.surface(2))
    return compare(field, truth, flight.sensor.beamwidth).errors


@pytest.mark.parametrize("seed", few(1, [1, 2]))
@pytest.mark.parametrize("name", ["small", "sal_stripmap"])
def test_odometry_that_errs_moves_heights_up_and_changes_nothing_else(name: str, seed: int) -> None:
    """By 0.1 m: the heights' errors are those with exact odometry and one that all share, to 1 mm, at steps as well.

    That is less than half a kerb, so that the nearest surface remains the nearest, but for 2 % of the pixels at most.
    Seen from where the odometry says, a third of them has other errors. Heights between foot and top of a wall
    have none.
    """
    exact, off = errors_with(0.0, name, seed), errors_with(0.1, name, seed)
    assert len(off.nearest) == len(exact.nearest)
    common = np.where(off.within_extent & exact.within_extent, np.nan, off.nearest - exact.nearest)
    assert np.nanmean(np.abs(common - np.nanmedian(common)) > 1e-3) <= 0.02
    assert np.nanmin(off.sigma) > 0.1


@pytest.fixture(scope="module")
def flight() -> SimulatedFlight:
    preset = load_preset("sal_stripmap")
    nodes = np.linspace(-20, 20, 81)
    scene = Scene("level", nodes, nodes, np.full((81, 81), 0.4), np.ones((81, 81)))
    return SimulatedFlight(preset, preset.make_sensor(), scene, preset.dwells, seed=1)


def exact_image(flight: SimulatedFlight, dwell: int, error: float) -> HeightImage:
    """The height image that shows the truth plus `error` (m)."""
    sensor, aperture, preset = flight.sensor, flight.aperture(dwell), flight.preset
    slc_grid = slant_plane_grid(sensor, aperture, 5000.0, preset.image.rows, preset.image.cols, 1.19)
    grid = look_grid(slc_grid, *blocks(*preset.looks))
    cell = sensor.range_resolution * azimuth_resolution(sensor, aperture, 5000.0)
    truth = truth_image(flight.surface(dwell), aperture, grid, cell, sensor.beams)
    first, last = sensor.beams.span
    seen = (truth.elevation > first) & (truth.elevation < last)
    points = grid.pixels()
    there = aperture_at(points, aperture)
    sight = points - there.position
    slant_range = np.linalg.norm(sight, axis=-1)
    positions = locate_at_elevation(truth.elevation, slant_range, sight @ there.direction, there, sensor.look_side)
    height, sigma = np.where(seen, truth.height + error, np.nan), np.where(seen, 0.01, np.nan)
    positions = np.where(seen[..., None], positions, np.nan)
    surface = Surface.at(positions, height, sigma, 0 * sigma)
    field = HeightField(grid, np.where(seen, 0, 1).astype(np.uint8), (surface,))
    slc = ComplexImage(dwell=dwell)
    image = messages.height_to_message(field, aperture, preset.looks, "ml", slc, Provenance())
    image.header.frame_id = "map"
    return image


def statistics_of(images: list[HeightImage], flight: SimulatedFlight) -> dict[str, Any]:
    """Entry of the report on images of the flight."""
    return surface_statistics(judged(images, flight, {image.dwell: flight.surface(image.dwell) for image in images}))


def test_the_errors_of_a_strip_are_those_that_were_added(flight: SimulatedFlight) -> None:
    images = [exact_image(flight, dwell, 0.25) for dwell in (3, 4, 5)]
    assert all(image.aperture.sliding for image in images)
    numbers = statistics_of(images, flight)
    assert numbers["bias_m"] == pytest.approx(0.25, abs=2e-4)
    assert numbers["rms_m"] == pytest.approx(0.25, abs=2e-4)
    assert numbers["s68_m"] < 2e-3
    assert numbers["beyond_5_sigma"] == 1.0
    assert numbers["surfaces"] == numbers["kinds"]["OK"]["surfaces"] > 400
    assert numbers["in_shadow"] == 0
    assert numbers["valid"] > 0.95
    assert numbers["common_sigma_m"] is None


def test_an_estimator_without_images_has_no_errors() -> None:
    numbers = surface_statistics(None)
    assert (numbers["valid"], numbers["surfaces"], numbers["s68_m"], numbers["crb_m"]) == (0.0, 0, None, None)


def test_the_bound_of_a_strip_knows_that_every_column_is_seen_from_abeam(flight: SimulatedFlight) -> None:
    """From the middle of the image its sides lie 0.38 beamwidths off, where the amplitude is sinc(0.38) = 0.78."""
    image, surface = exact_image(flight, 4, 0.0), flight.surface(4)
    sliding = messages.aperture_from_message(image.aperture)
    field, beams = messages.field_from_message(image), image_beams(flight.sensor, "taylor")
    looks = image.range_looks, image.azimuth_looks
    truth = true_surfaces(field, sliding, Processing("taylor", "taylor"), looks, flight, surface)
    abeam, from_the_middle = (
        height_bound(truth, field, aperture, beams, flight, looks[0] * looks[1])
        for aperture in (sliding, replace(sliding, sliding=False))
    )
    ratio = from_the_middle / abeam
    row = ratio[np.isfinite(ratio).all(axis=1)]
    assert len(row) > 5
    np.testing.assert_allclose(row[:, [0, -1]], 1 / np.sinc(0.36), rtol=0.07)
    np.testing.assert_allclose(row[:, row.shape[1] // 2], 1, rtol=0.03)


def test_the_error_that_pixels_share_is_stated_beside_their_bias(flight: SimulatedFlight) -> None:
    image = exact_image(flight, 4, 0.0)
    first = image.surfaces[0]
    common = np.zeros((len(first.height), 6), np.float32)
    common[:, 5] = np.where(np.isnan(first.height), np.nan, 0.03**2)
    first.common_covariance = to_floats(common)
    assert statistics_of([image], flight)["common_sigma_m"] == pytest.approx(0.03, rel=1e-3)


def test_heights_without_one_true_height_are_right_and_have_no_scatter(
    flight: SimulatedFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All surfaces extend from 1 m below to 1 m above the ground; every other height is 0.25 m above their top."""
    lit = surface_report.lit_surfaces

    def tall(*args: Any) -> LitSurfaces:
        found = lit(*args)
        return replace(found, spread=found.spread + 1.0, lowest=found.lowest - 1.0, highest=found.highest + 1.0)

    monkeypatch.setattr(surface_report, "lit_surfaces", tall)
    within, above = exact_image(flight, 4, 0.0), exact_image(flight, 4, 1.25)
    number = statistics_of([within, above], flight)
    assert number["within_extent"] == number["surfaces"] / 2 > 100
    assert number["within_1_sigma"] == 0.5
    assert number["bias_m"] == pytest.approx(0.25, abs=0.02)
    alone = statistics_of([within], flight)
    assert (alone["within_1_sigma"], alone["bias_m"], alone["s68_m"]) == (1.0, None, None)


def test_a_flight_beside_the_scene_is_refused_at_its_first_dwell(flight: SimulatedFlight) -> None:
    far = replace(flight, scene=replace(flight.scene, east=flight.scene.east + 500))
    with pytest.raises(UserError, match="no terrain"):
        far.surface(0)
