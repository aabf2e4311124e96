"""Calibrations: those that arrive, by the sensor they are of, and those that images were made with, by identity."""

from __future__ import annotations

from copy import copy
from typing import NamedTuple, Self

from sal_height.calibration import Calibration
from sal_height.engine.image_items import applied_calibration
from sal_height.engine.kept import Kept
from sal_height.engine.provenance import Provenance
from sal_height.engine.stage import Port
from sal_height.errors import Rejected
from sal_height.sensor import Sensor
from sal_height.topics import CALIBRATION

CALIBRATIONS_KEPT = 4
"""Calibrations that a stage keeps: images made with one may arrive after the next."""

CALIBRATIONS_ARRIVED = "calibrations"
"""Name of the event that a calibration has arrived."""


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
