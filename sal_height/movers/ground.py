"""Lag of the ground, against which movers are measured where the direction of the beam is uncertain."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls
from scipy.special import logsumexp

from sal_height.beams import Beams
from sal_height.geometry import aperture_at
from sal_height.imaging import NavigationPrior, Slc, line_of_sight
from sal_height.movers.spectrum import Bins
from sal_height.numeric import C64, C128, F64, MEDIAN_ERROR
from sal_height.sensor import Sensor


def ground_lag(slc: Slc, sensor: Sensor, lags: F64, spectra: Callable[[], tuple[F64, F64]]) -> tuple[float, float]:
    """Lag of the ground, and its standard deviation, rad.

    Where autofocus has estimated the middle of the beams, the image is there, with the error that autofocus states.
    Otherwise it is estimated from spectra and odometry, unless odometry is exact.

    Args:
        slc: image.
        sensor: sensor of the image.
        lags: lags of the search, shape (lags,), rad.
        spectra: function for the power of rows in Doppler bins, shape (rows, bins), and the gains of the beam there,
            shape (lags, bins).
    """
    if slc.placement.beams_error:
        return 0.0, slc.placement.beams_error / float(np.linalg.norm(slc.aperture.velocity))
    prior = lag_by_odometry(slc, sensor)
    return lag_of_spectra(*spectra(), lags, prior) if prior else (0.0, 0.0)


def spectra_of_image(images: C64 | C128, beams: Beams, bins: Bins, lags: F64) -> tuple[F64, F64]:
    """Power of the rows of a strip's image, and gains of the beam, for `ground_lag`."""
    power = np.sum(np.abs(bins.spectra(images * np.hanning(images.shape[-1]))) ** 2, axis=0)
    gains = np.sum(np.abs(bins.amplitudes(beams, float(np.mean(beams.span)), lags)) ** 2, axis=-1)
    return power, gains


def lag_of_spectra(power: F64, gains: F64, lags: F64, prior: float) -> tuple[float, float]:
    """Mean and standard deviation of the lag by spectra and odometry, rad.

    The spectra are the median over rows, each over its own mean, so that no target counts for much; they have the
    beam's power over that of noise, which is unknown. Arguments as for `ground_lag`, and the standard deviation of the
    lag by odometry, rad.
    """
    power = power[np.all(power > 0, axis=-1)]
    if not len(power):
        return 0.0, prior
    power = power / np.mean(power, axis=-1, keepdims=True)
    level, error = np.median(power, axis=0), MEDIAN_ERROR * np.std(power) / np.sqrt(len(power))
    misfits = []
    for gain in gains:
        columns = np.stack([gain, np.ones_like(gain)], axis=-1)
        share, _ = nnls(columns, level)
        misfits.append(np.sum((columns @ share - level) ** 2) / error**2)
    misfit = np.array(misfits)
    excess = max(1.0, misfit.min() / max(1, len(level) - 3))
    logarithm = -misfit / (2 * excess) - (lags / prior) ** 2 / 2
    weight = np.exp(logarithm - logsumexp(logarithm))
    lag = float(weight @ lags)
    return lag, float(np.sqrt(weight @ (lags - lag) ** 2))


def lag_by_odometry(slc: Slc, sensor: Sensor) -> float:
    """Standard deviation of the lag of the ground by the covariance of the pose, rad; 0: it is exact.

    An error of the velocity is in that of the position along the flight (`Placement.seen_from`).
    """
    grid, aperture = slc.grid, slc.aperture
    middle = grid.middle
    slant_range = float(np.linalg.norm(middle - aperture_at(middle, aperture).position))
    pointing = NavigationPrior.of(aperture, np.zeros((3, 3)), line_of_sight(sensor, aperture)).pointing
    along = aperture.direction @ aperture.covariance[:3, :3] @ aperture.direction
    return float(np.hypot(pointing, np.sqrt(along) / slant_range)) if along >= 0 else pointing
