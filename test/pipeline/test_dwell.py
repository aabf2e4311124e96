"""The core's way from phase history to heights, without ROS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sal_height.beams import Beams
from sal_height.calibration import Calibration
from sal_height.elevation import ESTIMATORS, MEASURED, MlSettings, Validity, scatterer_count
from sal_height.errors import UserError
from sal_height.geometry import Trajectory
from sal_height.imaging import ImageSettings, Slc
from sal_height.pipeline import Compressor, channels_and_beams, heights
from sal_height.sensor import Channels, PhaseHistory, clipped, whitened_channels
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.simulation.receiver_noise import receiver_noise

STRIP_IMAGE = ImageSettings(air="none", rows=16, cols=128)


def strip_flight(full_scale: float = 0.0) -> SimulatedFlight:
    """Eight blocks of 256 pulses; an image needs 256 pulses and the 310 of an aperture."""
    flight = flight_of(replace(load_preset("sal_stripmap"), dwells=8), seed=3)
    return replace(flight, sensor=replace(flight.sensor, full_scale=full_scale, config_hash=""))


def noise_of(flight: SimulatedFlight, block: int) -> PhaseHistory:
    """A block of receiver noise."""
    samples = receiver_noise(flight.sensor, flight.sensor.pulse_count, np.random.default_rng(block))
    reference = np.full(flight.sensor.pulse_count, flight.preset.flight.slant_range_m)
    return PhaseHistory(flight.dwell_start_ns(block), flight.pulse_times, reference, samples)


def track_of(flight: SimulatedFlight, block: int) -> Trajectory:
    """Odometry of that block, and of the ones before."""
    return Trajectory([state for number in range(block + 1) for state in flight.platform_states(number)])


def no_calibration(flight: SimulatedFlight, config_hash: str) -> Calibration:
    zeros = np.zeros(flight.sensor.detector_count)
    response = np.ones((flight.sensor.detector_count, flight.sensor.sample_count), dtype=np.complex128)
    return Calibration(config_hash, response, zeros, zeros, zeros)


def test_images_of_a_strip_tell_of_the_clipped_blocks_that_are_in_them() -> None:
    """Block 3 is clipped in channel 5; pulses are held a little longer than needed, so one more image may say so."""
    flight, bad, compressor, told = strip_flight(full_scale=100.0), 3, Compressor(), {}
    for block in range(flight.dwells):
        history = noise_of(flight, block)
        if block == bad:
            history.samples[5] = clipped(1e5 * history.samples[5], flight.sensor.full_scale)
        slc = compressor.add(history, track_of(flight, block), flight.sensor, STRIP_IMAGE)
        if slc:
            told[block] = slc.saturated_share
    assert set(told) == set(range(2, flight.dwells))
    clipped_images = {block for block, shares in told.items() if shares.any()}
    assert {3, 4, 5} <= clipped_images <= {3, 4, 5, 6}
    assert told[bad][5] > 0.99
    assert not np.delete(told[bad], 5).any()


def test_blocks_that_a_wrong_calibration_refuses_leave_nothing_behind() -> None:
    """Neither their pulses nor their clipped samples."""
    flight, compressor = strip_flight(full_scale=100.0), Compressor()
    theirs, ours = no_calibration(flight, "another"), no_calibration(flight, flight.sensor.config_hash)
    images = []
    for block in range(6):
        history = noise_of(flight, block)
        if block in {0, 1}:
            history.samples[:] = clipped(1e5 * history.samples, flight.sensor.full_scale)
            with pytest.raises(UserError, match="another"):
                compressor.add(history, track_of(flight, block), flight.sensor, STRIP_IMAGE, theirs)
        else:
            images.append(compressor.add(history, track_of(flight, block), flight.sensor, STRIP_IMAGE, ours))
    assert [slc is not None for slc in images] == [False, False, True, True]
    assert not any(slc.saturated_share.any() for slc in images if slc)


def test_a_strip_needs_of_each_block_its_own_odometry_only() -> None:
    """The images are those that odometry of the whole flight gives."""
    flight, whole, own = strip_flight(), Compressor(), Compressor()
    for block in range(5):
        history, track, short = noise_of(flight, block), track_of(flight, block), flight.track(block)
        assert len(short.states) < len(track.states) or block == 0
        seen = [c.add(history, t, flight.sensor, STRIP_IMAGE) for c, t in ((whole, track), (own, short))]
        assert (seen[0] is None) == (seen[1] is None)
        if seen[0] and seen[1]:
            np.testing.assert_allclose(seen[1].images, seen[0].images, rtol=0, atol=1e-6 * np.abs(seen[0].images).max())


def test_a_calibration_states_the_noise_that_it_leaves() -> None:
    flight = flight_of(replace(load_preset("small"), dwells=1), seed=1)
    calibration = no_calibration(flight, flight.sensor.config_hash)
    gains = np.linspace(0.5, 1.5, flight.sensor.detector_count)
    weak = replace(calibration, response=calibration.response * gains[:, None])
    history, track = flight.phase_history(0), Trajectory(flight.platform_states(0))
    before = Compressor().add(history, track, flight.sensor, ImageSettings(air="none", rows=8, cols=8))
    after = Compressor().add(history, track, flight.sensor, ImageSettings(air="none", rows=8, cols=8), weak)
    assert before
    assert after
    equaliser = np.abs(weak.equaliser[:, 0]) ** 2
    np.testing.assert_allclose(after.noise_power, before.noise_power * equaliser, rtol=1e-6)
    np.testing.assert_allclose(after.images, before.images * weak.equaliser[:, :1, None], rtol=1e-3, atol=1e-4)


@pytest.fixture(scope="module")
def small() -> tuple[SimulatedFlight, Slc]:
    """A dwell of the small preset, and its images."""
    preset = load_preset("small")
    flight = flight_of(replace(preset, dwells=1), seed=1)
    image = ImageSettings(air="none", rows=preset.image.rows, cols=preset.image.cols)
    slc = Compressor().add(flight.phase_history(0), Trajectory(flight.platform_states(0)), flight.sensor, image)
    assert slc
    return flight, slc


@pytest.mark.parametrize("objective", ["normalised", "numerator"])
def test_every_usable_pixel_has_a_finite_height_and_sigma(small: tuple[SimulatedFlight, Slc], objective: str) -> None:
    """With the published objective one pixel was said to hold two scatterers of an infinite sigma."""
    flight, slc = small
    field = heights(slc, flight.sensor, ESTIMATORS["ml"], MlSettings(objective=objective))
    assert np.mean(scatterer_count(field.validity) > 0) > 0.5
    for number, surface in enumerate(field.surfaces):
        usable = scatterer_count(field.validity) > number
        assert np.isfinite(surface.sigma[usable]).all()
        assert np.isfinite(surface.height[usable]).all()
        assert not np.isfinite(surface.height[~usable]).any()


def test_a_dead_channel_is_left_out(small: tuple[SimulatedFlight, Slc]) -> None:
    """Of eight detectors the heights that seven give; ruined samples of a single pixel cost that pixel only."""
    flight, slc = small
    images = slc.images.copy()
    images[0] = 0
    field = heights(replace(slc, images=images), flight.sensor, ESTIMATORS["ml"], MlSettings())
    sensor = flight.sensor
    rest = replace(
        sensor, elevation_boresights=sensor.elevation_boresights[1:], noise_power=sensor.noise_power[1:], config_hash=""
    )
    seven = replace(slc, images=images[1:], noise_power=slc.noise_power[1:], saturated_share=slc.saturated_share[1:])
    expected = heights(seven, rest, ESTIMATORS["ml"], MlSettings())
    np.testing.assert_array_equal(field.validity, expected.validity)
    np.testing.assert_array_equal(field.first.height, expected.first.height)


def test_clipped_samples_mark_the_heights_of_a_dwell(small: tuple[SimulatedFlight, Slc]) -> None:
    flight, slc = small
    share = np.zeros(flight.sensor.detector_count)
    share[3] = 1e-3
    marked = heights(replace(slc, saturated_share=share), flight.sensor, ESTIMATORS["ml"], MlSettings())
    allowed = heights(
        replace(slc, saturated_share=share), flight.sensor, ESTIMATORS["ml"], MlSettings(max_saturated_fraction=1e-3)
    )
    usable = np.isin(allowed.validity, MEASURED)
    assert (marked.validity[usable] == Validity.SATURATED).all()
    assert usable.sum() > 30
    assert not np.isfinite(marked.first.height).any()


def test_the_width_of_the_beams_is_that_of_the_calibration(small: tuple[SimulatedFlight, Slc]) -> None:
    """As if the sensor were described with beams of that width."""
    flight, slc = small
    wide = replace(no_calibration(flight, flight.sensor.config_hash), width_factor=1.1)
    calibrated = heights(slc, flight.sensor, ESTIMATORS["monopulse"], ESTIMATORS["monopulse"].settings(), wide)
    described = heights(slc, flight.sensor.widened(1.1), ESTIMATORS["monopulse"], ESTIMATORS["monopulse"].settings())
    plain = heights(slc, flight.sensor, ESTIMATORS["monopulse"], ESTIMATORS["monopulse"].settings())
    np.testing.assert_allclose(calibrated.first.height, described.first.height, rtol=0, atol=1e-9)
    assert np.nanmax(np.abs(calibrated.first.height - plain.first.height)) > 0.01


def test_dwells_have_the_very_same_beams_whatever_their_noise_level(small: tuple[SimulatedFlight, Slc]) -> None:
    """What is made from beams is held with them; of other ratios of the channels' noise the beams are others."""
    flight, slc = small
    live = np.arange(flight.sensor.detector_count)

    def channels_of(noise_power: np.ndarray) -> tuple[Channels, Beams]:
        image = replace(slc, noise_power=noise_power)
        return channels_and_beams(image, flight.sensor, ESTIMATORS["ml"], None, live)

    channels, beams = channels_of(slc.noise_power)
    louder, same = channels_of(slc.noise_power * (3 + 1e-14 * live))
    assert same is beams
    np.testing.assert_array_equal(louder.noise_powers, channels.noise_powers)
    np.testing.assert_allclose(louder.transform, channels.transform / np.sqrt(3), rtol=1e-12)
    uneven, other = channels_of(slc.noise_power * (1 + 1e-3 * live))
    direct = whitened_channels(np.diag(slc.noise_power * (1 + 1e-3 * live)), flight.sensor.mixing)
    assert other is not beams
    highest = np.sqrt(slc.noise_power[-1] * (1 + 1e-3 * live[-1]))
    np.testing.assert_allclose(uneven.transform, direct.transform / highest, rtol=1e-8, atol=1e-12 / highest)
    np.testing.assert_allclose(uneven.noise_powers, direct.noise_powers / highest**2, rtol=1e-8)
    scaled = flight.sensor.beams.combined(direct.matrix).response(flight.sensor.beams.span[0], 0.0)
    np.testing.assert_allclose(other.response(flight.sensor.beams.span[0], 0.0), scaled, atol=1e-8)
