"""All that is measured of a sensor, from images of flights by the core alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence, circular, multilook

from sal_height.beams.array import Beams, column_squint
from sal_height.calibration.accumulate import (
    Calibrator,
    Sighting,
    brightest,
    common_response,
    find_reference_target,
    targets_in,
)
from sal_height.calibration.beam_calibration import BeamCalibration
from sal_height.calibration.calibration import CalibrationSettings
from sal_height.elevation.estimators.maximum_likelihood import MlSettings, ml_elevation
from sal_height.elevation.looks.looks import Looks
from sal_height.errors import NotDetermined, Rejected
from sal_height.figures.synthetic_tape import RangeFault, TapeTarget, make_tape
from sal_height.geometry.earth import sphere_point
from sal_height.geometry.frames import ApertureState, angles_of
from sal_height.geometry.grid import Grid
from sal_height.geometry.trajectory import Trajectory
from sal_height.imaging.focus import ImageSettings, Slc, focus_dwell
from sal_height.numeric import F64
from sal_height.response.point_targets import PointTarget, PointTargetSettings
from sal_height.simulation.flight import SimulatedFlight, flight_of
from sal_height.simulation.impairments import Impairments, RangeSawtooth
from sal_height.simulation.preset import TargetSettings, load_preset


def flown(dwells: int, **changes: Any) -> SimulatedFlight:
    return flight_of(replace(load_preset("small"), dwells=dwells, **changes), seed=4)


def images(flight: SimulatedFlight) -> Iterator[Slc]:
    track = Trajectory([state for dwell in range(flight.dwells) for state in flight.platform_states(dwell)])
    settings = ImageSettings(
        air="none", range_window="rectangular", azimuth_window="rectangular", cols=flight.preset.image.cols
    )
    for dwell in range(flight.dwells):
        yield focus_dwell(flight.phase_history(dwell), track, flight.sensor, settings)


def calibrated(flight: SimulatedFlight, slcs: Iterable[Slc], place: F64 | None = None, **changes: Any) -> Any:
    """Calibration and the reasons of what is undetermined; `place`: that of a reference target in map, m."""
    calibrator = Calibrator(flight.sensor, place, CalibrationSettings(**changes))
    for slc in slcs:
        calibrator.add(slc)
    return calibrator.calibration()


def test_what_receivers_have_in_common_is_told_by_a_target() -> None:
    """A sawtooth of 10 % in all receivers; one target among speckle leaves 0.25 of it, over eight seeds +- 0.03."""
    sawtooth = Impairments(range_sawtooth=RangeSawtooth(depth=0.1, teeth=8))
    target = TargetSettings(east_m=0.0, north_m=0.3, height_m=0.5, power_db=50.0)
    flight = flown(1, impairments=sawtooth, targets=(target,))
    (slc,) = images(flight)
    calibration, undetermined = calibrated(flight, [slc])
    true = sawtooth.receiver_response(flight.sensor)[0]
    shape = calibration.response / calibration.response.mean(axis=1)[:, None]
    error = np.abs(shape.mean(axis=0) - true / true.mean())
    assert np.sqrt(np.mean(error**2)) < 0.35 * np.std(true)
    assert not any("common" in sentence for sentence in undetermined)


def test_memory_of_targets_is_bounded_and_the_brightest_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [PointTarget(0.0, 0.0, float(over), np.zeros((64, 64), np.complex128)) for over in (300, 100, 900, 500)]
    chip = 64 * 64 * 16
    assert [target.over_clutter for target in brightest(found, 2 * chip)] == [900.0, 500.0]
    assert [target.over_clutter for target in brightest(found, 3 * chip - 1)] == [900.0, 500.0]
    assert brightest([], chip) == []
    flight = flown(2, targets=(TargetSettings(east_m=0.0, north_m=0.3, height_m=0.5, power_db=45.0),))
    (slc, _), calibrator = images(flight), Calibrator(flight.sensor)
    monkeypatch.setattr(
        "sal_height.calibration.accumulate.TARGET_MEMORY",
        3 * targets_in(slc.images.sum(axis=0), PointTargetSettings())[0].spectrum.nbytes,
    )
    for _ in range(5):
        calibrator.add(slc)
    assert len(calibrator._targets) == 3


def test_the_common_response_is_that_of_a_tape_at_its_frequencies() -> None:
    """Four targets of 50 dB; the chip of 64 rows does not hold all that the step at the edge of the band makes."""
    places = ((120.0, 100.0), (120.4, 300.3), (380.2, 100.7), (380.0, 400.0))
    fault = RangeFault(support=0.8, sawtooth=0.05)
    tape = make_tape((512, 512), np.random.default_rng(5), tuple(TapeTarget(*place, 50.0) for place in places), fault)
    targets = targets_in(tape, PointTargetSettings())
    assert len(targets) == 4
    found, true = common_response(list(targets), 256), fault.response(256)
    assert np.sqrt(np.mean(np.abs(found - true / true.mean()) ** 2)) < 0.04
    with pytest.raises(NotDetermined, match="No point target stands out from its surroundings"):
        common_response([], 256)


def test_a_sensor_that_is_as_described_stays_so() -> None:
    """Gains and width within 4 of their standard errors, and no echoes."""
    flight = flown(10)
    calibration, undetermined = calibrated(flight, images(flight))
    gain = calibration.response.mean(axis=1)
    assert np.all(np.abs(np.log(np.abs(gain))) < 4 * calibration.gain_sigma)
    assert np.all(np.abs(np.angle(gain)) < 4 * calibration.phase_sigma)
    assert abs(calibration.width_factor - 1) < 4 * calibration.width_sigma < 0.02
    assert np.ptp(np.abs(calibration.response), axis=1).max() < 0.01
    assert len(undetermined) == 1


def test_beams_are_told_by_images_of_white_noise_power(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of noise alone, channels have the power that the likelihood is told, within 5 standard errors of 2000 looks."""
    given: list[Any] = []

    def remember(looks: Looks, _beams: Beams, _settings: CalibrationSettings) -> BeamCalibration:
        given.append(looks.power.sum() / looks.count.sum() / looks.covariance.shape[-1] / looks.receiver_noise)
        return BeamCalibration.as_described(8)

    monkeypatch.setattr("sal_height.calibration.accumulate.calibrate_beams", remember)
    flight = flown(1, cnr_db=-60.0)
    calibrated(flight, images(flight))
    assert abs(given[0] - 1) < 5 * np.sqrt(1.3 / (64 * 12 * 8))


