"""Trial of a calibration: images made with it are tested before it is used.

A calibration of another instrument or another day is well-formed, and only the data contradict it. Images are made with
it and tested as heights are (`pipeline.fit`). Where the gains of all channels together, or the beams, depart from what
it states, images are made with the calibration in use before it as well: if nothing departs in these, the new one is
refused. A calibration that is better than the one before, or no worse, is adopted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from sal_height.calibration import Calibration
from sal_height.doubts import FitTest
from sal_height.elevation import ESTIMATORS
from sal_height.elevation.fit.channel_gains import BEAM_STRETCH, CHANNEL_GAIN, FEWEST_CHANNELS, common_gain_test
from sal_height.errors import UserError
from sal_height.imaging import Slc
from sal_height.pipeline.dwell import heights
from sal_height.pipeline.fit import HARMLESS, SIGNIFICANCE
from sal_height.sensor import Sensor

TESTED_BY = ESTIMATORS["ml"]
"""Estimator whose fit is tested."""

MOST_UNTESTED = 8
"""Dwells in a row without enough scatterers for the tests, as over water, after which a calibration is adopted."""


class CalibrationTrial:
    """Trial of a calibration on the images of the first dwells that it is for.

    Attributes:
        adopted: True if the calibration is used from now on, False if it is refused; None: not decided yet.
        refusal: warning that states why it is refused; empty: it is not.
        chosen: calibration of the images that were made last; None: none, the sensor is taken as described.
    """

    def __init__(self, calibration: Calibration, before: Calibration | None) -> None:
        """Start a trial.

        Args:
            calibration: calibration on trial.
            before: calibration that is in use; None: none, the sensor is taken as described.
        """
        self.adopted: bool | None = None
        self.refusal = ""
        self.chosen: Calibration | None = calibration
        self._calibration, self._before = calibration, before
        self._untested = 0
        self._has_images = False
        self._strip_before: Slc | None = None
        """Last image of the strip without the calibration."""

    @property
    def settled(self) -> Calibration | None:
        """Calibration in use after the trial as far as it went."""
        return self._calibration if self.adopted else self._before

    @property
    def left_out(self) -> Calibration | None:
        """Calibration that is not in use after the trial as far as it went."""
        return self._before if self.adopted else self._calibration

    def images(self, form: Callable[[Calibration | None], Slc | None], sensor: Sensor) -> Slc | None:
        """Images of a dwell with the calibration that is `chosen` then; None: of too few pulses as yet.

        Args:
            form: function that forms the images of the dwell with a calibration, or without one. It is called once
                with each, for blocks of a strip follow each other.
            sensor: sensor of the dwell.
        """
        if self.adopted is not None:
            self.chosen = self.settled
            return form(self.chosen)
        in_strip = sensor.mode == "stripmap"
        # A strip without the calibration goes on until the one with it has an image, and needs all blocks.
        before = form(self._before) if in_strip else None
        self._strip_before = before or self._strip_before
        slc = form(self._calibration)
        self._has_images = self._has_images or slc is not None
        self.chosen = self._calibration if self._has_images else self._before
        if slc is None:
            return None if self._has_images else before
        gains, stretch = _tests_of(slc, sensor, self._calibration)
        departing = [test for test in (gains, stretch) if _departs(test)]
        other = (self._strip_before if in_strip else form(self._before)) if departing else None
        if other:
            self.refusal = self._contradiction(departing[0], _tests_of(other, sensor, self._before))
            if self.refusal:
                self.adopted, self.chosen, self._strip_before = False, self._before, None
                return before if in_strip else other
        self._untested += math.isnan(gains.p_value)
        if math.isfinite(gains.p_value) or self._untested >= MOST_UNTESTED:
            self.adopted, self._strip_before = True, None
        return slc

    def _contradiction(self, departing: FitTest, tests_before: Sequence[FitTest]) -> str:
        """Warning that the data contradict the calibration and not what was in use before; empty: they do not.

        What is wrong in the dwell itself, as with interference, departs with both by nearly as much.
        """
        (before,) = (test for test in tests_before if test.name == departing.name)
        if any(map(_departs, tests_before)) or not before.statistic <= departing.statistic / 2:
            return ""
        former = f"calibration {self._before.id}" if self._before else "the description of the sensor alone"
        return (
            f"Calibration {self._calibration.id} is refused: with it {_described(departing)}, with {former} by "
            f"{_percent(before)}. It may be of another instrument or another day; images are made with {former}. "
            "Calibrate the sensor again (sal-height calibrate), or leave the calibration out."
        )


def can_be_tried(sensor: Sensor) -> bool:
    """True if the tests of gains are possible: with enough channels that are not mixtures of detectors."""
    return sensor.detector_count >= FEWEST_CHANNELS and not sensor.is_mixed


def _tests_of(slc: Slc, sensor: Sensor, calibration: Calibration | None) -> tuple[FitTest, FitTest]:
    """Tests of the gains of all channels and of the beams; NaN of images that no heights can be made of."""
    try:
        tests = heights(slc, sensor, TESTED_BY, TESTED_BY.settings(), calibration).fit
    except UserError:  # which the heights will state
        tests = ()
    stretch = next((test for test in tests if test.name == BEAM_STRETCH), FitTest(BEAM_STRETCH))
    return common_gain_test(tests), stretch


def _departs(test: FitTest) -> bool:
    """True if a test is significant, and large; of all gains together what is significant is large."""
    least, greatest = HARMLESS[BEAM_STRETCH] if test.name == BEAM_STRETCH else (0.0, 0.0)
    return test.p_value < SIGNIFICANCE / 2 and not least <= test.size <= greatest


def _described(test: FitTest) -> str:
    """The part of a sentence that states what departs, and by how much."""
    if test.name == CHANNEL_GAIN:
        return f"the gains of the channels depart from those of the beams by {_percent(test)} rms"
    return f"the width of the beams over the distance between them departs by {_percent(test)}"


def _percent(test: FitTest) -> str:
    return f"{100 * test.size:.1f} %"
