"""Pictures of heights."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import Normalize
from PIL import Image

from sal_height.bag import qos
from sal_height.bag.reader import BagReader
from sal_height.bag.writer import BagWriter
from sal_height.elevation import ESTIMATORS
from sal_height.geometry.grid import Grid
from sal_height.messages import serialize
from sal_height.messages.types import DiagnosticArray, DiagnosticStatus, Doubt, FitTest, HeightImage, KeyValue
from sal_height.picture import STYLE, beyond, look_of, page, shaded
from sal_height.relief import GroundEstimate, HeightField, Surface
from sal_height.runs.campaign.campaign_picture import _style
from sal_height.runs.live.latency_picture import draw_run
from sal_height.runs.products.calibrate import beyond_error
from sal_height.runs.replay.judge import published_latencies
from sal_height.runs.responses.pictures import corners, draw_image, ground_steps
from sal_height.runs.truth.comparison import PublishedErrors, SurfaceComparison
from sal_height.runs.truth.doubt_picture import draw_doubts, fit_over_dwells
from sal_height.runs.truth.height_picture import ground_picture, height_limits, percent_text
from sal_height.runs.truth.pictures import _normal, counted, kind_shares
from sal_height.runs.truth.profile import column_of_greatest_relief
from sal_height.runs.truth.surface_report import GroundCoverage, Judged


@pytest.mark.parametrize(
    ("terrain", "limits"),
    [
        (np.full((4, 5), 2.0), (1.7, 2.3)),
        (np.linspace(0.0, 10.0, 201), (0.05, 9.95)),
        (np.array([0.0, np.nan]), (-0.3, 0.3)),
    ],
)
def test_colours_span_the_terrain_and_on_flat_ground_the_errors(
    terrain: np.ndarray, limits: tuple[float, float]
) -> None:
    assert height_limits(terrain, 0.3) == pytest.approx(limits)


def judgement_of(place: list[list[float]], sigma: list[float], ghost: list[bool]) -> Judged:
    """Four cells of 1 m from west to east: lit, lit, in shadow and silent, and one outside the array."""
    count = len(place)
    errors = PublishedErrors(
        place=np.array(place),
        validity=np.zeros(count, dtype=np.uint8),
        sigma=np.array(sigma),
        common=np.zeros(count),
        nearest=np.where(ghost, np.nan, 0.1),
        own=np.full(count, 0.1),
        ghost=np.array(ghost),
    )
    comparison = SurfaceComparison(errors, 2, 2, 2, 0, 1, 0, np.zeros((5, 7), dtype=np.int64))
    inside = np.array([True, True, True, False])
    ground = GroundCoverage(
        size=1.0,
        tolerance=0.1,
        number=np.array([[5, -2], [5, -1], [5, 0], [5, 1]]),
        terrain=np.array([0.0, 1.0, 2.0, 3.0]),
        inside=inside,
        lit=np.array([True, True, False, False]),
        right=np.array([True, False, False, False]),
        silent=np.array([False, False, True, False]),
    )
    return Judged(comparison, ground, bounds=np.array([0.1]))


def test_a_cell_shows_the_surface_nearest_to_its_middle_and_an_empty_one_why_it_is() -> None:
    one = judgement_of([[-1.4, 5.5, 3.0], [-1.9, 5.5, 4.0]], [0.2, 0.3], [False, False])
    picture = ground_picture(one)
    assert picture.extent == (-2, 1, 5, 6)
    np.testing.assert_array_equal(picture.terrain, [[0, 1, 2]])
    np.testing.assert_array_equal(picture.lit, [[0, 1, np.nan]])
    np.testing.assert_array_equal(picture.height, [[3, 3, 3]])
    near = ground_picture(judgement_of([[-1.4, 5.5, 3.0], [-5.0, 5.5, 4.0]], [0.2, 0.3], [True, False]))
    np.testing.assert_array_equal(near.sigma, [[0.2, 0.2, 0.2]])
    np.testing.assert_array_equal(near.ghost, [[1, 1, 1]])
    assert np.isnan(near.error).all()
    empty = ground_picture(judgement_of([[-9.0, 5.5, 3.0]], [0.2], [False]))
    assert np.isnan(empty.height).all()
    np.testing.assert_array_equal(empty.silent, [[0, 0, 1]])


def test_shares_of_the_ground_are_of_the_cells_inside_the_array() -> None:
    shares = judgement_of([[0.0, 0.0, 0.0]], [0.1], [False]).ground.shares
    assert shares == {"lit": pytest.approx(2 / 3), "shadow": pytest.approx(1 / 3), "right": pytest.approx(1 / 2)}


def errors_of(nearest: list[float], sigma: list[float]) -> PublishedErrors:
    count = len(nearest)
    place = np.zeros((count, 3))
    ghost = ~np.isfinite(nearest)
    off, validity = np.array(nearest), np.zeros(count, np.uint8)
    return PublishedErrors(place, validity, np.array(sigma), np.zeros(count), off, off, ghost)


def test_every_published_surface_is_counted_in_the_histogram() -> None:
    """Within 1 sigma, 2 sigmas, between, beyond 5, beyond the histogram on both sides, and where nothing is lit."""
    nearest = [0.05, -0.15, 0.3, -0.6, 90.0, -90.0, np.nan, np.nan, np.nan, np.nan]
    found = counted(errors_of(nearest, [0.1] * 10))
    assert found.total == 10
    assert found.unlit == 4
    assert (found.bins[0], found.bins[-1], found.bins.sum()) == (1, 1, 6)
    assert found.within == pytest.approx((0.1, 0.2))
    assert found.beyond == pytest.approx(0.3)


def test_errors_that_keep_their_sigmas_are_drawn_as_the_normal_distribution() -> None:
    """The shares of N(0, 1) within 1 and 2 are 0.6827 and 0.9545; 100 000 draws have a standard error of 0.0015."""
    sigma = np.random.default_rng(1).uniform(0.01, 1.0, 100_000)
    found = counted(errors_of((sigma * np.random.default_rng(2).normal(size=sigma.size)).tolist(), sigma.tolist()))
    assert found.within == pytest.approx((0.6827, 0.9545), abs=0.006)
    assert found.bins / found.total == pytest.approx(_normal(), abs=0.005)
    assert _normal().sum() == pytest.approx(1.0, abs=1e-12)


def field_of(heights: np.ndarray) -> HeightField:
    """A height image with surfaces of these heights, shape (surfaces, rows, cols)."""
    rows, cols = heights.shape[1:]
    grid = Grid(np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, rows, cols)
    ones, places = np.ones((rows, cols)), np.zeros((rows, cols, 3))
    surfaces = tuple(Surface.at(places, one, ones, ones) for one in heights)
    return HeightField(grid, np.zeros((rows, cols), np.uint8), surfaces)


def test_the_profile_goes_through_the_column_of_the_greatest_relief() -> None:
    heights = np.zeros((2, 40, 4))
    heights[1] = np.nan
    heights[0, 20:, 1] = 2.0  # a step
    heights[0, 5, 2] = 50.0  # a single height that is wrong
    heights[1, 20:, 3] = 3.0  # layover: second surfaces above the first
    heights[0, 2:, 0] = np.nan  # hardly any height
    heights[0, 0, 0] = 90.0
    higher = heights.copy()
    higher[1, 20:, 3] = 4.0
    assert column_of_greatest_relief({7: field_of(heights)}) == (7, 3)
    assert column_of_greatest_relief({7: field_of(heights), 9: field_of(higher)}) == (9, 3)
    assert column_of_greatest_relief({7: field_of(heights[:1])}) == (7, 1)
    assert column_of_greatest_relief({7: field_of(np.full((1, 3, 3), np.nan))}) is None
    assert column_of_greatest_relief({}) is None


@pytest.mark.parametrize(
    ("values", "ends"),
    [([0.0, 1.0], "neither"), ([-0.1, 1.0], "min"), ([0.0, 1.1, np.nan], "max"), ([-1.0, 2.0], "both")],
)
def test_a_scale_has_triangles_where_values_go_beyond_it(values: list[float], ends: str) -> None:
    assert beyond(np.array(values), (0, 1)) == ends


def test_a_picture_is_as_wide_as_two_columns_and_one_of_greys_is_stored_as_greys(tmp_path: Path) -> None:
    for colour, mode in (("0.3", "L"), ("red", "RGB")):
        with page(tmp_path / "a.png", 1.0) as figure:
            figure.text(0.5, 0.5, "A", color=colour)
        with Image.open(tmp_path / "a.png") as picture:
            assert (picture.size, picture.mode) == ((1585, 220), mode)
            assert np.ptp(np.asarray(picture.convert("L"))) > 100


def test_no_letter_is_smaller_than_six_points() -> None:
    sizes = {name: value for name, value in STYLE.items() if name.endswith(("font.size", "labelsize", "titlesize"))}
    assert len(sizes) >= 5
    assert min(*sizes.values(), STYLE["legend.fontsize"], STYLE["legend.title_fontsize"]) >= 6


def test_light_comes_from_the_north_west_and_leaves_level_ground_as_it_is() -> None:
    """A slope of 45 degrees that faces the light is sqrt(2) as bright as level ground, one that turns away is dark."""
    norm = Normalize(-10, 10)
    north, east = np.mgrid[:5, :5] / np.sqrt(2)
    level, facing, away = (shaded(one, (1.0, 1.0), norm) for one in (np.zeros((5, 5)), east - north, north - east))
    plain = np.array(mpl.colormaps["viridis"](0.5))
    np.testing.assert_allclose(level, np.broadcast_to(plain, (5, 5, 4)), atol=1e-12)
    bright = np.sqrt(2) - 1
    np.testing.assert_allclose(facing[2, 2, :3], plain[:3] * (1 - bright) + bright, atol=1e-12)
    np.testing.assert_allclose(away[2, 2, :3], plain[:3] / 2, atol=1e-12)
    assert shaded(np.array([[0.0, np.nan], [0.0, 0.0]]), (1.0, 1.0), norm)[..., 3].tolist() == [[1, 0], [1, 1]]


def test_all_estimators_are_told_apart_by_colour_and_by_line() -> None:
    looks = [look_of(name) for name in (*ESTIMATORS, "tracked")]
    assert len({one.colour for one in looks}) == len({str(one.line) for one in looks}) == len(looks)


@pytest.mark.parametrize(("share", "text"), [(0.001, "<1"), (0.42, "42"), (0.997, ">99"), (1.0, "100")])
def test_only_all_is_100_percent(share: float, text: str) -> None:
    assert percent_text(share) == text


def test_pixels_of_a_slant_plane_are_drawn_where_they_are_on_level_ground() -> None:
    """A step of 1 m in range, under 30 degrees from nadir, is one of 2 m on the ground."""
    slant = np.array([0.0, -0.5, -np.sqrt(0.75)])
    grid = Grid(np.array([10.0, 21.0, 4.0]), slant, np.array([1.0, 0.0, 0.0]), 1.0, 0.5, 5, 3)
    down, across = ground_steps(grid)
    np.testing.assert_allclose(down, [0, -2])
    np.testing.assert_allclose(across, [0.5, 0])
    np.testing.assert_allclose(corners(grid).min(axis=0), [9.75, 15.0])
    np.testing.assert_allclose(corners(grid).max(axis=0), [11.25, 25.0])


def test_an_image_is_north_up(tmp_path: Path) -> None:
    """The flight goes to the north-west, and the brightest pixels, far away and behind, are in the south-west."""
    turned = np.sqrt(0.5)
    grid = Grid(np.zeros(3), np.array([-turned, -turned, 0]), np.array([-turned, turned, 0]), 1.0, 1.0, 40, 40)
    image = np.full((40, 40), 0.01, np.complex64)
    image[30:, :10] = 1.0
    draw_image(image, grid, "a", tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.mode == "L"
        pixels = np.asarray(picture)[70:570, 110:610]  # within the axes
    row, col = np.argwhere(pixels == 255).mean(axis=0) / pixels.shape
    assert row == pytest.approx((28.3 + 21.2) / 56.6, abs=0.05)
    assert col == pytest.approx((56.6 - 28.3) / 56.6, abs=0.05)


def test_flat_responses_of_receivers_are_no_finding() -> None:
    shapes = np.ones((3, 64), dtype=np.complex128)
    shapes[1:] += 0.05 * np.exp(2j * np.pi * np.arange(64) / 16)
    assert beyond_error(shapes, np.array([0.03, 0.03, np.nan])).tolist() == [False, True, False]
    assert beyond_error(shapes, np.full(3, 0.06)).tolist() == [False, False, False]


def test_shares_of_cells_are_of_those_chosen() -> None:
    kind = np.array([[0, 0, 1, 3], [2, 2, 2, 2]], np.uint8)
    shape = kind.shape
    estimate = GroundEstimate(0, 0, 1, np.zeros(shape), np.ones(shape), kind, np.ones(shape, np.uint32))
    assert kind_shares(estimate, np.array([[True] * 4, [False] * 4])).tolist() == [0.5, 0.25, 0, 0.25]
    assert kind_shares(estimate, np.zeros(shape, bool)).tolist() == [0, 0, 0, 0]


def test_latencies_of_a_bag_are_those_that_nodes_told_over_time(tmp_path: Path) -> None:
    """Two nodes, of which one tells no latency before the second time; a third tells none at all."""
    with BagWriter(tmp_path / "run" / "bag") as bag:
        bag.add_topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", [qos.FRAMES])
        for step, told in enumerate(
            ({"ml_height": (4.0, 9.0), "sink": None}, {"ml_height": (5.0, 8.0), "map": (1.0, 2.0)})
        ):
            states = []
            for name, numbers in told.items():
                values = zip(("latency_p50_ms", "latency_p95_ms"), numbers or (), strict=False)
                states.append(DiagnosticStatus(name=name, values=[KeyValue(key=k, value=str(v)) for k, v in values]))
            stamp = 10**9 + step * 500_000_000
            bag.write("/diagnostics", serialize(DiagnosticArray(status=states)), stamp, stamp)
    found = published_latencies(BagReader(tmp_path / "run" / "bag"))
    assert found.keys() == {"ml_height", "map"}
    np.testing.assert_allclose(found["ml_height"], [[0.0, 0.5], [4.0, 5.0], [9.0, 8.0]])
    np.testing.assert_allclose(found["map"], [[0.5], [1.0], [2.0]])
    (tmp_path / "run" / "report.json").write_text('{"latency_budget_s": 0.3}')
    assert draw_run(tmp_path / "run")
    with Image.open(tmp_path / "run" / "latency.png") as picture:
        assert picture.size[0] == 1585
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    assert (pixels == (213, 94, 0)).all(axis=1).sum() > 50  # ml_height in the colour of its estimator


def test_bags_of_a_campaign_differ_in_line_or_filling_and_estimators_in_colour() -> None:
    styles = {name: [_style(name, number) for number in range(8)] for name in ("ml", "monopulse")}
    for of_one in styles.values():
        assert len({(one["ls"], one["fillstyle"]) for one in of_one}) == 8
        assert len({(one["color"], one["marker"]) for one in of_one}) == 1
    assert styles["ml"][0]["color"] != styles["monopulse"][0]["color"]
    assert styles["ml"][0]["marker"] != styles["monopulse"][0]["marker"]


def test_doubts_are_drawn_over_the_dwells(tmp_path: Path) -> None:
    """Of several tests of a name the least probable one; a dwell without a test has none, and no doubt no picture."""
    images = [
        HeightImage(fit=[FitTest(name="channel gain", p_value=p) for p in (0.1, 1e-3)]),
        HeightImage(
            fit=[FitTest(name="channel gain", p_value=0.0), FitTest(name="noise level", p_value=float("nan"))],
            doubts=[Doubt(name="channel gain"), Doubt(name="beams of unknown accuracy")],
        ),
    ]
    names, decades, doubted = fit_over_dwells(images)
    assert names == ["channel gain", "noise level", "beams of unknown accuracy"]
    assert decades == pytest.approx(np.array([[3, 12], [np.nan, np.nan], [np.nan, np.nan]]), nan_ok=True)
    assert doubted.tolist() == [[False, True], [False, False], [False, True]]
    assert draw_doubts({"ml": images, "capon": images[:1]}, tmp_path / "doubts.png")
    with Image.open(tmp_path / "doubts.png") as picture:
        assert np.ptp(np.asarray(picture.convert("L"))) > 200
    assert not draw_doubts({"ml": images[:1]}, tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()
