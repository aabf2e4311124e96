"""The description of anybody's sensor, in YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, MinLen
from pydantic_core import PydanticCustomError
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from sal_height.configuration import Float, StrictKeys, read_yaml, validated
from sal_height.geometry import Mounting, Origin
from sal_height.sensor import Sensor
from sal_height.simulation import MountingSettings, OriginSettings

Positive = Annotated[Float, Gt(0)]


@dataclass(frozen=True)
class Description(StrictKeys):
    """A sensor without the sizes of its dwells, which their arrays have; keys are in docs/import.md."""

    name: Annotated[str, MinLen(1)]
    look_side: Literal["left", "right"]
    bandwidth_hz: Positive
    elevation_diameter_m: Positive
    azimuth_diameter_m: Positive
    elevation_boresights_rad: Annotated[tuple[Float, ...], MinLen(1)]
    wavelength_m: Positive | None = None
    carrier_hz: Positive | None = None
    pattern: Literal["gaussian", "sinc", "jinc"] = "sinc"
    noise_power: tuple[Annotated[Float, Ge(0)], ...] = ()
    mode: Literal["spotlight", "stripmap"] = "spotlight"
    waveform: Literal["spectrum", "chirp", "deramped"] = "spectrum"
    chirp_rate_hz_per_s: Float = 0.0
    pulse_duration_s: Annotated[Float, Ge(0)] = 0.0
    sampling_rate_hz: Annotated[Float, Ge(0)] = 0.0
    full_scale: Annotated[Float, Ge(0)] = 0.0
    mounting: MountingSettings = field(default_factory=MountingSettings)
    origin: OriginSettings | None = None
    processing: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.wavelength_m is None) == (self.carrier_hz is None):
            raise PydanticCustomError("carrier", "it must have either wavelength_m or carrier_hz")

    @property
    def place(self) -> Origin | None:
        """The map's origin on the earth; None: not known."""
        return self.origin.place if self.origin else None

    def sensor(self, pulse_count: int, sample_count: int, pulse_repetition_frequency: float) -> Sensor:
        """The sensor of dwells of that size.

        Args:
            pulse_count: number of pulses in a dwell.
            sample_count: number of samples in a pulse.
            pulse_repetition_frequency: pulse repetition frequency, Hz.

        Raises:
            UserError: a value that no sensor has.
        """
        x, y, z, w = Rotation.from_euler("ZYX", self.mounting.boresight_rad[::-1]).as_quat().tolist()
        return Sensor(
            name=self.name,
            look_side={"right": 1, "left": -1}[self.look_side],
            wavelength=self.wavelength_m or speed_of_light / (self.carrier_hz or 1.0),
            bandwidth=self.bandwidth_hz,
            sample_count=sample_count,
            pulse_count=pulse_count,
            pulse_repetition_frequency=pulse_repetition_frequency,
            elevation_diameter=self.elevation_diameter_m,
            azimuth_diameter=self.azimuth_diameter_m,
            pattern=self.pattern,
            elevation_boresights=self.elevation_boresights_rad,
            noise_power=self.noise_power or (0.0,) * len(self.elevation_boresights_rad),
            mode=self.mode,
            waveform=self.waveform,
            chirp_rate=self.chirp_rate_hz_per_s,
            pulse_duration=self.pulse_duration_s,
            sampling_rate=self.sampling_rate_hz,
            full_scale=self.full_scale,
            mounting=Mounting(self.mounting.frame_id, self.mounting.lever_arm_m, (x, y, z, w)),
        )


def read_description(path: Path | str) -> Description:
    """The description in a YAML file.

    Raises:
        UserError: it cannot be read, or a key is missing, unknown or has a value out of its range.
    """
    content = read_yaml(Path(path), f"Sensor {path}", f"File {path} cannot be read.")
    return validated(Description, content, f"Sensor {path}")