def test_settings_say_how_much_is_kept_and_clipped() -> None:
    flight = flown(1)
    (slc,) = images(flight)
    calibrator = Calibrator(flight.sensor, settings=CalibrationSettings(azimuth_looks=2, pixels_per_dwell=100))
    calibrator.add(slc)
    assert [columns.shape[1:] for columns in calibrator._columns] == [(64, 2)] * 2
    clipped = replace(slc, saturated_share=np.full(8, 0.01))
    with pytest.raises(Rejected, match=r"0.01 of a channel's samples are clipped; calibration needs 0.0008 or less"):
        calibrator.add(clipped)
    Calibrator(flight.sensor, settings=CalibrationSettings(max_saturated_fraction=0.02)).add(clipped)


def dead(slc: Slc) -> Slc:
    return replace(slc, images=slc.images * (np.arange(8) != 2)[:, None, None].astype(np.float32))


SPOILED: dict[str, Callable[[Slc], Slc]] = {
    "zeros": lambda slc: replace(slc, images=np.zeros_like(slc.images)),
    "not finite": lambda slc: replace(slc, images=np.full_like(slc.images, np.nan)),
    "a dead channel": dead,
    "narrow": lambda slc: replace(slc, images=slc.images[..., :3], grid=replace(slc.grid, cols=3)),
    "without noise": lambda slc: replace(slc, noise_power=np.zeros_like(slc.noise_power)),
}


@pytest.mark.parametrize("spoil", SPOILED.values(), ids=SPOILED)
def test_images_that_do_not_tell_leave_all_as_described_and_say_why(spoil: Any) -> None:
    flight = flown(2)
    with np.errstate(invalid="raise"):
        calibration, undetermined = calibrated(flight, [spoil(slc) for slc in images(flight)])
    assert calibration.width_factor == 1.0
    assert np.all(np.isfinite(calibration.response))
    assert len(undetermined) >= 2
    for sentence in undetermined:
        assert_one_sentence(sentence)


