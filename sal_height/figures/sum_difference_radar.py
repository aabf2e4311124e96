"""The relief paper's sum-difference radar: its geometry and discriminator, noise, hybrids and orders of accumulation.

gamma is Delta / Sigma without noise; the signal-to-noise ratio (SNR) is that of Sigma. All targets are steady.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from scipy.special import j1, jv

from sal_height.beams import GAUSSIAN_WIDTH, pattern_named
from sal_height.elevation import (
    Estimator,
    discriminant,
    discriminate,
    discriminator_variance,
    products,
    ratio,
    total_least_squares,
)
from sal_height.figures.curve import Curve, Figure, exact_curve
from sal_height.figures.noise import BLOCK, circular
from sal_height.figures.patterns import FROM_PUPIL
from sal_height.figures.sample_statistics import Measured, mean, median, s68, std
from sal_height.figures.unit_arrays import array_of
from sal_height.geometry import EARTH_RADIUS, ApertureState, height_of, locate_at_elevation
from sal_height.numeric import C128, F64, in_threads
from sal_height.theory import (
    SteadyLaw,
    SteadyMlLaw,
    crossover_slope,
    hybrid_gain,
    s68_of,
    steady_looks_mean,
    steady_mean,
    synthesise,
)

Draw = Callable[[np.random.Generator, int], F64]

SEPARATION = 0.5
"""Separation delta of the axes of the two beams, beamwidths."""

ELEVATIONS = np.linspace(-0.7, 0.7, 57)
"""Elevations from the equisignal direction, beamwidths."""

SEPARATIONS = np.linspace(0.1, 1.2, 45)
"""Separations of the beams over which the slope is drawn, beamwidths."""

SLOPES: dict[str, Callable[[F64], F64]] = {
    "gaussian": lambda q: q / GAUSSIAN_WIDTH**2,
    "sinc": lambda q: 1 / q - np.pi / np.tan(np.pi * q),
    "jinc": lambda q: np.pi * jv(2, np.pi * q) / j1(np.pi * q),
}
"""-G'(q) / G(q) per beamwidth of each pattern G at q beamwidths."""

PLATFORM_HEIGHT = 10_000.0
"""Height H of the platform, m."""

LOOK_ANGLES_DEG = np.linspace(15, 70, 56)
"""Angles from nadir, degrees."""

ANGLE_ERROR, RANGE_ERROR = 1e-3, 1.0
"""Errors of angle (rad) and range (m) whose effects are drawn."""

WIDTH = "half 16-84 % width"

EQUAL_NOISE = (1.0, 1.0)
"""Noise powers in Sigma and Delta."""

GAMMAS = (0.25, 0.75)

SNR_DB = np.arange(-5.0, 26.0, 2.5)

ESTIMATORS: tuple[tuple[str, Estimator, type[SteadyLaw], str], ...] = (
    ("ratio", ratio, SteadyLaw, "-"),
    ("exact ML", total_least_squares, SteadyMlLaw, "--"),
)
"""The relief paper's eq. 17 and the maximum likelihood for a real angle, with the law of each and its line."""

COUPLINGS = np.linspace(0.5, 1.0, 11)
"""Coupling c of the hybrid; a passive one has at most 1 / sqrt(2)."""

LOSSES_DB = np.linspace(0, 3, 7)

ORDER_SNR, ORDER_GAMMA = 0.1, 0.5
"""SNR of one pulse."""

PULSES = np.array([1, 2, 4, 8, 16, 32, 64, 128])


def relief_discriminator() -> Iterator[Curve]:
    """Beams, sum and difference; gamma over elevation with the paper's straight line; its slope over the separation."""
    lower, upper = (FROM_PUPIL["jinc"](ELEVATIONS + sign * SEPARATION / 2) for sign in (1, -1))
    response = array_of((pattern_named("jinc"),), 2, SEPARATION).response(ELEVATIONS, 0.0)
    for colour, (case, weights, closed_form) in enumerate(
        (
            ("lower", (1, 0), lower),
            ("upper", (0, 1), upper),
            ("sum", (1, 1), upper + lower),
            ("difference", (-1, 1), upper - lower),
        )
    ):
        yield exact_curve("amplitude", case, ELEVATIONS, response @ weights, closed_form, colour=colour)
    for colour, (name, slope) in enumerate(SLOPES.items()):
        pattern = pattern_named(name)
        low, high = (FROM_PUPIL[name](ELEVATIONS + sign * SEPARATION / 2) for sign in (1, -1))
        gamma = discriminant(array_of((pattern,), 2, SEPARATION), ELEVATIONS, 0.0)
        yield exact_curve("gamma", name, ELEVATIONS, gamma, (high - low) / (high + low), colour=colour)
        line, expected = crossover_slope(pattern, SEPARATION, 1.0), slope(np.array(SEPARATION / 2))
        yield exact_curve(
            "gamma", f"{name}, g theta", ELEVATIONS, line * ELEVATIONS, expected * ELEVATIONS, "--", colour
        )
        slopes = np.array([crossover_slope(pattern, separation, 1.0) for separation in SEPARATIONS.tolist()])
        yield exact_curve("slope", name, SEPARATIONS, slopes, slope(SEPARATIONS / 2), colour=colour)


