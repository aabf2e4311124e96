"""Calibration of a sensor from the images of many dwells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy.fft

from sal_height.beams import Beams, column_squint
from sal_height.calibration.beam_calibration import BeamCalibration, calibrate_beams, calibrate_on_target
from sal_height.calibration.calibration import DEFAULTS, Calibration, CalibrationSettings
from sal_height.calibration.pupil import PupilCalibration, calibrate_pupil
from sal_height.calibration.receiver_responses import CrossSpectra, differential_response, remove_range_phase
from sal_height.elevation import Looks, Window, windowed_looks
from sal_height.errors import NotDetermined, Rejected, UserError
from sal_height.geometry import ApertureState, Grid, angles_of, aperture_at, pixels_at
from sal_height.imaging import Slc, image_beams
from sal_height.numeric import C64, C128, F64, WORKERS, window
from sal_height.response import CHIP, PointTarget, PointTargetSettings, estimate_transfer_function, find_targets
from sal_height.sensor import Channels, Sensor, spectrum_sensor, whitened_channels, with_powers

TARGET_MEMORY = 2**27
"""Bytes of the chips of point targets that are kept: 2048 of 64 x 64 pixels, where 25 per dwell would be 1.6 MB."""


class Sighting(NamedTuple):
    """A reference target in the images of a dwell.

    Attributes:
        samples: pixel of the target in each channel, complex128, shape (channels,).
        elevation: elevation of the line of sight, rad from nadir.
        squint: squint of the line of sight, rad.
    """

    samples: C128
    elevation: float
    squint: float


def find_reference_target(
    pixels: C64,
    grid: Grid,
    aperture: ApertureState,
    look_side: int,
    target: F64,
    settings: CalibrationSettings = DEFAULTS,
) -> Sighting | None:
    """Find the reference target in the images of a dwell; None: it is not in them, or does not stand out.

    Args:
        pixels: pixels of all channels, shape (channels, rows, cols).
        grid: positions of the pixels, in the slant plane.
        aperture: aperture of the images.
        look_side: +1 looking right, -1 left.
        target: position in the map, m, shape (3,).
        settings: search distance, and least brightness.
    """
    sight = target - aperture.position
    along = sight @ aperture.direction
    across = np.sqrt(np.maximum(sight @ sight - along**2, 0.0))
    row, col = (int(np.rint(index)) for index in pixels_at(across, along, aperture, grid))
    (rows, cols), reach = pixels.shape[1:], settings.target_reach
    if not (reach <= row < rows - reach and reach <= col < cols - reach):
        return None
    power = np.sum(pixels.real**2 + pixels.imag**2, axis=0)
    near = power[row - reach : row + reach + 1, col - reach : col + reach + 1]
    if not near.max() > 10 ** (settings.target_over_image_db / 10) * np.median(power):
        return None
    down, right = np.unravel_index(np.argmax(near), near.shape)
    _, elevation, squint = angles_of(target, aperture_at(target, aperture), look_side)
    samples = pixels[:, row - reach + int(down), col - reach + int(right)].astype(np.complex128)
    return Sighting(samples, float(elevation), float(squint))


class Calibrator:
    """Collects statistics of the images of a sensor, dwell by dwell, and estimates a calibration from them."""

    def __init__(self, sensor: Sensor, target: F64 | None = None, settings: CalibrationSettings = DEFAULTS) -> None:
        """Start without dwells.

        Args:
            sensor: description of the sensor.
            target: position of a reference target in the map, m, shape (3,); None: no target.
            settings: criteria for the data that are used.
        """
        self.sensor = spectrum_sensor(sensor)
        self.dwells = 0
        self._target, self._settings = target, settings
        self._beams = self.sensor.beams
        channels, frequencies = self.sensor.detector_count, self.sensor.sample_count
        shape = channels, channels
        self._spectra = CrossSpectra(np.zeros((frequencies, *shape), np.complex128), np.zeros(shape, np.complex128), 0)
        self._noise_powers = np.zeros(channels)
        self._sightings: list[Sighting] = []
        self._targets: list[PointTarget] = []
        self._columns: list[C64] = []
        self._squints: list[F64] = []

    def add(self, slc: Slc) -> None:
        """Process the images of a dwell.

        Args:
            slc: images of all channels in the slant plane, unweighted in range, their rows a range cell apart.

        Raises:
            NotDetermined: the images are weighted in range or not in the slant plane.
            Rejected: samples of a channel are clipped.
        """
        clipped, allowed = slc.saturated_share.max(), self._settings.max_saturated_fraction
        if clipped > allowed:
            raise Rejected(
                "saturated",
                f"{clipped:.3g} of a channel's samples are clipped; calibration needs {allowed:g} or less.",
            )
        if not self.dwells:
            self._beams = image_beams(self.sensor, slc.azimuth_window)
        grid, aperture, side = slc.grid, slc.aperture, self.sensor.look_side
        pixels = remove_range_phase(slc, self.sensor)
        self._spectra.add(pixels, self.sensor, slc.noise_power)
        self._targets = brightest([*self._targets, *targets_in(pixels.sum(axis=0), self._settings)], TARGET_MEMORY)
        if self._target is not None:
            seen = find_reference_target(pixels, grid, aperture, side, self._target, self._settings)
            self._sightings += [seen] if seen else []
        squint = column_squint(grid, aperture, self._beams, side)
        for columns in self._kept_columns(*pixels.shape[1:]):
            self._columns.append(pixels[..., columns].copy())
            self._squints.append(squint[columns].mean())
        self._noise_powers += slc.noise_power
        self.dwells += 1

    def calibration(self) -> tuple[Calibration, list[str]]:
        """Return the calibration, and a message on each part that is not determined and stays as described."""
        channels, frequencies = self.sensor.detector_count, self.sensor.sample_count
        response, sigma = np.ones((channels, frequencies), dtype=np.complex128), np.full(channels, np.nan)
        undetermined: list[str] = []
        try:
            response, sigma = differential_response(self._spectra, self._settings.echo_significance)
        except NotDetermined as error:
            undetermined.append(f"How receivers differ over the band: {error}")
        beams = self._calibrated_beams(response, undetermined)
        pupil = self._calibrated_pupil(response, beams, undetermined) if self._settings.pupil_prior_waves else None
        if pupil:
            beams = replace(
                beams, gains=beams.gains * pupil.gains, width_factor=beams.width_factor * pupil.width_factor
            )
        try:
            response = response * common_response(self._targets, frequencies)
        except NotDetermined as error:
            undetermined.append(f"What receivers do to the band in common: {error}")
        calibration = Calibration(
            self.sensor.config_hash,
            response=response * beams.gains[:, None],
            response_sigma=sigma,
            gain_sigma=beams.gain_sigmas,
            phase_sigma=beams.phase_sigmas,
            width_factor=beams.width_factor,
            width_sigma=beams.width_sigma,
            pupil=pupil.coefficients if pupil else np.zeros(0),
            pupil_sigma=pupil.sigma if pupil else np.zeros(0),
            pupil_misfit=pupil.misfit if pupil else np.nan,
            pupil_p_value=pupil.p_value if pupil else np.nan,
            dwells=self.dwells,
        )
        return calibration, undetermined

    def _kept_columns(self, rows: int, cols: int) -> list[slice]:
        """Return the blocks of `azimuth_looks` columns that are kept of a dwell; the next dwell keeps others."""
        looks = self._settings.azimuth_looks
        blocks = cols // looks
        kept = min(blocks, -(-self._settings.pixels_per_dwell // rows))
        first = ((self.dwells * kept + index) % blocks * looks for index in range(kept))
        return [slice(col, col + looks) for col in first]

    def _calibrated_beams(self, response: C128, undetermined: list[str]) -> BeamCalibration:
        """Return gains and width of the beams, by the reference target if it determines them, or by the scene.

        Adds to `undetermined` a message on each that does not determine them.
        """
        estimates: dict[str, Callable[[], BeamCalibration]] = {"scene": partial(self._beams_by_scene, response)}
        if self._target is not None:
            estimates = {"reference target": self._beams_by_target, **estimates}
        for source, estimate in estimates.items():
            try:
                if self.sensor.is_mixed:
                    raise NotDetermined(
                        "The channels are mixtures of detectors; beams are calibrated of single detectors only."
                    )
                return estimate()
            except UserError as error:
                undetermined.append(f"Gains and width of the beams by the {source}: {error}")
        return BeamCalibration.as_described(self.sensor.detector_count)

    def _calibrated_pupil(
        self, response: C128, beams: BeamCalibration, undetermined: list[str]
    ) -> PupilCalibration | None:
        """Return aberrations of the pupil, and gains and width relative to `beams` with them, by the scene."""
        try:
            if self.sensor.is_mixed:
                raise NotDetermined("The channels are mixtures of detectors; the pupil is that of single detectors.")
            looks, described = self._scene(response * beams.gains[:, None])
            return calibrate_pupil(looks, described.widened(beams.width_factor), self._settings)
        except UserError as error:
            undetermined.append(f"Aberrations of the pupil: {error}")
            return None

    def _beams_by_target(self) -> BeamCalibration:
        """Return gains of the beams, and their width if elevations differ, by the reference target.

        Raises:
            NotDetermined: it was not seen, or not by all detectors.
        """
        if not self._sightings:
            least = self._settings.target_over_image_db
            raise NotDetermined(f"No dwell shows the target {least:g} dB over its image; one at least must.")
        channels = self._whitened_channels(self._noise_powers / self.dwells)
        samples, elevation, squint = (np.array(values) for values in zip(*self._sightings, strict=True))
        samples, beams = samples @ channels.transform.T, self._beams.combined(channels.matrix)
        return calibrate_on_target(samples, beams, elevation, squint, channels.noise_powers[0], self._settings)

    def _beams_by_scene(self, response: C128) -> BeamCalibration:
        """Return gains and width of the beams, by the scene; NotDetermined if it does not determine them."""
        return calibrate_beams(*self._scene(response), self._settings)

    def _scene(self, response: C128) -> tuple[Looks, Beams]:
        """Looks of range-weighted images, equalised by these responses of the receivers, and the beams in them.

        Raises:
            NotDetermined: no image has enough columns.
        """
        if not self._columns:
            raise NotDetermined(f"No image has {self._settings.azimuth_looks} columns; needed are as many or more.")
        rows = self.sensor.sample_count
        taper = window("taylor", rows)
        weights = taper / response
        noise = self._noise_powers / self.dwells * np.mean(np.abs(weights) ** 2, axis=1)
        channels = self._whitened_channels(noise)
        columns = [np.pad(part, ((0, 0), (0, rows - part.shape[1]), (0, 0))) for part in self._columns]
        spectra = scipy.fft.fft(np.concatenate(columns, axis=2), axis=1, workers=WORKERS)
        spectra *= scipy.fft.ifftshift(weights, axes=1)[..., None].astype(np.complex64)
        images = scipy.fft.ifft(spectra, axis=1, workers=WORKERS, overwrite_x=True)
        # Squints are rounded to 0.01 beamwidths, so that beams are computed for few.
        step = 0.01 * self.sensor.beams.track_beamwidth
        squint = np.round(np.array(self._squints) / step) * step
        windows = Window.named("boxcar", 1), Window.named("boxcar", self._settings.azimuth_looks)
        looks = windowed_looks(images, windows, squint, channels, hermitian=True)
        return looks, self._beams.combined(channels.matrix)

    def _whitened_channels(self, noise_powers: F64) -> Channels:
        """Return channels of equal noise from those of the sensor, whose pixels have these noise powers."""
        return whitened_channels(with_powers(self.sensor.noise_covariance, noise_powers), self.sensor.mixing)


def targets_in(image: C64, settings: PointTargetSettings) -> tuple[PointTarget, ...]:
    """Return the point targets of an image; empty if no pixel stands out, or the image is too narrow for a point."""
    power = image.real**2 + image.imag**2
    rows, cols = (min(size, length) for size, length in zip(CHIP, image.shape, strict=True))
    if min(rows, cols) < 4 or not power.max() > 10 ** (settings.point_over_clutter_db / 10) * power.mean():
        return ()
    return find_targets(image, (rows, cols), settings).targets


def brightest(targets: list[PointTarget], memory: int) -> list[PointTarget]:
    """Return the brightest targets over their clutter whose chips fit into `memory` bytes.

    The standard error of a response falls with the sum of these ratios, to which the faint ones add least.
    """
    ranked = sorted(targets, key=lambda target: -target.over_clutter)
    size = np.cumsum([target.spectrum.nbytes for target in ranked])
    return ranked[: int(np.searchsorted(size, memory, side="right"))]


def common_response(targets: list[PointTarget], frequencies: int) -> C128:
    """Return the range response that point targets show, at the fast-time frequencies, shape (frequencies,).

    Args:
        targets: targets in unweighted images of the sum of all channels, rows a range cell apart.
        frequencies: number of fast-time frequencies.

    Raises:
        NotDetermined: there is no target.
    """
    if not targets:
        raise NotDetermined(
            "No point target stands out from its surroundings, alone and as a point; at least one is needed, in any "
            "dwell (parameter point_over_clutter_db)."
        )
    transfer = estimate_transfer_function(targets)
    pixels = scipy.fft.ifft(scipy.fft.ifftshift(transfer.range.without_clutter()))
    near, half = np.zeros(frequencies, dtype=np.complex128), min(len(pixels), frequencies) // 2
    near[:half], near[-half:] = pixels[:half], pixels[-half:]
    return scipy.fft.fftshift(scipy.fft.fft(near))
