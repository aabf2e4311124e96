"""The array estimator: its Monte Carlo against the random numbers that it takes, and images against the paper's way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy.fft
from rclpy.parameter import Parameter

from benchmarks.cases import SLANT_RANGE, spotlight
from benchmarks.row import Row, medians, sized
from benchmarks.stage_jobs import job_of
from sal_height import messages
from sal_height.beams import Beams, pattern_named
from sal_height.elevation import (
    ESTIMATORS,
    OBJECTIVES,
    ElevationEstimate,
    Looks,
    MlSettings,
    PeakSearches,
    Window,
    ml_elevation,
    search_guard,
    windowed_looks,
)
from sal_height.geometry import ApertureState, Grid
from sal_height.imaging import Slc
from sal_height.messages import serialize
from sal_height.messages.types import ChannelFrame, Header, Provenance
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.numeric import C64, F64, in_parallel
from sal_height.pipeline import heights
from sal_height.sensor import Channels, Sensor
from sal_height.theory.array_trials import SAMPLES_AT_ONCE, TargetPixels, with_streams

DETECTORS, PITCH, BEAMWIDTH, LOOKS = 16, 0.5, 1.55e-4, 4
TRIALS = sized(100_000, 1000)
ROWS, COLS = sized((400, 250), (20, 20))
CNR = 10.0

UPSAMPLING = 16
"""Of the paper's way: steps of 1/32 beamwidth."""

PIXELS_AT_ONCE = 256
"""Whose convolutions NumPy holds at a time."""


def node_over_core() -> Iterator[Row]:
    """A dwell through node ml_height, from images to published heights, against the core's own time."""
    samples = _slc("jinc")
    grid, aperture, sensor = _scene()
    slc = Slc(samples, grid, aperture, np.ones(DETECTORS), np.zeros(DETECTORS))
    frame = ChannelFrame(header=Header(stamp=messages.to_stamp(0)), dwell=0)
    sent = messages.slc_to_messages(slc, frame, Provenance(config_hash=sensor.config_hash))
    described = serialize(messages.sensor_to_message(sensor, messages.to_stamp(0)))
    settings = ESTIMATORS["ml"].settings(range_looks=1, azimuth_looks=LOOKS)
    with Graph() as graph:
        looks = [Parameter("range_looks", value=1), Parameter("azimuth_looks", value=LOOKS)]
        node = graph.add(PROCESSING["ml_height"](context=graph.context, parameter_overrides=looks))

        def core() -> None:
            heights(slc, sensor, ESTIMATORS["ml"], settings)

        job = job_of(node, [("sensor_info", described), *(("slc", serialize(image)) for image in sent)])
        through, alone = medians(lambda: node._process_job(job), core)
    yield Row(
        "node ml_height over the core",
        through / alone,
        "1",
        "<= 1.2",
        f"{ROWS} × {COLS * LOOKS} images of {DETECTORS} detectors, every column its squint: {1e3 * through:.0f} ms "
        f"with messages, image and points over {1e3 * alone:.0f} ms of estimate, layover and heights",
    )


def _scene() -> tuple[Grid, ApertureState, Sensor]:
    """Pixels, platform and sensor of a spotlight image of ROWS x COLS * LOOKS pixels, half a beamwidth wide."""
    case = spotlight(DETECTORS, 64, ROWS, 2, COLS * LOOKS)
    steps = np.arange(DETECTORS) - (DETECTORS - 1) / 2
    sensor = replace(
        case.sensor,
        elevation_diameter=case.sensor.wavelength / BEAMWIDTH,
        azimuth_diameter=case.sensor.wavelength / BEAMWIDTH,
        elevation_boresights=tuple(elevation_at(0) + PITCH * BEAMWIDTH * steps),
        config_hash="",
    )
    spacing, middle = BEAMWIDTH / 2 * SLANT_RANGE / (COLS * LOOKS), case.grid.points(0.5, (COLS * LOOKS - 1) / 2)
    row_spacing = 1e-3  # the target fills the image at one elevation
    origin = middle - (COLS * LOOKS - 1) / 2 * spacing * case.grid.col_direction
    grid = replace(case.grid, origin=origin, row_spacing=row_spacing, col_spacing=spacing, rows=ROWS)
    aperture = ApertureState(case.antenna.mean(axis=0), np.array([50.0, 0.0, 0.0]), np.eye(3), 1.0, np.zeros((6, 6)))
    return grid, aperture, sensor


