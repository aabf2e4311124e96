"""Data that a strip keeps from block to block."""

from __future__ import annotations

from sal_height.calibration import Calibration
from sal_height.imaging import Corrected, ImageSettings, Slc, StripDelay, StripFocuser


class StripBuffer:
    """Pulses that the next image of a strip still needs, and the delay that goes on from block to block.

    Another sensor or another calibration starts a new strip.
    """

    def __init__(self) -> None:
        """Start without a strip."""
        self._start(("", ""))

    def _start(self, source: tuple[str, str]) -> None:
        self._source, self._focuser, self._delay = source, StripFocuser(), StripDelay()

    def focus_block(self, block: Corrected, settings: ImageSettings, calibration: Calibration | None) -> Slc | None:
        """Form images of the columns that a block completes; None: too few as yet.

        Args:
            block: samples over fast-time frequency without known errors, of all channels.
            settings: settings of the image.
            calibration: calibration that was removed from the samples.

        Raises:
            Rejected, UserError: as of `StripFocuser.focus_block`.
        """
        source = block.sensor.config_hash, calibration.id if calibration else ""
        if source != self._source:
            self._start(source)
        history = self._delay.joined(block.history, block.delay, block.sensor)
        return self._focuser.focus_block(history, block.track, block.sensor, settings)

    @property
    def shortfall(self) -> str:
        """Why the block that started a strip completed no image, a sentence; empty: it did, or was not the last one."""
        return self._focuser.shortfall
