"""Presets: a sensor, its flight, a scene and the processing, read from validated YAML.

docs/presets.md describes every key. Keys that depend on the beams of the sensor are checked by `flight.flight_of`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import AfterValidator
from pydantic_core import PydanticCustomError
from scipy.spatial.transform import Rotation

from sal_height.beams import PATTERNS, read_beam_tables
from sal_height.configuration import Angle, Decibels, Float, Int, StrictKeys, read_yaml, validated
from sal_height.errors import UserError, did_you_mean
from sal_height.geometry import Mounting, Origin, describe_implausible_pressure
from sal_height.sensor import MAX_DETECTORS, Sensor
from sal_height.simulation.impairments import UNIMPAIRED, Impairments
from sal_height.simulation.uncertainty_settings import AS_SIMULATED, UncertaintySettings

SHIPPED = Path(__file__).parents[1] / "presets"  # folder of the presets of the package
BEAM_TABLES = ".csv"  # suffix of the file of measured beams that a preset may name as its pattern

Length = Annotated[Float, Ge(-1000), Le(1000)]


def _pattern_or_file(value: str) -> str:
    if value not in PATTERNS and not value.endswith(BEAM_TABLES):
        *others, last = map(repr, PATTERNS)
        allowed = f"{', '.join(others)} or {last}, or the path of a {BEAM_TABLES} file of beams"
        raise PydanticCustomError("pattern", f"it must be {allowed}")
    return value


@dataclass(frozen=True)
class HybridSettings(StrictKeys):
    """A hybrid of two beams, the lower one first: Sigma = c (upper + lower) and Delta = c (upper - lower)."""

    place: Literal["antenna", "receiver"]
    coupling: Annotated[Float, Gt(0), Le(1)] = 1 / np.sqrt(2)
    loss_db: Annotated[Float, Ge(0), Le(60)] = 0.0
    delta_gain_db: Decibels = 0.0
    delta_phase_rad: Angle = 0.0


@dataclass(frozen=True)
class MountingSettings(StrictKeys):
    """Position and rotation of the antenna on the platform, in the axes of base_link (x forward, y left, z up)."""

    frame_id: Annotated[str, MinLen(1)] = "sensor"
    lever_arm_m: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    boresight_rad: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class BlankedRange(StrictKeys):
    """Slant ranges over which a channel (from 0) does not receive."""

    channel: Annotated[Int, Ge(0), Lt(MAX_DETECTORS)]
    first_m: Annotated[Float, Ge(0), Le(1e7)]
    last_m: Annotated[Float, Ge(0), Le(1e7)]


@dataclass(frozen=True)
class SensorSettings(StrictKeys):
    """The sensor as people describe it: an evenly spaced detector array around the look angle."""

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
    detector_phases_rad: tuple[Angle, ...] = ()
    full_scale_over_noise_db: Annotated[Float, Ge(-60), Le(300)] | None = None
    azimuth_aperture_m: Annotated[Float, Ge(1e-6), Le(1e4)] | None = None
    mounting: MountingSettings = MountingSettings()
    beam_uncertainty_db: Annotated[Float, Ge(-200), Lt(0)] | None = None
    uncertainty: UncertaintySettings = AS_SIMULATED
    blanked_ranges: tuple[BlankedRange, ...] = ()

    @property
    def beamwidth_rad(self) -> float:
        """Beamwidth along the detector axis."""
        return self.wavelength_m / self.aperture_m


@dataclass(frozen=True)
class Passes(StrictKeys):
    """Passes to and fro over the same ground: every second one is flown westwards and sees it from the other side.

    Attributes:
        count: number of passes, among which the dwells are divided evenly.
        interval_s: time from the start of a pass to that of the next one, s.
    """

    count: Annotated[Int, Ge(1), Le(10_000)] = 1
    interval_s: Annotated[Float, Gt(0), Le(1e5)] = 120.0

    def dwells_each(self, dwells: int) -> int:
        """Number of dwells of each pass; the last one may have fewer."""
        return -(-dwells // self.count)


@dataclass(frozen=True)
class Flight(StrictKeys):
    """Level tracks, straight but for gusts; in stripmap dwells follow each other without a gap."""

    slant_range_m: Annotated[Float, Ge(1), Le(1e7)]
    look_angle_rad: Annotated[Float, Gt(0), Lt(np.pi / 2)]
    speed_mps: Annotated[Float, Ge(0.01), Le(20000)]
    odometry_rate_hz: Annotated[Float, Gt(0), Le(10000)]
    dwell_spacing_m: Annotated[Float, Ge(1e-6), Le(1e6)] | None = None
    gust_mps: Annotated[Float, Ge(0), Le(20)] = 0.0
    passes: Passes = Passes()


@dataclass(frozen=True)
class OriginSettings(StrictKeys):
    """The map's origin on the earth, on WGS 84."""

    latitude_deg: Annotated[Float, Ge(-90), Le(90)]
    longitude_deg: Annotated[Float, Ge(-180), Le(180)]
    height_m: Annotated[Float, Ge(-1000), Le(10_000)] = 0.0

    def __post_init__(self) -> None:
        if not (self.latitude_deg or self.longitude_deg):
            raise PydanticCustomError("origin", "it must not be at latitude and longitude 0, a position at sea")

    @property
    def place(self) -> Origin:
        """The same in rad."""
        return Origin(np.radians(self.latitude_deg).item(), np.radians(self.longitude_deg).item(), self.height_m)


