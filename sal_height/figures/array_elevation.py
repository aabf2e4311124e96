"""Figures 10 and 11 of the SAL paper: the array's maximum-likelihood elevation of a fluctuating target.

16 point detectors half a beamwidth apart behind a square aperture. The CNR is that of one detector looking straight at
the target. Searched are +-4 beamwidths, half a pitch beyond the outermost boresights.

Theory is that of many looks and high CNR. The estimate maximises |b^T g|^2 summed over the looks, with weights b = a
(the paper's objective, "numerator") or b = a / |a| ("normalised"), a(theta) being the detectors' responses. Its mean is
then the maximiser of the expected objective. Near that, noise n and a target of amplitude A at theta0 move it by
Re(A* b'^T n) / (-|A|^2 b''^T a0), and the mean of 1 / sum |A|^2 is 1 / ((K - 1) C).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.optimize import minimize_scalar

from sal_height.beams import Beams, pattern_named
from sal_height.elevation import OBJECTIVES
from sal_height.figures.curve import Curve
from sal_height.figures.sample_statistics import Measured, mean, std
from sal_height.figures.unit_arrays import array_of
from sal_height.numeric import F64
from sal_height.theory import TargetPixels

WEIGHTS: dict[str, Callable[[F64], F64]] = {
    "normalised": lambda response: np.asarray(response / np.linalg.norm(response)),
    "numerator": lambda response: response,
}
"""b from the responses of the detectors, by the name of the objective."""

CHANNELS, PITCH = 16, 0.5

END_OF_SEARCH = CHANNELS * PITCH / 2
"""Half width of the search, beamwidths."""

ELEVATIONS = np.linspace(0, 4, 9)
"""True elevations in figure 10, beamwidths; elevations below 0 mirror them."""


def fig10(trials: int, seed: int) -> Iterator[Curve]:
    """Mean and standard deviation of the estimate over the true elevation, by looks, CNR and objective."""
    beams = example_array()
    for objective in WEIGHTS:
        for style, looks in zip((":", "--", "-"), (1, 4, 16), strict=True):
            for colour, cnr_db in enumerate((0, 5, 10, 20)):
                cnr = 10 ** (cnr_db / 10)
                samples = [estimates(elevation, cnr, looks, objective, trials, seed) for elevation in ELEVATIONS]
                means, spreads = _theory(beams, objective, looks, cnr_db)
                for quantity, statistic, closed_form in (
                    ("mean", mean, means),
                    ("standard deviation", std, spreads),
                ):
                    values, errors = np.array([statistic(sample) for sample in samples]).T
                    case = f"K {looks}, CNR {cnr_db} dB"
                    yield Curve(
                        f"{quantity}, {objective}", case, ELEVATIONS, values, errors, closed_form, style, colour
                    )


def fig11(trials: int, seed: int) -> Iterator[Curve]:
    """Histogram of the estimate for CNR 3, four looks and a target at 1.75 beamwidths; mean without outliers."""
    cnr, looks, elevation = 3.0, 4, 1.75
    bins = np.linspace(-4, 4, 161)
    width = bins[1] - bins[0]
    for colour, objective in enumerate(WEIGHTS):
        sample = estimates(elevation, cnr, looks, objective, trials, seed)
        fraction = np.histogram(sample, bins)[0] / trials
        error = np.sqrt(fraction * (1 - fraction) / trials)
        yield Curve(
            "density",
            objective,
            bins[:-1] + width / 2,
            fraction / width,
            error / width,
            np.full_like(fraction, np.nan),
            "steps-mid",
            colour,
        )
        core = mean(sample[np.abs(sample - elevation) < 1.0])  # beamwidths: outliers are farther from the truth
        middle = limit(example_array(), objective, elevation, cnr)
        yield _point("core mean", objective, elevation, core, middle)


def example_array() -> Beams:
    """The array of both figures."""
    return array_of((pattern_named("sinc"),), CHANNELS, PITCH)


def estimates(elevation: float, cnr: float, looks: int, objective: str, trials: int, seed: int) -> F64:
    """Estimates of independent pixels, beamwidths, shape (trials,), by the code of the node."""
    pixels = TargetPixels(example_array(), elevation, cnr, looks)
    return pixels.peak_elevations(seed, trials, OBJECTIVES[objective], 0.0)


def limit(beams: Beams, objective: str, elevation: float, cnr: float) -> float:
    """Limit of the estimate for many looks: the maximiser of the expected objective, beamwidths.

    The expected covariance is C a0 a0^T + I. The elevation itself for "normalised"; "numerator" is biased inwards.
    """
    target = beams.response(elevation, 0.0)

    def negative(angle: float) -> float:
        weights = WEIGHTS[objective](beams.response(angle, 0.0))
        return -float(cnr * (weights @ target) ** 2 + weights @ weights)

    bounds = (max(elevation - 0.8, -END_OF_SEARCH), min(elevation + 0.8, END_OF_SEARCH))
    return float(minimize_scalar(negative, bounds=bounds, method="bounded", options={"xatol": 1e-9}).x)


def limit_std(beams: Beams, objective: str, elevation: float, cnr: float, looks: int) -> float:
    """Standard deviation at high CNR, |b'| / |b''^T a0| / sqrt(2 (K - 1) C), times sqrt(1 + 1 / (C |a0|^2)).

    The last factor is the loss caused by unknown amplitudes. For "normalised" the result is the stochastic Cramer-Rao
    bound times sqrt(K / (K - 1)). Beamwidths.
    """
    target, middle = beams.response(elevation, 0.0), limit(beams, objective, elevation, cnr)
    step = 1e-3  # of the differences that approximate derivatives, beamwidths
    below, here, above = (WEIGHTS[objective](beams.response(middle + offset, 0.0)) for offset in (-step, 0.0, step))
    slope, curvature = (above - below) / (2 * step), (above - 2 * here + below) / step**2
    unknown_amplitudes = 1 + 1 / (cnr * target @ target)
    variance = unknown_amplitudes * slope @ slope / (curvature @ target) ** 2 / (2 * (looks - 1) * cnr)
    return float(np.sqrt(variance))


def _theory(beams: Beams, objective: str, looks: int, cnr_db: float) -> tuple[F64, F64]:
    """Mean and standard deviation at ELEVATIONS; NaN where theory has no closed form.

    The middle of the array is its own mirror image. An estimate at the end of the search cannot pass it.
    """
    means, spreads = np.where(ELEVATIONS == 0, 0.0, np.nan), np.full_like(ELEVATIONS, np.nan)
    # There the error of the asymptotic theory is far below the standard error of 100 000 trials.
    if looks < 16 or cnr_db < 20:
        return means, spreads
    cnr = 10 ** (cnr_db / 10)
    for i, elevation in enumerate(ELEVATIONS.tolist()):
        middle, spread = limit(beams, objective, elevation, cnr), limit_std(beams, objective, elevation, cnr, looks)
        if middle + 6 * spread < END_OF_SEARCH:
            means[i], spreads[i] = middle, spread
    return means, spreads


def _point(quantity: str, case: str, x: float, measured: Measured, closed_form: float) -> Curve:
    value, error = measured
    return Curve(quantity, case, np.array([x]), np.array([value]), np.array([error]), np.array([closed_form]))
