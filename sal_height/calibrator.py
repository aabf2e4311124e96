"""From the images of many dwells to the calibration of the sensor that took them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft

from sal_height.calibration import Calibration
from sal_height.differential_response import CrossSpectra, cross_spectra, differential_response, unwound
from sal_height.errors import NotDetermined
from sal_height.geometry import Aperture, Grid
from sal_height.point_targets import CHIP, LEAST_OVER_CLUTTER_DB, PointTarget, find_targets
from sal_height.sensor import Sensor
from sal_height.transfer_function import estimate_transfer_function, without_clutter

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]


class Calibrator:
    """Gathers what the images of a sensor tell, dwell by dwell."""

    def __init__(self, sensor: Sensor) -> None:
        """Begin with the description of the sensor, whose waveform is "spectrum"."""
        self.sensor = sensor
        self.dwells = 0
        self._spectra = CrossSpectra.none(sensor.detector_count, sensor.sample_count)
        self._targets: list[PointTarget] = []

    def add(self, slc: npt.NDArray[np.complex64], grid: Grid, aperture: Aperture, noise_powers: Array) -> None:
        """Take in the images of a dwell; arguments as of `cross_spectra`.

        Raises:
            NotDetermined: the images are weighted in range or not in the slant plane.
        """
        pixels = unwound(slc, grid, aperture, self.sensor)
        self._spectra += cross_spectra(pixels, self.sensor, noise_powers)
        self._targets += targets_in(pixels.sum(axis=0))
        self.dwells += 1

    def calibration(self) -> tuple[Calibration, list[str]]:
        """The calibration, and a sentence for each part that could not be determined and stays as described."""
        channels, frequencies = self.sensor.detector_count, self.sensor.sample_count
        response, sigma = np.ones((channels, frequencies), dtype=np.complex128), np.zeros(channels)
        undetermined = []
        try:
            differential = differential_response(self._spectra)
            response, sigma = response * differential.response, differential.sigma
        except NotDetermined as error:
            undetermined.append(f"How receivers differ: {error}")
        try:
            response = response * common_response(self._targets, frequencies)
        except NotDetermined as error:
            undetermined.append(f"What receivers have in common: {error}")
        return Calibration(self.sensor.config_hash, response, sigma, dwells=self.dwells), undetermined


def targets_in(image: npt.NDArray[np.complex64]) -> tuple[PointTarget, ...]:
    """Point targets of an image; none where no pixel stands out from its mean."""
    power = image.real**2 + image.imag**2
    if not power.max() > 10 ** (LEAST_OVER_CLUTTER_DB / 10) * power.mean():
        return ()
    rows, cols = (min(size, length) for size, length in zip(CHIP, image.shape, strict=True))
    return find_targets(image, (rows, cols)).targets


def common_response(targets: list[PointTarget], frequencies: int) -> ComplexArray:
    """The range response that point targets show, at the fast-time frequencies, shape (frequencies,).

    Args:
        targets: in unweighted images, rows a range cell apart, of the sum of all channels.
        frequencies: number of fast-time frequencies.

    Raises:
        NotDetermined: there is no target.
    """
    if not targets:
        raise NotDetermined(
            f"No point target stands {LEAST_OVER_CLUTTER_DB:g} dB over its surroundings, alone and as a point; needed "
            "is one at least, in any dwell."
        )
    transfer = estimate_transfer_function(targets)
    pixels = scipy.fft.ifft(scipy.fft.ifftshift(without_clutter(transfer.range_response, transfer.range_sigma)))
    near, half = np.zeros(frequencies, dtype=np.complex128), min(len(pixels), frequencies) // 2
    near[:half], near[-half:] = pixels[:half], pixels[-half:]
    return np.asarray(scipy.fft.fftshift(scipy.fft.fft(near)))