def against_random_numbers() -> Iterator[Row]:
    """Draw targets and noise, sum up covariances, find the peaks; over drawing the same numbers on as many threads."""
    pixels, normalised = TargetPixels(beams_of("sinc"), elevation_at(1.75), CNR, LOOKS), OBJECTIVES["normalised"]

    def draw(rng: np.random.Generator, part: slice) -> None:
        count = part.stop - part.start
        rng.standard_normal((count, LOOKS, 2 * DETECTORS), dtype=np.float32)
        rng.standard_normal((count, 2 * LOOKS), dtype=np.float32)

    at_once = SAMPLES_AT_ONCE // (LOOKS * DETECTORS)
    whole, bare = medians(
        lambda: pixels.peak_elevations(1, TRIALS, normalised, 0.0),
        lambda: with_streams(draw, 1, TRIALS, at_once),
    )
    yield Row(
        f"array Monte Carlo, {DETECTORS} detectors, {LOOKS} looks, over its random numbers",
        whole / bare,
        "1",
        "<= 2.5",
        f"{1e6 * whole / TRIALS:.2f} µs a trial over {1e6 * bare / TRIALS:.2f} µs for its normal float32 numbers",
    )


def throughput() -> Iterator[Row]:
    """Images of single looks to elevations, against the paper's way in NumPy on as many threads."""
    for name in ("sinc", "jinc"):
        yield from _throughput(name)


def _throughput(name: str) -> Iterator[Row]:
    beams, settings, slc = beams_of(name), MlSettings(layover=False), _slc(name)
    one, many = np.zeros(COLS), np.linspace(-0.5, 0.5, COLS) * BEAMWIDTH

    def estimate(squint: F64) -> ElevationEstimate:
        return ml_elevation(azimuth_looks(slc, LOOKS, squint), beams, settings)

    there, limit = np.zeros_like(slc), grid_product(beams)
    single, several, paper, copy, product = medians(
        lambda: estimate(one),
        lambda: estimate(many),
        lambda: by_convolution(slc, LOOKS, beams),
        lambda: np.copyto(there, slc),
        limit,
    )
    mega = ROWS * COLS / 1e6
    size = f"{ROWS} × {COLS} pixels of {LOOKS} looks, {DETECTORS} detectors"
    yield Row(
        f"array estimate with sigma and validity, {name}, times the paper's",
        paper / single,
        "1",
        ">= 6",
        f"{size}: {1e3 * single:.0f} ms, {mega / single:.2f} Mpixel/s; the convolution upsampled to steps of "
        f"1/{UPSAMPLING} pitch, and nothing else, {1e3 * paper:.0f} ms",
    )
    yield Row(
        f"array estimate with sigma and validity, {name}, over a copy",
        single / copy,
        "1",
        "<= 10",
        f"one plain copy of the images to memory at hand: {1e3 * copy:.1f} ms; the limit: the bare product of their "
        f"covariances and the grid takes BLAS {1e3 * product:.0f} ms, {product / copy:.1f} copies",
    )
    yield Row(
        f"array estimate, {name}, every column its squint",
        mega / several,
        "Mpixel/s",
        ">= 0.1",
        f"{1e3 * several:.0f} ms",
    )


def _slc(name: str) -> C64:
    """Images of single looks at a fluctuating target in unit noise, (detectors, ROWS, COLS * LOOKS)."""
    pixels = TargetPixels(beams_of(name), elevation_at(1.75), CNR, LOOKS)
    samples = pixels.draw(np.random.default_rng(2), ROWS * COLS)
    return np.ascontiguousarray(samples.reshape(ROWS, COLS * LOOKS, DETECTORS).transpose(2, 0, 1))


