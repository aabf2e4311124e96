"""The whole way from phase history to heights, each step one line.

`Compressor` makes the images of all channels of a dwell, or of what a block completes of a strip; `heights` makes the
heights of one such set of images, `heights_of_dwells` those of several at once. The ROS nodes only turn messages into
these calls and back.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.beams import Beams, column_squint
from sal_height.calibration import Calibration
from sal_height.elevation import (
    CellResponse,
    ElevationEstimate,
    ElevationEstimator,
    HeightSettings,
    Looks,
    look_grid,
    moving_squint,
    sidelobe_variance,
    windowed_looks,
    with_foreign_power,
    without_imprecise,
    without_saturated,
)
from sal_height.geometry import Grid, Trajectory
from sal_height.imaging import (
    Corrected,
    CorrectionSettings,
    ImageSettings,
    Slc,
    cell_response,
    correct_dwell,
    focus_dwell,
    with_known_errors,
)
from sal_height.numeric import Index
from sal_height.pipeline.channels import channel_sets, channels_and_beams, live_channels
from sal_height.pipeline.strip import StripBuffer
from sal_height.relief import HeightField, height_field, joined_rows, level_turn
from sal_height.sensor import PhaseHistory, Sensor, count_saturated, range_compressed


class Compressor:
    """From the phase history of dwells to the images of all channels.

    In spotlight each dwell is an image. In stripmap dwells are consecutive blocks of pulses; those that the next image
    still needs are held, with their track and their shares of clipped samples.
    """

    def __init__(self) -> None:
        """Start without a strip."""
        self._strip = StripBuffer()

    def add(
        self,
        history: PhaseHistory,
        track: Trajectory,
        sensor: Sensor,
        settings: ImageSettings,
        calibration: Calibration | None = None,
    ) -> Slc | None:
        """Images of a dwell, or of the columns that a block completes of a strip; None: of too few as yet.

        Args:
            history: of all channels, as the sensor delivers it.
            track: of the platform, from the first pulse or before to the last or after.
            sensor: that took it.
            settings: what image is wanted.
            calibration: of the sensor's receivers, taken out of the samples; None: they are as described.

        Raises:
            Rejected: pulses or frequencies do not sample the scene, or the block comes out of order.
            UserError: an image that cannot be made, a track that does not cover the pulses, air that is not known, or
                the calibration of another sensor.
        """
        # Samples over frequency, without the errors that are known.
        corrected = corrected_spectrum(history, track, sensor, settings, calibration)
        # Azimuth compression, with one and the same filter for all channels.
        if sensor.mode == "spotlight":
            slc: Slc | None = focus_dwell(corrected.history, corrected.track, corrected.sensor, settings)
        else:
            slc = self._strip.focus_block(corrected, settings, calibration)
        # What the corrections leave is an error that all pixels share.
        if slc:
            slc = replace(slc, aperture=with_known_errors(slc.aperture, corrected.sensor, settings))
        # The calibration has raised the noise of channels that were weak.
        if slc and calibration:
            slc = replace(slc, noise_power=calibration.noise_gains(settings.range_window) * slc.noise_power)
        return slc

    @property
    def shortfall(self) -> str:
        """Why the block that began a strip completed no image, a sentence; empty: it did, or was not the last one."""
        return self._strip.shortfall


def corrected_spectrum(
    history: PhaseHistory,
    track: Trajectory,
    sensor: Sensor,
    settings: CorrectionSettings,
    calibration: Calibration | None = None,
) -> Corrected:
    """Samples over fast-time frequency, the track, and the sensor that has such samples; without known errors.

    Arguments are those of `Compressor.add`.

    Raises:
        UserError: air that is not known, or the calibration of another sensor.
    """
    # Clipped samples are counted while they are still those of the receivers.
    counted = count_saturated(history, sensor)
    # Range compression: samples over fast-time frequency, whatever the waveform.
    spectrum, sensor = range_compressed(counted, sensor)
    # Calibration: all channels get one response over the band.
    if calibration:
        calibration.check(sensor)
        spectrum = calibration.equalised(spectrum)
    # Errors that are known: clocks, delays, and air.
    return correct_dwell(spectrum, track, sensor, settings)


def heights(
    slc: Slc,
    sensor: Sensor,
    estimator: ElevationEstimator,
    settings: HeightSettings,
    calibration: Calibration | None = None,
) -> HeightField:
    """Height, its standard deviation and a place, or the reason why there is none, for every pixel of a dwell.

    Where receivers are blanked, every row of pixels is estimated from the channels that receive all of it, and is
    MISSING_DATA if these are too few. Arguments and errors as of `elevations`.
    """
    return heights_of_dwells([slc], sensor, estimator, settings, calibration)[0]


def heights_of_dwells(
    slcs: Sequence[Slc],
    sensor: Sensor,
    estimator: ElevationEstimator,
    settings: HeightSettings,
    calibration: Calibration | None = None,
) -> list[HeightField]:
    """`heights` of several dwells, the same as one by one, in less time: elevations are estimated of all at once."""
    dwells = [
        [
            (rows, Observed.of(slc, sensor, estimator, settings, calibration, channels))
            for channels, rows in channel_sets(slc, sensor, settings.windows[0])
        ]
        for slc in slcs
    ]
    estimates = iter(estimate_together([seen for dwell in dwells for _, seen in dwell], estimator, settings))
    # Range, Doppler and elevation give the place on the ground.
    side, velocity = sensor.look_side, settings.radial_velocity_mps
    return [
        joined_rows(
            [
                (
                    rows,
                    height_field(
                        next(estimates), seen.looks, slc.grid, seen.grid, slc.aperture, side, velocity, seen.beams
                    ),
                )
                for rows, seen in dwell
            ]
        )
        for slc, dwell in zip(slcs, dwells, strict=True)
    ]


def elevations(
    slc: Slc,
    sensor: Sensor,
    estimator: ElevationEstimator,
    settings: HeightSettings,
    calibration: Calibration | None = None,
    channels_used: Index | None = None,
) -> tuple[ElevationEstimate, Looks, Grid, Beams]:
    """Elevation of every height pixel, the looks that it was estimated from, the grid of the pixels, and the beams.

    Args:
        slc: images of all channels.
        sensor: whose phase history they were made from.
        estimator: one of `elevation.ESTIMATORS`.
        settings: of the estimator, an object of its class `estimator.settings`.
        calibration: that the images were made with; None: the beams are as the sensor describes them.
        channels_used: numbers of the channels to estimate from; None: all that are not dead.

    Raises:
        Rejected: too few channels have a signal, or they are not those that the estimator needs.
        UserError: looks that do not fit in the image, or noise powers that are not known.
    """
    seen = Observed.of(slc, sensor, estimator, settings, calibration, channels_used)
    (estimate,) = estimate_together([seen], estimator, settings)
    return estimate, seen.looks, seen.grid, seen.beams


@dataclass(frozen=True, eq=False)
class Observed:
    """What an estimator takes of a dwell, and what its estimate is judged by.

    Attributes:
        looks: of the channels.
        beams: of the channels; those of the next dwell are the same object if nothing has changed.
        grid: of the height pixels.
        response: of the images.
        saturated_share: the greatest of the channels.
    """

    looks: Looks
    beams: Beams
    grid: Grid
    response: CellResponse
    saturated_share: float

    @classmethod
    def of(
        cls,
        slc: Slc,
        sensor: Sensor,
        estimator: ElevationEstimator,
        settings: HeightSettings,
        calibration: Calibration | None,
        channels_used: Index | None,
    ) -> Self:
        """The looks of a dwell; arguments and errors as of `elevations`."""
        # Channels without any signal are left out.
        live = live_channels(slc.images, sensor) if channels_used is None else channels_used
        images = slc.images if len(live) == len(slc.images) else slc.images[live]
        # The channels that the estimator takes, of equal noise, or sum and difference; and their beams.
        channels, beams = channels_and_beams(slc, sensor, estimator, calibration, live)
        # The height pixels, and the squint of each column; a target that moves is seen at another one than its pixel.
        grid = look_grid(slc.grid, *settings.windows)
        squint = column_squint(grid, slc.aperture, sensor.beams, sensor.look_side)
        squint = moving_squint(squint, settings.radial_velocity_mps, np.linalg.norm(slc.aperture.velocity))
        # Looks: the covariance of the channels in each of them, and what sidelobes and other ranges bring to a pixel.
        response = cell_response(slc, sensor)
        turn = level_turn(float(np.mean(beams.span)), slc.grid, slc.aperture, sensor.look_side)
        looks = windowed_looks(images, settings.windows, squint, channels, beams.is_complex, response, turn)
        return cls(looks, beams, grid, response, float(slc.saturated_share[live].max()))

    @property
    def kind(self) -> Hashable:
        """Looks of the same kind can be put side by side; those that are too large to be held are of none."""
        covariance = self.looks.covariance
        held = None if isinstance(covariance, np.ndarray) else id(covariance)
        return held, id(self.beams), covariance.shape, tuple(self.looks.noise_powers.tolist())


def estimate_together(
    observed: Sequence[Observed], estimator: ElevationEstimator, settings: HeightSettings
) -> list[ElevationEstimate]:
    """Elevation of every height pixel of some dwells; those whose looks are of one kind are estimated at once."""
    kinds: dict[Hashable, list[int]] = {}
    for number, seen in enumerate(observed):
        kinds.setdefault(seen.kind, []).append(number)
    found: dict[int, ElevationEstimate] = {}
    for numbers in kinds.values():
        # Elevation from the ratios between channels, which clipped samples spoil.
        looks = Looks.side_by_side([observed[number].looks for number in numbers])
        estimate = estimator.estimate(looks, observed[numbers[0]].beams, settings)
        found |= dict(zip(numbers, estimate.of_dwells(len(numbers)), strict=True))
    return [judged(found[number], seen, settings) for number, seen in enumerate(observed)]


def judged(estimate: ElevationEstimate, seen: Observed, settings: HeightSettings) -> ElevationEstimate:
    """The estimate with the error by scatterers elsewhere, without what is imprecise, or spoilt by clipped samples."""
    looks, beams = seen.looks, seen.beams
    # The error by scatterers elsewhere, whose sidelobes are in the pixel, and pixels that noise leaves uncertain.
    foreign = sidelobe_variance(estimate.elevation, looks, beams, settings.windows, seen.response)
    estimate = with_foreign_power(estimate, foreign)
    estimate = without_imprecise(estimate, settings.max_sigma_beamwidths * beams.beamwidth)
    return without_saturated(estimate) if seen.saturated_share > settings.max_saturated_share else estimate
