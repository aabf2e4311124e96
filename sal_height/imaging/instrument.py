"""Errors of an instrument that its description leaves: of mounting, range and clocks, stated or assumed.

Each is a shift of the antenna or a turn of the body that all pixels of a flight share. What somebody states decides on
autofocus and the placement of images; what is only assumed, because nobody states it, covers the heights.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sal_height.geometry import ApertureState
from sal_height.imaging.pixels import line_of_sight
from sal_height.numeric import F64
from sal_height.sensor import AS_DESCRIBED, Sensor, StandardDeviation, deviation_of
from sal_height.settings import Settings, setting

BORESIGHT_RAD, LEVER_ARM_M, ODOMETRY_DELAY_S, SAMPLE_CLOCK = 1e-3, 0.1, 1e-3, 2e-6
"""Standard deviations of an instrument that nobody has calibrated: boresight by a mechanic's alignment, lever arm
between housings rather than phase centres (a tape between marked points gives 2 cm), stamps by a computer, clock by a
crystal."""

RANGE_DELAY_M = 0.15
"""The same of the delay of echoes, as of half a metre of cable; one range cell where that is more."""


class InstrumentSettings(Settings):
    """Standard deviations of errors of the instrument."""

    range_sigma_m: float = setting(
        AS_DESCRIBED,
        "standard deviation of what is left of the range offset; 0: exact; -1: as the sensor's description states, or "
        f"else {RANGE_DELAY_M:g} m, or a range cell if that is more",
        unit="m",
        minimum=-1.0,
        maximum=1e4,
    )
    odometry_delay_sigma_s: float = setting(
        AS_DESCRIBED,
        "standard deviation of what is left of the delay of the odometry; 0: exact; -1: as the sensor's description "
        f"states, or else {ODOMETRY_DELAY_S:g} s",
        unit="s",
        minimum=-1.0,
        maximum=10.0,
    )
    lever_arm_sigma_m: float = setting(
        AS_DESCRIBED,
        "standard deviation of each component of the lever arm; 0: exact; -1: as the sensor's description states, or "
        f"else {LEVER_ARM_M:g} m",
        unit="m",
        minimum=-1.0,
        maximum=100.0,
    )
    boresight_sigma_rad: float = setting(
        AS_DESCRIBED,
        "standard deviation of the rotation of the mounting about each axis; 0: exact; -1: as the sensor's description "
        f"states, or else {BORESIGHT_RAD:g} rad",
        unit="rad",
        minimum=-1.0,
        maximum=0.1,
    )
    sample_clock_sigma: float = setting(
        AS_DESCRIBED,
        "relative standard deviation of the rate of the sample clock, an error in proportion to range; 0: exact; -1: "
        f"as the sensor's description states, or else {SAMPLE_CLOCK:g}",
        minimum=-1.0,
        maximum=0.1,
    )


class InstrumentError(NamedTuple):
    """Independent errors of one kind.

    Attributes:
        name: name with the assumed value, as in a message.
        parameter: parameter that states it.
        effects: shift of the antenna (m) and turn of the body about the axes of map (rad) by one standard deviation of
            each, shape (errors, 6).
        is_assumed: True if nobody stated it.
    """

    name: str
    parameter: str
    effects: F64
    is_assumed: bool


def instrument_errors(
    aperture: ApertureState, middle: F64, sensor: Sensor, settings: InstrumentSettings
) -> Iterator[InstrumentError]:
    """The errors that the description of a sensor leaves.

    Args:
        aperture: state of the antenna.
        middle: middle of the image in map, m, shape (3,).
        sensor: sensor with its mounting.
        settings: settings whose standard deviations replace those of the description.
    """
    described, sight = sensor.uncertainty, line_of_sight(sensor, aperture)
    # From the axes of base_link, in which covariances of the mounting are, to those of map.
    body = aperture.rotation @ sensor.mounting.axes.inv().as_matrix()
    covariance = sensor.mounting.lever_arm_covariance
    arm = _mounted(settings.lever_arm_sigma_m, covariance, LEVER_ARM_M, body)
    yield _shift("lever arm {:g} m in each direction", "lever_arm_sigma_m", *arm)
    cell = max(RANGE_DELAY_M, sensor.range_resolution)
    delay = deviation_of(settings.range_sigma_m, described.range_delay, cell)
    yield _shift("range delay {:.3g} m", "range_sigma_m", delay, sight[None])
    late = deviation_of(settings.odometry_delay_sigma_s, described.odometry_delay, ODOMETRY_DELAY_S)
    yield _shift("time stamps of odometry {:g} s", "odometry_delay_sigma_s", late, aperture.velocity[None])
    covariance = sensor.mounting.rotation_covariance
    turn = _mounted(settings.boresight_sigma_rad, covariance, BORESIGHT_RAD, body)
    yield _turn("boresight {:g} rad about each axis", "boresight_sigma_rad", *turn)
    clock = deviation_of(settings.sample_clock_sigma, described.sample_clock, SAMPLE_CLOCK)
    slant_range = np.linalg.norm(middle - aperture.position)
    yield _shift("sample clock {:g} of range", "sample_clock_sigma", clock, slant_range * sight[None])


def _shift(name: str, parameter: str, known: StandardDeviation, directions: F64) -> InstrumentError:
    """Errors that shift the antenna in these directions, shape (errors, 3)."""
    effects = known.sigma * np.hstack([directions, np.zeros_like(directions)])
    return InstrumentError(name.format(known.sigma), parameter, effects, known.is_assumed)


def _turn(name: str, parameter: str, known: StandardDeviation, axes: F64) -> InstrumentError:
    """Errors that turn the body about these axes of map, shape (errors, 3)."""
    effects = known.sigma * np.hstack([np.zeros_like(axes), axes])
    return InstrumentError(name.format(known.sigma), parameter, effects, known.is_assumed)


def _mounted(
    parameter: float, covariance: tuple[float, ...] | None, usual: float, body: F64
) -> tuple[StandardDeviation, F64]:
    """The standard deviation of the mounting, and its directions in map: of the same size, unless described otherwise.

    Args:
        parameter: value of the parameter.
        covariance: covariance in the axes of base_link, 9 numbers; None: not known.
        usual: standard deviation that is assumed if neither is stated.
        body: matrix from the axes of base_link to those of map.
    """
    if covariance is None or parameter >= 0:
        return deviation_of(parameter, None, usual), np.eye(3)
    variances, directions = np.linalg.eigh(np.reshape(covariance, (3, 3)))
    return StandardDeviation(1.0, is_assumed=False), (body @ (directions * np.sqrt(np.maximum(variances, 0.0)))).T
