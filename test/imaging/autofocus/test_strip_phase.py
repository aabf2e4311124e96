"""The phase of a strip's pulses: found in blocks of any length, and joined; a flight of the stripmap lidar, 20 dB."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import Array, few
from phase_errors import white_phase

from sal_height.geometry import Trajectory
from sal_height.imaging.autofocus.gradient import AutofocusSettings, Focus
from sal_height.imaging.autofocus.phase_error import course_of, turns_slowly
from sal_height.imaging.autofocus.strip_phase import WINDOW, link_block, stays_in_range_cell
from sal_height.imaging.pixels import line_of_sight
from sal_height.sensor import PhaseHistory
from sal_height.simulation import SimulatedFlight, flight_of, load_preset

SETTINGS = AutofocusSettings()
BLOCKS, PULSES = 4, 256


@cache
def flown(gust: float = 0.0, cnr_db: float = 20.0) -> tuple[SimulatedFlight, PhaseHistory, Trajectory]:
    """Pulses of some blocks one after the other, without errors, and their track."""
    preset = load_preset("sal_stripmap")
    flight = flight_of(
        replace(preset, dwells=BLOCKS, cnr_db=cnr_db, flight=replace(preset.flight, gust_mps=gust)), seed=5
    )
    blocks = [flight.phase_history(dwell) for dwell in range(BLOCKS)]
    whole = replace(
        blocks[0],
        pulse_times=np.arange(BLOCKS * PULSES) / flight.sensor.pulse_repetition_frequency,
        reference_range=np.concatenate([block.reference_range for block in blocks]),
        samples=np.concatenate([block.samples for block in blocks], axis=1),
        saturated_share=np.concatenate([block.shares for block in blocks], axis=1),
    )
    track = flight.track(0)
    for dwell in range(1, BLOCKS):
        track = track.followed_by(flight.track(dwell))
    return flight, whole, track


def turned(history: PhaseHistory, phase: Array) -> PhaseHistory:
    return replace(history, samples=history.samples * np.exp(1j * phase).astype(np.complex64)[:, None])


def linked(error: Array, block: int, **flight: float) -> tuple[Array, list[Focus]]:
    """What is left of a phase error that is put in, block by block, and what was said of each."""
    simulated, history, track = flown(**flight)
    antenna, said = track.positions(history.stamp_ns, history.pulse_times), []
    corrected, found = turned(history, error), np.zeros(len(error))
    for first in range(0, len(error) // block * block, block):
        now, so_far = slice(first, first + block), slice(0, first)
        pulses = corrected.pulses(now)
        aperture = track.aperture(pulses.stamp_ns, pulses.pulse_times)
        sight = line_of_sight(simulated.sensor, aperture)
        before = (corrected.pulses(so_far), antenna[so_far]) if first else None
        focus = link_block(pulses, antenna[now], before, sight, aperture.direction, simulated.sensor, SETTINGS)
        found[now] = focus.phase
        corrected.samples[:, now] = turned(pulses, -focus.phase).samples
        said.append(focus)
    done = len(error) // block * block
    return np.angle(np.exp(1j * (error - found)))[:done], said


def vibration(amplitude_m: float, frequency: float) -> Array:
    flight, history, _ = flown()
    return 4 * np.pi / flight.sensor.wavelength * amplitude_m * np.sin(2 * np.pi * frequency * history.pulse_times)


ERRORS = {
    "none": lambda: np.zeros(BLOCKS * PULSES),
    "10 um at 50 Hz": lambda: vibration(10e-6, 50.0),
    "1 um at 2 kHz": lambda: vibration(1e-6, 2000.0),
    "white": lambda: white_phase(BLOCKS * PULSES, 10.0, np.random.default_rng(3)),
}


@pytest.mark.parametrize("gust", few(1, [2.0, 0.0]), ids=["gusts", "calm"])
@pytest.mark.parametrize("name", ERRORS)
def test_what_is_left_of_a_phase_error_is_small_whatever_it_was(name: str, gust: float) -> None:
    """Steps from pulse to pulse are left to what is stated, or up to a third of it; and no trend beyond its error.

    What is stated is the error of the worst 32 pulses of a block, .1 rad.
    Gusts turn the antenna's way by up to .06 rad, and a trend of .03 of a beam is .1 rad.
    """
    left, said = linked(ERRORS[name](), PULSES, gust=gust)
    assert all(focus.trusted for focus in said)
    steps = np.angle(np.exp(1j * np.diff(left)))
    stated = float(np.sqrt(np.mean([focus.standard_error**2 for focus in said])))
    assert stated == pytest.approx(0.117, rel=0.05)
    assert 1 / 3 < np.std(steps) / stated < 1.0
    error = float(np.sqrt(np.mean([focus.trend_error**2 for focus in said])))
    assert error < 0.08
    of_blocks = np.array([steps[first : first + PULSES - 1].mean() for first in range(0, len(steps), PULSES)])
    assert np.sqrt(np.mean(of_blocks**2)) < 2 * error


@pytest.mark.parametrize(("cnr_db", "least_m", "most_m"), [(20.0, 0.003, 0.007), (0.0, 0.005, 0.015)])
def test_images_are_blurred_by_a_little(cnr_db: float, least_m: float, most_m: float) -> None:
    """By half a centimetre, and in weak echoes by up to one and a half: trends of the error over an aperture's pulses.

    They are those of 12 apertures that overlap, in 1024 pulses, so that they are known to 40 %.
    """
    left, _ = linked(ERRORS["none"](), PULSES, cnr_db=cnr_db)
    course, aperture = np.unwrap(left), 310
    time = np.arange(aperture) - (aperture - 1) / 2
    starts = range(0, len(course) - aperture, 64)
    trends = np.array([time @ course[first : first + aperture] for first in starts]) / (time @ time)
    sensor = flown(cnr_db=cnr_db)[0].sensor
    speed = trends * sensor.wavelength * sensor.pulse_repetition_frequency / (4 * np.pi)
    assert least_m < np.std(speed) * 5000.0 / 50.0 < most_m


@pytest.mark.parametrize("block", [40, 100, 341, 1024])
def test_blocks_of_any_length_join(block: int) -> None:
    """No step at a seam is beyond 5 of the others, where a phase that is not joined would step by up to 3 rad."""
    left, said = linked(ERRORS["10 um at 50 Hz"](), block)
    assert all(focus.trusted for focus in said)
    steps = np.angle(np.exp(1j * np.diff(left)))
    seams = [*range(block - 1, len(steps), block), *range(WINDOW - 1, len(steps), WINDOW)]
    assert np.abs(steps[seams]).max() < 5 * np.std(steps) < 1.0


def test_a_block_says_nothing_of_the_trend_that_the_beams_are_known_to_have() -> None:
    """Beams that look .3 of a beam ahead of where they are said to look turn the phase by as much, to .08 of a beam."""
    flight, history, track = flown()
    block = history.pulses(slice(0, WINDOW))
    antenna = track.positions(block.stamp_ns, block.pulse_times)
    aperture = track.aperture(block.stamp_ns, block.pulse_times)
    sight, beam = line_of_sight(flight.sensor, aperture), flight.sensor.beams.track_beamwidth
    behind = sight - 0.3 * beam * aperture.direction
    trends = [
        course_of(link_block(block, antenna, None, one, aperture.direction, flight.sensor, SETTINGS).phase)[1]
        for one in (sight, behind)
    ]
    way = float(np.linalg.norm(antenna[1] - antenna[0]))
    of_a_beam = 4 * np.pi / flight.sensor.wavelength * way * beam
    assert trends[0] / of_a_beam == pytest.approx(0.0, abs=0.08)
    assert (trends[1] - trends[0]) / of_a_beam == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize(("cnr_db", "trusted"), [(0.0, True), (-6.0, False)])
def test_phases_of_weak_echoes_are_not_trusted(cnr_db: float, trusted: bool) -> None:
    """At 0 dB a step is known to .35 rad, at -6 dB to more than 1 rad."""
    _, said = linked(ERRORS["none"](), PULSES, cnr_db=cnr_db)
    assert all(focus.trusted == trusted for focus in said)


def test_noise_alone_has_no_phase() -> None:
    flight, history, track = flown()
    block, rng = history.pulses(slice(0, WINDOW)), np.random.default_rng(4)
    noise = np.sqrt(0.5 * flight.sensor.noise_power[0]) * rng.standard_normal((*block.samples.shape, 2))
    dark = replace(block, samples=noise.view(np.complex128)[..., 0].astype(np.complex64))
    antenna = track.positions(block.stamp_ns, block.pulse_times)
    aperture = track.aperture(block.stamp_ns, block.pulse_times)
    sight = line_of_sight(flight.sensor, aperture)
    focus = link_block(dark, antenna, None, sight, aperture.direction, flight.sensor, SETTINGS)
    assert not focus.trusted


def test_what_a_pulse_lights_must_stay_in_a_range_cell() -> None:
    """Half a beam ahead of abeam, ranges are longer by (range x beam)^2 / 8 range, which may be half a cell."""
    sensor = flown()[0].sensor
    farthest = 4 * sensor.range_resolution / sensor.beams.track_beamwidth**2
    assert stays_in_range_cell(sensor, 0.99 * farthest)
    assert not stays_in_range_cell(sensor, 1.01 * farthest)
    silent = replace(sensor, noise_power=(0.0,) * sensor.detector_count, config_hash="")
    assert not stays_in_range_cell(silent, 5000.0)


def test_course_of_a_phase_that_turns_slowly() -> None:
    """Steps of 4 rad and more, which change by .1 rad from one to the next; white phases have no course."""
    time = np.arange(200) - 99.5
    bend = 0.05 * time**2
    bend -= bend.mean()
    phase = np.angle(np.exp(1j * (bend + 1.3 * time)))
    course, trend = course_of(phase)
    np.testing.assert_allclose(course, bend, atol=1e-9)
    assert trend == pytest.approx(1.3)
    assert turns_slowly(phase)
    assert not turns_slowly(white_phase(200, 10.0, np.random.default_rng(5)))
