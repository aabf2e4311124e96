"""Height errors that calibration leaves of a sensor that is not as described: on flights, by the core alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.row import Row, sized
from benchmarks.spread import in_processes
from sal_height.calibration import Calibration, Calibrator
from sal_height.elevation import ESTIMATORS, ElevationEstimate, MlSettings
from sal_height.geometry import Trajectory
from sal_height.imaging import ImageSettings, focus_dwell
from sal_height.numeric import F64
from sal_height.pipeline import Compressor, elevations
from sal_height.sensor import PhaseHistory
from sal_height.simulation import Impairments, RangeSawtooth, SimulatedFlight, flight_of, load_preset

DWELLS = sized(100, 4)
"""Of preset small: a second of flight."""

COMPARED = sized(8, 1)
"""Dwells of each flight whose heights are compared."""

SEEDS = sized((1, 2), (1,))
"""Of the flights: what is left of a sawtooth varies by a factor of 7 from one to the next."""

CNR_DB, CLEAR_DB = 20.0, 40.0
"""At which the sensor is calibrated, and at which heights are compared, so that not the noise is."""

MIN_CNR_DB = 10 * np.log10(3)

SAWTOOTH = Impairments(range_sawtooth=RangeSawtooth(depth=0.1, teeth=16, receivers=(3,)))
GAINS_DB = (0.5, -0.5, 0.5, -0.5, -0.5, 0.5, -0.5, 0.5)
PHASES_RAD = tuple(np.radians([5.0, 5.0, -5.0, -5.0, 5.0, 5.0, -5.0, -5.0]).tolist())
BEAMS = Impairments(beam_width_factor=1.05, undescribed_gains_db=GAINS_DB, undescribed_phases_rad=PHASES_RAD)


def left_of_errors() -> Iterator[Row]:
    """Elevations less those that the true calibration gives of the same frames: rms after over before."""
    names = ("sawtooth of 10 % on one receiver", "beams 5 %, .5 dB, 5 deg")
    of_flights = in_processes(_squares_of_a_flight, [(kind, seed) for kind in (SAWTOOTH, BEAMS) for seed in SEEDS])
    for name in names:
        squares = np.concatenate([next(of_flights) for _ in SEEDS], axis=1)
        before, after = np.sqrt(np.mean(squares, axis=1))
        yield Row(
            f"elevation error left by calibration, {name}",
            after / before,
            "1",
            "<= 0.1",
            f"{len(SEEDS)} flights of {DWELLS} dwells of small; rms {1e3 * before:.2f} before, "
            f"{1e3 * after:.2f} after, 1e-3 beamwidths, in {COMPARED} dwells each",
        )


def _squares_of_a_flight(part: tuple[Impairments, int]) -> F64:
    """Squared distances before and after calibration, shape (2, pixels), of a flight with this seed."""
    impairments, seed = part
    calibration = _calibrated(_flight(impairments, CNR_DB, seed))
    if impairments.range_sawtooth:
        calibration = _of_the_band(calibration)
    return np.concatenate(_square_errors(_flight(impairments, CLEAR_DB, seed), calibration), axis=1)


def _of_the_band(calibration: Calibration) -> Calibration:
    """The calibration without gains and width, whose own errors are greater than what a sawtooth does."""
    return replace(
        calibration, response=calibration.response / calibration.response.mean(axis=1)[:, None], width_factor=1
    )


def _flight(impairments: Impairments, cnr_db: float, seed: int) -> SimulatedFlight:
    return flight_of(replace(load_preset("small"), dwells=DWELLS, impairments=impairments, cnr_db=cnr_db), seed=seed)


def _track(flight: SimulatedFlight, dwells: int) -> Trajectory:
    return Trajectory([state for dwell in range(dwells) for state in flight.platform_states(dwell)])


def _calibrated(flight: SimulatedFlight) -> Calibration:
    sensor, track = flight.sensor, _track(flight, DWELLS)
    calibrator = Calibrator(sensor)
    settings = ImageSettings(
        air="none", range_window="rectangular", azimuth_window="rectangular", cols=flight.preset.image.cols
    )
    for dwell in range(DWELLS):
        slc = focus_dwell(flight.phase_history(dwell), track, sensor, settings)
        calibrator.add(slc)
    return calibrator.calibration()[0]


def _square_errors(flight: SimulatedFlight, calibration: Calibration) -> list[F64]:
    """Squared distances to the elevations that the true calibration gives, beamwidths, of the pixels valid in all.

    One array for each dwell, of shape (2, pixels): before calibration and after.
    """
    impairments, sensor = flight.preset.impairments, flight.sensor
    none = replace(calibration, response=np.ones_like(calibration.response), width_factor=1.0)
    true = replace(none, response=impairments.receiver_response(sensor), width_factor=impairments.beam_width_factor)
    squares = []
    for dwell in range(COMPARED):
        history = flight.phase_history(dwell)
        truth, *estimates = (_estimate(flight, dwell, history, one) for one in (true, none, calibration))
        valid = np.all([one.validity == 0 for one in (truth, *estimates)], axis=0)
        off = np.array([(one.elevation - truth.elevation)[valid] for one in estimates]) / sensor.beamwidth
        squares.append(off**2)
    return squares


def _estimate(
    flight: SimulatedFlight, dwell: int, history: PhaseHistory, calibration: Calibration
) -> ElevationEstimate:
    sensor, image = flight.sensor, flight.preset.image
    settings = ImageSettings(air="none", rows=image.rows, cols=image.cols)
    slc = Compressor().add(history, _track(flight, dwell + 1), sensor, settings, calibration)
    if slc is None:
        raise RuntimeError("A spotlight dwell makes an image.")
    wanted = MlSettings(min_cnr_db=MIN_CNR_DB, layover=False)
    return elevations(slc, sensor, ESTIMATORS["ml"], wanted, calibration)[0]