@dataclass(frozen=True)
class ImageSize(StrictKeys):
    """Pixels of the SLC, at the resolution in range (rows) and azimuth (cols)."""

    rows: Annotated[Int, Ge(1), Le(65536)]
    cols: Annotated[Int, Ge(1), Le(65536)]


@dataclass(frozen=True)
class TargetSettings(StrictKeys):
    """A point target (`PointScatterer`) in addition to those of the scene; its power over a cell of brightness 1."""

    east_m: Annotated[Float, Ge(-1e7), Le(1e7)]
    north_m: Annotated[Float, Ge(-1e7), Le(1e7)]
    height_m: Annotated[Float, Ge(-12_000), Le(1e6)]
    power_db: Annotated[Float, Ge(-60), Le(100)]
    radial_velocity_mps: Annotated[Float, Ge(-1000), Le(1000)] = 0.0
    along_velocity_mps: Annotated[Float, Ge(-1000), Le(1000)] = 0.0


@dataclass(frozen=True)
class Preset(StrictKeys):
    """Description of a run."""

    name: Annotated[str, MinLen(1)]
    sensor: SensorSettings
    flight: Flight
    image: ImageSize
    scene: Annotated[str, MinLen(1)]
    cnr_db: Annotated[Float, Ge(-60), Le(100)]
    looks: tuple[Annotated[Int, Ge(1)], Annotated[Int, Ge(1)]]
    dwells: Annotated[Int, Ge(1), Le(1_000_000)]
    scene_extent_m: Annotated[Float, Ge(0), Le(10_000)] = 0.0
    double_bounce_db: Decibels | None = None
    targets: tuple[TargetSettings, ...] = ()
    impairments: Impairments = UNIMPAIRED
    estimators: tuple[str, ...] = ()
    processing: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    latency_budget_s: Annotated[Float, Gt(0), Le(86400)] | None = None
    origin: OriginSettings | None = None

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
        azimuth_diameter = s.azimuth_aperture_m or s.aperture_m
        beamwidths = s.beamwidth_rad, s.wavelength_m / azimuth_diameter
        file = SHIPPED / s.pattern if (SHIPPED / s.pattern).is_file() else Path(s.pattern)
        tables = () if s.pattern in PATTERNS else read_beam_tables(file, *beamwidths)
        steps = np.arange(s.detectors) - (s.detectors - 1) / 2
        boresights = self.flight.look_angle_rad + steps * s.pitch_beamwidths * s.beamwidth_rad
        matrix, in_antenna, noise_power = _channels(s)
        turn = Rotation.from_euler("ZYX", s.mounting.boresight_rad[::-1])
        x, y, z, w = turn.as_quat().tolist()
        level_db = s.full_scale_over_noise_db  # noise of power 1 has the rms 1 / sqrt(2) in each part
        return Sensor(
            name=self.name,
            look_side={"right": 1, "left": -1}[s.look_side],
            wavelength=s.wavelength_m,
            bandwidth=s.bandwidth_hz,
            sample_count=s.sample_count,
            pulse_count=s.pulse_count,
            pulse_repetition_frequency=s.pulse_repetition_frequency_hz,
            elevation_diameter=s.aperture_m,
            azimuth_diameter=azimuth_diameter,
            pattern="table" if tables else s.pattern,
            elevation_boresights=tuple(boresights.tolist()),
            noise_power=noise_power,
            channel_matrix=matrix,
            matrix_in_antenna=in_antenna,
            full_scale=0.0 if level_db is None else float(10 ** (level_db / 20) / np.sqrt(2)),
            mounting=s.uncertainty.mounted(Mounting(s.mounting.frame_id, s.mounting.lever_arm_m, (x, y, z, w))),
            waveform=s.waveform,
            chirp_rate=s.bandwidth_hz / s.pulse_duration_s if s.pulse_duration_s else 0.0,
            pulse_duration=s.pulse_duration_s,
            sampling_rate=s.sampling_rate_hz,
            mode=s.mode,
            detector_size=s.detector_size_beamwidths,
            detector_rotation=s.detector_rotation_rad,
            beam_tables=tables,
            beam_uncertainty=0.0 if s.beam_uncertainty_db is None else 10 ** (s.beam_uncertainty_db / 20),
            uncertainty=s.uncertainty.of_sensor,
            blanked_ranges=tuple((one.channel, one.first_m, one.last_m) for one in s.blanked_ranges),
        )


