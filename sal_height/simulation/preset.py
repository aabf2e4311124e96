"""Presets: a sensor, its flight, a scene and how to process it, read from validated YAML."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import AfterValidator, TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError
from scipy.spatial.transform import Rotation

from sal_height.beams import PATTERNS, BeamTable, read_beam_tables
from sal_height.errors import UserError
from sal_height.geometry import Mounting
from sal_height.numeric import C128
from sal_height.sensor import MAX_DETECTORS, Sensor, lit_angle
from sal_height.simulation.impairments import MOST_SWING_BEAMWIDTHS, UNIMPAIRED, Impairments
from sal_height.simulation.settings import STRICT_KEYS, Decibels, Float, Int

Length = Annotated[Float, Ge(-1000), Le(1000)]
Turn = Annotated[Float, Ge(-np.pi), Le(np.pi)]

BEAM_TABLES = ".csv"
"""Suffix of the file of measured beams that a preset may name as its pattern."""


def _pattern_or_file(value: str) -> str:
    if value not in PATTERNS and not value.endswith(BEAM_TABLES):
        first, *others, last = (repr(name) for name in PATTERNS)
        allowed = f"{', '.join([first, *others])} or {last}"
        raise PydanticCustomError("pattern", f"input should be {allowed}, or the path of a {BEAM_TABLES} file of beams")
    return value


@dataclass(frozen=True)
class HybridSettings:
    """A hybrid of two beams, with the channels Sigma = c (upper + lower) and Delta = c (upper - lower).

    Beams are those of the detectors, the lower one first. `coupling` is c: 1 / sqrt(2) without loss; 1 as if the whole
    signals of both beams could be added. The loss comes on top. In the antenna the hybrid is before the receivers, and
    what it loses is lost to their noise; behind the receivers noise goes through it with the signal.

    `delta_gain_db` and `delta_phase_rad` are of the Delta channel's receiver against Sigma's; its noise goes along.
    """

    __pydantic_config__ = STRICT_KEYS

    place: Literal["antenna", "receiver"]
    coupling: Annotated[Float, Gt(0), Le(1)] = 1 / np.sqrt(2)
    loss_db: Annotated[Float, Ge(0), Le(60)] = 0.0
    delta_gain_db: Decibels = 0.0
    delta_phase_rad: Annotated[Float, Ge(-np.pi), Le(np.pi)] = 0.0

    @property
    def delta_gain(self) -> complex:
        """Complex gain of the Delta channel's receiver against that of Sigma."""
        return complex(10 ** (self.delta_gain_db / 20) * np.exp(1j * self.delta_phase_rad))

    def matrix(self) -> C128:
        """Rows Sigma and Delta, columns lower and upper beam."""
        amplitude = self.coupling * 10 ** (-self.loss_db / 20)
        return np.array([[1, 1], [-self.delta_gain, self.delta_gain]], dtype=np.complex128) * amplitude


@dataclass(frozen=True)
class MountingSettings:
    """Where the antenna is on the platform and how it is turned, in the axes of base_link (x forward, y left, z up).

    `boresight_rad` are roll, pitch and yaw of the sensor's axes against those of base_link, turned in the order yaw,
    pitch, roll.
    """

    __pydantic_config__ = STRICT_KEYS

    frame_id: Annotated[str, MinLen(1)] = "sensor"
    lever_arm_m: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    boresight_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)

    @property
    def mounting(self) -> Mounting:
        """The mounting as a value of the core."""
        turn = Rotation.from_euler("ZYX", self.boresight_rad[::-1])
        x, y, z, w = turn.as_quat().tolist()
        return Mounting(self.frame_id, self.lever_arm_m, (x, y, z, w))


