"""Accuracy of the description of an instrument, as files state it: presets, and descriptions of users' own sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from sal_height.configuration import Float, StrictKeys
from sal_height.geometry import Mounting
from sal_height.sensor import NEPERS_PER_DB, SensorUncertainty

Deviation = Annotated[Float, Ge(0), Le(1)]


@dataclass(frozen=True)
class UncertaintySettings(StrictKeys):
    """Standard deviations of an instrument from its description; None: not stated; 0: exact.

    Attributes:
        lever_arm_m: of each component of the lever arm.
        boresight_rad: of the rotation of the mounting about each axis.
        range_delay_m: of the delay of echoes, as by cables and filters, in slant range.
        sample_clock: of the rate of the sample clock, relative.
        odometry_delay_s: of the time by which odometry is stamped late against the frames.
        beam_pitch: of the distance between the beams, relative.
        beam_width: of the width of the beams, relative.
        channel_gain_db: of the gain of each channel.
        channel_phase_rad: of the phase of each channel.
        noise_power: of the noise of the receivers, relative.
    """

    lever_arm_m: Annotated[Float, Ge(0), Le(100)] | None = None
    boresight_rad: Annotated[Float, Ge(0), Le(0.1)] | None = None
    range_delay_m: Annotated[Float, Ge(0), Le(1e4)] | None = None
    sample_clock: Annotated[Float, Ge(0), Le(0.1)] | None = None
    odometry_delay_s: Annotated[Float, Ge(0), Le(10)] | None = None
    beam_pitch: Annotated[Float, Ge(0), Le(0.1)] | None = None
    beam_width: Deviation | None = None
    channel_gain_db: Annotated[Float, Ge(0), Le(20)] | None = None
    channel_phase_rad: Annotated[Float, Ge(0), Le(math.pi)] | None = None
    noise_power: Deviation | None = None

    @property
    def of_sensor(self) -> SensorUncertainty:
        """The same in the units of the sensor, without its mounting."""
        gain = self.channel_gain_db
        return SensorUncertainty(
            self.range_delay_m,
            self.sample_clock,
            self.odometry_delay_s,
            self.beam_pitch,
            self.beam_width,
            None if gain is None else NEPERS_PER_DB * gain,
            self.channel_phase_rad,
            self.noise_power,
        )

    def mounted(self, mounting: Mounting) -> Mounting:
        """The mounting, known as well as that."""
        return replace(
            mounting,
            lever_arm_covariance=_isotropic(self.lever_arm_m),
            rotation_covariance=_isotropic(self.boresight_rad),
        )


AS_SIMULATED = UncertaintySettings(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Of a simulated instrument, which is as it is described unless a preset says otherwise."""


def _isotropic(sigma: float | None) -> tuple[float, ...] | None:
    """Covariance with the same standard deviation in all directions, 9 numbers; None: not stated."""
    return None if sigma is None else tuple((sigma**2 * np.eye(3)).ravel().tolist())