def _channels(s: SensorSettings) -> tuple[tuple[tuple[complex, ...], ...], bool, tuple[float, ...]]:
    """`channel_matrix`, `matrix_in_antenna` and `noise_power` of the `Sensor`."""
    in_antenna, noise_power = False, (1.0,) * s.detectors
    if not (s.hybrid or s.detector_gains_db or s.detector_phases_rad):
        return (), True, noise_power
    gains_db, phases = np.array(s.detector_gains_db or (0.0,)), np.array(s.detector_phases_rad or (0.0,))
    matrix = np.diag(10 ** (gains_db / 20) * np.exp(1j * phases) * np.ones(s.detectors))
    if s.hybrid:
        delta_gain = complex(10 ** (s.hybrid.delta_gain_db / 20) * np.exp(1j * s.hybrid.delta_phase_rad))
        amplitude = s.hybrid.coupling * 10 ** (-s.hybrid.loss_db / 20)
        matrix = np.array([[1, 1], [-delta_gain, delta_gain]]) * amplitude @ matrix
        if s.hybrid.place == "antenna":
            in_antenna, noise_power = True, (1.0, float(abs(delta_gain) ** 2))
    return tuple(tuple(row) for row in matrix.tolist()), in_antenna, noise_power


def preset_names() -> list[str]:
    """Names of the presets of the package."""
    return sorted(entry.stem for entry in SHIPPED.glob("*.yaml"))


