"""From the images of many dwells to the calibration of the sensor that took them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.fft

from sal_height.beams import column_squint
from sal_height.calibration.beams import (
    MIXED,
    BeamCalibration,
    calibrate_beams,
    calibrate_gains_on_target,
    calibrate_on_target,
    calibrate_phases,
)
from sal_height.calibration.calibration import Calibration
from sal_height.calibration.receivers import CrossSpectra, cross_spectra, differential_response, unwound
from sal_height.calibration.reference_target import Sighting, sighting
from sal_height.elevation import Window, windowed_looks
from sal_height.errors import NotDetermined, Rejected, UserError
from sal_height.imaging import Slc, image_beams
from sal_height.numeric import C64, C128, F64, WORKERS, noise_gain, window
from sal_height.response import (
    CHIP,
    PointTarget,
    PointTargetSettings,
    estimate_transfer_function,
    find_targets,
    without_clutter,
)
from sal_height.sensor import MAX_SHARE, Sensor, spectrum_sensor, whitened_channels, with_powers

LOOKS = 4
"""Columns averaged to a pixel for the beams; rows are not averaged, so that slopes do not mix elevations."""

PIXELS = 256
"""Least number of pixels kept of each dwell for the beams: 8000 of 15 dB give the width within 0.1 %."""

NARROWEST = 4
"""Least rows or columns of a chip in which a point can be recognised."""

SQUINT_STEP = 0.01
"""Beamwidths to which squints of columns are rounded, so that beams are computed for few."""


TARGET_MEMORY = 2**27
"""Bytes of the chips of point targets that are held: 2048 of 64 x 64 pixels, where 25 per dwell would be 1.6 MB."""


class Calibrator:
    """Gathers what the images of a sensor tell, dwell by dwell."""

    def __init__(self, sensor: Sensor, target: F64 | None = None, settings: PointTargetSettings | None = None) -> None:
        """Begin.

        Args:
            sensor: its description.
            target: place of a reference target in the map, m, shape (3,); None: there is none.
            settings: which bright pixels of the scene are taken for point targets.
        """
        self._settings = settings or PointTargetSettings()
        self.sensor = spectrum_sensor(sensor)
        self._target = target
        self._sightings: list[Sighting] = []
        self.dwells = 0
        self._beams = self.sensor.beams
        self._spectra = CrossSpectra.none(self.sensor.detector_count, self.sensor.sample_count)
        self._targets: list[PointTarget] = []
        self._columns: list[C64] = []
        self._squints: list[F64] = []
        self._noise_powers = np.zeros(self.sensor.detector_count)

    def add(self, slc: Slc) -> None:
        """Take in the images of a dwell.

        Args:
            slc: images of all channels in the slant plane, unweighted in range, their rows a range cell apart.

        Raises:
            NotDetermined: the images are weighted in range or not in the slant plane.
            Rejected: samples of a channel are clipped.
        """
        share = slc.saturated_share.max()
        if share > MAX_SHARE:
            raise Rejected(
                "saturated",
                f"{share:.3g} of a channel's samples are clipped; calibration needs {MAX_SHARE:g} or less.",
            )
        if not self.dwells:
            self._beams = image_beams(self.sensor, slc.azimuth_window)
        grid, aperture = slc.grid, slc.aperture
        pixels = unwound(slc.images, grid, aperture, self.sensor)
        self._spectra += cross_spectra(pixels, self.sensor, slc.noise_power)
        self._targets = brightest([*self._targets, *targets_in(pixels.sum(axis=0), self._settings)], TARGET_MEMORY)
        if self._target is not None:
            seen = sighting(pixels, grid, aperture, self.sensor.look_side, self._target)
            self._sightings += [seen] if seen else []
        squint = column_squint(grid, aperture, self._beams, self.sensor.look_side)
        for block in self._blocks(*pixels.shape[1:]):
            columns = slice(LOOKS * block, LOOKS * (block + 1))
            self._columns.append(pixels[..., columns].copy())
            self._squints.append(squint[columns].mean())
        self._noise_powers += slc.noise_power
        self.dwells += 1

    def calibration(self) -> tuple[Calibration, list[str]]:
        """The calibration, and a sentence for each part that could not be determined and stays as described."""
        channels, frequencies = self.sensor.detector_count, self.sensor.sample_count
        response, sigma = np.ones((channels, frequencies), dtype=np.complex128), np.full(channels, np.nan)
        undetermined: list[str] = []
        try:
            differential = differential_response(self._spectra)
            response, sigma = differential.response, differential.sigma
        except NotDetermined as error:
            undetermined.append(f"How receivers differ over the band: {error}")
        beams = self._calibrated_beams(response, undetermined)
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
            dwells=self.dwells,
        )
        return calibration, undetermined

    def _blocks(self, rows: int, cols: int) -> list[int]:
        """Blocks of LOOKS columns that are kept of a dwell's images; others in the next dwell."""
        blocks = cols // LOOKS
        kept = min(blocks, -(-PIXELS // rows))
        return [(self.dwells * kept + index) % blocks for index in range(kept)]

    def _calibrated_beams(self, response: C128, undetermined: list[str]) -> BeamCalibration:
        """Gains and width of the beams, by the reference target if it determines them; notes what is not determined."""
        if self._target is not None:
            try:
                return self._by_target()
            except UserError as error:
                undetermined.append(f"Gains and width of the beams by the reference target: {error}")
        try:
            return self._by_scene(response)
        except UserError as error:
            undetermined.append(f"Gains and width of the beams by the scene: {error}")
        return BeamCalibration.none(self.sensor.detector_count)

    def _by_target(self) -> BeamCalibration:
        """Gains of the beams, and their width if elevations differ, by the reference target.

        Raises:
            NotDetermined: it was not seen, or not by all detectors.
        """
        if self.sensor.is_mixed:
            raise NotDetermined(MIXED)
        if not self._sightings:
            raise NotDetermined("No dwell shows the target 20 dB over its image; one at least must.")
        channels = whitened_channels(
            with_powers(self.sensor.noise_covariance, self._noise_powers / self.dwells), self.sensor.mixing
        )
        samples = np.array([one.samples for one in self._sightings]) @ channels.transform.T
        covariance = (samples[:, :, None] * samples[:, None].conj()).astype(np.complex64)
        angles = np.array([[one.elevation, one.squint] for one in self._sightings]).T
        known = covariance, 1, self._beams.combined(channels.matrix), *angles, float(channels.noise_powers[0])
        try:
            return calibrate_on_target(*known)
        except NotDetermined:
            return calibrate_gains_on_target(*known)

    def _by_scene(self, response: C128) -> BeamCalibration:
        """Width and gains of the beams, by images of weighted range and equal receivers.

        Raises:
            NotDetermined: they cannot be told.
        """
        if self.sensor.is_mixed:
            raise NotDetermined(MIXED)
        if not self._columns:
            raise NotDetermined(f"No image has {LOOKS} columns; needed are as many or more.")
        taper = window("taylor", self.sensor.sample_count)
        weights = taper / response
        noise = self._noise_powers / self.dwells * np.mean(np.abs(weights) ** 2, axis=1)
        channels = whitened_channels(with_powers(self.sensor.noise_covariance, noise), self.sensor.mixing)
        columns = [_in_length(columns, self.sensor.sample_count) for columns in self._columns]
        spectra = scipy.fft.fft(np.concatenate(columns, axis=2), axis=1, workers=WORKERS)
        spectra *= scipy.fft.ifftshift(weights, axes=1)[..., None].astype(np.complex64)
        images = scipy.fft.ifft(spectra, axis=1, workers=WORKERS, overwrite_x=True)
        step = SQUINT_STEP * self.sensor.beams.track_beamwidth
        squint = np.round(np.array(self._squints) / step) * step
        windows = Window.named("boxcar", 1), Window.named("boxcar", LOOKS)
        looks = windowed_looks(images, windows, squint, channels, hermitian=True)
        calibrate = calibrate_beams if self.sensor.detector_count > 2 else calibrate_phases
        found = calibrate(looks, self._beams.combined(channels.matrix))
        alike = np.sqrt(noise_gain(taper**2)) / noise_gain(taper)  # speckle of rows that are neighbours
        return replace(
            found,
            width_sigma=found.width_sigma * alike,
            gain_sigmas=found.gain_sigmas * alike,
            phase_sigmas=found.phase_sigmas * alike,
        )


def _in_length(columns: C64, rows: int) -> C64:
    """Columns (channels, rows, cols) with zeros up to as many rows."""
    return np.pad(columns, ((0, 0), (0, rows - columns.shape[1]), (0, 0)))


def targets_in(image: C64, settings: PointTargetSettings) -> tuple[PointTarget, ...]:
    """Point targets of an image; none where no pixel stands out from its mean, or it is too narrow to tell."""
    power = image.real**2 + image.imag**2
    rows, cols = (min(size, length) for size, length in zip(CHIP, image.shape, strict=True))
    if min(rows, cols) < NARROWEST or not power.max() > 10 ** (settings.point_over_clutter_db / 10) * power.mean():
        return ()
    return find_targets(image, (rows, cols), settings).targets


def brightest(targets: list[PointTarget], memory: int) -> list[PointTarget]:
    """The brightest of some targets over their clutter, as many as their chips fit into `memory` bytes.

    The standard error of a response falls with the sum of these ratios, to which the faint ones add least.
    """
    ranked = sorted(targets, key=lambda target: -target.over_clutter)
    held = np.cumsum([target.spectrum.nbytes for target in ranked])
    return ranked[: int(np.searchsorted(held, memory, side="right"))]


def common_response(targets: list[PointTarget], frequencies: int) -> C128:
    """The range response that point targets show, at the fast-time frequencies, shape (frequencies,).

    Args:
        targets: in unweighted images, rows a range cell apart, of the sum of all channels.
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
    pixels = scipy.fft.ifft(scipy.fft.ifftshift(without_clutter(transfer.range_response, transfer.range_sigma)))
    near, half = np.zeros(frequencies, dtype=np.complex128), min(len(pixels), frequencies) // 2
    near[:half], near[-half:] = pixels[:half], pixels[-half:]
    return scipy.fft.fftshift(scipy.fft.fft(near))