def by_convolution(slc: C64, looks: int, beams: Beams) -> F64:
    """Elevation (rad) as the paper has it: profiles convolved with the beam, upsampled, powers averaged, the highest.

    By FFT over detectors, zero-padded against wrapping, and zero-padded again in frequency.

    Args:
        slc: shape (detectors, rows, cols).
        looks: columns to average.
        beams: beams of equally spaced detectors.
    """
    count, rows, cols = slc.shape
    length = scipy.fft.next_fast_len(2 * count, real=False)
    pitch = (beams.boresights[-1] - beams.boresights[0]) / (count - 1)
    steps = (np.arange(length) + length // 2) % length - length // 2
    kernel = scipy.fft.fft(beams.response(beams.boresights[0] - steps * pitch, 0.0)[:, 0]).real.astype(np.float32)
    profiles = slc.reshape(count, rows, cols // looks, looks).transpose(1, 2, 3, 0).reshape(-1, looks, count)
    place = np.arange(-UPSAMPLING // 2, (count - 1) * UPSAMPLING + UPSAMPLING // 2 + 1)
    best = np.empty(len(profiles), dtype=np.intp)

    def work(part: slice) -> None:
        for first in range(part.start, part.stop, PIXELS_AT_ONCE):
            block = slice(first, min(first + PIXELS_AT_ONCE, part.stop))
            spectrum = scipy.fft.fft(profiles[block], n=length, axis=-1) * kernel
            padded = np.zeros((*spectrum.shape[:2], UPSAMPLING * length), dtype=np.complex64)
            padded[..., : length // 2], padded[..., -length // 2 :] = (
                spectrum[..., : length // 2],
                spectrum[..., length // 2 :],
            )
            fine = scipy.fft.ifft(padded, axis=-1, overwrite_x=True)[..., place]
            best[block] = np.argmax(np.sum(fine.real**2 + fine.imag**2, axis=1), axis=-1)

    in_parallel(work, len(profiles))
    elevation: F64 = beams.boresights[0] + place[best] * (pitch / UPSAMPLING)
    return elevation.reshape(rows, -1)


def grid_product(beams: Beams) -> Callable[[], object]:
    """The product of all pixels' covariances and of the grid that is searched, as one of BLAS on all processors.

    No estimate that tries every node of the grid does without it: 136 entries by 72 nodes for 16 detectors, 9800
    multiplications a pixel. BLAS makes them at the peak of the processor (46 a nanosecond on an AMD EPYC Zen 4, 0.21 us
    a pixel); the compiled loop of the search reaches half of that, and costs nothing beside other threads. Sums of the
    covariances (0.5 us a pixel), the climb and the fit (0.3 us) come on top.
    """
    tables = PeakSearches.over(beams, OBJECTIVES["normalised"], search_guard(beams)).at(0.0).tables
    grid = np.ascontiguousarray(tables.grid[0])
    entries = np.ones((ROWS * COLS, len(grid)), np.float32)
    objective = np.zeros((len(entries), grid.shape[1]), np.float32)
    return lambda: np.matmul(entries, grid, out=objective)


def azimuth_looks(slc: C64, count: int, squint: npt.ArrayLike = 0.0, hermitian: bool = False) -> Looks:
    """Looks of pixels of `count` samples in azimuth, in unit noise."""
    windows, alike = (Window.named("boxcar", 1), Window.named("boxcar", count)), np.eye(len(slc), dtype=np.complex128)
    channels = Channels(alike, alike, np.ones(len(slc)))
    return windowed_looks(slc, windows, np.full(slc.shape[2] // count, squint), channels, hermitian)


def beams_of(name: str) -> Beams:
    """16 beams of that pattern, half a beamwidth apart."""
    steps = np.arange(DETECTORS, dtype=np.float64) - (DETECTORS - 1) / 2
    boresights = elevation_at(0) + PITCH * BEAMWIDTH * steps
    return Beams((pattern_named(name),), boresights, BEAMWIDTH)


def elevation_at(offset: float) -> float:
    """Elevation (rad) that many beamwidths above the middle of the array."""
    return float(np.pi / 4 + offset * BEAMWIDTH)
