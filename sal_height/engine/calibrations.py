"""Calibrations: those that arrive, by the sensor they are of, and those that images were made with, by identity."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple, Self

from sal_height.calibration import Calibration
from sal_height.engine.image_items import applied_calibration
from sal_height.engine.kept import Kept
from sal_height.engine.provenance import Provenance
from sal_height.engine.stage import Event, Notice, Port, Result
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
        trial: number of the trial; two of the same calibration have different numbers.
    """

    in_use: Calibration | None = None
    on_trial: Calibration | None = None
    trial: int = 0

    def with_received(self, calibration: Calibration) -> CalibrationChoice:
        """The choice after a calibration was received; the same one if it is known already."""
        if calibration.id in {one.id for one in (self.in_use, self.on_trial) if one}:
            return self
        return CalibrationChoice(self.in_use, calibration, self.trial + 1)

    def decided(self, *, adopted: bool) -> CalibrationChoice:
        """The choice after a trial."""
        return self._replace(in_use=self.on_trial if adopted else self.in_use, on_trial=None)


class ChosenCalibrations:
    """The calibrations to make images with, by config_hash of their sensor."""

    def __init__(self) -> None:
        """Start without any."""
        self._kept = Kept[CalibrationChoice](CALIBRATIONS_KEPT)

    def __copy__(self) -> Self:
        """The same calibrations; the copy receives others later."""
        copied = type(self)()
        copied._kept = copy(self._kept)  # noqa: SLF001 (of our own class)
        return copied

    def receive(self, calibration: Calibration) -> None:
        """Put a calibration on trial, in place of another one that is."""
        name = calibration.config_hash
        self._kept.put(name, (self._kept.get(name) or CalibrationChoice()).with_received(calibration))

    def of(self, sensor: Sensor) -> CalibrationChoice:
        """The calibrations of a sensor; of one whose data cannot be tested each is in use once it was received."""
        choice = self._kept.use(sensor.config_hash) or CalibrationChoice()
        return choice if can_be_tried(sensor) or not choice.on_trial else choice.decided(adopted=True)

    def follow(self, choice: CalibrationChoice, results: Sequence[Result]) -> None:
        """Adopt or refuse the calibration on trial by the results of a dwell, unless another was received since."""
        adopted = any(isinstance(one, Event) and one.name == CALIBRATIONS_ADOPTED for one in results)
        refused = any(isinstance(one, Notice) and one.kind == CALIBRATION_REFUSED for one in results)
        if choice.on_trial and (adopted or refused) and self._kept.get(choice.on_trial.config_hash) == choice:
            self._kept.put(choice.on_trial.config_hash, choice.decided(adopted=adopted))


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
