"""Calibrations on trial: those of the instrument itself, of which none may be refused, and those of other instruments.

Scenes and dwells as of the group `fit`; every trial has one dwell.

    python -m benchmarks trials        rows with targets, into bench.json
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.goodness_of_fit import CNR_DB, SCENES_TRIED, images_of, parts_of
from benchmarks.row import Row, sized
from sal_height.calibration import Calibration
from sal_height.imaging import Slc
from sal_height.numeric import C64, C128, F64
from sal_height.pipeline import CalibrationTrial
from sal_height.sensor import Sensor

CHANNELS = 16

DWELLS = sized(16, 2)
"""Dwells of each scene and CNR."""

ERROR = 0.01
"""Standard deviation of measured gains (relative) and phases (rad)."""


class Instrument(NamedTuple):
    """Departures of an instrument from the description.

    Attributes:
        gains_db: gain of each channel, dB.
        phases: phase of each channel, rad.
        width_factor: width of the beams over their distance, over the described one.
    """

    gains_db: F64 = np.zeros(CHANNELS)
    phases: F64 = np.zeros(CHANNELS)
    width_factor: float = 1.0

    def calibration(self, sensor: Sensor, error: float = 0.0) -> Calibration:
        """The calibration of this instrument, with errors of a standard deviation."""
        rng = np.random.default_rng(3)
        measured = self._gains * np.exp(error * (rng.standard_normal(CHANNELS) + 1j * rng.standard_normal(CHANNELS)))
        sigma = np.full(CHANNELS, error)
        response = np.repeat(measured[:, None], sensor.sample_count, axis=1)
        return Calibration(sensor.config_hash, response, 0 * sigma, sigma, sigma, self.width_factor, 0.001)

    def dwells(self, scene: str, cnr_db: float, dwells: int) -> Iterator[tuple[Slc, Sensor]]:
        """Images of this instrument without a calibration, whose noise powers are known."""
        images = images_of(scene, CHANNELS, dwells, 1 / self.width_factor)
        slc = images.slc(cnr_db)
        yield from ((_times(part, self._gains), images.sensor) for part in parts_of(slc))

    @property
    def _gains(self) -> C128:
        return np.asarray(10 ** (self.gains_db / 20) * np.exp(1j * self.phases), np.complex128)


def _spread(seed: int) -> F64:
    return np.random.default_rng(seed).standard_normal(CHANNELS)


AS_DESCRIBED = Instrument()
DEPARTING = Instrument(1.0 * _spread(7), np.pi * _spread(8), 1.03)


class Foreign(NamedTuple):
    """An instrument whose calibration is used for one that is as described.

    Attributes:
        instrument: the other instrument.
        least: least fractions of dwells at 10, 20 and 30 dB that should refuse it, %.
    """

    instrument: Instrument
    least: tuple[float, float, float]


FOREIGN: dict[str, Foreign] = {
    "gains 2 dB rms": Foreign(Instrument(2.0 * _spread(5)), (90, 95, 95)),
    "gains 1 dB rms": Foreign(Instrument(1.0 * _spread(5)), (0, 50, 80)),
    "phases of any value": Foreign(
        Instrument(phases=np.random.default_rng(6).uniform(-np.pi, np.pi, 16)), (90, 95, 95)
    ),
    "phases .5 rad rms": Foreign(Instrument(phases=0.5 * _spread(6)), (50, 90, 95)),
    "phases .2 rad rms": Foreign(Instrument(phases=0.2 * _spread(6)), (0, 0, 0)),
    "beams 5 % wider": Foreign(Instrument(width_factor=1.05), (10, 90, 95)),
    "beams 2 % wider": Foreign(Instrument(width_factor=1.02), (0, 10, 90)),
}


def tried(slc: Slc, sensor: Sensor, calibration: Calibration, before: Calibration | None = None) -> CalibrationTrial:
    """The trial of a calibration on images without one."""
    trial = CalibrationTrial(calibration, before)
    trial.images(lambda one: calibrated(slc, one), sensor)
    return trial


def calibrated(slc: Slc, calibration: Calibration | None) -> Slc:
    """Images that are made with a calibration whose gains are the same at all frequencies."""
    return _times(slc, calibration.equaliser[:, 0]) if calibration else slc


def _times(slc: Slc, gains: C64 | C128) -> Slc:
    images = (gains[:, None, None] * slc.images).astype(np.complex64)
    return replace(slc, images=images, noise_power=np.abs(gains).astype(np.float64) ** 2 * slc.noise_power)


def refused() -> Iterator[Row]:
    """Rows of the group: right calibrations that are refused, and wrong ones."""
    for name, instrument in (("as described", AS_DESCRIBED), ("that departs from the description", DEPARTING)):
        count = dwells = 0
        for scene in SCENES_TRIED:
            for cnr_db in CNR_DB:
                for slc, sensor in instrument.dwells(scene, cnr_db, DWELLS):
                    count += tried(slc, sensor, instrument.calibration(sensor, ERROR)).adopted is False
                    dwells += 1
        about = f"{len(SCENES_TRIED)} scenes, {CNR_DB} dB"
        yield Row(f"right calibrations refused: sensor {name}", count, f"of {dwells}", "<= 0", about)
    for name, (foreign, least) in FOREIGN.items():
        for scene in ("level", "street"):
            for cnr_db, wanted in zip((10, 20, 30), least, strict=True):
                found = [
                    tried(slc, sensor, foreign.calibration(sensor)).adopted is False
                    for slc, sensor in AS_DESCRIBED.dwells(scene, cnr_db, DWELLS)
                ]
                label = f"calibration of another instrument, {name}: {scene} {cnr_db} dB"
                yield Row(label, 100 * float(np.mean(found)), "%", f">= {wanted:.0f}", "dwells that refuse it")
