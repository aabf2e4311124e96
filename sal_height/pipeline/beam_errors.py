"""Accuracy of the beams and channels of a sensor: by parameters, description and calibration, or else assumed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sal_height.calibration import Calibration
from sal_height.doubts import UNKNOWN_SENSOR, Assumption, Doubt, doubts_of_assumed
from sal_height.elevation import BEAM_PITCH, BEAM_WIDTH, CHANNEL_GAIN_DB, HeightSettings
from sal_height.sensor import NEPERS_PER_DB, BeamErrors, Sensor, deviation_of

BEAMS = "beams of unknown accuracy"
"""Name of the doubt about what is assumed of beams and channels."""


class KnownBeams(NamedTuple):
    """Accuracy of the beams of a sensor.

    Attributes:
        errors: errors of the description; of those that a calibration measured, its standard errors count instead.
        doubts: doubt about what is assumed of them.
    """

    errors: BeamErrors
    doubts: tuple[Doubt, ...]


def known_beams(sensor: Sensor, settings: HeightSettings, calibration: Calibration | None) -> KnownBeams:
    """Accuracy of the beams of a sensor.

    Where `Sensor.beam_uncertainty` is stated, it contains width and gains; nothing is assumed of these then.

    Args:
        sensor: sensor with its description.
        settings: settings whose standard deviations replace those of the description.
        calibration: calibration of the sensor; None: none.
    """
    described = sensor.uncertainty
    in_db = None if described.channel_gain is None else described.channel_gain / NEPERS_PER_DB
    is_stated = sensor.beam_uncertainty > 0
    pitch = deviation_of(settings.beam_pitch_sigma, described.beam_pitch, BEAM_PITCH)
    width = deviation_of(settings.beam_width_sigma, described.beam_width, 0.0 if is_stated else BEAM_WIDTH)
    gain = deviation_of(settings.channel_gain_sigma_db, in_db, 0.0 if is_stated else CHANNEL_GAIN_DB)
    width_is_measured = calibration is not None and np.isfinite(calibration.width_sigma)
    gains_are_measured = calibration is not None and bool(np.all(np.isfinite(calibration.gain_sigma)))
    quantities = (
        ("distance between the beams {:.3g} of it", "beam_pitch_sigma", pitch, False),
        ("width of the beams {:.3g} of it", "beam_width_sigma", width, width_is_measured),
        ("gain of each channel {:.3g} dB", "channel_gain_sigma_db", gain, gains_are_measured),
    )
    assumed = [
        Assumption(what.format(known.sigma), parameter)
        for what, parameter, known, is_measured in quantities
        if known.is_assumed and known.sigma and not is_measured
    ]
    errors = BeamErrors(pitch.sigma, width.sigma, NEPERS_PER_DB * gain.sigma, described.channel_phase or 0.0)
    return KnownBeams(errors, doubts_of_assumed(BEAMS, UNKNOWN_SENSOR, assumed))