def relief_geometry() -> Iterator[Curve]:
    """Height h = H - rho cos theta (relief paper, eq. 1) and on the sphere, and its errors caused by theta and rho.

    Ranges are those of a plane square to nadir.
    """
    theta = np.deg2rad(LOOK_ANGLES_DEG)
    slant_range = PLATFORM_HEIGHT / np.cos(theta)
    for colour, (case, height, law) in enumerate((("flat", _flat, _flat_law), ("sphere", _sphere, _sphere_law))):
        for quantity, angle, distance in (
            ("height error of 1 mrad", theta + ANGLE_ERROR, slant_range),
            ("height error of 1 m of range", theta, slant_range + RANGE_ERROR),
        ):
            error = height(angle, distance) - height(theta, slant_range)
            expected = law(angle, distance) - law(theta, slant_range)
            yield exact_curve(quantity, case, LOOK_ANGLES_DEG, error, expected, colour=colour)
        value, expected = height(theta, slant_range), law(theta, slant_range)
        yield exact_curve("height", case, LOOK_ANGLES_DEG, value, expected, colour=colour)
    first_order = slant_range * np.sin(theta) * ANGLE_ERROR
    yield exact_curve("height error of 1 mrad", "rho sin theta", LOOK_ANGLES_DEG, first_order, no_theory(theta), ":", 2)


def _seen(theta: F64, slant_range: F64) -> F64:
    """Points in the map at these angles and ranges from a level platform, to the right and abeam."""
    position, velocity = np.array([0.0, 0.0, PLATFORM_HEIGHT]), np.array([1.0, 0.0, 0.0])
    return locate_at_elevation(
        theta, slant_range, 0.0, ApertureState(position, velocity, np.eye(3), 1.0, np.zeros((6, 6))), 1
    )


def _flat(theta: F64, slant_range: F64) -> F64:
    return _seen(theta, slant_range)[..., 2]


def _sphere(theta: F64, slant_range: F64) -> F64:
    return height_of(_seen(theta, slant_range))


def _flat_law(theta: F64, slant_range: F64) -> F64:
    return PLATFORM_HEIGHT - slant_range * np.cos(theta)


def _sphere_law(theta: F64, slant_range: F64) -> F64:
    """From the triangle of platform, target and the earth's centre: r by the law of cosines, (r^2 - R^2) / (r + R)."""
    high = EARTH_RADIUS + PLATFORM_HEIGHT
    drop = slant_range**2 - 2 * high * slant_range * np.cos(theta)
    squares = PLATFORM_HEIGHT * (high + EARTH_RADIUS) + drop
    return squares / (np.sqrt(high**2 + drop) + EARTH_RADIUS)


def relief_snr(trials: int, seed: int) -> Iterator[Curve]:
    """Bias and spread of the paper's ratio and of the exact maximum likelihood over the SNR of one pulse train.

    The maximum likelihood has no mean. All points have the same draws of noise.
    """
    snr = 10 ** (SNR_DB / 10)
    for colour, gamma in enumerate(GAMMAS):
        for name, estimator, law, style in ESTIMATORS:
            sample = sampled(partial(_trains, gamma, snr, estimator), (seed, 31), trials)
            case, off, laws = f"gamma {gamma}, {name}", sample - gamma, [law(gamma, x) for x in snr.tolist()]
            if estimator is ratio:
                bias = steady_mean(gamma, snr) - gamma
                yield Curve("bias", f"{case}, mean", SNR_DB, *measured(mean, off), bias, ":", colour)
            bias = np.array([law.ppf(0.5) for law in laws]) - gamma
            yield Curve("bias", f"{case}, median", SNR_DB, *measured(median, off), bias, style, colour)
            widths = np.array([s68_of(law) for law in laws])
            yield Curve(WIDTH, case, SNR_DB, *measured(s68, sample), widths, style, colour)
        first_order = np.sqrt(discriminator_variance(gamma, snr, EQUAL_NOISE))
        yield exact_curve(WIDTH, f"gamma {gamma}, first order", SNR_DB, first_order, no_theory(snr), ":", colour)