def test_two_detectors_tell_their_phase_and_no_more() -> None:
    preset = load_preset("small")
    sensor = replace(preset.sensor, detectors=2, pitch_beamwidths=0.7)
    phases = Impairments(undescribed_phases_rad=(0.2, -0.2))
    flight = flown(8, sensor=sensor, impairments=phases)
    calibration, _ = calibrated(flight, images(flight))
    gain = calibration.response.mean(axis=1)
    np.testing.assert_allclose(np.angle(gain), [0.2, -0.2], atol=0.03)
    np.testing.assert_allclose(np.abs(gain), 1, atol=1e-9)
    assert np.isnan(calibration.gain_sigma).all()
    assert np.isnan(calibration.width_sigma)


def test_mixtures_of_detectors_have_no_gains_of_their_own() -> None:
    flight = flight_of(replace(load_preset("xband_sumdiff"), dwells=2), seed=1)
    calibration, undetermined = calibrated(flight, images(flight))
    assert any("mixtures of detectors" in sentence for sentence in undetermined)
    assert np.isnan(calibration.width_sigma)


def paired(**changes: Any) -> SimulatedFlight:
    """A lidar of two detectors whose gains are 1 dB and 20 degrees apart, over a street with a reflector."""
    sensor = replace(load_preset("small").sensor, detectors=2, pitch_beamwidths=0.7)
    faults = Impairments(undescribed_gains_db=(0.5, -0.5), undescribed_phases_rad=(0.17, -0.17))
    reflector = TargetSettings(east_m=0.0, north_m=0.1, height_m=0.2, power_db=40.0)
    return flown(1, sensor=sensor, impairments=faults, targets=(reflector,), **changes)


def test_a_reference_target_tells_what_a_scene_cannot() -> None:
    """Amplitudes of a pair; speckle beside the target leaves 1 %. The bias of monopulse goes with them."""
    flight = paired()
    calibration, undetermined = calibrated(flight, images(flight), sphere_point(0.0, 0.1, 0.2))
    gain = calibration.response.mean(axis=1)
    np.testing.assert_allclose(20 * np.log10(np.abs(gain)), [0.5, -0.5], atol=0.1)
    np.testing.assert_allclose(np.angle(gain), [0.17, -0.17], atol=0.02)
    assert np.all((calibration.gain_sigma > 0) & (calibration.gain_sigma < 0.02))
    assert not any("reference" in sentence for sentence in undetermined)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"azimuth_looks": 13}, "No image has 13 columns"),
        ({"pixels_per_parameter": 1000}, "5000 are needed"),
        ({"min_energy": 1e6}, "an energy of 1e+06 noise powers"),
        ({"max_uncertainty": 1e-6, "pixels_per_parameter": 1}, "to bring that to 0.0001 %"),
        ({"target_over_image_db": 70.0}, "No dwell shows the target 70 dB over its image"),
        ({"point_over_clutter_db": 90.0}, "No point target stands out"),
    ],
    ids=str,
)
def test_settings_say_what_is_enough(changed: dict[str, Any], sentence: str) -> None:
    """A dwell over a reflector, which with the settings as they are determines everything."""
    flight, place = paired(), sphere_point(0.0, 0.1, 0.2) if "target" in sentence else None
    _, undetermined = calibrated(flight, images(flight), place, **changed)
    assert any(sentence in reason for reason in undetermined)


def test_heights_of_a_pair_lose_their_bias_by_a_reference_target() -> None:
    """Elevation of the target itself: before, off by 1 dB over the slope of the pair; a tenth of that after."""
    flight, place = paired(), sphere_point(0.0, 0.1, 0.2)
    (slc,) = images(flight)
    calibration, _ = calibrated(flight, [slc], place)
    track, history, sensor = Trajectory(flight.platform_states(0)), flight.phase_history(0), flight.sensor
    _, elevation, _ = angles_of(place, slc.aperture, sensor.look_side)
    biases = []
    for frames in (history, calibration.equalised(history)):
        after = focus_dwell(frames, track, sensor, ImageSettings(air="none", cols=12))
        squint = column_squint(after.grid, after.aperture, sensor.beams, sensor.look_side)
        looks = multilook(after.images, 1, 1, squint=squint, noise_power=after.noise_power[0])
        found = ml_elevation(looks, sensor.beams, MlSettings(min_cnr_db=0.0, layover=False))
        brightest = np.unravel_index(np.argmax(looks.power), looks.power.shape)
        biases.append(abs(float(found.elevation[brightest]) - float(elevation)) / sensor.beamwidth)
    assert biases[0] > 0.02
    assert biases[1] < 0.1 * biases[0]


