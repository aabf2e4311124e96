"""The whole procedure from phase history to heights.

Read `dwell` first, then `channels` (the channels of a dwell, and their beams), `instrument` and `beam_errors` (accuracy
of the sensor's description), `fit` (tests of a dwell against it), `calibration_trial` (whether the data contradict a
calibration), `strip` (data that a strip keeps from block to block) and `moving` (movers in images).
"""

from sal_height.pipeline.beam_errors import known_beams
from sal_height.pipeline.calibration_trial import TESTED_BY, CalibrationTrial, can_be_tried
from sal_height.pipeline.channels import channel_sets, channels_and_beams, live_channels
from sal_height.pipeline.dwell import Compressor, corrected_spectrum, elevations, heights, heights_of_dwells
from sal_height.pipeline.instrument import range_covariance
from sal_height.pipeline.moving import dwell_with_movers, movers, strip_with_movers

__all__ = [
    "TESTED_BY",
    "CalibrationTrial",
    "Compressor",
    "can_be_tried",
    "channel_sets",
    "channels_and_beams",
    "corrected_spectrum",
    "dwell_with_movers",
    "elevations",
    "heights",
    "heights_of_dwells",
    "known_beams",
    "live_channels",
    "movers",
    "range_covariance",
    "strip_with_movers",
]