def _trains(gamma: float, snr: F64, estimator: Estimator, rng: np.random.Generator, trials: int) -> F64:
    """Estimates of gamma from one pulse train in unit noise each, shape (SNRs, trials)."""
    total, difference = circular(rng, (2, trials, 1))
    return np.stack([_estimate(estimator, total + a, difference + gamma * a) for a in np.sqrt(snr).tolist()])


def _estimate(estimator: Estimator, total: C128, difference: C128) -> F64:
    return discriminate(products(total, difference), estimator, EQUAL_NOISE)


def relief_hybrid(trials: int, seed: int) -> Iterator[Curve]:
    """Gain in SNR of a hybrid before the receivers, from the spread of gamma, over sums formed after them.

    Lossless and unitary, it gains nothing. All points have the same draws of noise.
    """
    (after,), (after_error,) = measured(std, sampled(_after, (seed, 32), trials))
    unitary, none = np.sqrt(0.5), np.zeros_like(COUPLINGS)
    for colour, (quantity, case, x, coupling, loss_db) in enumerate(
        (
            ("gain over loss", "c 1", LOSSES_DB, np.ones_like(LOSSES_DB), LOSSES_DB),
            ("gain over loss", "c 1 / sqrt 2", LOSSES_DB, np.full_like(LOSSES_DB, unitary), LOSSES_DB),
            ("gain over coupling", "no loss", COUPLINGS, COUPLINGS, none),
        )
    ):
        loss = 10 ** (loss_db / 10)
        before, error = measured(std, sampled(partial(_before, coupling / np.sqrt(loss)), (seed, 33), trials))
        gain, expected = 20 * np.log10(after / before), 10 * np.log10(hybrid_gain(coupling, loss))
        both = 20 / np.log(10) * np.hypot(error / before, after_error / after)
        yield Curve(quantity, case, x, gain, both, expected, colour=colour)


def _beams() -> F64:
    """Amplitudes of lower and upper beam, shape (2, 1, 1), of which (upper + lower)^2 / 2 is the SNR.

    The SNR is high enough that the spread of gamma gives it within 0.3 %.
    """
    snr, gamma = 1000.0, 0.5
    lower_upper = np.array([1 - gamma, 1 + gamma])
    return np.sqrt(snr / 2) * lower_upper[:, None, None]


def _after(rng: np.random.Generator, trials: int) -> F64:
    """Estimates from sum and difference of two beams that were each received in unit noise, shape (1, trials)."""
    lower, upper = _beams() + circular(rng, (2, trials, 1))
    return _estimate(total_least_squares, upper + lower, upper - lower)[None]


def _before(amplitudes: F64, rng: np.random.Generator, trials: int) -> F64:
    """Estimates from `amplitudes` times sum and difference, received in unit noise: shape (amplitudes, trials)."""
    (lower, upper), (noise, other) = _beams(), circular(rng, (2, trials, 1))
    received = [(a * (upper + lower) + noise, a * (upper - lower) + other) for a in amplitudes.tolist()]
    return np.stack([_estimate(total_least_squares, *channels) for channels in received])


def relief_order(trials: int, seed: int) -> Iterator[Curve]:
    """The paper's ratio of weak pulses, over their number, in three orders of accumulation.

    Only coherent sums of Sigma and Delta bring the mean to gamma. Sums of products bring it to gamma x / (x + 1), worse
    than the mean of the pulses' ratios, gamma (1 - exp(-x)), x being the SNR of one pulse.
    """
    sample = sampled(_in_orders, (seed, 34), trials).reshape(3, len(PULSES), trials)
    x, gamma, number = ORDER_SNR, ORDER_GAMMA, PULSES.astype(np.float64)
    single = np.full_like(number, steady_mean(gamma, x))
    means = steady_mean(gamma, x * number), steady_looks_mean(gamma, x, number), single
    widths = np.full((3, len(PULSES)), np.nan)
    widths[:, 0] = s68_of(SteadyLaw(gamma, x))
    widths[0] = [s68_of(SteadyLaw(gamma, x * pulses)) for pulses in PULSES.tolist()]
    for colour, case in enumerate(("aperture, then ratio", "products, then ratio", "ratios, then mean")):
        yield Curve("mean", case, number, *measured(mean, sample[colour]), means[colour], colour=colour)
        yield Curve(WIDTH, case, number, *measured(s68, sample[colour]), widths[colour], colour=colour)


