"""Conversion of the calibration of a sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sal_height.calibration import Calibration
from sal_height.engine.frames import BODY_FRAME
from sal_height.errors import UserError
from sal_height.messages.basics import complex_pairs, from_complex_pairs
from sal_height.messages.types import Calibration as CalibrationMessage
from sal_height.messages.types import Header, Time


def calibration_to_message(
    calibration: Calibration, stamp: Time, undetermined: Sequence[str] = ()
) -> CalibrationMessage:
    """Return the Calibration message; `undetermined` has a text for each part that could not be determined."""
    channels, frequencies = calibration.response.shape
    return CalibrationMessage(
        header=Header(stamp=stamp, frame_id=BODY_FRAME),
        id=calibration.id,
        config_hash=calibration.config_hash,
        dwells=calibration.dwells,
        channels=channels,
        frequencies=frequencies,
        response=complex_pairs(calibration.response),
        response_sigma=calibration.response_sigma,
        gain_sigma=calibration.gain_sigma,
        phase_sigma=calibration.phase_sigma,
        width_factor=calibration.width_factor,
        width_sigma=calibration.width_sigma,
        pupil=calibration.pupil,
        pupil_sigma=calibration.pupil_sigma,
        pupil_misfit=calibration.pupil_misfit,
        pupil_p_value=calibration.pupil_p_value,
        undetermined=list(undetermined),
    )


def calibration_from_message(message: CalibrationMessage) -> Calibration:
    """Return the calibration in a message.

    Raises:
        UserError: the message has no id, the number of its values contradicts its channels and frequencies, or a value
            is out of its range.
    """
    if not message.id:
        raise UserError("A Calibration has no id; it must have one, to which products refer.")
    response = from_complex_pairs(message.response, f"Calibration {message.id!r}: response")
    shape = message.channels, message.frequencies
    if response.size != shape[0] * shape[1]:
        raise UserError(
            f"Calibration {message.id!r} has {response.size} complex entries of response; {shape[0]} channels of "
            f"{shape[1]} frequencies need {shape[0] * shape[1]}."
        )
    return Calibration(
        config_hash=message.config_hash,
        response=response.reshape(shape),
        response_sigma=np.array(message.response_sigma),
        gain_sigma=np.array(message.gain_sigma),
        phase_sigma=np.array(message.phase_sigma),
        width_factor=message.width_factor,
        width_sigma=message.width_sigma,
        pupil=np.array(message.pupil),
        pupil_sigma=np.array(message.pupil_sigma),
        pupil_misfit=message.pupil_misfit,
        pupil_p_value=message.pupil_p_value,
        dwells=message.dwells,
        id=message.id,
    )
