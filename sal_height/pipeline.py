"""The whole way from phase history to heights, each step one line.

`Compressor` makes the images of all channels of a dwell, or of what a block completes of a strip; `heights` makes the
heights of one such set of images. The ROS nodes only turn messages into these calls and back.
"""

from __future__ import annotations

from dataclasses import replace

from sal_height.calibration import Calibration
from sal_height.geometry import Trajectory
from sal_height.imaging import Settings, Slc, StripFocuser, focus_dwell
from sal_height.sensor import PhaseHistory, Sensor, count_saturated, range_compressed


class Compressor:
    """From the phase history of dwells to the images of all channels.

    In spotlight each dwell is an image. In stripmap dwells are consecutive blocks of pulses; those that the next image
    still needs are held, with their track and their shares of clipped samples.
    """

    def __init__(self) -> None:
        """Begin without a strip."""
        self._strip = StripFocuser()
        self._strip_of = ("", "")

    def add(
        self,
        history: PhaseHistory,
        track: Trajectory,
        sensor: Sensor,
        settings: Settings,
        calibration: Calibration | None = None,
    ) -> Slc | None:
        """Images of a dwell, or of the columns that a block completes of a strip; None: of too few as yet.

        Args:
            history: of all channels, as the sensor delivers it.
            track: of the platform, from the first pulse or before to the last or after.
            sensor: that took it.
            settings: what image is wanted.
            calibration: of the sensor's receivers, taken out of the samples; None: they are as described.

        Raises:
            Rejected: pulses or frequencies do not sample the scene, or the block comes out of order.
            UserError: an image that cannot be made, a track that does not cover the pulses, or the calibration of
                another sensor.
        """
        # Clipped samples are counted while they are still those of the receivers.
        counted = count_saturated(history, sensor)
        # Range compression: samples over fast-time frequency, whatever the waveform.
        spectrum, sensor = range_compressed(counted, sensor)
        # Calibration: all channels get one response over the band.
        if calibration:
            calibration.check(sensor)
            spectrum = calibration.equalised(spectrum)
        # Azimuth compression, with one and the same filter for all channels.
        if sensor.mode == "spotlight":
            slc: Slc | None = focus_dwell(spectrum, track, sensor, settings)
        else:
            strip = self._strip_for(sensor, calibration)
            slc = strip.focus_block(spectrum, track, sensor, settings)
        # The calibration has raised the noise of channels that were weak.
        if slc and calibration:
            slc = replace(slc, noise_power=calibration.noise_gains(settings.range_window) * slc.noise_power)
        return slc

    def _strip_for(self, sensor: Sensor, calibration: Calibration | None) -> StripFocuser:
        """The strip that a block continues; a new one if the sensor or the calibration is another."""
        key = (sensor.config_hash, calibration.id if calibration else "")
        if self._strip_of != key:
            self._strip, self._strip_of = StripFocuser(), key
        return self._strip