def _in_orders(rng: np.random.Generator, trials: int) -> F64:
    """Estimates of gamma in the three orders from the first pulses of each trial, shape (3 PULSES, trials)."""
    total, difference = circular(rng, (2, trials, int(PULSES[-1])))
    total += np.sqrt(ORDER_SNR)
    difference += ORDER_GAMMA * np.sqrt(ORDER_SNR)
    each = _estimate(ratio, total[..., None], difference[..., None])
    first = [(total[:, :number], difference[:, :number]) for number in PULSES.tolist()]
    apertures = [[synthesise(channel, np.zeros(1))[:, None] for channel in channels] for channels in first]
    return np.stack(
        [
            *(_estimate(ratio, *aperture) for aperture in apertures),
            *(_estimate(ratio, *channels) for channels in first),
            *(np.mean(each[:, :number], axis=1) for number in PULSES.tolist()),
        ]
    )


def sampled(draw: Draw, seed: tuple[int, int], trials: int) -> F64:
    """Estimates of shape (points, trials), from blocks that `draw` makes with a generator each and a number."""
    counts = [min(BLOCK, trials - first) for first in range(0, trials, BLOCK)]
    seeds = np.random.SeedSequence(seed).spawn(len(counts))
    return np.concatenate(in_threads(draw, map(np.random.default_rng, seeds), counts), axis=1)


def measured(statistic: Callable[[F64], Measured], sample: F64) -> tuple[F64, F64]:
    """A statistic of each row of a sample, and its standard errors."""
    values, errors = np.array([statistic(row) for row in sample]).T
    return values, errors


def no_theory(x: F64) -> F64:
    """The closed form of an approximation that is drawn for comparison."""
    return np.full_like(x, np.nan)


_OFF_AXIS = "off the equisignal direction (beamwidths)"
_LOOK = "look angle from nadir (deg)"
_SNR = "SNR of Sigma (dB)"
_PULSES = f"pulses of {10 * np.log10(ORDER_SNR):.0f} dB"

RELIEF_FIGURES = {
    "relief_discriminator": Figure(
        f"Relief paper, figure 2: discrimination characteristic of two beams {SEPARATION} beamwidths apart",
        {
            "amplitude": (_OFF_AXIS, "amplitude (circular aperture)"),
            "gamma": (_OFF_AXIS, "gamma = difference / sum"),
            "slope": ("separation of the beams (beamwidths)", "slope g of gamma (1 / beamwidth)"),
        },
        13,
        lambda _trials, _seed: relief_discriminator(),
    ),
    "relief_geometry": Figure(
        f"Relief paper, figure 1: height from look angle and range, platform at {PLATFORM_HEIGHT / 1000:.0f} km",
        {
            "height": (_LOOK, "height of a plane (m)"),
            "height error of 1 mrad": (_LOOK, "height error (m)"),
            "height error of 1 m of range": (_LOOK, "height error (m)"),
        },
        7,
        lambda _trials, _seed: relief_geometry(),
    ),
    "relief_snr": Figure(
        "Relief paper, eq. 17: its ratio and the exact maximum likelihood for a real angle; one pulse train",
        {"bias": (_SNR, "bias of the estimated gamma"), WIDTH: (_SNR, f"{WIDTH} of the estimated gamma")},
        12,
        relief_snr,
    ),
    "relief_hybrid": Figure(
        "Relief paper, eq. 3: sum and difference formed before the receivers, against after them",
        {
            "gain over coupling": ("coupling c of the hybrid", "gain in SNR (dB)"),
            "gain over loss": ("loss of the hybrid (dB)", "gain in SNR (dB)"),
        },
        3,
        relief_hybrid,
    ),
    "relief_order": Figure(
        f"Relief paper, conclusions: orders of accumulation, gamma {ORDER_GAMMA}, steady target",
        {"mean": (_PULSES, "mean of the estimated gamma"), WIDTH: (_PULSES, f"{WIDTH} of the estimated gamma")},
        6,
        relief_order,
    ),
}
"""Figures by name."""
