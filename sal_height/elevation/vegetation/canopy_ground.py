"""Elevation of the ground under a canopy: the lowest layer that is too thin to be part of the volume above it.

The covariance over the noise power of a pixel with ground at elevation t under a canopy is modelled as

    C(t) = I + p a(t) a(t)^H + sum_j v_j V_j(t),    V_j(t) = integral b_j(x - t) a(x) a(x)^H dx,    p, v_j >= 0

with triangles b_j, LAYER_BEAMWIDTHS apart and as wide to each side, from t upwards: a volume whose reflectivity changes
no faster than that, over a ground that does (random volume over ground). p and v are those of greatest likelihood for
each t (`_fit`). Twice the gain in log-likelihood

    L(t) = -K (ln det C(t) + tr C(t)^-1 R)

over the best model without ground tests p = 0, which is at the edge of the allowed range, so that without ground it
exceeds x with half the probability of chi-square of one degree (Self and Liang, J. American Statistical Association 82,
1987). Elevation and sigma are mean and standard deviation over t with the weight exp L(t): the volume may take over
part of the ground, which the curvature at the peak alone would not show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import chdtri

from sal_height.beams import Beams
from sal_height.elevation.array.bounds import Numbers, beam_power
from sal_height.elevation.array.estimate import ElevationEstimate, Validity, detection_limit
from sal_height.elevation.array.height_settings import HeightSettings
from sal_height.elevation.looks.looks import Looks
from sal_height.numeric import F64, in_parallel
from sal_height.settings import setting

LAYER_BEAMWIDTHS = 0.8
"""Distance between the layers of the volume, and its least mean height above the ground.

