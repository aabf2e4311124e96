"""From the phase history of a dwell to its heights: the whole procedure, to be read from top to bottom.

Steps 1 to 5 make the images of all channels (`Compressor`), steps 6 to 17 the heights of these images by one estimator
(`heights`; `heights_of_dwells` takes several dwells at once). Step 18, which follows the relief from dwell to dwell, is
`relief.track`.

All of it is the same to the last bit for a dwell alone and among others, and for any number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
    narrow_band_doubts,
    with_ambiguous_position,
    with_known_errors,
    with_unknown_odometry,
)
from sal_height.numeric import Bool, Index, one_blas_thread
from sal_height.pipeline.beam_errors import KnownBeams, known_beams
from sal_height.pipeline.channels import channel_sets, channels_and_beams, live_channels
from sal_height.pipeline.fit import (
    DwellFit,
    fit_of,
    gain_left,
    with_measured_channel_noise,
    with_measured_gains,
    with_measured_noise,
    without_silent,
)
from sal_height.pipeline.instrument import with_instrument
from sal_height.pipeline.strip import StripBuffer
from sal_height.relief import HeightField, height_field, joined_rows, level_turn
from sal_height.sensor import BeamErrors, PhaseHistory, Sensor, count_saturated, range_compressed


class Compressor:
    """From the phase history of dwells to the images of all channels.

    In spotlight each dwell is an image. In stripmap dwells are consecutive blocks of pulses; those that the next image
    still needs are kept, with their track and their fractions of clipped samples.
    """

    def __init__(self) -> None:
        """Start without a strip."""
        self._strip = StripBuffer()

    @one_blas_thread()
    def add(
        self,
        history: PhaseHistory,
        track: Trajectory,
        sensor: Sensor,
        settings: ImageSettings,
        calibration: Calibration | None = None,
    ) -> Slc | None:
        """Form images of a dwell, or of the columns of a strip that a block completes; None: too few as yet.

        Args:
            history: phase history of all channels, as the sensor delivers it.
            track: track of the platform, from the first pulse or before to the last or after.
            sensor: sensor of the phase history.
            settings: settings of the image.
            calibration: calibration of the sensor's receivers, removed from the samples; None: as described.

        Raises:
            Rejected: pulses or frequencies do not sample the scene, or the block is out of order.
            UserError: an image that cannot be made, a track that does not cover the pulses, unknown air, or
                the calibration of another sensor.
        """
        corrected = corrected_spectrum(history, track, sensor, settings, calibration)
        emitters = narrow_band_doubts(corrected.history.samples, corrected.sensor)
        # 5  Azimuth compression, autofocus included, with one and the same filter for all channels.
        if corrected.sensor.mode == "spotlight":
            slc: Slc | None = focus_dwell(corrected.history, corrected.track, corrected.sensor, settings)
        else:
            slc = self._strip.focus_block(corrected, settings, calibration)
        # The corrections and odometry leave a common error of all pixels, stated or assumed.
        if slc:
            stated = with_known_errors(slc.aperture, slc.grid.middle, corrected.sensor, settings).covariance
            slc = with_unknown_odometry(with_instrument(slc, corrected.sensor, settings), corrected)
            slc = with_ambiguous_position(slc, corrected.sensor, stated)
            slc = replace(slc, doubts=(*slc.doubts, *emitters)) if emitters else slc
        # The calibration has raised the noise of channels that were weak.
        if slc and calibration:
            slc = replace(slc, noise_power=calibration.noise_gains(settings.range_window) * slc.noise_power)
        return slc

    @property
    def shortfall(self) -> str:
        """Why the block that started a strip completed no image, a sentence; empty: it did, or was not the last one."""
        return self._strip.shortfall


@one_blas_thread()
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
    # 1  Clipped samples are counted while they are still those of the receivers.
    counted = count_saturated(history, sensor)
    # 2  Range compression: samples over fast-time frequency, whatever the waveform.
    spectrum, sensor = range_compressed(counted, sensor)
    # 3  Calibration: all channels get one response over the band.
    if calibration:
        calibration.check(sensor)
        spectrum = calibration.equalised(spectrum)
    # 4  Errors that are known: clocks, delays, and air.
    return correct_dwell(spectrum, track, sensor, settings)


def heights(
    slc: Slc,
    sensor: Sensor,
    estimator: ElevationEstimator,
    settings: HeightSettings,
    calibration: Calibration | None = None,
) -> HeightField:
    """Height, its standard deviation and a position, or the reason why it is invalid, for every pixel of a dwell.

    Where receivers are blanked, every row of pixels is estimated from the channels that receive all of it, and is
    MISSING_DATA if these are too few. Arguments and errors as of `elevations`.
    """
    return heights_of_dwells([slc], sensor, estimator, settings, calibration)[0]


@one_blas_thread()
def heights_of_dwells(
    slcs: Sequence[Slc],
    sensor: Sensor,
    estimator: ElevationEstimator,
    settings: HeightSettings,
    calibration: Calibration | None = None,
) -> list[HeightField]:
    """`heights` of several dwells, the same as one by one, in less time; arguments and errors as of `elevations`."""
    known = known_beams(sensor, settings, calibration)
    fields = _heights_of_dwells(slcs, sensor, estimator, settings, calibration, known)
    if not settings.measures_noise_and_gains:
        return fields
    # 17  The same again with gains, then noise, that the data show, of dwells that contradict their description.
    return [
        _with_measured(slc, field, sensor, estimator, settings, calibration, known)
        for slc, field in zip(slcs, fields, strict=True)
    ]


def _with_measured(
    slc: Slc,
    field: HeightField,
    sensor: Sensor,
    estimator: ElevationEstimator,
    settings: HeightSettings,
    calibration: Calibration | None,
    known: KnownBeams,
) -> HeightField:
    """Heights of a dwell with gains and noise power that its tests show; the tests remain those of the description."""
    tests, errors = field.fit, known.errors
    # Noise that one channel alone has looks like scatterers in its beam, and spoils the gains of its neighbours.
    if even := with_measured_channel_noise(slc, field.fit):
        slc = even
        (field,) = _heights_of_dwells([slc], sensor, estimator, settings, calibration, known)
    # Without a channel its neighbours are not predicted well: their gains are measured when it is left out.
    if audible := without_silent(slc, field.fit):
        slc = audible
        (field,) = _heights_of_dwells([slc], sensor, estimator, settings, calibration, known)
    if equal := with_measured_gains(slc, field.fit):
        left = gain_left(field.fit)
        slc, known = equal, known._replace(errors=errors._replace(gain=float(np.hypot(errors.gain, left))))
        if calibration:  # whose standard errors count instead, under its identity
            calibration = replace(calibration, gain_sigma=np.hypot(calibration.gain_sigma, left))
        (field,) = _heights_of_dwells([slc], sensor, estimator, settings, calibration, known)
    if measured := with_measured_noise(slc, field.fit):
        (field,) = _heights_of_dwells([measured], sensor, estimator, settings, calibration, known)
    return replace(field, fit=tests)


def _heights_of_dwells(
    slcs: Sequence[Slc],
    sensor: Sensor,
    estimator: ElevationEstimator,
    settings: HeightSettings,
    calibration: Calibration | None,
    known: KnownBeams,
) -> list[HeightField]:
    """Heights of dwells with noise powers and gains as stated, and beams whose accuracy is `known`."""
    # 6  Channels that receive: of each row of pixels those that are neither dead nor blanked.
    parts = [
        (number, rows, _observe(slc, sensor, estimator, settings, calibration, known.errors, channels))
        for number, slc in enumerate(slcs)
        for channels, rows in channel_sets(slc, sensor, settings.windows[0])
    ]
    # 11  Elevation from the ratios between channels.
    estimates = estimator.estimate_dwells([(seen.looks, seen.beams) for *_, seen in parts], settings)
    fields: list[list[tuple[Bool, HeightField]]] = [[] for _ in slcs]
    fits: list[list[tuple[int, DwellFit]]] = [[] for _ in slcs]
    for (number, rows, seen), estimate in zip(parts, estimates, strict=True):
        judged, grid, aperture = _judge(estimate, seen, settings), slcs[number].grid, slcs[number].aperture
        # 15  Range, Doppler and elevation give the position on the ground.
        field = height_field(
            judged,
            seen.looks,
            grid,
            seen.grid,
            aperture,
            sensor.look_side,
            settings.radial_velocity_mps,
            seen.beams,
            settings.radial_velocity_sigma_mps,
        )
        fields[number].append((rows, field))
        # 16  Tests of the data, where a single scatterer was fitted; clipped samples do not fit anything.
        residue = None if seen.saturated_share > settings.max_saturated_fraction else estimate.residue
        fit = fit_of(residue, seen.looks, seen.beams, seen.channels, sensor, settings, calibration)
        fits[number].append((int(np.count_nonzero(rows)), fit))
    # Where receivers are blanked, the tests are those of the rows that most of the pixels are in.
    most = [max(of_dwell, key=lambda part: part[0])[1] for of_dwell in fits]
    joined = (joined_rows(of_dwell) for of_dwell in fields)
    return [
        replace(field, fit=fit.tests, doubts=(*known.doubts, *fit.doubts))
        for field, fit in zip(joined, most, strict=True)
    ]


@one_blas_thread()
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
        sensor: sensor of the images.
        estimator: estimator, one of `elevation.ESTIMATORS`.
        settings: settings of the estimator, an object of its class `estimator.settings`.
        calibration: calibration of the images; None: the beams are as the sensor describes them.
        channels_used: numbers of the channels to estimate from; None: all that are not dead.

    Raises:
        Rejected: too few channels have a signal, or they are not those that the estimator needs.
        UserError: looks that do not fit in the image, or noise powers that are not known.
    """
    channels = live_channels(slc.images, sensor) if channels_used is None else channels_used
    errors = known_beams(sensor, settings, calibration).errors
    seen = _observe(slc, sensor, estimator, settings, calibration, errors, channels)
    (estimate,) = estimator.estimate_dwells([(seen.looks, seen.beams)], settings)
    return _judge(estimate, seen, settings), seen.looks, seen.grid, seen.beams