@dataclass(frozen=True)
class SensorSettings:
    """The sensor as people describe it: an evenly spaced detector array around the look angle.

    `aperture_m` is the diameter of the antenna along the detector axis, and beside it too unless `azimuth_aperture_m`
    is given; one beamwidth is the wavelength over the diameter, in each direction its own.

    `pattern` is the name of an aperture, or the path of a .csv of measured beams: from the preset's folder or, if it is
    not there, from the working directory. `detector_size_beamwidths` are widths along the detector axis and beside it.

    `detector_gains_db` and `detector_phases_rad` are of the detectors' receivers, one each, and described to whoever
    processes their channels; noise goes along, unless a hybrid in the antenna follows them. None: 0.

    `full_scale_over_noise_db` is where receivers clip real and imaginary part, over the rms of the noise in one of
    them. None: never.

    With waveform chirp or deramped, `sample_count` is that of the record: it holds the pulse and the range window.
    """

    __pydantic_config__ = STRICT_KEYS

    look_side: Literal["left", "right"]
    wavelength_m: Annotated[Float, Ge(1e-9), Le(100)]
    aperture_m: Annotated[Float, Ge(1e-6), Le(1e4)]
    pattern: Annotated[str, AfterValidator(_pattern_or_file)]
    detectors: Annotated[Int, Ge(2), Le(MAX_DETECTORS)]
    pitch_beamwidths: Annotated[Float, Ge(1e-3), Le(1e3)]
    bandwidth_hz: Annotated[Float, Ge(1), Le(1e15)]
    sample_count: Annotated[Int, Ge(2), Le(65536)]
    pulse_count: Annotated[Int, Ge(2), Le(65536)]
    pulse_repetition_frequency_hz: Annotated[Float, Ge(1e-3), Le(1e9)]
    waveform: Literal["spectrum", "chirp", "deramped"] = "spectrum"
    pulse_duration_s: Annotated[Float, Ge(0), Le(1e3)] = 0.0
    sampling_rate_hz: Annotated[Float, Ge(0), Le(1e15)] = 0.0
    mode: Literal["spotlight", "stripmap"] = "spotlight"
    detector_size_beamwidths: tuple[Annotated[Float, Ge(0), Le(100)], Annotated[Float, Ge(0), Le(100)]] = (0.0, 0.0)
    detector_rotation_rad: Annotated[Float, Ge(-np.pi / 2), Le(np.pi / 2)] = 0.0
    hybrid: HybridSettings | None = None
    detector_gains_db: tuple[Decibels, ...] = ()
    detector_phases_rad: tuple[Annotated[Float, Ge(-np.pi), Le(np.pi)], ...] = ()
    full_scale_over_noise_db: Annotated[Float, Ge(-60), Le(300)] | None = None
    azimuth_aperture_m: Annotated[Float, Ge(1e-6), Le(1e4)] | None = None
    mounting: MountingSettings = MountingSettings()

    @property
    def azimuth_diameter_m(self) -> float:
        """Diameter of the antenna beside the detector axis, m."""
        return self.aperture_m if self.azimuth_aperture_m is None else self.azimuth_aperture_m

    @property
    def beamwidth_rad(self) -> float:
        """Beamwidth along the detector axis."""
        return self.wavelength_m / self.aperture_m

    @property
    def track_beamwidth_rad(self) -> float:
        """Beamwidth along the flight (`Beams.track_beamwidth`)."""
        along, beside = self.beamwidth_rad, self.wavelength_m / self.azimuth_diameter_m
        return math.sqrt(
            beside * beside + (along * along - beside * beside) * math.sin(self.detector_rotation_rad) ** 2
        )

    @property
    def is_bare(self) -> bool:
        """Whether the channels are the detectors as they are."""
        return not (self.hybrid or self.detector_gains_db or self.detector_phases_rad)

    @property
    def in_antenna(self) -> bool:
        """Whether the channels are formed before the receivers."""
        return self.is_bare or (self.hybrid is not None and self.hybrid.place == "antenna")

    def channel_matrix(self) -> tuple[tuple[complex, ...], ...]:
        """`Sensor.channel_matrix`: the detectors' gains, and the hybrid behind them; empty: none of them."""
        if self.is_bare:
            return ()
        gains_db = np.array(self.detector_gains_db or (0.0,) * self.detectors)
        phases = np.array(self.detector_phases_rad or (0.0,) * self.detectors)
        gains = np.diag(10 ** (gains_db / 20) * np.exp(1j * phases))
        matrix = self.hybrid.matrix() @ gains if self.hybrid else gains
        return tuple(tuple(row) for row in matrix.tolist())

    def full_scale(self) -> float:
        """`Sensor.full_scale`: noise of power 1 has the rms 1 / sqrt(2) in each part."""
        level = self.full_scale_over_noise_db
        return 0.0 if level is None else float(10 ** (level / 20) / np.sqrt(2))

    def noise_power(self) -> tuple[float, ...]:
        """Noise power per receiver: 1, except Delta, whose gain scales it."""
        if self.hybrid and self.in_antenna:
            return 1.0, float(abs(self.hybrid.delta_gain) ** 2)
        return (1.0,) * self.detectors

    def beam_tables(self) -> tuple[BeamTable, ...]:
        """The measured beams in the file that `pattern` names; none if it names an aperture.

        Raises:
            UserError: a file that cannot be used.
        """
        if self.pattern in PATTERNS:
            return ()
        azimuth_beamwidth = self.wavelength_m / self.azimuth_diameter_m
        return read_beam_tables(Path(self.pattern), self.beamwidth_rad, azimuth_beamwidth)


