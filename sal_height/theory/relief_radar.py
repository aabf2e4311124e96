"""Gain of a hybrid before the receivers, coherent sums of pulses, and the slope of gamma (relief paper).

After accumulation of a pulse train, Sigma = S + n and Delta = gamma S + n' (relief paper, eq. 8 and 9); x is the
signal-to-noise power ratio in Sigma. `discriminator_noise` has the means and laws of the estimates: for coherent sums
of N pulses `steady_mean` and `SteadyLaw` at N x, or `SteadyMlLaw` for the maximum likelihood; for sums of N pulses'
products `steady_looks_mean`; for a mean of N pulses' ratios `steady_mean` at x.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sal_height.beams import Pattern
from sal_height.errors import UserError
from sal_height.numeric import C128, F64


def hybrid_gain(coupling: npt.ArrayLike, loss: npt.ArrayLike) -> F64:
    """Return the gain in signal-to-noise power ratio of a hybrid before the receivers over sums after them: 2 c^2 / L.

    The hybrid forms c (upper + lower) / sqrt(L) and c (upper - lower) / sqrt(L), and the same receivers follow. With
    c = 1 / sqrt(2) and no loss it is unitary and gains nothing: it rotates the two channels, which leaves equal
    independent noise unchanged. The gain of 2 that the relief paper's eq. 3 implies (c = 1) would need twice the power
    that the two beams deliver.

    Args:
        coupling: c, amplitude ratio.
        loss: L, power ratio, 1 or more.
    """
    return 2 * np.asarray(coupling) ** 2 / np.asarray(loss)


def synthesise(pulses: C128, phase: F64) -> C128:
    """Sum pulses (the last axis) coherently, after removing the `phase` (rad) that the flight gave to each.

    The sum is linear and the same for every channel, so that sum and difference may be formed before or after it. The
    estimate of gamma is not linear and must come last.
    """
    return np.sum(pulses * np.exp(-1j * phase), axis=-1)


def crossover_slope(pattern: Pattern, separation: float, beamwidth: float) -> float:
    """Return the slope g = -G'(delta/2) / G(delta/2) of gamma in the equisignal direction, 1/rad (relief paper, eq. 4).

    Args:
        pattern: G of both beams, even in elevation.
        separation: delta between the two beams' axes, rad.
        beamwidth: wavelength / aperture diameter, rad.

    Raises:
        UserError: the beams do not overlap in that direction, or gamma does not rise.
    """
    half = separation / 2 / beamwidth
    amplitude, slope = np.asarray(pattern.amplitude(half, 0.0)).item(), np.asarray(pattern.slope(half, 0.0)).item()
    steepness = float(np.real(-slope / amplitude)) / beamwidth if amplitude else np.nan
    if not (np.isfinite(steepness) and steepness > 0):
        raise UserError(
            f"Beams {separation:.6g} rad apart have the discriminator slope {steepness:.6g} /rad half way between "
            "them; it must be finite and greater than 0."
        )
    return steepness