@dataclass(frozen=True, eq=False)
class _Observed:
    """Inputs of an estimator for a dwell, and of the judgement of its estimate.

    Attributes:
        looks: looks of the channels.
        beams: beams of the channels; those of the next dwell are the same object if nothing has changed.
        grid: grid of the height pixels.
        response: response of the images.
        saturated_share: greatest fraction of clipped samples of a channel.
        channels: numbers of the channels, as long as they are not mixed.
    """

    looks: Looks
    beams: Beams
    grid: Grid
    response: CellResponse
    saturated_share: float
    channels: Index


def _observe(
    slc: Slc,
    sensor: Sensor,
    estimator: ElevationEstimator,
    settings: HeightSettings,
    calibration: Calibration | None,
    errors: BeamErrors,
    used: Index,
) -> _Observed:
    """Observe a dwell by beams with `errors` and the channels of the numbers `used`; the others as of `elevations`."""
    images = slc.images if len(used) == len(slc.images) else slc.images[used]
    # 7  The channels that the estimator takes, of equal noise, or sum and difference; and their beams.
    channels, beams = channels_and_beams(slc, sensor, estimator, calibration, used, errors)
    # 8  The height pixels.
    grid = look_grid(slc.grid, *settings.windows)
    # 9  The squint of each column; a target that moves is seen at another one than its pixel.
    squint = column_squint(grid, slc.aperture, sensor.beams, sensor.look_side)
    squint = moving_squint(squint, settings.radial_velocity_mps, np.linalg.norm(slc.aperture.velocity))
    # 10  Looks: the covariance of the channels in each pixel, and the parts of sidelobes and other ranges in it.
    response = cell_response(slc, sensor)
    turn = level_turn(float(np.mean(beams.span)), slc.grid, slc.aperture, sensor.look_side)
    looks = windowed_looks(images, settings.windows, squint, channels, beams.is_complex, response, turn)
    return _Observed(looks, beams, grid, response, float(slc.saturated_share[used].max()), used)


def _judge(estimate: ElevationEstimate, seen: _Observed, settings: HeightSettings) -> ElevationEstimate:
    """The estimate with the error by scatterers elsewhere, without imprecise pixels, or those of clipped samples."""
    looks, beams = seen.looks, seen.beams
    # 12  The error by scatterers elsewhere, whose sidelobes are in the pixel.
    foreign = sidelobe_variance(estimate.elevation, looks, beams, settings.windows, seen.response)
    estimate = with_foreign_power(estimate, foreign)
    # 13  Pixels that noise leaves uncertain.
    estimate = without_imprecise(estimate, settings.max_sigma_beamwidths * beams.beamwidth)
    # 14  Clipped samples spoil the ratios between channels.
    return without_saturated(estimate) if seen.saturated_share > settings.max_saturated_fraction else estimate