With 0.5 the volume passes for ground; with 1.0 and more the lower edge of crowns without undergrowth does, of 20 dB in
60 looks in 27 % of the pixels.
"""

STEP_BEAMWIDTHS = 0.1  # between elevations that are tried for the ground; the likelihood between them is a spline


class CanopyGroundSettings(HeightSettings):
    """Settings of the ground under a canopy."""

    max_sigma_beamwidths: float = setting(
        0.2,
        "largest standard deviation of elevation of a valid pixel; above it the pixel is IMPRECISE",
        unit="beamwidths",
        minimum=1e-3,
        maximum=10.0,
    )


@dataclass(frozen=True, eq=False)
class _Scan:
    """Log-likelihoods L of some pixels, over that of noise alone.

    Attributes:
        both: L with ground and volume, shape (elevations, pixels).
        volume: greatest L without ground, (pixels,).
        surface: greatest L without volume, (pixels,).
        explained: greatest power that a single surface explains, sum over looks, over the noise power, (pixels,).
        ground: power p of the ground at the elevation of greatest likelihood, (pixels,).
        canopy: mean height of the volume above it, beamwidths, (pixels,).
    """

    both: F64
    volume: F64
    surface: F64
    explained: F64
    ground: F64
    canopy: F64


def canopy_ground_elevation(looks: Looks, beams: Beams, settings: CanopyGroundSettings) -> ElevationEstimate:
    """Elevation of the ground in pixels with ground and a canopy above it.

    NO_GROUND: ground and canopy cannot be separated, as without an echo of the ground, or the pixel has only one
    surface, which may be either. NO_SIGNAL: nothing is detected. OUTSIDE_ARRAY: the ground is not above the first
    boresight. Ground means the lowest thin layer, whatever it consists of.

    Args:
        looks: covariance of M channels of equal noise in each pixel; complex if the beams are.
        beams: beams of the M channels.
        settings: rates of false alarms, and the limits for valid pixels.
    """
    first, last = beams.span
    tried = np.linspace(first, last, math.ceil((last - first) / beams.beamwidth / STEP_BEAMWIDTHS) + 1)
    shape = looks.count.shape
    elevation, sigma, power, canopy, explained = (np.full(shape, np.nan) for _ in range(5))
    best, evidence = np.zeros(shape, int), np.zeros((2, *shape))

    def work(cols: slice) -> None:
        for col in range(*cols.indices(shape[1])):
            rows = np.flatnonzero(looks.finite[:, col] & (looks.count[:, col] > 0))
            if not rows.size:
                continue
            here, count = (rows, np.full(len(rows), col)), looks.count[rows, col]
            mean = looks.covariance[here] / (count * looks.noise_power[here])[:, None, None]
            mean = mean.astype(np.complex128 if beams.is_complex else np.float64)
            scan = _scan(mean, count, beams, float(looks.squint[col]), tried)
            elevation[here], sigma[here] = _moments(tried, scan.both)
            # The part of the volume that is finer than its layers displaces the ground: where ground of a third of the
            # canopy's power is just detected, its mean error is 0.02 to 0.04 beamwidths.
            sigma[here] = np.hypot(sigma[here], 0.025 * beams.beamwidth)
            power[here], canopy[here], explained[here] = scan.ground, scan.canopy, scan.explained
            best[here] = scan.both.argmax(axis=0)
            evidence[:, *here] = 2 * (scan.both.max(axis=0) - np.stack([scan.volume, scan.surface]))

    in_parallel(work, shape[1])
    detected = explained * looks.floor >= detection_limit(looks, beams.count, settings)
    resolved = (evidence > chdtri(1, 2 * settings.false_alarm_rate)).all(axis=0) & (canopy > LAYER_BEAMWIDTHS)
    gain = looks.columns.each(beams.power, np.where(np.isfinite(elevation), elevation, first), looks.squint)
    received = looks.power / (looks.count * looks.noise_power) - beams.count
    # With many looks at high CNR, the part of a volume without ground that the layers cannot follow passes for ground,
    # with 0.5 to 3.5 % of the power (canopies of 30 dB, 60 looks).
    inside = (elevation > first) & (power >= settings.min_cnr) & (power * gain > 0.05 * received)
    precise = sigma <= settings.max_sigma_beamwidths * beams.beamwidth
    validity = np.select(
        [~looks.finite, ~detected, best <= 1, ~(resolved & inside), ~precise],
        [Validity.MISSING_DATA, Validity.NO_SIGNAL, Validity.OUTSIDE_ARRAY, Validity.NO_GROUND, Validity.IMPRECISE],
        Validity.OK,
    ).astype(np.uint8)
    return ElevationEstimate.of_one(elevation, sigma, power, validity)


def _scan(mean: Numbers, count: F64, beams: Beams, squint: float, tried: F64) -> _Scan:
    """Log-likelihoods of pixels (mean covariances over the noise power, (pixels, M, M)) with ground at each elevation.

    Args:
        mean: R.
        count: K, (pixels,).
        beams: beams of the channels.
        squint: squint of the pixels, rad.
        tried: elevations of the ground, rad.
    """
    noise = np.trace(mean, axis1=1, axis2=2).real
    both, bare = np.empty((2, len(tried), len(mean)))
    bare[:] = -np.inf
    ground, canopy = np.empty((2, len(tried), len(mean)))
    for index, elevation in enumerate(tried):
        layers = _layers(beams, squint, elevation)
        powers, both[index] = _fit(mean, layers)
        volume, heights = powers[:, 1:], LAYER_BEAMWIDTHS * np.arange(len(layers) - 1)
        ground[index], canopy[index] = powers[:, 0], volume @ heights / np.maximum(volume.sum(axis=1), 1e-300)
        if index % 3 == 0:  # as the lower end of a volume without ground
            bare[index] = _fit(mean, layers[1:])[1]
    response = beams.response(tried, squint)
    alone = np.sum((response.conj() @ mean) * response, axis=-1).real / beam_power(response)  # a^H R a / |a|^2
    best, pixel = both.argmax(axis=0), np.arange(len(mean))
    alone = np.maximum(alone.max(axis=1), 1.0)
    return _Scan(
        both=count * (both + noise),
        volume=count * (bare.max(axis=0) + noise),
        surface=count * (alone - 1 - np.log(alone)),  # the likelihood of the best power p
        explained=count * alone,
        ground=ground[best, pixel],
        canopy=canopy[best, pixel],
    )


def _layers(beams: Beams, squint: float, elevation: float) -> Numbers:
    """Covariances of ground at an elevation and of each layer of the volume above, of power 1 each: (1 + J, M, M)."""
    end = beams.domain(0.0)[1]
    steps = math.floor((end - elevation) / beams.beamwidth / STEP_BEAMWIDTHS)
    above = STEP_BEAMWIDTHS * np.arange(max(steps, 1) + 1)
    middles = np.arange(0.0, above[-1] + 1e-9, LAYER_BEAMWIDTHS)
    weights = np.maximum(1 - np.abs(above - middles[:, None]) / LAYER_BEAMWIDTHS, 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    weights = np.concatenate([np.eye(1, len(above)), weights])
    response = beams.response(np.minimum(elevation + above * beams.beamwidth, end), squint)
    return np.swapaxes(weights[:, :, None] * response, 1, 2) @ response.conj()


def _fit(mean: Numbers, layers: Numbers) -> tuple[F64, F64]:
    """Powers of greatest likelihood of the layers, (pixels, layers), and -ln det C - tr C^-1 R there, (pixels,).

    The steps are those of `profile.invert`. No layer may have more power than the pixel: without a layer at the
    elevations of the scatterers, the faintest parts of the layers would be raised without limit to explain them.
    """
    channels = mean.shape[-1]
    flat, dual = layers.reshape(len(layers), -1), layers.conj().reshape(len(layers), -1).T

    def model(powers: F64) -> Numbers:
        return (powers @ flat).reshape(mean.shape) + np.eye(channels)

    above_noise = np.maximum(np.trace(mean, axis1=1, axis2=2).real - channels, 1.0)
    most = above_noise[:, None] / np.trace(layers, axis1=1, axis2=2).real
    powers = most / len(layers)
    for _ in range(30):
        inverse = np.linalg.inv(model(powers))
        seen, expected = ((m.reshape(len(mean), -1) @ dual).real for m in (inverse @ mean @ inverse, inverse))
        powers = np.minimum(powers * np.sqrt(np.maximum(seen, 0.0) / expected), most)
    covariance = model(powers)
    misfit = np.trace(np.linalg.solve(covariance, mean), axis1=1, axis2=2).real
    return powers, -np.linalg.slogdet(covariance)[1] - misfit


def _moments(elevations: F64, likelihood: F64) -> tuple[F64, F64]:
    """Mean and standard deviation (rad) over elevation with the weight exp L, L a spline through the given values.

    Args:
        elevations: increasing, equally spaced angles, shape (n,), rad.
        likelihood: L, shape (n, pixels).
    """
    fine = np.linspace(elevations[0], elevations[-1], 8 * (len(elevations) - 1) + 1)
    smooth = CubicSpline(elevations, likelihood, axis=0)(fine)
    weight = np.exp(smooth - smooth.max(axis=0))
    weight /= weight.sum(axis=0)
    mean = fine @ weight
    return mean, np.sqrt(np.sum(weight * (fine[:, None] - mean) ** 2, axis=0))
