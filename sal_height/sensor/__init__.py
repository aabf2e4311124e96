"""The description of a sensor, and its samples up to the phase history.

Read `sensor` first (`Sensor`: wavelength, pulses, frequencies, beams, noise), then `phase_history` (samples of a dwell
over frequency), `waveform` (raw chirp or deramped echoes to phase history), `receivers` (clipped samples), `channels`
(from the receivers' channels to whitened ones) and `stripmap` (the angle that a fixed antenna illuminates).
"""

from sal_height.sensor.channels import Channels, sum_difference_channels, whitened_channels, with_powers
from sal_height.sensor.phase_history import NUFFT_TOLERANCE, PhaseHistory
from sal_height.sensor.sensor import (
    MAX_DETECTORS,
    MAX_SHARE,
    MODES,
    Sensor,
    aperture_length,
    clipped,
    count_saturated,
    lit_angle,
    lit_doppler,
    look_ahead_angle,
    processed_angle,
)
from sal_height.sensor.waveform import echo_sensor, from_spectrum, range_compressed, spectrum_sensor

__all__ = [
    "MAX_DETECTORS",
    "MAX_SHARE",
    "MODES",
    "NUFFT_TOLERANCE",
    "Channels",
    "PhaseHistory",
    "Sensor",
    "aperture_length",
    "clipped",
    "count_saturated",
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
