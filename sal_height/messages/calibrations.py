"""What was measured of a sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from sal_height_msgs import msg as messages
from std_msgs.msg import Header

from sal_height.calibration import Calibration
from sal_height.errors import UserError
from sal_height.messages.basics import BODY_FRAME


def calibration_to_message(
    calibration: Calibration, stamp: Time, undetermined: Sequence[str] = ()
) -> messages.Calibration:
    """Calibration as a message, with a sentence for all that could not be determined."""
    channels, frequencies = calibration.response.shape
    return messages.Calibration(
        header=Header(stamp=stamp, frame_id=BODY_FRAME),
        id=calibration.id,
        config_hash=calibration.config_hash,
        dwells=calibration.dwells,
        channels=channels,
        frequencies=frequencies,
        response_real=calibration.response.real.ravel(),
        response_imaginary=calibration.response.imag.ravel(),
        response_sigma=calibration.response_sigma,
        gain_sigma=calibration.gain_sigma,
        phase_sigma=calibration.phase_sigma,
        width_factor=calibration.width_factor,
        width_sigma=calibration.width_sigma,
        undetermined=list(undetermined),
    )


def calibration_from_message(message: messages.Calibration) -> Calibration:
    """The calibration a message holds.

    Raises:
        UserError: values out of their range, or an id that is not theirs.
    """
    parts = [np.array(values) for values in (message.response_real, message.response_imaginary)]
    shape = message.channels, message.frequencies
    if {part.size for part in parts} != {shape[0] * shape[1]}:
        raise UserError(
            f"Calibration {message.id!r} has {parts[0].size} and {parts[1].size} entries of response_real and "
            f"response_imaginary; {shape[0]} channels of {shape[1]} frequencies need {shape[0] * shape[1]}."
        )
    calibration = Calibration(
        config_hash=message.config_hash,
        response=(parts[0] + 1j * parts[1]).reshape(shape),
        response_sigma=np.array(message.response_sigma),
        gain_sigma=np.array(message.gain_sigma),
        phase_sigma=np.array(message.phase_sigma),
        width_factor=message.width_factor,
        width_sigma=message.width_sigma,
        dwells=message.dwells,
    )
    if message.id != calibration.id:
        raise UserError(f"The values of calibration {message.id!r} make the id {calibration.id!r}; it must be theirs.")
    return calibration
