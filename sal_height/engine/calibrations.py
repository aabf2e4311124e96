"""Calibrations: those that arrive, by the sensor they are of, and those that images were made with, by identity."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple, Self

from sal_height.calibration import Calibration
from sal_height.engine.image_items import applied_calibration
from sal_height.engine.kept import Kept
from sal_height.engine.provenance import Provenance
from sal_height.engine.results import Event, Notice, Result
from sal_height.engine.stage import Port
from sal_height.errors import Rejected
from sal_height.pipeline import can_be_tried
from sal_height.sensor import Sensor
from sal_height.topics import CALIBRATION

CALIBRATIONS_KEPT = 4
"""Calibrations that a stage keeps: images made with one may arrive after the next."""

CALIBRATIONS_ARRIVED, CALIBRATIONS_ADOPTED = "calibrations", "calibrations.adopted"
"""Names of the events that a calibration has arrived, and that the data agree with one."""

CALIBRATION_REFUSED = "calibration refused"
"""Name under which calibrations are counted that the data contradict."""


class StatedCalibration(NamedTuple):
    """A calibration as its message states it.

    Attributes:
        calibration: calibration of receivers and beams.
        stamp_ns: stamp of the last dwell that it was made from, ns.
        undetermined: warning for each part that could not be determined.
    """

    calibration: Calibration
    stamp_ns: int = 0
    undetermined: tuple[str, ...] = ()


CALIBRATION_PORT = Port(
    CALIBRATION, StatedCalibration, "calibration of receivers and beams, latched", latched=True, optional=True
)


class CalibrationChoice(NamedTuple):
    """The calibration of a sensor that is in use, and one that was received since.

    Attributes:
        in_use: calibration in use; None: none.
        on_trial: calibration that is adopted or refused by the next dwells; None: none.
        trial: number of the trial; no two trials of a stage have the same.
        first_open: number of the first trial whose outcome was not known when `on_trial` was received; 0: there was
            none. The calibration that it may have adopted is in use then.
    """

    in_use: Calibration | None = None
    on_trial: Calibration | None = None
    trial: int = 0
    first_open: int = 0

    def with_received(self, calibration: Calibration, trial: int) -> CalibrationChoice:
        """The choice after a calibration was received, which may have a trial of that number; the last one counts.

        The one in use is tried again if another one was on trial, which may have been adopted by then.
        """
        if self.on_trial and self.on_trial.id == calibration.id:
            return self
        if self.in_use and self.in_use.id == calibration.id and not self.on_trial:
            return self
        return CalibrationChoice(
            self.in_use, calibration, trial, (self.first_open or self.trial) if self.on_trial else 0
        )

    def decided(self, *, adopted: bool) -> CalibrationChoice:
        """The choice after a trial."""
        return CalibrationChoice(self.on_trial if adopted else self.in_use)

    def after(self, earlier: CalibrationChoice, *, adopted: bool) -> CalibrationChoice:
        """The choice after the trial of `earlier`: this one, or one before it whose outcome was open."""
        if self.on_trial and earlier.trial == self.trial:
            return self.decided(adopted=adopted)
        was_open = self.on_trial and 0 < self.first_open <= earlier.trial < self.trial
        return self._replace(in_use=earlier.on_trial) if was_open and adopted else self


class ChosenCalibrations:
    """The calibrations to make images with, by config_hash of their sensor."""

    def __init__(self) -> None:
        """Start without any."""
        self._kept = Kept[CalibrationChoice](CALIBRATIONS_KEPT)
        self._count = 0

    def __copy__(self) -> Self:
        """The same calibrations; the copy receives others later."""
        copied = type(self)()
        copied._kept, copied._count = copy(self._kept), self._count  # noqa: SLF001 (of our own class)
        return copied

    def receive(self, calibration: Calibration) -> None:
        """Put a calibration on trial, in place of another one that is."""
        name = calibration.config_hash
        self._count += 1
        self._kept.put(name, (self._kept.get(name) or CalibrationChoice()).with_received(calibration, self._count))

    def of(self, sensor: Sensor) -> CalibrationChoice:
        """The calibrations of a sensor; of one whose data cannot be tested each is in use once it was received."""
        choice = self._kept.use(sensor.config_hash) or CalibrationChoice()
        return choice if can_be_tried(sensor) or not choice.on_trial else choice.decided(adopted=True)

    def follow(self, choice: CalibrationChoice, results: Sequence[Result]) -> None:
        """Adopt or refuse the calibration on trial by the results of a dwell."""
        adopted = any(isinstance(one, Event) and one.name == CALIBRATIONS_ADOPTED for one in results)
        refused = any(isinstance(one, Notice) and one.kind == CALIBRATION_REFUSED for one in results)
        now = self._kept.get(choice.on_trial.config_hash) if choice.on_trial and (adopted or refused) else None
        if choice.on_trial and now:
            self._kept.put(choice.on_trial.config_hash, now.after(choice, adopted=adopted))


class Calibrations:
    """The calibrations that images were made with."""

    def __init__(self) -> None:
        """Start without any."""
        self._kept = Kept[Calibration](CALIBRATIONS_KEPT)

    def __copy__(self) -> Self:
        """The same calibrations; the copy keeps others later."""
        copied = type(self)()
        copied._kept = copy(self._kept)  # noqa: SLF001 (of our own class)
        return copied

    def add(self, calibration: Calibration) -> None:
        """Keep a calibration."""
        self._kept.put(calibration.id, calibration)

    def of(self, provenance: Provenance, sensor: Sensor, dwell: int) -> Calibration | None:
        """The calibration that images were made with; None: the sensor's own, or none.

        Raises:
            Rejected: it has not arrived.
        """
        applied = applied_calibration(provenance, sensor)
        calibration = self._kept.use(applied) if applied else None
        if applied and calibration is None:
            raise Rejected(
                "no calibration",
                f"Dwell {dwell}: its images were made with calibration {applied!r}, which was not received on topic "
                "calibration (transient local).",
            )
        return calibration
