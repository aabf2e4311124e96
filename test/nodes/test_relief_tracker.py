"""Stage relief_tracker: what it makes of height images, good and bad."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import assert_one_sentence
from stage_graph import StageGraph, with_fields

from sal_height import messages
from sal_height.engine.provenance import LEFT_OUT
from sal_height.engine.tracker import SERIES_KEPT
from sal_height.errors import UserError
from sal_height.geometry.earth import height_of
from sal_height.geometry.frames import ApertureState
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import locate_at_height
from sal_height.messages.types import HeightImage, Provenance
from sal_height.relief.heights import HeightField, Surface

Array = npt.NDArray[np.float64]

SHAPE, SPACING, LENGTH, SIGMA, NOISE = (120, 10), 0.5, 12.0, 1.0, 0.8

APERTURE = ApertureState(
    np.array([0.0, 0.0, 3500.0]), np.array([50.0, 0.0, 0.0]), np.eye(3), 5.0, np.zeros((6, 6)), sliding=False
)
SIGHT = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
GRID = Grid(APERTURE.position + 4900 * SIGHT - [5.0, 0.0, 0.0], SIGHT, np.array([1.0, 0.0, 0.0]), SPACING, 1.0, *SHAPE)


def relief(seed: int) -> Array:
    """True heights, m: tracks along range whose cells are SPACING sqrt(2) apart on the ground."""
    rng = np.random.default_rng(seed)
    height = SIGMA * rng.standard_normal(SHAPE)
    phi = np.exp(-SPACING * np.sqrt(2) / LENGTH)
    for i in range(1, SHAPE[0]):
        height[i] = phi * height[i - 1] + np.sqrt(1 - phi**2) * height[i]
    return height


def height_image(dwell: int = 0) -> HeightImage:
    """Noisy heights; pixel (60, 3) is of too little signal, (70, 4) an outlier, (80, 5) holds two scatterers."""
    rng = np.random.default_rng(100 + dwell)
    height = relief(dwell) + NOISE * rng.standard_normal(SHAPE)
    validity = np.full(SHAPE, HeightImage.OK, dtype=np.uint8)
    validity[60, 3], height[60, 3] = HeightImage.LOW_CNR, np.nan
    validity[80, 5], height[70, 4] = HeightImage.TWO_SCATTERERS, 30.0
    sight = GRID.pixels() - APERTURE.position
    positions = locate_at_height(height, np.linalg.norm(sight, axis=-1), sight[..., 0], APERTURE, 1)
    sigma, cnr_db = np.where(np.isfinite(height), NOISE, np.nan), np.full(SHAPE, 12.0)
    two = validity == HeightImage.TWO_SCATTERERS
    surface = Surface.at(positions, height, sigma, cnr_db)
    field = HeightField(GRID, validity, (surface, surface.where(two)))
    source = HeightImage(dwell=dwell)
    source.header.stamp = messages.to_stamp(1_700_000_000_000_000_000 + dwell)
    source.header.frame_id = "map"
    provenance = Provenance(config_hash="abc", calibration_id="c", parameters=[])
    provenance.parameters = messages.with_stage([], "ml_height", {"layover": True})
    return messages.height_to_message(field, APERTURE, (2, 3), "ml", source, provenance)


class Tracking:
    """A tracker fed with messages, and those that it publishes."""

    def __init__(self, topic: str = "ml/height", **parameters: Any) -> None:
        """Start it with these parameters."""
        self.graph, self.topic = StageGraph(), topic
        self.stage = self.graph.add("relief_tracker", **parameters)

    def track(self, image: HeightImage) -> HeightImage:
        """The tracked image of one."""
        tracked = self.graph.heard["tracked/height"]
        count = len(tracked)
        self.graph.publish(self.topic, image)
        assert len(tracked) == count + 1, self.stage.last_rejection
        return tracked[-1]


def of(image: HeightImage, name: str) -> Array:
    return np.array(getattr(image if name == "validity" else image.surfaces[0], name)).reshape(SHAPE)


def test_heights_are_tracked_and_in_their_places() -> None:
    """The error of 1200 cells, which hold 100 independent ones or more, is half of what it was."""
    tracking = Tracking()
    before = height_image()
    after = tracking.track(before)
    assert (after.header, after.dwell, after.grid, after.aperture) == (
        *(before.header, before.dwell, before.grid, before.aperture),
    )
    assert (after.estimator, after.range_looks, after.azimuth_looks) == ("tracked", 2, 3)
    validity, height = of(after, "validity"), of(after, "height")
    expected = np.zeros(SHAPE, dtype=np.uint8)
    expected[60, 3], expected[70, 4] = HeightImage.INTERPOLATED, HeightImage.LOW_CNR
    expected[80, 5] = HeightImage.TWO_SCATTERERS
    np.testing.assert_array_equal(validity, expected)
    assert len(after.surfaces) == 2
    there = validity != HeightImage.LOW_CNR
    error = (height - relief(0))[there]
    assert np.sqrt(np.mean(error**2)) < 0.65 * NOISE
    assert np.mean(np.abs(error) < of(after, "sigma")[there]) == pytest.approx(0.68, abs=0.12)
    field = messages.field_from_message(after)
    sight = (GRID.pixels() - APERTURE.position)[there]
    now = (field.first.positions - APERTURE.position)[there]
    np.testing.assert_allclose(np.linalg.norm(now, axis=-1), np.linalg.norm(sight, axis=-1), atol=1e-3)
    np.testing.assert_allclose(now[..., 0], sight[..., 0], atol=1e-3)
    np.testing.assert_allclose(height_of(field.first.positions)[there], height[there], atol=1e-3)


def test_the_provenance_states_the_settings_and_the_prior() -> None:
    tracking = Tracking()
    after = tracking.track(height_image())
    assert (after.provenance.config_hash, after.provenance.calibration_id) == ("abc", "c")
    stages = messages.stages_of(after.provenance.parameters)
    assert stages["ml_height"] == {"layover": True}
    recorded = stages["relief_tracker"]
    assert (recorded["estimator"], recorded["correlation_length_m"], recorded["along_track"]) == ("ml", 0.0, True)
    assert {name for name in recorded if "." in name} == {
        f"prior.{key}" for key in ("length", "sigma", "mean", "mean_sigma")
    }
    assert 0.1 < recorded["prior.sigma"] < 3
    assert tracking.stage.summary()["processed"] == 1


def test_parameters_are_followed() -> None:
    """From image to image; a prior that is given is not estimated, and neighbours that have a say change heights."""
    tracking = Tracking("monopulse/height", estimator="monopulse")
    after = []
    for values in (
        {"correlation_length_m": 5.0, "relief_sigma_m": 2.0, "along_track": False},
        {"along_track": True},
        {"gate": 1000.0},
    ):
        tracking.stage.set(**values)
        after.append(tracking.track(height_image()))
        recorded = messages.stages_of(after[-1].provenance.parameters)["relief_tracker"]
        assert (recorded["prior.length"], recorded["prior.sigma"]) == pytest.approx((5.0, 2.0))
        assert recorded.items() >= values.items()
    assert not np.array_equal(of(after[0], "height"), of(after[1], "height"))
    assert of(after[1], "validity")[70, 4] == HeightImage.LOW_CNR
    assert of(after[2], "validity")[70, 4] == HeightImage.OK
    assert of(after[2], "height")[70, 4] > 5


def prior_of(image: HeightImage) -> tuple[float, float]:
    recorded = messages.stages_of(image.provenance.parameters)["relief_tracker"]
    return recorded["prior.length"], recorded["prior.sigma"]


def of_sensor(config_hash: str, dwell: int) -> HeightImage:
    image = height_image(dwell)
    image.provenance.config_hash = config_hash
    return image


def test_a_prior_is_of_the_dwells_of_one_sensor_and_of_one_way_to_make_heights() -> None:
    """A dwell is tracked as if none of another sensor or of other parameters had come.

    Silent channels, and what was found in the data, do not count.
    """
    tracking = Tracking()
    alone = [prior_of(tracking.track(of_sensor("a", dwell))) for dwell in range(3)]
    first, second, blanked = (of_sensor("b", dwell) for dwell in range(3))
    other, changed = of_sensor("c", 1), of_sensor("b", 1)
    changed.provenance.parameters = messages.with_stage([], "ml_height", {"layover": False})
    blanked.provenance.parameters = messages.with_stage(
        [], "ml_height", {"layover": True, LEFT_OUT: [3], "placement": {"speed": 1.0}}
    )
    found = [prior_of(tracking.track(image)) for image in (first, other, changed, second, blanked)]
    assert [found[0], found[3], found[4]] == alone
    assert found[1] == found[2] != alone[1]


def test_priors_of_many_sensors_are_not_held() -> None:
    """That of the one that came longest ago is forgotten: it begins anew, and the others go on."""
    tracking = Tracking()
    begun = [prior_of(tracking.track(of_sensor(str(number), 0))) for number in range(SERIES_KEPT)]
    gone_on = prior_of(tracking.track(of_sensor("0", 1)))
    assert gone_on != prior_of(tracking.track(of_sensor("another", 1)))
    assert prior_of(tracking.track(of_sensor("1", 0))) == begun[1]
    assert prior_of(tracking.track(of_sensor("3", 1))) == gone_on


def test_a_reset_begins_with_the_first_prior() -> None:
    tracking = Tracking()
    first, second = (of(tracking.track(height_image()), "height") for _ in range(2))
    tracking.stage.forget()
    again = of(tracking.track(height_image()), "height")
    assert not np.array_equal(first, second, equal_nan=True)
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize(
    ("name", "value"),
    [("estimator", "best"), ("gate", 0.0), ("correlation_length_m", -1.0), ("relief_sigma_m", math.nan)],
)
def test_a_parameter_that_is_not_allowed_is_refused(name: str, value: Any) -> None:
    with pytest.raises(UserError, match=f"Parameter {name}"):
        Tracking(**{name: value})


NONE = np.zeros(0, np.float32)
EMPTY = {"grid.rows": 0, "grid.cols": 0, "validity": np.zeros(0, np.uint8)} | {
    f"surfaces.0.{name}": NONE for name in ("height", "sigma", "cnr_db", "east", "north")
}
NOTHING_VALID = messages.to_bytes(np.full(SHAPE, HeightImage.LOW_CNR, np.uint8))


@pytest.mark.parametrize(
    ("values", "reason", "words"),
    [
        (EMPTY, "wrong size", "at least 1"),
        ({"surfaces.0.sigma": np.ones(1199, np.float32)}, "wrong size", "sigma has 1199 entries"),
        ({"surfaces": []}, "wrong size", "at least one"),
        ({"aperture.velocity.x": 0.0}, "wrong geometry", "velocity"),
        ({"grid.row_direction.y": 0.0, "grid.row_direction.z": 0.0}, "wrong geometry", "norms must be 1"),
        ({"grid.origin.x": math.nan}, "not finite", "grid"),
    ],
)
def test_a_bad_image_is_counted_and_the_next_one_tracked(values: dict[str, Any], reason: str, words: str) -> None:
    tracking = Tracking()
    bad = with_fields(height_image(), values)
    tracking.graph.publish(tracking.topic, bad)
    assert tracking.stage.counted("dropped.") == {reason: 1}
    said, _, sentence = tracking.stage.last_rejection.partition(": ")
    assert said == reason
    assert_one_sentence(sentence, words)
    assert tracking.track(height_image(1)).dwell == 1
    summary = tracking.stage.summary()
    assert (summary["in"], summary["processed"], summary["waiting"]) == (2, 1, 0)


def test_a_dwell_without_enough_heights_is_published_as_it_was_measured() -> None:
    """One with no height, and one with single ones in three columns; the next is tracked as if they had not been."""
    tracking, alone = Tracking(), Tracking()
    sparse = np.full(SHAPE, HeightImage.LOW_CNR, np.uint8)
    sparse[60, :3] = HeightImage.OK
    for dwell, validity in enumerate((np.full(SHAPE, HeightImage.LOW_CNR, np.uint8), sparse)):
        image = with_fields(height_image(dwell), {"validity": messages.to_bytes(validity)})
        tracked = tracking.track(image)
        np.testing.assert_array_equal(of(tracked, "validity"), validity)
        there = validity == HeightImage.OK
        np.testing.assert_array_equal(of(tracked, "height")[there], of(image, "height")[there])
        assert np.isnan(of(tracked, "height")[~there]).all()
        assert not any(one.name.startswith("relief_tracker.prior.") for one in tracked.provenance.parameters)
    first = height_image(2)
    np.testing.assert_array_equal(of(tracking.track(first), "height"), of(alone.track(first), "height"))
    assert tracking.stage.counted("dropped.") == {}


def test_single_bad_pixels_are_left_out_and_counted() -> None:
    """Four pixels that no estimator should publish: the rest of the image is tracked as if they had no height."""
    tracking = Tracking()
    bad, masked = of_sensor("a", 0), of_sensor("b", 0)
    first = bad.surfaces[0]
    first.sigma[17], first.sigma[18], first.east[19], first.height[20] = math.inf, 0.0, math.inf, math.nan
    for pixel in range(17, 21):
        masked.validity[pixel] = HeightImage.MISSING_DATA
    ours, theirs = tracking.track(bad), tracking.track(masked)
    np.testing.assert_array_equal(of(ours, "height"), of(theirs, "height"))
    np.testing.assert_array_equal(of(ours, "validity"), of(theirs, "validity"))
    summary = tracking.stage.summary()
    assert (summary["processed"], summary["ignored.bad pixels"]) == (2, 1)
    assert_one_sentence(tracking.stage.last_rejection.partition(": ")[2], "dwell 0", "4 of 1200 pixels")
