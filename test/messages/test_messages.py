"""Messages and arrays: what goes in comes out, and bulk data is not copied when read."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import refused

from sal_height import messages
from sal_height.beams import PATTERNS
from sal_height.calibration import Calibration
from sal_height.elevation.array.estimate import ORDERS, Validity
from sal_height.engine.frame_items import check_frame, samples_of
from sal_height.errors import Rejected, UserError
from sal_height.geometry.earth import EARTH_RADIUS, sphere_point
from sal_height.geometry.frames import ApertureState, Mounting
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import PlatformState
from sal_height.imaging.focus import Slc
from sal_height.messages import deserialize, serialize, views
from sal_height.messages.frames import frame_of
from sal_height.messages.products import heights_of
from sal_height.messages.types import (
    BeamModel,
    ChannelFrame,
    ComplexImage,
    Header,
    HeightImage,
    Provenance,
    Quaternion,
    SensorInfo,
    Time,
    Waveform,
)
from sal_height.relief.heights import HeightField, Surface
from sal_height.sensor import SensorUncertainty
from sal_height.sensor.sensor import MODES, WAVEFORMS, PhaseHistory, Sensor
from sal_height.simulation.preset import load_preset

STAMP = Time(sec=1_700_000_000, nanosec=987_654_321)
APERTURE = ApertureState(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.eye(3), 1.0, np.zeros((6, 6)))
UNCERTAIN = ApertureState(
    np.array([0.0, 0.0, 3500.0]), np.array([50.0, 0.0, 0.0]), np.eye(3), 1.0, np.diag([0.01] * 3 + [1e-12] * 3)
)


def grid_at(rows: int, cols: int, origin: tuple[float, ...] = (10.0, 20.0, 0.0)) -> Grid:
    return Grid(np.array(origin), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, rows, cols)


def message_of(field: HeightField, aperture: ApertureState = APERTURE) -> HeightImage:
    """The message of a field of heights of one look in the frame map."""
    source = ComplexImage(header=Header(frame_id="map"))
    return messages.height_to_message(field, aperture, (1, 1), "ml", source, Provenance())


def through_the_wire(message):  # type: ignore[no-untyped-def]
    return deserialize(serialize(message), type(message))


@pytest.fixture
def sensor() -> Sensor:
    return load_preset("small").make_sensor()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.mark.parametrize("ns", [0, 1, 999_999_999, 1_000_000_000, 1_700_000_000_987_654_321])
def test_times_keep_every_nanosecond(ns: int) -> None:
    assert messages.to_ns(messages.to_stamp(ns)) == ns


MATRIX = tuple(tuple(row) for row in (np.eye(8) + 0.1j * np.arange(8)).tolist())
RANGES = ((0, 10.0, 20.0), (3, 4990.5, 5000.25), (3, 6000.0, 7000.0))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"channel_matrix": MATRIX, "matrix_in_antenna": False},
        {"mounting": Mounting("lidar", (0.5, -1.0, 0.25), (0.0, 0.6, 0.0, 0.8)), "azimuth_diameter": 0.02},
        {"beam_uncertainty": 0.056, "blanked_ranges": RANGES},
        {"uncertainty": SensorUncertainty(range_delay=0.0, beam_pitch=0.01), "mounting": Mounting("without accuracy")},
        {"mounting": Mounting(lever_arm_covariance=(1e-4, *8 * (0.0,)), rotation_covariance=(0.0,) * 9)},
    ],
    ids=" ".join,
)
def test_a_sensor_survives_its_message(sensor: Sensor, changes: dict[str, Any]) -> None:
    changed = replace(sensor, config_hash="", **changes)
    assert messages.sensor_from_message(through_the_wire(messages.sensor_to_message(changed, STAMP))) == changed


@pytest.mark.parametrize(
    ("channels", "edges", "complaint"),
    [([1], [10.0], "1 channels.blanked_ranges for 1"), ([8], [1.0, 2.0], "channel 8"), ([0], [2.0, 1.0], "increasing")],
)
def test_blanked_ranges_that_make_no_sense_are_refused(
    sensor: Sensor, channels: list[int], edges: list[float], complaint: str
) -> None:
    message = messages.sensor_to_message(sensor, STAMP)
    message.channels.blanked_channels, message.channels.blanked_ranges = channels, edges
    with refused(UserError, complaint):
        messages.sensor_from_message(message)


@pytest.mark.parametrize("wrong", [[1.0], [1.0, 2.0, *7 * [0.0]], [-1.0, *8 * [0.0]], [np.nan, *8 * [0.0]]])
def test_a_mounting_with_a_matrix_that_is_no_covariance_is_refused(sensor: Sensor, wrong: list[float]) -> None:
    message = messages.sensor_to_message(sensor, STAMP)
    message.mounting.rotation_covariance = wrong
    with refused(UserError, "rotation_covariance", "symmetric"):
        messages.sensor_from_message(message)


@pytest.mark.parametrize("wrong", [-0.01, np.nan, np.inf])
def test_an_uncertainty_that_is_no_standard_deviation_is_refused(sensor: Sensor, wrong: float) -> None:
    message = messages.sensor_to_message(sensor, STAMP)
    message.uncertainty.sample_clock = [wrong]
    with refused(UserError, "uncertainty.sample_clock", "0 or more"):
        messages.sensor_from_message(message)


@pytest.mark.parametrize("version", [0, 1, 2, 4])
def test_another_version_of_the_contract_is_refused(sensor: Sensor, version: int) -> None:
    message = messages.sensor_to_message(sensor, STAMP)
    assert message.contract_version == SensorInfo.CONTRACT_VERSION == 3
    message.contract_version = version
    with pytest.raises(UserError, match=f"contract_version {version}"):
        messages.sensor_from_message(message)


def test_a_sensor_info_without_identity_is_refused(sensor: Sensor) -> None:
    message = messages.sensor_to_message(sensor, STAMP)
    message.config_hash = ""
    with pytest.raises(UserError, match="config_hash"):
        messages.sensor_from_message(message)


def test_the_identity_is_the_publishers_own(sensor: Sensor) -> None:
    message = messages.sensor_to_message(sensor, STAMP)
    message.config_hash = "flight 7"
    assert messages.sensor_from_message(message).config_hash == "flight 7"


def test_complex_samples_survive_bit_for_bit_and_reading_does_not_copy(rng: np.random.Generator) -> None:
    samples = (rng.standard_normal((3, 5)) + 1j * rng.standard_normal((3, 5))).astype(np.complex64)
    message = ComplexImage(samples=messages.to_floats(samples[:, ::-1]))
    view = messages.complex_view(message.samples, (3, 5))
    assert np.array_equal(view, samples[:, ::-1])
    message.samples[0] = 42.0
    assert view[0, 0].real == 42.0


def test_phase_history_survives_its_frames(sensor: Sensor, rng: np.random.Generator) -> None:
    shape = (sensor.detector_count, sensor.pulse_count, sensor.sample_count)
    samples = rng.standard_normal((*shape, 2)).astype(np.float32).view(np.complex64)[..., 0]
    times = np.arange(shape[1]) / sensor.pulse_repetition_frequency
    history = PhaseHistory(messages.to_ns(STAMP), times, np.linspace(4999, 5001, shape[1]), samples)
    frames = [through_the_wire(f) for f in messages.history_to_messages(history, sensor, 7, STAMP)]
    for frame in frames:
        check_frame(frame_of(frame), sensor)
        assert (frame.dwell, frame.header.frame_id) == (7, "sensor")
    back = messages.history_from_messages(frames)
    assert back.stamp_ns == history.stamp_ns
    assert np.array_equal(back.samples, samples)
    assert np.array_equal(back.pulse_times, times)
    assert np.array_equal(back.reference_range, history.reference_range)


@pytest.mark.parametrize(("value", "usable"), [(3e38, True), (-3e38, True), (np.inf, False), (np.nan, False)])
def test_samples_must_be_finite_however_large_they_are(sensor: Sensor, value: float, usable: bool) -> None:
    shape = (sensor.pulse_count, sensor.sample_count)
    samples = np.ones((1, *shape), np.complex64)
    samples[0, -1, -1] = value
    history = PhaseHistory(0, np.arange(shape[0]) * 1e-4, np.full(shape[0], 5e3), samples)
    (frame,) = messages.history_to_messages(history, sensor, 0, STAMP)
    with nullcontext() if usable else pytest.raises(Rejected, match="NaN or infinite"):
        check_frame(frame_of(frame), sensor)


def integer_frame(sensor: Sensor, rng: np.random.Generator) -> tuple[ChannelFrame, np.ndarray]:
    """A frame of int16 samples in steps of 0.25, and these samples, shape (pulses, samples, 2)."""
    shape = (sensor.pulse_count, sensor.sample_count)
    whole = rng.integers(-32768, 32768, (*shape, 2), dtype=np.int16)
    history = PhaseHistory(0, np.arange(shape[0]) * 1e-4, np.full(shape[0], 5e3), np.zeros((1, *shape), np.complex64))
    (frame,) = messages.history_to_messages(history, sensor, 0, STAMP)
    frame.encoding, frame.scale = ChannelFrame.COMPLEX_INT16, 0.25
    frame.samples = messages.to_bytes(whole.astype("<i2").view(np.uint8))
    return frame, whole


def test_integer_samples_are_scaled(sensor: Sensor, rng: np.random.Generator) -> None:
    frame, whole = integer_frame(sensor, rng)
    frame = through_the_wire(frame)
    check_frame(frame_of(frame), sensor)
    samples = messages.history_from_messages([frame]).samples[0]
    assert samples.dtype == np.complex64
    np.testing.assert_array_equal(samples, (whole[..., 0] + 1j * whole[..., 1]) / 4)


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("encoding", "complex_float64", "unknown encoding"),
        ("encoding", "", "unknown encoding"),
        ("encoding", ChannelFrame.COMPLEX_FLOAT32, "wrong size"),
        ("scale", 0.0, "wrong scale"),
        ("scale", float("nan"), "wrong scale"),
        ("scale", float("inf"), "wrong scale"),
        ("scale", 1e31, "wrong scale"),
    ],
)
def test_samples_that_cannot_be_decoded_are_rejected(
    sensor: Sensor, rng: np.random.Generator, field: str, value: object, reason: str
) -> None:
    frame, _ = integer_frame(sensor, rng)
    setattr(frame, field, value)
    with pytest.raises(Rejected) as rejection:
        check_frame(frame_of(frame), sensor)
    assert rejection.value.reason == reason


def test_reading_float_samples_does_not_copy_them(sensor: Sensor) -> None:
    shape = (sensor.pulse_count, sensor.sample_count)
    history = PhaseHistory(0, np.arange(shape[0]) * 1e-4, np.full(shape[0], 5e3), np.zeros((1, *shape), np.complex64))
    (frame,) = messages.history_to_messages(history, sensor, 0, STAMP)
    view = samples_of(frame_of(frame))
    np.frombuffer(frame.samples, np.float32)[1] = 42.0
    assert view[0, 0] == 42j


def test_a_calibration_keeps_the_id_that_its_maker_gave_it() -> None:
    """A node in another language need not know how this package makes ids, and says NaN where it measured nothing."""
    nothing = np.full(2, np.nan)
    made = Calibration("of the sensor", np.full((2, 3), 0.5 + 1j), nothing, nothing, nothing, dwells=4)
    assert (
        messages.calibration_from_message(through_the_wire(messages.calibration_to_message(made, STAMP))).pupil.size
        == 0
    )
    pupil = {"pupil": np.linspace(-0.1, 0.1, 6), "pupil_sigma": np.ones(6), "pupil_misfit": 1.1, "pupil_p_value": 0.3}
    made = replace(made, **pupil)
    message = messages.calibration_to_message(made, STAMP)
    message.id = "flight 7, 2026-11-22"
    again = messages.calibration_from_message(through_the_wire(message))
    assert again.id == "flight 7, 2026-11-22"
    assert np.array_equal(again.response, made.response)
    assert all(np.array_equal(getattr(again, name), value) for name, value in pupil.items())
    assert np.isnan([*again.response_sigma, *again.gain_sigma, *again.phase_sigma, again.width_sigma]).all()
    message.id = ""
    with pytest.raises(UserError, match="no id"):
        messages.calibration_from_message(message)


def test_a_platform_state_survives_its_odometry() -> None:
    attitude = np.array([0.1, -0.2, 0.3, 0.9])
    state = PlatformState(
        messages.to_ns(STAMP),
        np.array([1e4, -2.0, 3535.534]),
        attitude / np.linalg.norm(attitude),
        np.array([50.0, 1.0, -0.5]),
        np.arange(36.0).reshape(6, 6),
        np.arange(9.0).reshape(3, 3),
    )
    back = messages.state_from_message(through_the_wire(messages.state_to_message(state, STAMP)))
    assert back.stamp_ns == state.stamp_ns
    assert np.array_equal(back.position, state.position)
    assert np.allclose(back.velocity, state.velocity, atol=1e-12)
    assert np.array_equal(back.covariance, state.covariance)
    assert np.array_equal(back.velocity_covariance, state.velocity_covariance)


def test_odometry_twist_is_in_body_axes() -> None:
    """Flying north (yaw 90 degrees) at 50 m/s: the body moves forward."""
    quarter_turn = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    state = PlatformState(0, np.zeros(3), quarter_turn, np.array([0.0, 50.0, 0.0]), np.zeros((6, 6)))
    twist = messages.state_to_message(state, STAMP).twist.twist.linear
    assert (twist.x, twist.y, twist.z) == pytest.approx((50.0, 0.0, 0.0))


def test_odometry_without_an_orientation_is_rejected() -> None:
    state = PlatformState(0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.ones(3), np.zeros((6, 6)))
    message = messages.state_to_message(state, STAMP)
    message.pose.pose.orientation = Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)
    with pytest.raises(Rejected, match="rotation"):
        messages.state_from_message(message)


def test_images_grid_and_aperture_survive_their_messages(rng: np.random.Generator) -> None:
    grid = Grid(np.array([1.0, 2.0, 3.0]), np.array([0.0, -0.6, -0.8]), np.array([1.0, 0.0, 0.0]), 0.04, 0.05, 6, 4)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    aperture = ApertureState(np.array([0.0, 1.0, 2.0]), np.array([50.0, 0.0, 0.0]), turn, 0.08, np.eye(6))
    slc = rng.standard_normal((3, 6, 4, 2)).astype(np.float32).view(np.complex64)[..., 0]
    frame = ChannelFrame(dwell=9)
    frame.header.stamp = STAMP
    sent = messages.slc_to_messages(
        Slc(slc, grid, aperture, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.5, 1.0])),
        frame,
        Provenance(config_hash="x"),
    )
    assert [message.saturated_share for message in sent] == [0.0, 0.5, 1.0]
    back = messages.slc_from_messages([through_the_wire(m) for m in sent])
    assert np.array_equal(back.images, slc)
    assert back.noise_power.tolist() == [0.1, 0.2, 0.3]
    assert back.saturated_share.tolist() == [0.0, 0.5, 1.0]
    assert np.array_equal(back.grid.points(2, 3), grid.points(2, 3))
    assert np.allclose(back.aperture.rotation, turn, atol=1e-15)
    assert np.array_equal(back.aperture.covariance, np.eye(6))
    assert all(m.header.stamp == STAMP and m.header.frame_id == "map" and m.dwell == 9 for m in sent)


@pytest.mark.parametrize(
    ("layer", "value"),
    [
        *(("height", value) for value in (np.nan, 2e7, -2e7)),
        *(("sigma", value) for value in (np.inf, np.nan, 0.0, -1.0, 2e7)),
        *(("spread", value) for value in (np.nan, -1.0, 2e7)),
        *(("north", value) for value in (np.inf, 2e7)),
    ],
)
def test_a_bad_pixel_is_masked_and_its_neighbours_stay(layer: str, value: float) -> None:
    """Bug 1: a single usable pixel with sigma = inf made consumers reject the whole height image."""
    grid = grid_at(2, 2)
    two = np.full((2, 2), Validity.TWO_SCATTERERS, np.uint8)
    ones = np.ones((2, 2))
    field = HeightField(grid, two, 2 * (Surface.at(grid.pixels(), ones, ones, ones),))
    message = message_of(field)
    assert heights_of(message).bad_pixels == 0
    getattr(message.surfaces[0], layer)[2] = value
    masked = messages.field_from_message(message)
    assert masked.validity.ravel().tolist() == [6, 6, Validity.MISSING_DATA, 6]
    assert np.isnan(masked.first.height).ravel().tolist() == [False, False, True, False]
    assert np.isnan(masked.first.positions[1, 0]).all()
    assert heights_of(message).bad_pixels == 1


@pytest.mark.parametrize("layover", [False, True])
def test_a_height_field_survives_its_message(layover: bool) -> None:
    grid = grid_at(2, 2)
    height = np.array([[1.0, np.nan], [2.0, 3.0]])
    validity = np.array([[0, 1], [0, 0]], dtype=np.uint8)
    positions = np.where(validity[..., None] == 0, grid.pixels() + np.array([0.25, -0.5, 0.0]), np.nan)
    surfaces = [Surface.at(positions, height, height / 10, height * 5)]
    if layover:
        validity[1, 0] = Validity.TWO_SCATTERERS
        alone = np.where(validity == Validity.TWO_SCATTERERS, 7.0, np.nan)
        shifted = positions + np.where(np.isnan(alone), np.nan, 1.0)[..., None]
        surfaces.append(Surface.at(shifted, alone, alone / 10, alone * 5))
    field = HeightField(grid, validity, tuple(surfaces))
    message = messages.height_to_message(field, APERTURE, (2, 3), "ml", ComplexImage(dwell=4), Provenance())
    message = through_the_wire(message)
    assert np.array_equal(np.array(message.surfaces[0].height), height.ravel(), equal_nan=True)
    assert bytes(message.validity) == validity.tobytes()
    assert message.surfaces[0].east[2] == pytest.approx(0.25)
    assert message.surfaces[0].north[2] == pytest.approx(-1.5)
    assert (message.dwell, message.range_looks, message.azimuth_looks) == (4, 2, 3)
    nan = np.nan
    expected = (
        [nan, nan, 7, nan],
        [nan, nan, 0.7, nan],
        [nan, nan, 35, nan],
        [nan, nan, 1.25, nan],
        [nan, nan, -0.5, nan],
    )
    for name, values in zip(("height", "sigma", "cnr_db", "east", "north"), expected, strict=True):
        if layover:
            np.testing.assert_allclose(np.array(getattr(message.surfaces[1], name)), values, rtol=1e-6)
    assert len(message.surfaces) == 1 + layover
    header = Header(stamp=message.header.stamp, frame_id="map")
    near = views.frame_near(np.array([10.0, 20.0, 0.5]), header, "ml_origin")
    cloud = views.field_points(field, near)
    assert (cloud.header.frame_id, cloud.header.stamp) == ("ml_origin", message.header.stamp)
    assert near.header.frame_id == "map"
    assert [field.name for field in cloud.fields] == list(views.POINT_FIELDS)
    points = np.frombuffer(cloud.data, np.float32).reshape(cloud.width, len(views.POINT_FIELDS))
    heights = [1, 2, 3, 7] if layover else [1, 2, 3]
    np.testing.assert_array_equal(points[:, 3], heights)
    if layover:
        np.testing.assert_allclose(points[3, :8], [1.25, -0.5, 0.5, 7, 0.7, 35, 0, 1], rtol=1e-6)


def test_points_far_from_the_origin_of_the_map_are_as_precise_as_near_ones() -> None:
    """Single precision has 4 mm at 50 km; the frame near the points is in double precision."""
    origin = np.array([50_000.0123456, -41_234.7654321, -120.4567])
    grid = Grid(origin, np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.37, 0.41, 20, 20)
    height = np.random.default_rng(1).uniform(-3, 3, (20, 20))
    surface = Surface.at(grid.pixels() + height[..., None] * [0, 0, 1], height, 0.1 + height * 0, height)
    field = HeightField(grid, np.zeros((20, 20), np.uint8), (surface,))
    near = views.frame_near(grid.origin, Header(frame_id="map"), "ml_origin")
    cloud = np.frombuffer(views.field_points(field, near).data, np.float32).reshape(400, -1)
    shift = near.transform.translation
    places = cloud[:, :3].astype(np.float64) + np.array([shift.x, shift.y, shift.z])
    true = surface.positions.reshape(-1, 3)
    assert np.abs(places - true).max() < 1e-6
    assert np.abs(true.astype(np.float32) - true).max() > 1e-3


def test_what_is_known_of_a_surface_survives_its_message(rng: np.random.Generator) -> None:
    """Spread, covariances and probabilities of the order, of one scatterer up to three."""
    grid = grid_at(2, 2)
    validity = np.array([[Validity.THREE_SCATTERERS, Validity.EXTENDED], [Validity.TWO_SCATTERERS, Validity.NO_SIGNAL]])
    held = np.array([[3, 1], [2, 0]])
    surfaces = []
    for number in range(3):
        root = rng.standard_normal((2, 2, 3, 3))
        own = root @ np.swapaxes(root, -1, -2)
        height = rng.uniform(1, 2, (2, 2))
        surface = Surface.at(grid.pixels() + height[..., None] * [0, 0, 1], height, height / 10, height)
        surface = replace(surface, spread=height / 3, own_covariance=own, common_covariance=2 * own)
        surfaces.append(surface.where(held > number))
    probability = rng.dirichlet(np.ones(ORDERS), (2, 2))
    field = HeightField(grid, validity.astype(np.uint8), tuple(surfaces), probability)
    message = through_the_wire(message_of(field))
    read = messages.field_from_message(message)
    assert heights_of(message).bad_pixels == 0
    np.testing.assert_array_equal(read.validity, validity)
    np.testing.assert_allclose(read.order_probability, probability, rtol=1e-6)
    for ours, theirs in zip(read.surfaces, surfaces, strict=True):
        for name in ("height", "sigma", "spread", "own_covariance", "common_covariance"):
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-6, err_msg=name)
    near = views.frame_near(grid.origin, message.header, "ml_origin")
    points = np.frombuffer(views.field_points(read, near).data, np.float32)
    points = points.reshape(-1, len(views.POINT_FIELDS))
    np.testing.assert_array_equal(points[:, views.POINT_FIELDS.index("surface")], [0, 0, 0, 1, 1, 2])
    third = 3 * surfaces[2].own_covariance[0, 0]
    np.testing.assert_allclose(points[5, -6:], third[np.triu_indices(3)], rtol=1e-6)
    message.surfaces.pop()
    assert messages.field_from_message(message).validity[0, 0] == Validity.MISSING_DATA
    message.surfaces[1].covariance = message.surfaces[1].covariance[:-1]
    with pytest.raises(Rejected, match=r"surfaces\[1\].covariance has 23 entries"):
        messages.field_from_message(message)


@pytest.mark.parametrize("name", ["covariance", "common_covariance"])
@pytest.mark.parametrize(
    "triangle",
    [
        (1.0, 0.0, 0.0, -1.0, 0.0, 1.0),
        (1.0, 2.0, 0.0, 1.0, 0.0, 1.0),
        (1.0, 0.9, 0.9, 1.0, -0.9, 1.0),
        (1.0, 0.0, 0.1, 1.0, 0.0, 0.0),
        (1.0, 0.0, 0.0, 1.0, np.nan, 1.0),
        (np.inf, 0.0, 0.0, 1.0, 0.0, 1.0),
        (2e14, 0.0, 0.0, 1.0, 0.0, 1.0),
    ],
    ids=[
        *("variance below 0", "correlation above 1", "determinant below 0", "correlated with 0", "NaN", "infinite"),
        "larger than the earth",
    ],
)
def test_a_pixel_whose_covariance_is_impossible_is_masked(name: str, triangle: tuple[float, ...]) -> None:
    grid = grid_at(1, 2)
    ones, circle = np.ones((1, 2)), np.array([0.3, -0.5, 0.7])
    certain = np.broadcast_to(np.outer(circle, circle), (1, 2, 3, 3))  # an error in one direction only is possible
    surface = replace(
        Surface.at(grid.pixels(), ones, ones, ones), own_covariance=certain, common_covariance=0 * certain
    )
    field = HeightField(grid, np.zeros((1, 2), np.uint8), (surface,))
    message = message_of(field)
    assert heights_of(message).bad_pixels == 0
    numbers = np.array(getattr(message.surfaces[0], name))
    numbers[6:] = triangle
    setattr(message.surfaces[0], name, numbers)
    masked = messages.field_from_message(message)
    assert masked.validity.tolist() == [[Validity.OK, Validity.MISSING_DATA]]
    assert heights_of(message).bad_pixels == 1


def test_where_no_covariance_is_told_it_follows_from_sigma_and_the_pose() -> None:
    """As in bags of older versions: sigma is that of the whole, and errors lie along the circle but for the pose."""
    grid = grid_at(1, 2, (10.0, -3500.0, 0.0))
    ones, sigma = np.ones((1, 2)), np.full((1, 2), 0.5)
    field = HeightField(grid, np.zeros((1, 2), np.uint8), (Surface.at(grid.pixels(), ones, sigma, ones),))
    message = message_of(field, UNCERTAIN)
    assert not message.surfaces[0].covariance.size
    surface = messages.field_from_message(message).first
    assert surface.common_covariance is not None
    np.testing.assert_allclose(surface.common_covariance[..., 2, 2], 0.01, rtol=1e-2)
    np.testing.assert_allclose(surface.covariance[..., 2, 2], 0.25, rtol=2e-3)
    np.testing.assert_allclose(surface.own_covariance[..., 1, 2], -0.24, rtol=1e-2)  # up and towards the flight


@pytest.mark.parametrize("lacking", [0, 1])
def test_a_surface_that_tells_no_covariance_takes_none_from_another(lacking: int) -> None:
    """A weaker surface without any scatterer tells none; the first keeps its own."""
    grid = grid_at(1, 2, (10.0, -3500.0, 0.0))
    told = np.broadcast_to(np.diag([1.0, 2.0, 4.0]), (1, 2, 3, 3))
    surface = Surface.at(grid.pixels(), *np.full((3, 1, 2), 0.5))
    known = replace(surface, own_covariance=told, common_covariance=told / 4)
    surfaces = [known, known]
    surfaces[lacking] = surface
    field = HeightField(grid, np.full((1, 2), Validity.TWO_SCATTERERS, np.uint8), tuple(surfaces))
    message = message_of(field, UNCERTAIN)
    read = messages.field_from_message(message).surfaces
    np.testing.assert_allclose(read[1 - lacking].own_covariance, told)
    np.testing.assert_allclose(read[1 - lacking].common_covariance, told / 4)
    np.testing.assert_allclose(read[lacking].covariance[..., 2, 2], 0.25, rtol=2e-3)


def test_validity_values_are_those_of_the_message() -> None:
    for reason in Validity:
        assert getattr(HeightImage, reason.name) == reason


def test_the_sphere_is_that_of_the_core() -> None:
    assert HeightImage.EARTH_RADIUS == EARTH_RADIUS


def test_texts_that_name_a_kind_are_those_of_the_core() -> None:
    assert (SensorInfo.SPOTLIGHT, SensorInfo.STRIPMAP) == MODES
    assert (Waveform.SPECTRUM, Waveform.CHIRP, Waveform.DERAMPED) == WAVEFORMS
    assert [getattr(BeamModel, name.upper()) for name in PATTERNS] == list(PATTERNS)


def test_look_sides_are_those_of_the_message() -> None:
    assert (SensorInfo.RIGHT, SensorInfo.LEFT) == (1, -1)


def test_the_scatterers_of_a_height_image_are_where_they_were(rng: np.random.Generator) -> None:
    """Within the float32 of their distance from the grid's origin, 7 m at most; heights that are not valid are not."""
    shape = (5, 4)
    north, height = rng.uniform(-5, 5, shape) - 80_000, rng.uniform(0, 30, shape)
    positions = sphere_point(rng.uniform(-5, 5, shape) + 60_000, north, height)
    grid = Grid(positions.mean(axis=(0, 1)), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, *shape)
    aperture = ApertureState(np.array([0.0, 0.0, 5e3]), np.array([50.0, 0.0, 0.0]), np.eye(3), 1.0, np.zeros((6, 6)))
    validity = np.full(shape, Validity.OK, np.uint8)
    validity[1], validity[2, 2] = Validity.TWO_SCATTERERS, Validity.LOW_CNR
    field = HeightField(grid, validity, 2 * (Surface.at(positions, height, height / 10 + 1, height),))
    message = through_the_wire(message_of(field, aperture))
    surface = messages.field_from_message(message).first
    usable = validity != Validity.LOW_CNR
    np.testing.assert_allclose(surface.positions[usable], positions[usable], rtol=0, atol=3e-6)
    np.testing.assert_allclose(surface.height[usable], height[usable], rtol=1e-7)
    np.testing.assert_allclose(surface.sigma[usable], height[usable] / 10 + 1, rtol=1e-7)
    assert np.isnan(surface.height[~usable]).all()
    assert np.isnan(surface.positions[~usable]).all()
