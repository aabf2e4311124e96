"""An instrument whose description does not say how well it is known: its heights do, and sigma covers errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import flat_scene, make_sensor
from scipy.spatial.transform import Rotation

from sal_height.elevation import ESTIMATORS, HeightSettings, MlSettings
from sal_height.engine.image_settings import pose_settings
from sal_height.geometry import AT_BASE_LINK, shift_along
from sal_height.imaging import CorrectionSettings, ImageSettings, Processing, Slc, with_known_errors
from sal_height.imaging.pixels import line_of_sight
from sal_height.numeric import fraction_of
from sal_height.pipeline import Compressor, heights, known_beams
from sal_height.pipeline.instrument import INSTRUMENT, range_covariance, with_instrument
from sal_height.runs.truth.comparison import SurfaceComparison, compare, joined_comparisons
from sal_height.runs.truth.surface_report import as_flown, true_surfaces
from sal_height.sensor import EXACT, NEPERS_PER_DB, NOTHING_STATED, BeamErrors, PhaseHistory, Sensor, SensorUncertainty
from sal_height.simulation import SimulatedFlight, UncertaintySettings, flight_of, load_preset
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.uncertainty_settings import AS_SIMULATED

PRESET = load_preset("sal_spotlight")
NOTHING = UncertaintySettings()
VACUUM = CorrectionSettings(air="none")


def described(stated: UncertaintySettings, cnr_db: float = 20.0) -> Sensor:
    """The sensor of the preset, with what its description states of its accuracy."""
    return replace(PRESET, cnr_db=cnr_db, sensor=replace(PRESET.sensor, uncertainty=stated)).make_sensor()


def flown(seed: int, cnr_db: float = 20.0, pitch: float = 0.0, gains_db: float = 0.0, **errors: Any) -> SimulatedFlight:
    """A flight over level ground with an instrument that is not as it is described."""
    drawn = np.random.default_rng([7, seed]).standard_normal(PRESET.sensor.detectors)
    impairments = replace(
        PRESET.impairments,
        odometry=OdometryErrors(**errors),
        undescribed_gains_db=tuple((gains_db * drawn).tolist()) if gains_db else (),
    )
    sensor = replace(PRESET.sensor, pitch_beamwidths=(1 + pitch) * PRESET.sensor.pitch_beamwidths)
    flight = flight_of(replace(PRESET, cnr_db=cnr_db, impairments=impairments, sensor=sensor), seed)
    return replace(flight, scene=flat_scene(half=20.0))


def compressed(flight: SimulatedFlight, sensor: Sensor, delay_m: float = 0.0, **settings: Any) -> Slc:
    history: PhaseHistory = flight.phase_history(0)
    history = replace(history, reference_range=history.reference_range + delay_m)
    size = {"rows": PRESET.image.rows, "cols": PRESET.image.cols}
    slc = Compressor().add(history, flight.track(0), sensor, ImageSettings(air="none", **size, **settings))
    assert slc is not None
    return slc


def compared(seed: int, stated: UncertaintySettings, delay_m: float = 0.0, **errors: Any) -> SurfaceComparison:
    flight, sensor = flown(seed, **errors), described(stated, errors.get("cnr_db", 20.0))
    slc = compressed(flight, sensor, delay_m)
    field = heights(slc, sensor, ESTIMATORS["ml"], MlSettings())
    seen, aperture = as_flown(field, slc.aperture, flight, 0)
    processing, looks = (
        Processing(slc.range_window, slc.azimuth_window),
        (MlSettings().range_looks, MlSettings().azimuth_looks),
    )
    truth = true_surfaces(seen, aperture, processing, looks, flight, flight.surface(0))
    return compare(field, truth, sensor.beamwidth)


def beyond(sigmas: float, stated: UncertaintySettings, **errors: Any) -> float:
    """Fraction of the heights of four flights whose error is beyond that many sigmas."""
    found = joined_comparisons([compared(seed, stated, **errors) for seed in range(4)]).errors
    return fraction_of(int(np.sum(np.abs(found.nearest) > sigmas * found.sigma)), len(found.sigma))


@pytest.mark.parametrize(
    ("key", "errors"),
    [
        ("boresight_rad", {"undescribed_boresight_rad": (1e-3, 0.0, 0.0)}),
        ("lever_arm_m", {"undescribed_lever_arm_m": (0.0, 0.0, 0.05)}),
        ("lever_arm_m", {"undescribed_lever_arm_m": (0.0, 0.1, 0.3)}),
        ("range_delay_m", {"delay_m": 0.1}),
        ("range_delay_m", {"delay_m": 0.3}),
        ("beam_pitch", {"pitch": 0.02, "cnr_db": 30.0}),
        ("channel_gain_db", {"gains_db": 0.8, "cnr_db": 30.0}),
    ],
)
def test_heights_are_within_5_sigma_unless_a_wrong_accuracy_is_stated(key: str, errors: dict[str, Any]) -> None:
    """The rest of the instrument is as described, and states so: what is assumed of one part covers its error."""
    assert beyond(5, AS_SIMULATED, **errors) > 0.01
    assert beyond(5, replace(AS_SIMULATED, **{key: None}), **errors) <= 0.002


def test_heights_of_an_instrument_that_is_not_described_are_within_5_sigma() -> None:
    assert beyond(5, NOTHING, undescribed_lever_arm_m=(0.0, 0.1, 0.3), gains_db=0.5, pitch=0.01, delay_m=0.3) == 0


@pytest.fixture(scope="module")
def slcs() -> tuple[Slc, Slc]:
    """Images of the same dwell by a description that states nothing, and by one that is exact."""
    flight = flown(0)
    return compressed(flight, described(NOTHING)), compressed(flight, described(AS_SIMULATED))


def test_nothing_is_assumed_where_a_description_states_that_it_is_exact(slcs: tuple[Slc, Slc]) -> None:
    assumed, exact = slcs
    assert exact.doubts == ()
    assert not exact.aperture.covariance.any()
    assert np.array_equal(assumed.images, exact.images)
    (doubt,) = assumed.doubts
    assert doubt.name == INSTRUMENT
    for part in ("boresight 0.001 rad", "lever arm 0.1 m", "range delay 0.15 m", "odometry 0.001 s", "clock 2e-06"):
        assert part in doubt.sentence
    for parameter in ("boresight_sigma_rad", "lever_arm_sigma_m", "range_sigma_m", "sample_clock_sigma"):
        assert parameter in doubt.sentence


def test_what_is_assumed_are_shifts_and_turns_of_an_instrument_that_nobody_calibrated(slcs: tuple[Slc, Slc]) -> None:
    assumed, _ = slcs
    aperture, sensor = assumed.aperture, described(NOTHING)
    sight, flight = line_of_sight(sensor, aperture), aperture.velocity
    along = 0.15**2 + (2e-6 * np.linalg.norm(assumed.grid.middle - aperture.position)) ** 2
    expected = 0.1**2 * np.eye(3) + along * np.outer(sight, sight) + 1e-3**2 * np.outer(flight, flight)
    # The boresight is off by many of the angles that the Doppler of pulses gives the beams along the flight.
    reach = np.linalg.norm(assumed.grid.middle - aperture.position) * shift_along(aperture, sight)
    expected += 1e-3**2 * np.outer(reach, reach)
    np.testing.assert_allclose(aperture.covariance[:3, :3], expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(aperture.covariance[3:, 3:], 1e-6 * np.eye(3), rtol=1e-9, atol=1e-15)


def test_the_range_delay_of_a_coarse_radar_is_a_range_cell(slcs: tuple[Slc, Slc]) -> None:
    sensor = replace(described(AS_SIMULATED), uncertainty=replace(EXACT, range_delay=None), bandwidth=7.5e6)
    aperture = with_instrument(slcs[1], sensor, VACUUM).aperture
    assert np.sqrt(np.trace(aperture.covariance)) == pytest.approx(sensor.range_resolution)


def test_only_what_is_stated_decides_on_autofocus(slcs: tuple[Slc, Slc]) -> None:
    """A boresight that may be off by several beamwidths would request it."""
    aperture, middle, nothing = slcs[1].aperture, slcs[1].grid.middle, described(NOTHING)
    assert with_known_errors(aperture, middle, nothing, VACUUM) is aperture
    stated = described(replace(NOTHING, boresight_rad=1e-3))
    by_description = with_known_errors(aperture, middle, stated, VACUUM).covariance
    by_parameter = with_known_errors(aperture, middle, nothing, VACUUM.changed(boresight_sigma_rad=1e-3)).covariance
    np.testing.assert_allclose(by_description, by_parameter, rtol=1e-9, atol=1e-18)
    assert by_description[3, 3] == pytest.approx(1e-6)


def test_a_parameter_states_more_than_the_description(slcs: tuple[Slc, Slc]) -> None:
    aperture, middle = slcs[1].aperture, slcs[1].grid.middle
    settings = VACUUM.changed(lever_arm_sigma_m=0.0, boresight_sigma_rad=0.0)
    for stated in (NOTHING, replace(NOTHING, boresight_rad=1e-3, lever_arm_m=0.1)):
        assert with_known_errors(aperture, middle, described(stated), settings) is aperture


def test_a_covariance_of_the_mounting_is_in_the_axes_of_the_platform(slcs: tuple[Slc, Slc]) -> None:
    """An arm that is uncertain along the flight only, of an antenna that is turned by a quarter about z."""
    sensor = described(AS_SIMULATED)
    turned = replace(sensor.mounting, rotation=(0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    turned = replace(turned, lever_arm_covariance=(0.04, *8 * (0.0,)), rotation_covariance=(1e-6, *8 * (0.0,)))
    base = replace(slcs[1].aperture, rotation=Rotation.from_euler("z", 0.5).as_matrix())
    aperture = replace(base, rotation=base.rotation @ turned.axes.as_matrix())
    middle = slcs[1].grid.middle
    found = with_known_errors(aperture, middle, replace(sensor, mounting=turned), VACUUM).covariance
    ahead = base.rotation[:, 0]
    np.testing.assert_allclose(found[:3, :3], 0.04 * np.outer(ahead, ahead), atol=1e-12)
    np.testing.assert_allclose(found[3:, 3:], 1e-6 * np.outer(ahead, ahead), atol=1e-15)


def test_what_is_assumed_of_beams_is_a_doubt_until_somebody_states_it() -> None:
    sensor = replace(described(NOTHING), config_hash="")
    errors, (doubt,) = known_beams(sensor, HeightSettings(), None)
    assert errors == BeamErrors(0.01, 0.02, 0.5 * NEPERS_PER_DB, 0.0)
    for name in ("beam_pitch_sigma", "beam_width_sigma", "channel_gain_sigma_db"):
        assert name in doubt.sentence
    settings = HeightSettings(beam_pitch_sigma=0.0, beam_width_sigma=0.0, channel_gain_sigma_db=0.0)
    assert known_beams(sensor, settings, None) == (BeamErrors(), ())
    stated = SensorUncertainty(beam_pitch=0.002, beam_width=0.003, channel_gain=0.004, channel_phase=0.005)
    found = known_beams(replace(sensor, uncertainty=stated), HeightSettings(), None)
    assert (found.errors, found.doubts) == (BeamErrors(0.002, 0.003, pytest.approx(0.004), 0.005), ())
    assert known_beams(replace(sensor, uncertainty=EXACT), HeightSettings(), None) == (BeamErrors(), ())


def test_an_uncertainty_of_the_beams_that_is_stated_contains_width_and_gains() -> None:
    sensor = replace(described(NOTHING), beam_uncertainty=0.05, config_hash="")
    errors, (doubt,) = known_beams(sensor, HeightSettings(), None)
    assert errors == BeamErrors(pitch=0.01)
    assert "gain" not in doubt.sentence


def test_descriptions_from_before_keep_their_identity() -> None:
    """Files of calibrations name it."""
    sensor = make_sensor(uncertainty=NOTHING_STATED, mounting=AT_BASE_LINK)
    assert sensor.config_hash == "ddb9d09d9d56244a"
    assert make_sensor().config_hash != sensor.config_hash


def test_the_covariance_by_ranges_is_the_part_of_range_delay_clock_and_air() -> None:
    """Of images whose mounting and stamps are exact it is all."""
    slc, sensor = compressed(flown(0), described(AS_SIMULATED)), described(NOTHING)
    exact = {"boresight_sigma_rad": 0.0, "lever_arm_sigma_m": 0.0, "odometry_delay_sigma_s": 0.0}
    settings = ImageSettings(air="standard", elevation_sigma_rad=1e-5, **exact)
    middle = slc.grid.middle
    found = range_covariance(slc.aperture, middle, sensor, settings.changed(boresight_sigma_rad=1e-3))
    expected = with_instrument(slc, sensor, settings).aperture.covariance - slc.aperture.covariance
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-18)
    assert found[3:, 3:].any()
    exact_ranges = pose_settings({"boresight_sigma_rad": 1e-3})
    assert not range_covariance(slc.aperture, middle, sensor, exact_ranges).any()
