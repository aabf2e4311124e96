"""The accuracy of the description of a sensor, and what is assumed where nobody states it."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

from sal_height.errors import UserError
from sal_height.geometry import NOT_STATED

AS_DESCRIBED = NOT_STATED
"""Value of a parameter that states no standard deviation: the one that the sensor's description states counts."""

NEPERS_PER_DB = math.log(10) / 20
"""Change of ln |gain| by 1 dB."""


@dataclass(frozen=True)
class SensorUncertainty:
    """Standard deviations of what a sensor's description states; None: not stated; 0: exact.

    The same content as sal_height_msgs/SensorUncertainty.

    Attributes:
        range_delay: delay of the echoes that is not in the range reference, m of slant range.
        sample_clock: rate of the sample clock over that described, relative.
        odometry_delay: time by which stamps of odometry are late against those of the frames, s.
        beam_pitch: distance between the beams over that described, relative: an error of elevation in proportion to the
            angle from the middle of the array.
        beam_width: width of the beams over that described, relative.
        channel_gain: gain of the channels against each other, of ln |gain|.
        channel_phase: phase of the channels against each other, rad.
        noise_power: noise of the receivers over that described, relative.

    Raises:
        UserError: a value that is negative or not finite.
    """

    range_delay: float | None = None
    sample_clock: float | None = None
    odometry_delay: float | None = None
    beam_pitch: float | None = None
    beam_width: float | None = None
    channel_gain: float | None = None
    channel_phase: float | None = None
    noise_power: float | None = None

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if value is not None and not 0 <= value < math.inf:
                raise UserError(f"Sensor uncertainty.{one.name} is {value!r}; it must be finite and 0 or more.")


NOTHING_STATED = SensorUncertainty()

EXACT = SensorUncertainty(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Of an instrument that is as it is described."""


class StandardDeviation(NamedTuple):
    """A standard deviation.

    Attributes:
        sigma: standard deviation.
        is_assumed: True if nobody stated it.
    """

    sigma: float
    is_assumed: bool


def deviation_of(parameter: float, described: float | None, usual: float) -> StandardDeviation:
    """The standard deviation that counts.

    Args:
        parameter: value of a parameter, which replaces the description; negative (AS_DESCRIBED): not stated.
        described: value in the sensor's description; None: not stated.
        usual: value of an instrument that nobody has calibrated, which is assumed if neither is stated.
    """
    if parameter >= 0:
        return StandardDeviation(parameter, is_assumed=False)
    if described is not None:
        return StandardDeviation(described, is_assumed=False)
    return StandardDeviation(usual, is_assumed=True)


class BeamErrors(NamedTuple):
    """Standard deviations of the beams and channels of a sensor, as of `SensorUncertainty`.

    Attributes:
        pitch: distance between the beams, relative.
        width: width of the beams, relative.
        gain: ln |gain| of the channels.
        phase: phase of the channels, rad.
    """

    pitch: float = 0.0
    width: float = 0.0
    gain: float = 0.0
    phase: float = 0.0


KNOWN_BEAMS = BeamErrors()