def load_preset(name_or_path: str) -> Preset:
    """The preset of that name (`preset_names`), or the one in that YAML file.

    A file of beams has its absolute path; one of the package has its name, which is valid on other machines.

    Raises:
        UserError: no such preset, not YAML, or a key that is missing, unknown or has a value out of its range.
    """
    path = SHIPPED / f"{name_or_path}.yaml" if name_or_path in preset_names() else Path(name_or_path)
    hint = did_you_mean(name_or_path, preset_names())
    unreadable = f"Preset {name_or_path!r} is neither a readable file nor one of {', '.join(preset_names())}{hint}."
    content = read_yaml(path, f"Preset {name_or_path}", unreadable)
    preset = parse_preset(content, name_or_path)
    pattern = preset.sensor.pattern
    found = [place for place in (path.parent / pattern, Path(pattern)) if place.is_file()]
    if pattern not in PATTERNS and path.parent != SHIPPED and found:
        pattern = str(found[0].absolute())
    return replace(preset, sensor=replace(preset.sensor, pattern=pattern))


def parse_preset(content: Any, source: str) -> Preset:
    """The preset with that content (mappings as from YAML); `source` names it in messages.

    Raises:
        UserError: a key that is missing, unknown, out of its range, or in contradiction to others: the first of these.
    """
    preset = validated(Preset, content, f"Preset {source}")
    for contradiction in (
        *_channel_misfits(preset),
        *_blanking_misfits(preset),
        *_impairment_misfits(preset),
        *_nature_misfits(preset),
        *_spacing_misfits(preset),
        *_pass_misfits(preset),
    ):
        raise UserError(f"Preset {source}: {contradiction}.")
    return preset


# Contradictions between keys: messages without their start and end.


def _channel_misfits(preset: Preset) -> Iterator[str]:
    """Contradictions of looks and image, and of the channels and the number of detectors."""
    sensor, impairments = preset.sensor, preset.impairments
    size = (preset.image.rows, preset.image.cols)
    if preset.looks[0] > size[0] or preset.looks[1] > size[1]:
        yield f"looks is {preset.looks}; they must fit in the image of {size} pixels"
    if sensor.hybrid and sensor.detectors != 2:
        yield f"sensor.detectors is {sensor.detectors} with a sensor.hybrid; a hybrid makes sum and difference of 2"
    for key, values in {
        "sensor.detector_gains_db": sensor.detector_gains_db,
        "sensor.detector_phases_rad": sensor.detector_phases_rad,
        "impairments.undescribed_gains_db": impairments.undescribed_gains_db,
        "impairments.undescribed_phases_rad": impairments.undescribed_phases_rad,
    }.items():
        if len(values) not in (0, sensor.detectors):
            yield f"{key} has {len(values)} entries; it must have {sensor.detectors}, one per detector, or none"


def _blanking_misfits(preset: Preset) -> Iterator[str]:
    """Contradictions of blanked ranges and the channels and samples that exist."""
    sensor = preset.sensor
    for one in sensor.blanked_ranges:
        if one.channel >= sensor.detectors:
            yield (
                f"sensor.blanked_ranges names channel {one.channel}; channels are numbered from 0 to "
                f"{sensor.detectors - 1}"
            )
        if one.last_m < one.first_m:
            yield f"sensor.blanked_ranges has last_m {one.last_m:g}; it must be first_m, {one.first_m:g}, or more"
    if sensor.blanked_ranges and sensor.waveform != "spectrum":
        yield f"sensor.blanked_ranges is given with sensor.waveform {sensor.waveform!r}; it goes with 'spectrum' only"


