"""What several tests of the core share: beams, targets, apertures, and a phase history summed up the slow way."""

from __future__ import annotations

import resource
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from _pytest.mark import ParameterSet
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from sal_height.beams.array import Beams
from sal_height.beams.pattern import PATTERNS, Pattern, pattern_named
from sal_height.elevation.looks.look_windows import Window
from sal_height.elevation.looks.looks import Looks, windowed_looks
from sal_height.geometry.frames import ApertureState, Mounting
from sal_height.sensor.channels import Channels, whitened_channels
from sal_height.sensor.sensor import Sensor
from sal_height.sensor.uncertainty import EXACT
from sal_height.simulation.preset import Preset
from sal_height.simulation.scene import Scene, VisibleSurface

Array = npt.NDArray[np.float64]

AS_VERSION_2: dict[str, dict[str, Any]] = {
    "sar_compression": {"azimuth_window": "taylor"},
    "ml_height": {"min_cnr_db": -60.0},
    "monopulse": {"min_cnr_db": -60.0},
}
"""Parameters of bags/version_2 whose defaults were others when the older bags of the same flight were recorded."""

BEAMWIDTH = 1.55e-4
"""Beamwidth of the SAL presets, rad: estimators are tested with it, so that a mixed-up unit shows."""


def make_beams(pattern: str = "sinc", count: int = 16, pitch: float = 0.5) -> Beams:
    """Detectors `pitch` beamwidths apart around an elevation of 45 degrees."""
    steps = (np.arange(count) - (count - 1) / 2) * pitch
    return Beams((pattern_named(pattern),), np.pi / 4 + steps * BEAMWIDTH, BEAMWIDTH)


