"""Tests of single scatterers: the noise of every pixel, thresholds for more scatterers, and the spread of surfaces.

They give the pixels that may have more than a point, and the probability of that before other models are fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import ORDERS, ElevationEstimate, noise_limit, sidelobe_limit
from sal_height.elevation.array.likelihood import ArraySettings, SinglePeaks
from sal_height.elevation.array.search import SQUINT_STEP
from sal_height.elevation.layover.extended import free_looks, spread_of
from sal_height.elevation.layover.order import (
    NEIGHBOURS,
    ONE,
    SPREAD,
    SPREADS,
    THREE,
    TWO,
    detection_threshold,
    log_evidence_of_level,
    log_evidence_of_one,
    log_evidence_of_spread,
    path_length,
)
from sal_height.elevation.layover.several import power_of
from sal_height.elevation.looks.looks import Looks
from sal_height.numeric import F64, Bool, blocks, in_threads, rows_at_once
from sal_height.settings import setting


class LayoverSettings(ArraySettings):
    """Settings of the estimators that search for several scatterers in a pixel."""

    layover: bool = setting(
        default=True, description="whether to search every pixel for several scatterers and extended surfaces"
    )
    layover_false_alarm: float = setting(
        1e-3,
        "fraction of single scatterers that may pass for two",
        minimum=1e-9,
        maximum=0.1,
    )
    spread_false_alarm: float = setting(
        1e-2,
        "fraction of points that may pass for extended surfaces; these keep a height",
        minimum=1e-9,
        maximum=0.1,
    )


@dataclass(frozen=True, eq=False)
class PixelNoise:
    """Noise and disturbances in a pixel; arrays (rows, cols), in units of the receivers' noise power.

    Attributes:
        beam_error: power of the errors of the beams in a channel, sum over looks (`beam_error`).
        raised: mean power of one look of noise, sidelobes of other pixels and errors of the beams.
        along_slope: mean power along the slope of one look of a scatterer on level ground, over `raised`: 1 plus the
            power from the different ranges in a pixel. These move the middle of its elevations with that of its ranges,
            the range of the height.
    """

    beam_error: F64
    raised: F64
    along_slope: F64

    @classmethod
    def of(cls, peaks: SinglePeaks, looks: Looks, beams: Beams) -> Self:
        """The noise in the pixels of `peaks`."""
        error = beams.uncertainty**2 * np.maximum(peaks.explained - looks.count, 0.0) / peaks.array_power
        raised = looks.floor + error / looks.count
        power = np.maximum(peaks.explained / raised / looks.count - 1, 0.0)
        return cls(error, raised, 1 + power * peaks.turning * looks.level_spread**2)


@dataclass(frozen=True, eq=False)
class Levels:
    """Powers over the raised noise power that noise, sidelobes and errors of the beams rarely exceed; (rows, cols).

    Attributes:
        tried: power from which one more scatterer is searched for.
        several: power from which one more scatterer is accepted.
        spread: power along the slope from which the scatterer is spread.
    """

    tried: F64
    several: F64
    spread: F64

    @classmethod
    def of(cls, noise: PixelNoise, looks: Looks, beams: Beams, settings: LayoverSettings) -> Self:
        """The levels for the number of looks of every pixel."""
        longest = looks.columns.each(partial(_longest_path, beams), looks.squint)
        values, of_col = np.unique(longest, return_inverse=True)
        lengths: list[float] = values.tolist()
        counts, of_pixel = np.unique(looks.count, return_inverse=True)
        of_pixel = of_pixel.reshape(looks.count.shape)
        sidelobes = sidelobe_limit(looks.leaked, settings.sidelobe_rate)

        def level(of_noise: F64, rate: float) -> F64:
            # Errors of the beams are also those of one look, but differ between directions.
            errors = sidelobe_limit(noise.beam_error, rate)
            return (of_noise + sidelobes + errors) / noise.raised

        rarely = settings.layover_false_alarm
        often = min(10 * rarely, 0.5)  # several scatterers are tried ten times as often as they may be accepted
        spread = noise_limit(free_looks(counts), settings.spread_false_alarm)[of_pixel]
        tried, several = (
            np.array([[detection_threshold(length, count, rate) for length in lengths] for count in counts.tolist()])
            for rate in (often, rarely)
        )
        return cls(
            tried=level(tried[of_pixel, of_col], often / beams.count),
            several=level(several[of_pixel, of_col], rarely / beams.count),
            spread=level(spread, settings.spread_false_alarm) * noise.along_slope,
        )


def _longest_path(beams: Beams, squint: F64) -> F64:
    """Length of the longest path over the boresights at the squints (rad) of a dwell, the same for each of them.

    It is longest at one of the ends, and changes by a thousandth in SQUINT_STEP.
    """
    step = SQUINT_STEP * beams.track_beamwidth
    ends = np.rint(np.array([squint.min(), squint.max()]) / step) * step
    return np.full(len(squint), max(path_length(beams, end) for end in ends.tolist()))


@dataclass(frozen=True, eq=False)
class Spread:
    """Standard deviation of elevation within surfaces that look like single scatterers, rad, (rows, cols).

    It is that beyond the spread of level ground.

    Attributes:
        own: spread of the pixel, from the power along the slope of the response; a small one is hardly distinct from
            noise.
        around: mean spread of a square of NEIGHBOURS pixels.
    """

    own: F64
    around: F64

    @classmethod
    def of(cls, peaks: SinglePeaks, noise: PixelNoise, levels: Levels, looks: Looks) -> Self:
        """Spreads from the power along the slopes; power beyond twice its level is not that of a surface."""
        power = power_of(peaks.explained, looks.count)
        free = np.where(looks.finite, free_looks(looks.count), 0.0)
        along = np.where(looks.finite, np.minimum(peaks.along_slope, 2 * levels.spread), 0.0)
        excess, unit = along - free * noise.along_slope, np.where(looks.finite, free * power * peaks.turning, 0.0)
        level = noise.along_slope
        own = spread_of(peaks.along_slope / level, looks.count, power / level, peaks.turning)
        return cls(own, spread_around(excess, unit, looks))


def spread_around(excess: F64, unit: F64, looks: Looks) -> F64:
    """Mean spread of the surfaces in a square of NEIGHBOURS pixels around each, rad, (rows, cols).

    Args:
        excess: power along the slopes of the responses beyond that of noise and of level ground, (rows, cols).
        unit: the same power of surfaces whose spread is 1 rad.
        looks: covariance of the pixels.
    """
    pooled, units = looks.columns.mean_of_neighbours(np.stack([excess, unit]), NEIGHBOURS)
    return np.sqrt(np.divide(np.maximum(pooled, 0.0), units, where=units > 0, out=np.zeros_like(units)))


def surface_deviation(spread: F64, looks: Looks) -> F64:
    """Standard deviation of the middle of a surface of this spread at the range of its height, rad, (rows, cols)."""
    return spread * np.sqrt(looks.unplaced / (2 * np.maximum(looks.count, 1.0)))


@dataclass(frozen=True, eq=False)
class SingleScatterers:
    """The pixels of an image under the assumption of a single scatterer in each.

    Attributes:
        estimate: estimate of these scatterers.
        peaks: peaks with the gains of one more scatterer, over the raised noise power.
        noise: noise in the pixels.
        levels: thresholds for more than noise.
        spread: spread of their surfaces.
    """

    estimate: ElevationEstimate
    peaks: SinglePeaks
    noise: PixelNoise
    levels: Levels
    spread: Spread

    @classmethod
    def of(
        cls, estimate: ElevationEstimate, peaks: SinglePeaks, looks: Looks, beams: Beams, settings: LayoverSettings
    ) -> Self:
        """Single scatterers of `peaks` in receivers' noise powers; other arguments as in `models.resolve`."""
        noise = PixelNoise.of(peaks, looks, beams)
        peaks, levels = peaks.over(noise.raised), Levels.of(noise, looks, beams, settings)
        return cls(estimate, peaks, noise, levels, Spread.of(peaks, noise, levels, looks))

    @property
    def suspicious(self) -> Bool:
        """True where one more scatterer, or a spread, would explain more than noise often does, (rows, cols)."""
        return (self.peaks.beside > self.levels.tried) | (self.peaks.along_slope > self.levels.spread)

    def log_evidence(self, looks: Looks, beams: Beams) -> F64:
        """Log-evidence of each model against noise from the gains of one more scatterer, (rows, cols, ORDERS)."""
        domain, evidence = float(np.ptp(beams.span)), np.zeros((*looks.count.shape, ORDERS))

        def weigh(rows: slice) -> None:
            peaks, count, raised = self.peaks, looks.count[rows], self.noise.along_slope[rows]
            along, explained, turning = peaks.along_slope[rows], peaks.explained[rows], peaks.turning[rows]
            single = log_evidence_of_one(explained, count, turning, domain)
            more = log_evidence_of_one(peaks.beside[rows], count, turning, domain)
            spread = log_evidence_of_spread(along, explained, count, turning, raised, beams.beamwidth)
            evidence[rows, :, ONE] = single + log_evidence_of_level(along, count, raised)
            evidence[rows, :, TWO], evidence[rows, :, THREE] = single + more, single + 2 * more
            evidence[rows, :, SPREAD] = single + spread

        in_threads(weigh, blocks(len(evidence), rows_at_once(len(SPREADS) * evidence.shape[1])))
        return evidence

    def sigma(self, probability: F64, looks: Looks) -> F64:
        """Standard deviation (rad) of the elevations, on surfaces or of two scatterers a spread away from their middle.

        Args:
            probability: probability of the models, (rows, cols, ORDERS).
            looks: covariance of the pixels.
        """
        likely = probability[..., ONE] + probability[..., TWO] + probability[..., SPREAD]
        of_two = probability[..., TWO] / np.maximum(likely, 1e-300)
        on_surface = surface_deviation(self.spread.around, looks)
        return np.sqrt(self.estimate.sigma**2 + on_surface**2 + of_two * self.spread.own**2)