@dataclass(frozen=True)
class Flight:
    """A level track eastwards, with one dwell every `dwell_spacing_m`; in stripmap dwells follow without a gap.

    It is straight except for the motion by gusts of `gust_mps` (rms, in each axis), see `gust`.
    """

    __pydantic_config__ = STRICT_KEYS

    slant_range_m: Annotated[Float, Ge(1), Le(1e7)]
    look_angle_rad: Annotated[Float, Gt(0), Lt(np.pi / 2)]
    speed_mps: Annotated[Float, Ge(0.01), Le(20000)]
    odometry_rate_hz: Annotated[Float, Gt(0), Le(10000)]
    dwell_spacing_m: Annotated[Float, Ge(1e-6), Le(1e6)] | None = None
    gust_mps: Annotated[Float, Ge(0), Le(20)] = 0.0


@dataclass(frozen=True)
class ImageSize:
    """Pixels of the SLC, at the resolution in range (rows) and azimuth (cols)."""

    __pydantic_config__ = STRICT_KEYS

    rows: Annotated[Int, Ge(1), Le(65536)]
    cols: Annotated[Int, Ge(1), Le(65536)]


@dataclass(frozen=True)
class TargetSettings:
    """A point target (`PointTarget`) beside those of the scene; power over that of a cell of brightness 1."""

    __pydantic_config__ = STRICT_KEYS

    east_m: Annotated[Float, Ge(-1e7), Le(1e7)]
    north_m: Annotated[Float, Ge(-1e7), Le(1e7)]
    height_m: Annotated[Float, Ge(-12_000), Le(1e6)]
    power_db: Annotated[Float, Ge(-60), Le(100)]
    radial_velocity_mps: Annotated[Float, Ge(-1000), Le(1000)] = 0.0
    along_velocity_mps: Annotated[Float, Ge(-1000), Le(1000)] = 0.0


@dataclass(frozen=True)
class Preset:
    """What a run is made from. `cnr_db` is that of a detector looking straight at a cell of brightness 1 in the SLC.

    In stripmap it looks straight at the cell in elevation; the loss of its beam over the aperture is compensated.
    `scene_extent_m` spreads the scatterers in height about the scene's terrain (`Scene.extent`); `targets` are added to
    it, at rest or moving. `impairments` are how the sensor differs from its description.

    `estimators` are the names of the height estimators of a run; none: those that run by default and suit the sensor.
    `processing` holds parameters of nodes by node and name; the option --param overrides them.
    """

    __pydantic_config__ = STRICT_KEYS

    name: Annotated[str, MinLen(1)]
    sensor: SensorSettings
    flight: Flight
    image: ImageSize
    scene: Annotated[str, MinLen(1)]
    cnr_db: Annotated[Float, Ge(-60), Le(100)]
    looks: tuple[Annotated[Int, Ge(1)], Annotated[Int, Ge(1)]]
    dwells: Annotated[Int, Ge(1), Le(1_000_000)]
    scene_extent_m: Annotated[Float, Ge(0), Le(10_000)] = 0.0
    targets: tuple[TargetSettings, ...] = ()
    impairments: Impairments = UNIMPAIRED
    estimators: tuple[str, ...] = ()
    processing: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def dwell_spacing_m(self) -> float:
        """Distance flown from one dwell to the next, m; in stripmap during the pulses of a dwell."""
        if self.flight.dwell_spacing_m is not None:
            return self.flight.dwell_spacing_m
        return self.flight.speed_mps * self.sensor.pulse_count / self.sensor.pulse_repetition_frequency_hz

    def make_sensor(self) -> Sensor:
        """The sensor, with unit noise power in receivers of gain 1; a linear FM pulse rises.

        Raises:
            UserError: beams that leave the quarter between nadir and horizon, a pulse that does not fit the record, or
                a file of beams that cannot be used.
        """
        s = self.sensor
        tables = s.beam_tables()
        steps = np.arange(s.detectors) - (s.detectors - 1) / 2
        boresights = self.flight.look_angle_rad + steps * s.pitch_beamwidths * s.beamwidth_rad
        return Sensor(
            name=self.name,
            look_side={"right": 1, "left": -1}[s.look_side],
            wavelength=s.wavelength_m,
            bandwidth=s.bandwidth_hz,
            sample_count=s.sample_count,
            pulse_count=s.pulse_count,
            pulse_repetition_frequency=s.pulse_repetition_frequency_hz,
            elevation_diameter=s.aperture_m,
            azimuth_diameter=s.azimuth_diameter_m,
            pattern="table" if tables else s.pattern,
            elevation_boresights=tuple(boresights.tolist()),
            noise_power=s.noise_power(),
            channel_matrix=s.channel_matrix(),
            matrix_in_antenna=s.in_antenna,
            full_scale=s.full_scale(),
            mounting=s.mounting.mounting,
            waveform=s.waveform,
            chirp_rate=s.bandwidth_hz / s.pulse_duration_s if s.pulse_duration_s else 0.0,
            pulse_duration=s.pulse_duration_s,
            sampling_rate=s.sampling_rate_hz,
            mode=s.mode,
            detector_size=s.detector_size_beamwidths,
            detector_rotation=s.detector_rotation_rad,
            beam_tables=tables,
        )


