"""The description of a sensor, and its samples up to the phase history.

Read `sensor` first (`Sensor`: wavelength, pulses, frequencies, beams, noise; `PhaseHistory`: samples of a dwell over
frequency), then `uncertainty` (accuracy of that description), `waveform` (raw chirp or deramped echoes to phase
history) and `channels` (from the receivers' channels to whitened ones).
"""

from sal_height.sensor.channels import Channels, sum_difference_channels, whitened_channels, with_powers
from sal_height.sensor.sensor import (
    MAX_DETECTORS,
    MAX_SHARE,
    MODES,
    NUFFT_TOLERANCE,
    PhaseHistory,
    Sensor,
    aperture_length,
    clipped,
    count_saturated,
    lit_angle,
    lit_doppler,
    look_ahead_angle,
    processed_angle,
)
from sal_height.sensor.uncertainty import (
    AS_DESCRIBED,
    EXACT,
    KNOWN_BEAMS,
    NEPERS_PER_DB,
    NOTHING_STATED,
    BeamErrors,
    SensorUncertainty,
    StandardDeviation,
    deviation_of,
)
from sal_height.sensor.waveform import echo_sensor, from_spectrum, range_compressed, spectrum_sensor

__all__ = [
    "AS_DESCRIBED",
    "EXACT",
    "KNOWN_BEAMS",
    "MAX_DETECTORS",
    "MAX_SHARE",
    "MODES",
    "NEPERS_PER_DB",
    "NOTHING_STATED",
    "NUFFT_TOLERANCE",
    "BeamErrors",
    "Channels",
    "PhaseHistory",
    "Sensor",
    "SensorUncertainty",
    "StandardDeviation",
    "aperture_length",
    "clipped",
    "count_saturated",
    "deviation_of",
    "echo_sensor",
    "from_spectrum",
    "lit_angle",
    "lit_doppler",
    "look_ahead_angle",
    "processed_angle",
    "range_compressed",
    "spectrum_sensor",
    "sum_difference_channels",
    "whitened_channels",
    "with_powers",
]
