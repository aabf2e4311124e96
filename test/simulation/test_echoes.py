"""Echoes of a group of pulses against the sum over scatterers, how long a group may be, and responses of beams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import BEAMWIDTH, beams_named, direct_history, make_sensor, sensor_with_complex_beams

from sal_height.beams import Beams
from sal_height.geometry.frames import angles_of
from sal_height.sensor.sensor import Sensor, lit_angle
from sal_height.sensor.waveform import echo_sensor
from sal_height.simulation.echoes import NODES_PER_BEAMWIDTH, _table, response_of
from sal_height.simulation.flight import SimulatedFlight, flight_of
from sal_height.simulation.preset import load_preset
from sal_height.simulation.pulse_groups import PulseGroup, _beam_nodes, outermost, pulse_groups, smooth_group
from sal_height.simulation.scene import VisibleSurface
from sal_height.simulation.spotlight import simulate_dwell
from sal_height.simulation.stripmap import simulate_block

ERROR = 1e-4
"""Of a sample, over the rms of the samples of all detectors: -80 dB."""


def flight_named(name: str, gust: float = 0.0, **flight: float) -> SimulatedFlight:
    preset = load_preset(name)
    return flight_of(replace(preset, flight=replace(preset.flight, gust_mps=gust, **flight)), seed=3)


def some_of(surface: VisibleSurface, count: int) -> VisibleSurface:
    """Some scatterers, the outermost among them."""
    rng = np.random.default_rng(61)
    far = np.isin(surface.positions[:, 0], outermost(surface.positions.T)[:, 0])
    return surface.where(far | (rng.uniform(size=len(far)) < count / len(far)))


def strengths_of(surface: VisibleSurface) -> np.ndarray:
    rng = np.random.default_rng(62)
    return rng.standard_normal(len(surface.power)) + 1j * rng.standard_normal(len(surface.power))


def groups_of(flight: SimulatedFlight, surface: VisibleSurface, antenna: np.ndarray) -> list[PulseGroup]:
    sensor, probes = echo_sensor(flight.built), outermost(surface.positions.T)
    return pulse_groups(
        len(antenna), lambda pulses: smooth_group(sensor, probes, antenna, np.zeros((len(antenna[pulses]), 1)), pulses)
    )


@pytest.mark.parametrize(
    ("name", "gust", "groups"),
    [
        ("sal_spotlight", 0.0, 1),
        ("sal_spotlight", 1.0, 2),
        ("small", 0.0, 1),
        ("xband_relief", 0.0, 1),
        ("xband_sumdiff", 0.0, 1),
        ("xband_relief", 1.0, 0),
        ("woods", 0.0, 0),
    ],
)
def test_dwell_of_a_preset_is_the_sum_over_its_scatterers(name: str, gust: float, groups: int) -> None:
    """In the fewest groups of pulses that its geometry allows; 0: in single pulses."""
    flight = flight_named(name, gust)
    sensor, times = echo_sensor(flight.built), flight.dwell_start_ns(1) * 1e-9 + flight.pulse_times
    surface, antenna = some_of(flight.surface(1), 150), flight.position(times)
    assert len(groups_of(flight, surface, antenna)) == groups
    reference, strengths = np.full(len(times), flight.preset.flight.slant_range_m), strengths_of(surface)
    samples = simulate_dwell(sensor, surface, strengths, antenna, reference)
    weighted = sensor.beams.response(surface.elevation, surface.squint).T * strengths
    expected = direct_history(sensor, surface.positions, weighted, antenna, reference)
    assert np.sqrt(np.mean(np.abs(samples - expected) ** 2)) < ERROR * np.sqrt(np.mean(np.abs(expected) ** 2))


@pytest.mark.parametrize(("bandwidth", "groups"), [(1e7, 1), (4e7, 3)])
def test_migration_of_many_wavelengths_has_shorter_groups(bandwidth: float, groups: int) -> None:
    """Its second order is left out: at 10 MHz up to 2e-3 rad of an outermost scatterer, at 40 MHz 16 times as much."""
    flight = flight_named("xband_relief")
    sensor, times = replace(flight.sensor, bandwidth=bandwidth, config_hash=""), flight.dwell_start_ns(1) * 1e-9
    surface, antenna = flight.surface(1), flight.position(times + flight.pulse_times)
    surface = some_of(surface.where(np.abs(surface.slant_range - 35e3) < 0.49 * sensor.range_window), 150)
    probes, angles = outermost(surface.positions.T), np.zeros((64, 1))
    found = pulse_groups(64, lambda pulses: smooth_group(sensor, probes, antenna, angles[pulses], pulses))
    assert len(found) == groups
    strengths, reference = strengths_of(surface), np.full(64, 35e3)
    samples = simulate_dwell(sensor, surface, strengths, antenna, reference)
    weighted = sensor.beams.response(surface.elevation, surface.squint).T * strengths
    expected = direct_history(sensor, surface.positions, weighted, antenna, reference)
    assert np.sqrt(np.mean(np.abs(samples - expected) ** 2)) < ERROR * np.sqrt(np.mean(np.abs(expected) ** 2))


@pytest.mark.parametrize("gust", [0.0, 1.0])
def test_block_of_sal_stripmap_is_the_sum_over_what_is_lit(gust: float) -> None:
    """Each pulse sees the scatterers under its own angles: those that the middle of its third of the block lights up.

    In gusts groups are shorter, and only scatterers are tried that are lit in all pulses.
    """
    flight = flight_named("sal_stripmap", gust)
    sensor, times = flight.sensor, flight.dwell_start_ns(4) * 1e-9 + flight.pulse_times
    surface, antenna = some_of(flight.surface(4), 300), flight.position(times)
    if gust:
        surface = surface.where(np.abs(surface.positions[:, 0] - np.mean(antenna[:, 0])) < 0.4)
    strengths, reference = strengths_of(surface), np.full(len(times), 5000.0)
    rotation = flight._gust.rotation(times).as_matrix()
    samples = simulate_block(sensor, surface, strengths, antenna, rotation, reference)
    boresight, lit = (rotation @ np.array([0, -1, -1]) * np.sqrt(0.5))[:, 0], lit_angle(sensor.beams) * 5000
    error = power = 0.0
    for pulse in range(0, len(times), 17):
        middle = (42, 128, 213)[np.searchsorted((85, 171), pulse, side="right")]
        off = surface.positions[:, 0] - antenna[middle, 0] - 5000 * boresight[middle]
        state = replace(flight.aperture(4), position=antenna[pulse], rotation=rotation[pulse])
        _, elevation, squint = angles_of(surface.positions, state, sensor.look_side)
        weighted = sensor.beams.response(elevation, squint).T * strengths * (np.abs(off) <= lit)
        expected = direct_history(sensor, surface.positions, weighted, antenna[[pulse]], reference[[pulse]])[:, 0]
        error += np.sum(np.abs(samples[:, pulse] - expected) ** 2)
        power += np.sum(np.abs(expected) ** 2)
    assert np.sqrt(error / power) < ERROR


def test_swinging_beams_are_interpolated_between_pulses() -> None:
    """Beams that swing by a tenth of a beamwidth within the dwell; jumping ones are asked for in every pulse."""
    flight = flight_named("sal_spotlight")
    sensor, times = flight.sensor, flight.dwell_start_ns(1) * 1e-9 + flight.pulse_times
    surface, antenna = some_of(flight.surface(1), 100), flight.position(times)
    reference, strengths = np.full(len(times), 5000.0), strengths_of(surface)
    smooth = 0.1 * sensor.beamwidth * np.sin(np.arange(64) / 20)
    jumping = 0.1 * sensor.beamwidth * np.random.default_rng(63).uniform(size=64)
    for pointing in (smooth, jumping):
        samples = simulate_dwell(sensor, surface, strengths, antenna, reference, 0.0, pointing)
        error = power = 0.0
        for pulse in range(0, 64, 7):
            response = sensor.beams.response(surface.elevation, surface.squint - pointing[pulse]).T
            expected = direct_history(sensor, surface.positions, response * strengths, antenna[[pulse]], reference[[0]])
            error += np.sum(np.abs(samples[:, [pulse]] - expected) ** 2)
            power += np.sum(np.abs(expected) ** 2)
        assert np.sqrt(error / power) < ERROR


def test_mover_among_scatterers_at_rest_has_its_place_in_every_pulse() -> None:
    """At 10 m/s in range it comes half a range cell nearer, and its echo turns many times from pulse to pulse."""
    flight = flight_named("sal_spotlight")
    sensor, times = flight.sensor, flight.pulse_times - flight.pulse_times.mean()
    surface = some_of(flight.surface(1), 60)
    velocity = np.zeros_like(surface.positions)
    velocity[5] = [0, 7, -7]
    surface, strengths = replace(surface, velocity=velocity), strengths_of(surface)
    antenna = flight.position(flight.dwell_start_ns(1) * 1e-9 + flight.pulse_times)
    samples = simulate_dwell(sensor, surface, strengths, antenna, np.full(64, 5000.0), times)
    weighted = sensor.beams.response(surface.elevation, surface.squint).T * strengths
    for pulse in (0, 40, 63):
        there = surface.after(times[pulse]).positions
        expected = direct_history(sensor, there, weighted, antenna[[pulse]], np.array([5000.0]))[:, 0]
        error = np.linalg.norm(samples[:, pulse] - expected)
        assert error < 3 * ERROR * np.linalg.norm(expected)  # the first pulse of a group has more than its mean


def test_antenna_that_shakes_has_no_groups() -> None:
    flight = flight_named("small")
    surface, times = flight.surface(1), flight.dwell_start_ns(1) * 1e-9 + flight.pulse_times
    antenna = flight.position(times)
    assert len(groups_of(flight, surface, antenna)) == 1
    antenna = antenna + np.random.default_rng(64).uniform(-1e-3, 1e-3, antenna.shape)
    assert groups_of(flight, surface, antenna) == []


def test_nodes_of_beams_hold_their_error() -> None:
    """Of the wave cos(pi x), which is the edge of an aperture, that moves by some beamwidths."""
    for reach in (0.01, 0.05, 0.1, 0.2):
        angles = np.linspace(-reach, reach, 64)[:, None]
        nodes = _beam_nodes(angles)
        assert nodes is not None
        group = PulseGroup(slice(0, 64), np.zeros((64, 3)), np.zeros(3), nodes)
        for shift in np.linspace(0, 1, 9):
            wave = np.cos(np.pi * (angles[:, 0] + shift))
            assert np.abs(group.interpolation.T @ wave[nodes] - wave).max() < 2e-4
    assert _beam_nodes(np.zeros((8, 2))) is not None
    assert _beam_nodes(np.linspace(-3, 3, 64)[:, None]) is None


SENSORS = {
    "jinc": make_sensor(),
    "sinc": make_sensor(pattern="sinc"),
    "gaussian": make_sensor(pattern="gaussian"),
    "finite and turned": make_sensor(pattern="sinc", detector_size=(0.5, 0.3), detector_rotation=0.3),
    "long antenna": make_sensor(azimuth_diameter=0.03),
    "complex": sensor_with_complex_beams(),
    "measured": load_preset("xband_sumdiff").make_sensor(),
}


def directions(sensor: Sensor, reach: float, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(71)
    return rng.uniform(-reach, reach, count) * sensor.beamwidth, rng.uniform(
        -1.2, 1.2, count
    ) * sensor.azimuth_beamwidth


def error_of(beams: Beams, offset: np.ndarray, squint: np.ndarray) -> float:
    expected = beams.response(offset + beams.axis_middle, squint)
    seen = response_of(beams, offset, squint)
    assert np.iscomplexobj(seen) == np.iscomplexobj(expected)
    return float(np.abs(seen - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("name", SENSORS)
def test_table_has_the_responses_of_the_beams(name: str) -> None:
    """Also across the edges of a measured beam, where it becomes 0 at once."""
    offset, squint = directions(SENSORS[name], 9.0 if name == "measured" else 4.0)
    assert error_of(SENSORS[name].beams, offset, squint) < 8e-5


def test_value_does_not_depend_on_what_else_is_asked_for() -> None:
    beams = SENSORS["jinc"].beams
    offset, squint = directions(SENSORS["jinc"], 4.0)
    few = response_of(beams, offset[:3], squint[:3])
    np.testing.assert_array_equal(few, response_of(beams, offset, squint)[:3])


def test_tables_are_bounded_and_alike_dwells_share_one() -> None:
    _table.cache_clear()
    beams = SENSORS["sinc"].beams
    for number in range(20):
        response_of(beams, np.array([0.05 * number]) * BEAMWIDTH, np.zeros(1))
    assert _table.cache_info().currsize == 1
    for number in range(10):
        response_of(make_sensor(pattern="sinc").beams, np.zeros(number + 1), np.zeros(number + 1))
    assert _table.cache_info().currsize == 8


def test_what_lies_far_off_needs_no_large_table() -> None:
    beams = SENSORS["jinc"].beams
    offset, squint = (
        np.array([0.1, -300.0, 0.2, 90.0, 25.45]) * BEAMWIDTH,
        np.array([0.1, 0.2, 800, -0.1, 0]) * BEAMWIDTH,
    )
    assert error_of(beams, offset, squint) < 8e-5
    table = _table(beams, BEAMWIDTH / NODES_PER_BEAMWIDTH, 512, 512)[0][0]
    assert _table.cache_info().hits > 0
    np.testing.assert_allclose(
        response_of(beams, offset, squint)[[1, 3]],
        beams.response(offset + beams.axis_middle, squint)[[1, 3]],
        rtol=1e-6,
    )
    assert table.nbytes < 20e6


def test_beams_of_every_pattern_are_smooth_between_nodes() -> None:
    for name, pitch in (("jinc", 0.5), ("sinc", 0.5)):
        beams = beams_named(name)
        _, rough = _table(beams, beams.beamwidth / NODES_PER_BEAMWIDTH, 64, 32)
        assert not rough.any(), (name, pitch)
