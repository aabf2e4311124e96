"""Selection of the channels that heights are made of, and their beams."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.calibration import Calibration
from sal_height.elevation import ElevationEstimator, MakeChannels, Window, axis_looks, live_detectors
from sal_height.errors import Rejected
from sal_height.geometry import aperture_at
from sal_height.imaging import Slc, image_beams
from sal_height.numeric import C64, Bool, Index
from sal_height.sensor import KNOWN_BEAMS, BeamErrors, Channels, Sensor, with_powers

NOISE_DIGITS = 9
"""Decimals of the ratios of channels' noise powers: rounding makes them differ from dwell to dwell in the 16th."""


def channels_and_beams(
    slc: Slc,
    sensor: Sensor,
    estimator: ElevationEstimator,
    calibration: Calibration | None,
    live: Index,
    errors: BeamErrors = KNOWN_BEAMS,
) -> tuple[Channels, Beams]:
    """The channels that an estimator uses, of those that are `live`, and their beams; other arguments as of `heights`.

    The uncertainty of the beams follows from the errors of their description and from the calibration.

    They depend on the ratios of the noise powers, which are rounded to NOISE_DIGITS, and hardly ever change from dwell
    to dwell: these have the very same beams then, and all that is cached for them. Powers are in units of the highest.
    """
    powers = slc.noise_power[live]
    level = powers.max() if np.all(np.isfinite(powers) & (powers > 0)) else 1.0
    ratios = tuple(np.round(powers / level, NOISE_DIGITS).tolist())
    channels, beams = _channels_and_beams(
        sensor, estimator.channels, calibration, errors, slc.azimuth_window, tuple(live.tolist()), ratios
    )
    return replace(channels, transform=channels.transform / np.sqrt(level)), beams


@lru_cache(maxsize=8)
def _channels_and_beams(
    sensor: Sensor,
    make_channels: MakeChannels,
    calibration: Calibration | None,
    errors: BeamErrors,
    azimuth_window: str,
    live: tuple[int, ...],
    noise_power: tuple[float, ...],
) -> tuple[Channels, Beams]:
    indices = np.array(live)
    square = np.ix_(indices, indices)
    powers = np.zeros(sensor.detector_count)
    powers[indices] = noise_power
    channels = make_channels(with_powers(sensor.noise_covariance, powers)[square], sensor.mixing[square])
    # The beams in the images, with the width of the calibration, and the uncertainty of both.
    beams = image_beams(sensor, azimuth_window)
    if calibration:
        left = calibration.beam_uncertainty(beams, errors)
        beams = calibration.beams(beams)
    else:
        left = beams.uncertainty_by(errors.gain**2 + errors.phase**2, errors.width)
    uncertainty = float(np.hypot(beams.uncertainty, left))
    beams = replace(beams, uncertainty=uncertainty, pitch_uncertainty=errors.pitch)
    return channels, beams.detectors(indices).combined(channels.matrix)


def channel_sets(slc: Slc, sensor: Sensor, down: Window) -> list[tuple[Index, Bool]]:
    """Sets of channels to estimate heights from, and the rows of height pixels that each is for, (rows,).

    A channel is left out of a row if it is dead, or blanked in one of the looks or less than the spacing of the pixels
    from it, where the response of a scatterer is cut off. Sets of fewer than two channels are left out, and so are
    parts of channels that are mixtures of detectors.

    Args:
        slc: images of all channels.
        sensor: sensor of the images.
        down: number of looks in range.

    Raises:
        Rejected: no row has enough channels.
    """
    live, grid = live_channels(slc.images, sensor), slc.grid
    if not sensor.blanked_ranges:
        return [(live, np.ones(down.pixels(grid.rows), np.bool_))]
    points = grid.points(np.arange(grid.rows)[:, None], np.array([0, grid.cols // 2, grid.cols - 1]))
    slant_range = np.linalg.norm(points - aperture_at(points, slc.aperture).position, axis=-1)
    spacing = grid.row_spacing
    received = sensor.receives(slant_range.min(axis=1) - spacing, slant_range.max(axis=1) + spacing)[live]
    sees = axis_looks(down, grid.rows, None).looks.down((~received.T).astype(np.float64)) == 0
    sets, of_row = np.unique(sees, axis=0, return_inverse=True)
    least = len(live) if sensor.is_mixed else 2
    found = [(live[one], of_row == number) for number, one in enumerate(sets) if np.count_nonzero(one) >= least]
    if not found:
        raise Rejected(
            "blanked channels",
            f"No row of the images is received by {least} channels or more; SensorInfo channels.blanked_ranges leaves "
            "too few to estimate elevations.",
        )
    return found


def live_channels(images: C64, sensor: Sensor) -> Index:
    """Numbers of the channels that are not dead (`looks.live_detectors`).

    Raises:
        Rejected: there are fewer than two, or one is missing of channels that are mixtures of detectors.
    """
    live = live_detectors(images)
    if len(live) < len(images) and sensor.is_mixed:
        dead = sorted(set(range(len(images))) - set(live.tolist()))
        raise Rejected(
            "dead channels",
            f"Channels {dead} have no finite sample other than 0 in the images; the detectors cannot be separated "
            "without one of the channels that the channel matrix of SensorInfo mixes them into.",
        )
    return live
