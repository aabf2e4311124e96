"""From the images of many dwells to the calibration of the sensor that took them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.calibration import Calibration
from sal_height.differential_response import CrossSpectra, cross_spectra, differential_response
from sal_height.errors import NotDetermined
from sal_height.geometry import Aperture, Grid
from sal_height.sensor import Sensor

Array = npt.NDArray[np.float64]


class Calibrator:
    """Gathers what the images of a sensor tell, dwell by dwell."""

    def __init__(self, sensor: Sensor) -> None:
        """Begin with the description of the sensor, whose waveform is "spectrum"."""
        self.sensor = sensor
        self.dwells = 0
        self._spectra = CrossSpectra.none(sensor.detector_count, sensor.sample_count)

    def add(self, slc: npt.NDArray[np.complex64], grid: Grid, aperture: Aperture, noise_powers: Array) -> None:
        """Take in the images of a dwell; arguments as of `cross_spectra`.

        Raises:
            NotDetermined: the images are weighted in range or not in the slant plane.
        """
        self._spectra += cross_spectra(slc, grid, aperture, self.sensor, noise_powers)
        self.dwells += 1

    def calibration(self) -> tuple[Calibration, list[str]]:
        """The calibration, and a sentence for each part that could not be determined and stays as described."""
        channels, frequencies = self.sensor.detector_count, self.sensor.sample_count
        response = np.ones((channels, frequencies), dtype=np.complex128)
        sigma = np.zeros(channels)
        undetermined = []
        try:
            differential = differential_response(self._spectra)
            response, sigma = differential.response, differential.sigma
        except NotDetermined as error:
            undetermined.append(str(error))
        return Calibration(self.sensor.config_hash, response, sigma, dwells=self.dwells), undetermined