def test_a_target_that_is_not_seen_leaves_the_scene_to_tell() -> None:
    flight = flown(10)
    calibration, undetermined = calibrated(flight, images(flight), sphere_point(1000.0, 0.0, 0.0))
    assert "by the reference target: No dwell shows the target" in undetermined[0]
    assert calibration.width_sigma > 0


ROWS, COLS = 64, 24
APERTURE = ApertureState(np.array([0.0, 0.0, 3500.0]), np.array([50.0, 0.0, 0.0]), np.eye(3), 0.1, np.zeros((6, 6)))
SIGHT = np.array([0.0, -1.0, -1.0]) / np.sqrt(2)
GRID = Grid(
    APERTURE.position + 4950.0 * SIGHT - np.array([0.4, 0.0, 0.0]),
    SIGHT,
    np.array([1.0, 0.0, 0.0]),
    0.05,
    0.04,
    ROWS,
    COLS,
)
ROW, COL = 30, 7


def seen(over_db: float, row: int = ROW, col: int = COL) -> Sighting | None:
    """A target at ROW and COL whose image, of `over_db` over the speckle of two channels, is at `row` and `col`."""
    pixels = circular(np.random.default_rng(1), (2, ROWS, COLS)).astype(np.complex64)
    pixels[:, row, col] = 10 ** (over_db / 20) * np.array([1, 0.5j])
    return find_reference_target(pixels, GRID, APERTURE, 1, GRID.points(ROW, COL))


def test_it_is_found_within_two_pixels_of_its_place_and_seen_under_its_angles() -> None:
    _, elevation, squint = angles_of(GRID.points(ROW, COL), APERTURE, 1)
    for row, col in ((ROW, COL), (ROW - 2, COL + 2)):
        found = seen(40.0, row, col)
        assert found is not None
        np.testing.assert_allclose(found.samples, [100, 50j], rtol=1e-6)
        assert found.elevation == pytest.approx(float(elevation), abs=1e-12)
        assert found.squint == pytest.approx(float(squint), abs=1e-12)
    assert elevation != pytest.approx(squint, abs=0.1)


def test_it_is_not_taken_from_elsewhere_nor_from_speckle() -> None:
    assert seen(40.0, ROW + 3, COL) is None
    assert seen(40.0, ROW, COL + 3) is None
    assert seen(15.0) is None


@pytest.mark.parametrize(("row", "col"), [(1, COL), (ROWS - 2, COL), (ROW, 1), (ROW, COLS - 2), (-40, COL)])
def test_beyond_the_edge_there_is_none(row: int, col: int) -> None:
    pixels = np.full((2, ROWS, COLS), 1e-3, dtype=np.complex64)
    pixels[:, max(row, 0), col] = 1
    assert find_reference_target(pixels, GRID, APERTURE, 1, GRID.points(row, col)) is None


def test_in_a_strip_it_is_seen_from_abeam() -> None:
    """The strip's images are those of an aperture that slides along: the squint of a target at any column is 0."""
    flight = flight_of(replace(load_preset("sal_stripmap"), dwells=1), seed=1)
    aperture = replace(flight.aperture(0), sliding=True)
    place = aperture.position + 5000.0 * SIGHT + np.array([0.3, 0.0, 0.0])
    grid = replace(GRID, origin=aperture.position + 4999.0 * SIGHT - np.array([0.4, 0.0, 0.0]))
    pixels = np.full((2, ROWS, COLS), 1e-3, dtype=np.complex64)
    pixels[:, 20, 17] = 1
    found = find_reference_target(pixels, grid, aperture, 1, place)
    assert found is not None
    assert found.squint == pytest.approx(0, abs=1e-9)
    assert abs(angles_of(place, aperture, 1)[2]) > 1e-5