def preset_names() -> list[str]:
    """Names of the presets that come with the package."""
    return sorted(entry.name.removesuffix(".yaml") for entry in _shipped().iterdir() if entry.name.endswith(".yaml"))


def _shipped() -> Path:
    """The folder of the presets that come with the package."""
    return Path(str(resources.files("sal_height") / "presets"))


def load_preset(name_or_path: str) -> Preset:
    """The preset of that name (`preset_names`), or the one in that YAML file; a file of beams by its absolute path.

    Raises:
        UserError: no such preset, not YAML, or a key that is missing, unknown or has a value out of its range.
    """
    path = _shipped() / f"{name_or_path}.yaml" if name_or_path in preset_names() else Path(name_or_path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise UserError(
            f"Preset {name_or_path!r} is neither a readable file nor one of {', '.join(preset_names())}."
        ) from error
    try:
        content = yaml.safe_load(text)
    except RecursionError as error:
        raise UserError(f"Preset {name_or_path} is nested too deeply; a preset has two levels of keys.") from error
    except (yaml.YAMLError, ValueError) as error:
        raise UserError(f"Preset {name_or_path} is not valid YAML: {' '.join(str(error).split())}.") from error
    return _with_absolute_pattern(parse_preset(content, name_or_path), path.parent)


def _with_absolute_pattern(preset: Preset, folder: Path) -> Preset:
    """The preset with the path of its file of beams made absolute, as seen from `folder` or the working directory."""
    pattern = preset.sensor.pattern
    if pattern in PATTERNS:
        return preset
    beside = folder / pattern
    path = beside if beside.is_file() else Path(pattern)
    return replace(preset, sensor=replace(preset.sensor, pattern=str(path.absolute())))


def parse_preset(content: Any, source: str) -> Preset:
    """The preset with that content (mappings as from YAML); `source` names it in messages.

    Raises:
        UserError: a key that is missing, unknown or has a value out of its range: the first one found.
    """
    try:
        preset = TypeAdapter(Preset).validate_python(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = " ".join(".".join(str(part) for part in first["loc"]).split()) or "the top level"
        if first["type"] == "missing":
            raise UserError(f"Preset {source}: {key} is missing; it is required.") from error
        if first["type"] == "unexpected_keyword_argument":
            raise UserError(f"Preset {source}: {key} is not a known key; remove it or correct its spelling.") from error
        allowed = _rounded(first["msg"][0].lower() + first["msg"][1:])
        raise UserError(f"Preset {source}: {key} is {_shown(first['input'])}; {allowed}.") from error
    size = (preset.image.rows, preset.image.cols)
    if preset.looks[0] > size[0] or preset.looks[1] > size[1]:
        raise UserError(f"Preset {source}: looks is {preset.looks}; they must fit in the image of {size} pixels.")
    _check_channels(preset.sensor, source)
    _check_impairments(preset, source)
    _check_dwell_spacing(preset, source)
    return preset


def check_pulses(sensor: Sensor, speed: float) -> None:
    """Check that the pulses sample the Doppler of all that the sensor's main lobes light up.

    Args:
        sensor: of a preset.
        speed: of the platform, m/s.

    Raises:
        UserError: the pulse repetition frequency is too low.
    """
    beamwidths = lit_angle(sensor.beams) / sensor.beams.track_beamwidth
    doppler_band = 4 * speed * lit_angle(sensor.beams) / sensor.wavelength
    if sensor.pulse_repetition_frequency < doppler_band * (1 - 1e-6):
        raise UserError(
            f"Preset {sensor.name}: sensor.pulse_repetition_frequency_hz is {sensor.pulse_repetition_frequency:g}; the "
            f"main lobe spans {doppler_band:g} Hz of Doppler ({4 * beamwidths:g} speed / aperture), so it must be that "
            "or more."
        )


def _check_channels(sensor: SensorSettings, source: str) -> None:
    """Check that a hybrid has two detectors, and that there is one gain and one phase per detector.

    Raises:
        UserError: it has not, or they are not.
    """
    if sensor.hybrid and sensor.detectors != 2:
        raise UserError(
            f"Preset {source}: sensor.detectors is {sensor.detectors} with a sensor.hybrid; a hybrid makes sum and "
            "difference of 2."
        )
    for key in ("detector_gains_db", "detector_phases_rad"):
        _check_one_per_detector(f"sensor.{key}", getattr(sensor, key), sensor, source)


def _check_one_per_detector(key: str, values: tuple[float, ...], sensor: SensorSettings, source: str) -> None:
    if len(values) not in (0, sensor.detectors):
        raise UserError(
            f"Preset {source}: {key} has {len(values)} entries; it must have {sensor.detectors}, one per "
            "detector, or none."
        )


def _check_impairments(preset: Preset, source: str) -> None:
    """Check that impairments name receivers and frequencies that exist, and that the beams stay on lit ground.

    Raises:
        UserError: they are not.
    """
    sensor, impairments = preset.sensor, preset.impairments
    for key in ("undescribed_gains_db", "undescribed_phases_rad"):
        _check_one_per_detector(f"impairments.{key}", getattr(impairments, key), sensor, source)
    sawtooth, swing = impairments.range_sawtooth, impairments.antenna_swing.amplitude_rad
    if sawtooth and max(sawtooth.receivers, default=0) >= sensor.detectors:
        raise UserError(
            f"Preset {source}: impairments.range_sawtooth.receivers names {max(sawtooth.receivers)}; receivers are "
            f"numbered from 0 to {sensor.detectors - 1}."
        )
    if sawtooth and sawtooth.teeth > sensor.sample_count / 2:
        raise UserError(
            f"Preset {source}: impairments.range_sawtooth.teeth is {sawtooth.teeth:g}; {sensor.sample_count} samples "
            f"show at most {sensor.sample_count // 2}."
        )
    if impairments.nyquist_spur_over_noise and (sensor.waveform != "spectrum" or sensor.sample_count % 2):
        raise UserError(
            f"Preset {source}: impairments.nyquist_spur_over_noise is {impairments.nyquist_spur_over_noise:g}; "
            "with a sensor.waveform other than 'spectrum', or an odd sensor.sample_count, it must be 0."
        )
    most = MOST_SWING_BEAMWIDTHS * sensor.track_beamwidth_rad
    if swing > most:
        raise UserError(
            f"Preset {source}: impairments.antenna_swing.amplitude_rad is {swing:g}; it must be {most:g}, "
            f"{MOST_SWING_BEAMWIDTHS:g} beamwidths, or less."
        )


def _check_dwell_spacing(preset: Preset, source: str) -> None:
    """Check that spotlight dwells do not overlap, and that stripmap dwells have no spacing of their own.

    Raises:
        UserError: they do, or it is missing or given.
    """
    spacing, speed = preset.flight.dwell_spacing_m, preset.flight.speed_mps
    duration = preset.sensor.pulse_count / preset.sensor.pulse_repetition_frequency_hz
    if preset.sensor.mode == "stripmap":
        if spacing is not None:
            raise UserError(
                f"Preset {source}: flight.dwell_spacing_m is {spacing:.6g}; in stripmap dwells follow each other "
                f"without a gap, here every {duration * speed:.6g} m, so leave it out."
            )
    elif spacing is None:
        raise UserError(f"Preset {source}: flight.dwell_spacing_m is missing; it is required.")
    elif duration > spacing / speed:
        raise UserError(
            f"Preset {source}: flight.dwell_spacing_m is {spacing:.6g}, {spacing / speed:.3g} s of "
            f"flight; a dwell takes {duration:.3g} s, so it must be {duration * speed:.6g} or more."
        )


def _shown(value: Any) -> str:
    """A value for a sentence: its long numbers rounded, and cut where it is too long to read."""
    try:
        text = repr(value) if isinstance(value, str) else _rounded(repr(value))
    except ValueError:  # a number of more digits than Python writes
        return "a number of thousands of digits"
    return text if len(text) <= 100 else f"{text[:100]} ..."


def _rounded(text: str) -> str:
    """The text with numbers of more than seven characters rounded to six digits."""
    return re.sub(r"\d+(\.\d+)?(e[-+]?\d+)?", lambda n: n[0] if len(n[0]) <= 7 else f"{float(n[0]):.6g}", text)