def _impairment_misfits(preset: Preset) -> Iterator[str]:
    """Contradictions of impairments and the receivers and frequencies that exist."""
    sensor, impairments = preset.sensor, preset.impairments
    if sawtooth := impairments.range_sawtooth:
        if (named := max(sawtooth.receivers, default=0)) >= sensor.detectors:
            yield (
                f"impairments.range_sawtooth.receivers names {named}; receivers are numbered from 0 to "
                f"{sensor.detectors - 1}"
            )
        if sawtooth.teeth > sensor.sample_count / 2:
            yield (
                f"impairments.range_sawtooth.teeth is {sawtooth.teeth:g}; {sensor.sample_count} samples show at most "
                f"{sensor.sample_count // 2}"
            )
    if (ripple := impairments.chirp_ripple) and ripple.cycles > sensor.sample_count / 2:
        yield (
            f"impairments.chirp_ripple.cycles is {ripple.cycles:g}; {sensor.sample_count} samples show at most "
            f"{sensor.sample_count // 2}"
        )
    if impairments.nyquist_spur_over_noise and (sensor.waveform != "spectrum" or sensor.sample_count % 2):
        yield (
            f"impairments.nyquist_spur_over_noise is {impairments.nyquist_spur_over_noise:g}; with a sensor.waveform "
            "other than 'spectrum', or an odd sensor.sample_count, it must be 0"
        )
    if impairments.laser_within_pulse and sensor.waveform == "spectrum":
        yield (
            "impairments.laser_within_pulse is true; with sensor.waveform 'spectrum', whose samples are no times, it "
            "must be false"
        )
    if impairments.adc_bits and sensor.full_scale_over_noise_db is None:
        yield (
            f"impairments.adc_bits is {impairments.adc_bits}; converters need sensor.full_scale_over_noise_db, or "
            "adc_bits must be 0"
        )


def _nature_misfits(preset: Preset) -> Iterator[str]:
    """Contradictions: a laser in a radar, a pressure that air does not have."""
    impairments, wavelength = preset.impairments, preset.sensor.wavelength_m
    longest_light_m = 100e-6  # wavelength of a laser; terahertz radars have longer waves, which no laser line describes
    if impairments.laser_linewidth_hz and wavelength > longest_light_m:
        yield (
            f"impairments.laser_linewidth_hz is {impairments.laser_linewidth_hz:g} with sensor.wavelength_m "
            f"{wavelength:g}; a laser is part of a lidar, whose wavelength is {longest_light_m:g} or less, so leave it "
            "out"
        )
    air = impairments.air
    if air and (wrong := describe_implausible_pressure(air.height_m, air.temperature_k, air.pressure_pa)):
        yield f"impairments.air is impossible: {wrong}; give pressure_pa in Pa, as it is at height_m"


def _spacing_misfits(preset: Preset) -> Iterator[str]:
    """Contradictions: spotlight dwells that overlap, stripmap dwells with a spacing of their own."""
    sensor, flight = preset.sensor, preset.flight
    spacing, duration = flight.dwell_spacing_m, sensor.pulse_count / sensor.pulse_repetition_frequency_hz
    if sensor.mode == "stripmap":
        if spacing is not None:
            yield (
                f"flight.dwell_spacing_m is {spacing:.6g}; in stripmap dwells follow each other without a gap, here "
                f"every {duration * flight.speed_mps:.6g} m, so leave it out"
            )
    elif spacing is None:
        yield "flight.dwell_spacing_m is missing; it is required"
    elif duration > spacing / flight.speed_mps:
        yield (
            f"flight.dwell_spacing_m is {spacing:.6g}, {spacing / flight.speed_mps:.3g} s of flight; a dwell takes "
            f"{duration:.3g} s, so it must be {duration * flight.speed_mps:.6g} or more"
        )


def _pass_misfits(preset: Preset) -> Iterator[str]:
    """Contradictions: passes that do not follow each other."""
    passes = preset.flight.passes
    if passes.count == 1:
        return
    if passes.count > preset.dwells:
        yield (
            f"dwells is {preset.dwells} and flight.passes.count is {passes.count}; each pass needs a dwell or more, "
            f"so give {passes.count} dwells or more, or fewer passes"
        )
    pause_s = 1.0  # least time between the end of a pass and the start of the next one, s
    least = passes.dwells_each(preset.dwells) * preset.dwell_spacing_m / preset.flight.speed_mps + pause_s
    if passes.interval_s < least:
        yield (
            f"flight.passes.interval_s is {passes.interval_s:g}; a pass takes {least - pause_s:.3g} s, so it must be "
            f"{least:.3g} or more"
        )