def phased(pattern: Pattern, gain: complex = 1.0, tilt: float = 0.0, bend: float = 0.0) -> Pattern:
    """A complex pattern: another one times gain exp(j (tilt e + bend e^2))."""

    def phasor(e: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        return np.asarray(gain * np.exp(1j * (tilt * np.asarray(e) + bend * np.asarray(e) ** 2)))

    def slope(e: npt.ArrayLike, a: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        turning = 1j * (tilt + 2 * bend * np.asarray(e))
        return np.asarray((pattern.slope(e, a) + turning * pattern.amplitude(e, a)) * phasor(e))

    return replace(
        pattern,
        name="phased",
        amplitude=lambda e, a: pattern.amplitude(e, a) * phasor(e),
        slope=slope,
        azimuth_slope=lambda e, a: pattern.azimuth_slope(e, a) * phasor(e),
    )


def beams_named(name: str) -> Beams:
    if name != "complex":
        return make_beams(name)
    patterns = tuple(phased(PATTERNS["jinc"], bend=0.3) if i % 3 else PATTERNS["jinc"] for i in range(16))
    return replace(make_beams(), patterns=patterns)


def elevation_at(offset: npt.ArrayLike) -> Array:
    """Elevation (rad) that many beamwidths above the middle of `make_beams`."""
    return np.pi / 4 + np.asarray(offset) * BEAMWIDTH


def offset_of(elevation: npt.ArrayLike) -> Array:
    """Beamwidths above the middle of `make_beams`."""
    return (np.asarray(elevation) - np.pi / 4) / BEAMWIDTH


def whitening(noise_covariance: Array, channel_matrix: Array) -> tuple[float, Array]:
    """Noise power and transform of `whitened_channels`."""
    channels = whitened_channels(noise_covariance, channel_matrix)
    return float(channels.noise_powers[0]), channels.transform


AT_BASE_LINK_EXACTLY = Mounting(lever_arm_covariance=(0.0,) * 9, rotation_covariance=(0.0,) * 9)


def make_sensor(**changes: object) -> Sensor:
    """A lidar of three detectors looking right at 45 degrees, as it is described."""
    values = {
        "name": "test",
        "look_side": 1,
        "wavelength": 1.55e-6,
        "bandwidth": 2e9,
        "sample_count": 64,
        "pulse_count": 48,
        "pulse_repetition_frequency": 30e3,
        "elevation_diameter": 0.01,
        "azimuth_diameter": 0.01,
        "pattern": "jinc",
        "elevation_boresights": tuple(np.pi / 4 + np.array([-0.5, 0.0, 0.5]) * BEAMWIDTH),
        "noise_power": (1.0, 1.0, 1.0),
        "mounting": AT_BASE_LINK_EXACTLY,
        "uncertainty": EXACT,
    }
    if "aperture" in changes:  # of an antenna that is as long as it is high
        changes["elevation_diameter"] = changes["azimuth_diameter"] = changes.pop("aperture")
    return Sensor(**{**values, **changes})


def sensor_with_complex_beams(**changes: object) -> Sensor:
    """`make_sensor` with jinc beams whose phase grows along and beside the detector axis."""
    sensor = make_sensor(**changes)
    jinc = pattern_named("jinc")

    def amplitude(e: npt.ArrayLike, a: npt.ArrayLike) -> npt.NDArray[np.complexfloating]:
        return np.asarray(jinc.amplitude(e, a) * np.exp(1j * (0.7 * np.asarray(e) + 0.4 * np.asarray(a))))

    beams = replace(sensor.beams, patterns=(replace(jinc, amplitude=amplitude),))
    sensor.__dict__["beams"] = beams
    return sensor


RAW_SETTINGS: dict[str, dict[str, float]] = {
    "spectrum": {},
    "chirp": {"pulse_duration_s": 100e-9, "sampling_rate_hz": 2.5e9, "sample_count": 329},
    "deramped": {"pulse_duration_s": 1e-6, "sampling_rate_hz": 64e6, "sample_count": 68},
}
"""Settings with which the small preset flies with another waveform and keeps its 64 resolution cells."""

RAW_WAVEFORMS = ("chirp", "deramped")


def with_waveform(preset: Preset, waveform: str) -> Preset:
    """The small preset with another waveform."""
    return replace(preset, sensor=replace(preset.sensor, waveform=waveform, **RAW_SETTINGS[waveform]))


def make_aperture(
    height: float = 5000 * np.cos(np.pi / 4),
    angles: Sequence[float] = (0.0, 0.0, 0.0),
    velocity: Sequence[float] = (50.0, 0.0, 0.0),
    length: float = 0.08,
) -> ApertureState:
    """A platform above the map origin, turned by roll, pitch and yaw (rad)."""
    return ApertureState(
        position=np.array([0.0, 0.0, height]),
        velocity=np.array(velocity),
        rotation=Rotation.from_euler("ZYX", angles[::-1]).as_matrix(),
        length=length,
        covariance=np.zeros((6, 6)),
    )


def flat_scene(height: float = 0.0, north: float = 0.0, half: float = 40.0) -> Scene:
    """Level ground of brightness 1 around (0, `north`)."""
    nodes = np.linspace(-half, half, 161)
    level = np.full((len(nodes), len(nodes)), height)
    return Scene("flat", nodes, north + nodes, level, np.ones_like(level))


def bare_scatterers(positions: Array, power: Array, deterministic: bool) -> VisibleSurface:
    """Scatterers of which only positions and powers matter; how they are seen is NaN."""
    unused = np.full(len(positions), np.nan)
    sure, still = np.full(len(positions), deterministic), np.zeros_like(positions)
    return VisibleSurface(positions, unused, power, unused, unused, unused, sure, still)


def target_slc(
    beams: Beams,
    offset: npt.ArrayLike,
    pixels: int,
    looks: int,
    cnr: float,
    rng: np.random.Generator,
    squint: float = 0,
) -> npt.NDArray[np.complex128]:
    """Images (channels, pixels, looks) of a fluctuating target in unit noise.

    Args:
        beams: of the channels.
        offset: of the target, beamwidths; broadcasts with (pixels, looks).
        pixels: rows of the image, independent trials.
        looks: columns of the image.
        cnr: mean power ratio in a detector that looks straight at it.
        rng: of amplitudes and noise.
        squint: of the target, rad.
    """
    response = beams.response(elevation_at(np.broadcast_to(offset, (pixels, looks))), squint)
    amplitude = np.sqrt(cnr) * circular(rng, (pixels, looks))
    return np.moveaxis(response * amplitude[..., None], -1, 0) + circular(rng, (len(beams.boresights), pixels, looks))


def blocks(range_looks: int, azimuth_looks: int) -> tuple[Window, Window]:
    """Windows in range and azimuth of pixels of `range_looks` x `azimuth_looks` samples without overlap."""
    return Window.named("boxcar", range_looks), Window.named("boxcar", azimuth_looks)


def multilook(
    slc: npt.NDArray[Any],
    range_looks: int,
    azimuth_looks: int,
    hermitian: bool = False,
    transform: npt.NDArray[Any] | None = None,
    squint: npt.ArrayLike = 0.0,
    noise_power: npt.ArrayLike = 1.0,
) -> Looks:
    """`windowed_looks` over `blocks`; the squint (rad) of the columns and the noise power of the channels broadcast."""
    return looks_in(slc, blocks(range_looks, azimuth_looks), hermitian, transform, squint, noise_power)


def looks_in(
    slc: npt.NDArray[Any],
    windows: tuple[Window, Window],
    hermitian: bool = False,
    transform: npt.NDArray[Any] | None = None,
    squint: npt.ArrayLike = 0.0,
    noise_power: npt.ArrayLike = 1.0,
) -> Looks:
    """`windowed_looks` over any windows, otherwise as `multilook`."""
    same = np.eye(len(slc))
    channels = Channels(same if transform is None else transform, same, np.full(len(slc), noise_power))
    return windowed_looks(slc, windows, np.full(windows[1].pixels(slc.shape[2]), squint), channels, hermitian)


def circular(rng: np.random.Generator, shape: tuple[int, ...]) -> npt.NDArray[np.complex128]:
    """Circular complex Gaussian numbers of mean power 1."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def standard_error_of_rms(error: Array) -> float:
    """Of the root mean square of `error`, from the spread of its squares."""
    return float(np.std(error**2) / np.sqrt(len(error)) / (2 * np.sqrt(np.mean(error**2))))


def noise_free_looks(beams: Beams, offset: Array, squint: float = 0.0, count: int = 1, energy: float = 1e6) -> Looks:
    """Exact covariance of a target at each of `offset` (beamwidths, shape (pixels,)), one column."""
    response = beams.response(elevation_at(offset), squint)
    return Looks.of(energy * (response[:, None, :, None] * response[:, None, None, :]), count, squint)


def sample_frequencies(sensor: Sensor) -> Array:
    """Frequencies of the fast-time samples, Hz: the carrier is their mean."""
    steps = np.arange(sensor.sample_count) - (sensor.sample_count - 1) / 2
    return speed_of_light / sensor.wavelength + steps * sensor.bandwidth / sensor.sample_count


def direct_history(
    sensor: Sensor, positions: Array, amplitudes: npt.ArrayLike, antenna: Array, reference: Array
) -> npt.NDArray[np.complex128]:
    """Sum over scatterers of A exp(-j 4 pi f (R - reference) / c): (..., pulses, frequencies).

    `amplitudes` has the shape (..., scatterers).
    """
    delay = np.linalg.norm(positions - antenna[:, None, :], axis=-1) - reference[:, None]
    phase = 4 * np.pi / speed_of_light * sample_frequencies(sensor) * delay[..., None]
    return np.einsum("...s,psf->...pf", np.asarray(amplitudes), np.exp(-1j * phase))


def assert_one_sentence(text: str, *parts: str) -> None:
    """Assert that a message for the user is one line that begins and ends as a sentence and holds all `parts`."""
    assert "\n" not in text
    assert text[0].isupper()
    assert text.endswith(".")
    for part in parts:
        assert part in text


def refused(kind: type[Exception], *parts: str, reason: str = "") -> pytest.RaisesExc[Exception]:
    """Expect an error of a class whose message is one sentence with all `parts`, and of a `Rejected` its reason."""

    def fits(error: Exception) -> bool:
        assert_one_sentence(str(error), *parts)
        return not reason or getattr(error, "reason", "") == reason

    return pytest.RaisesExc(kind, check=fits)


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """No file may grow beyond `size` bytes: write() fails as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


class PlainPublisher:
    """A publisher of rclpy that takes plain messages, or bytes; all else is as rclpy has it."""

    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    def publish(self, message: Any) -> None:
        from sal_height.messages import serialize

        self._publisher.publish(message if isinstance(message, bytes) else serialize(message))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._publisher, name)


def publisher_of(node: Any, kind: type[Any], topic: str, qos: Any) -> PlainPublisher:
    """A publisher of plain messages of that class."""
    from sal_height.nodes.transport.message_types import class_of

    return PlainPublisher(node.create_publisher(class_of(kind), topic, qos))


def few(count: int, cases: Iterable[Any]) -> list[Any]:
    """The cases of a parametrised test, of which `make test` runs the first `count` and `make thorough` all.

    Tuples hold one value for each parameter.
    """
    cases = list(cases)
    assert count < len(cases), "make test runs all"
    return [*cases[:count], *map(_thorough, cases[count:])]


def _thorough(case: Any) -> ParameterSet:
    if isinstance(case, ParameterSet):
        return case._replace(marks=[*case.marks, pytest.mark.thorough])
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.thorough)
