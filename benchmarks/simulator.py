"""Simulated dwells: time over that of the FFTs and the noise they contain, and over one non-uniform FFT per pulse.

All of it is processor time, as the simulator shares the processors with the graph that it feeds.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import cycle

import finufft
import numpy as np
import scipy.fft

from benchmarks.row import REPEATS, Row, sized
from sal_height.sensor import echo_sensor
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.simulation.preset import TargetSettings
from sal_height.simulation.receiver_noise import receiver_noise

TARGETS = {"sal_spotlight": 8, "sal_stripmap": 60, "xband_relief": 14, "xband_sumdiff": 45, "small": 35, "woods": 500}
"""Greatest times over FFTs and noise: a twentieth of a non-uniform FFT per pulse, but for the radar in woods."""

PRESETS = sized(tuple(TARGETS), ("small",))


def over_transforms() -> Iterator[Row]:
    """Each preset as it is; then what makes groups of pulses shorter, and a scatterer that moves."""
    for name in PRESETS:
        yield _row(name, flight_of(load_preset(name), 1), TARGETS[name])
    windy = load_preset(PRESETS[0])
    yield _row(
        f"{windy.name} in gusts of 1 m/s",
        flight_of(replace(windy, flight=replace(windy.flight, gust_mps=1.0)), 1),
        1.5 * TARGETS[windy.name],
    )
    mover = TargetSettings(east_m=0.0, north_m=0.5, height_m=0.0, power_db=20.0, radial_velocity_mps=0.01)
    yield _row(
        f"{windy.name} with a mover",
        flight_of(replace(windy, targets=(*windy.targets, mover)), 1),
        1.5 * TARGETS[windy.name],
    )
    yield _row_over_pulses()


def _row(name: str, flight: SimulatedFlight, target: float) -> Row:
    """A dwell over the FFTs of its profiles, twice as dense as its samples, and its noise."""
    dwells = cycle(range(1, flight.dwells - 1))
    shape = flight.sensor.detector_count, flight.sensor.pulse_count, 2 * flight.sensor.sample_count
    profiles, rng = np.ones(shape, dtype=np.complex64), np.random.default_rng(1)

    def least() -> None:
        scipy.fft.fft(profiles, axis=-1)
        receiver_noise(flight.sensor, flight.sensor.pulse_count, rng)

    seconds, reference = _processor_times(lambda: flight.phase_history(next(dwells)), least)
    count = len(flight.surface(1).power)
    return Row(
        f"simulator, a dwell of {name}",
        seconds / reference,
        "1",
        f"<= {target:g}",
        f"{1e3 * seconds:.1f} ms for {count} scatterers; FFTs of all pulses and noise {1e3 * reference:.1f} ms",
    )


def _row_over_pulses() -> Row:
    """A dwell against the sum of its echoes by one non-uniform FFT of all detectors per pulse, scaled from a pulse."""
    name = sized("sal_spotlight", "small")
    flight = flight_of(load_preset(name), 1)
    sensor, surface, antenna = echo_sensor(flight.built), flight.surface(1), flight.aperture(1).position
    weighted = np.ascontiguousarray(sensor.beams.response(surface.elevation, surface.squint).T, dtype=np.complex128)

    def pulse() -> None:
        delay = np.linalg.norm(surface.positions - antenna, axis=-1) - flight.preset.flight.slant_range_m
        strengths = weighted * np.exp(-1j * sensor.centre_wavenumber * delay)
        phase = sensor.wavenumber_step * delay
        finufft.nufft1d1(phase, strengths, sensor.sample_count, isign=-1, eps=1e-5, nthreads=1)

    seconds, one = _processor_times(lambda: flight.phase_history(1), pulse)
    return Row(
        f"simulator, {name} against a non-uniform FFT per pulse",
        sensor.pulse_count * one / seconds,
        "1",
        ">= 20",
        f"{1e3 * seconds:.1f} ms, and {1e3 * one:.1f} ms for each of {sensor.pulse_count} pulses",
    )


def _processor_times(*functions: Callable[[], object]) -> list[float]:
    """Median processor times (s) of all threads, measured in turn."""
    for function in functions:
        function()
    times = [[_processor_time(function) for function in functions] for _ in range(REPEATS)]
    return [statistics.median(column) for column in zip(*times, strict=True)]


def _processor_time(function: Callable[[], object]) -> float:
    start = time.process_time()
    function()
    return time.process_time() - start
