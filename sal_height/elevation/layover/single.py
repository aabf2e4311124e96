"""What single scatterers say of every pixel: its noise, how much more would be suspicious, and how spread surfaces are.

From this follows which pixels may hold more than a point, and how probable that is before anything else is fitted.
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
from sal_height.numeric import F64, Bool
from sal_height.settings import setting

SUSPICIOUS = 10.0  # several scatterers are tried for so many times the share of single ones that may be taken for two


class LayoverSettings(ArraySettings):
    """Settings of the estimators that look for several scatterers in a pixel."""

    layover: bool = setting(
        default=True, description="whether to search every pixel for several scatterers and extended surfaces"
    )
    layover_false_alarm: float = setting(
        1e-3,
        "fraction of single scatterers that may be taken for two",
        minimum=1e-9,
        maximum=0.1,
    )
    spread_false_alarm: float = setting(
        1e-2,
        "fraction of points that may be taken for extended surfaces; these keep a height",
        minimum=1e-9,
        maximum=0.1,
    )


@dataclass(frozen=True, eq=False)
class PixelNoise:
    """What acts as noise in a pixel; arrays (rows, cols), in units of the receivers' noise power.

    Attributes:
        beam_error: power of the errors of the beams in a channel, sum over looks (`beam_error`).
        raised: mean power of one look of noise, sidelobes of other pixels and errors of the beams.
        along_slope: mean power along the slope of one look of a scatterer on level ground, over `raised`: 1 and what
            the different ranges in a pixel bring. They move the middle of its elevations with that of its ranges, which
            heights belong to.
    """

    beam_error: F64
    raised: F64
    along_slope: F64

    @classmethod
    def of(cls, peaks: SinglePeaks, looks: Looks, beams: Beams) -> Self:
        """The noise beside the scatterers of `peaks`."""
        error = beams.uncertainty**2 * np.maximum(peaks.explained - looks.count, 0.0) / peaks.array_power
        raised = looks.floor + error / looks.count
        power = np.maximum(peaks.explained / raised / looks.count - 1, 0.0)
        return cls(error, raised, 1 + power * peaks.turning * looks.level_spread**2)


@dataclass(frozen=True, eq=False)
class Levels:
    """Powers over the raised noise power that noise, sidelobes and errors of the beams rarely exceed; (rows, cols).

    Attributes:
        tried: from which on one more scatterer is looked for.
        several: from which on one more is taken.
        spread: power along the slope from which on the scatterer is spread.
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
            # Errors of the beams are those of one look, too, but differ between directions.
            errors = sidelobe_limit(noise.beam_error, rate)
            return (of_noise + sidelobes + errors) / noise.raised

        rarely = settings.layover_false_alarm
        often = min(SUSPICIOUS * rarely, 0.5)
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
        own: as the power along the slope of the response shows it; it hardly tells a small spread from noise.
        around: of NEIGHBOURS pixels together.
    """

    own: F64
    around: F64

    @classmethod
    def of(cls, peaks: SinglePeaks, noise: PixelNoise, levels: Levels, looks: Looks) -> Self:
        """The spreads behind the power along the slopes; beyond twice its level it is not that of a surface."""
        power = power_of(peaks.explained, looks.count)
        free = np.where(looks.finite, free_looks(looks.count), 0.0)
        along = np.where(looks.finite, np.minimum(peaks.along_slope, 2 * levels.spread), 0.0)
        excess, unit = along - free * noise.along_slope, np.where(looks.finite, free * power * peaks.turning, 0.0)
        pooled, units = looks.columns.mean_of_neighbours(np.stack([excess, unit]), NEIGHBOURS)
        around = np.divide(np.maximum(pooled, 0.0), units, where=units > 0, out=np.zeros_like(units))
        level = noise.along_slope
        own = spread_of(peaks.along_slope / level, looks.count, power / level, peaks.turning)
        return cls(own, np.sqrt(around))

    def deviation(self, spread: F64, looks: Looks) -> F64:
        """Standard deviation of the middle of a surface of this spread at the range of its height, rad."""
        return spread * np.sqrt(looks.unplaced / (2 * np.maximum(looks.count, 1.0)))


@dataclass(frozen=True, eq=False)
class SingleScatterers:
    """The pixels of an image as if each held a single scatterer.

    Attributes:
        estimate: of these.
        peaks: with the gains of one more, over the raised noise power.
        noise: beside them.
        levels: of what is more than noise.
        spread: of the surfaces they are on.
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
        """Those of `peaks` in noise powers of the receivers; the other arguments are those of `layover.resolve`."""
        noise = PixelNoise.of(peaks, looks, beams)
        peaks, levels = peaks.over(noise.raised), Levels.of(noise, looks, beams, settings)
        return cls(estimate, peaks, noise, levels, Spread.of(peaks, noise, levels, looks))

    @property
    def suspicious(self) -> Bool:
        """Where one more scatterer, or a spread, would explain more than noise often does, (rows, cols)."""
        return (self.peaks.beside > self.levels.tried) | (self.peaks.along_slope > self.levels.spread)

    def log_evidence(self, looks: Looks, beams: Beams) -> F64:
        """Log-evidence of each model against noise from the gains of one more scatterer, (rows, cols, ORDERS)."""
        peaks, count, domain = self.peaks, looks.count, float(np.ptp(beams.span))
        along, raised = peaks.along_slope, self.noise.along_slope
        evidence = np.zeros((*count.shape, ORDERS))
        single = log_evidence_of_one(peaks.explained, count, peaks.turning, domain)
        more = log_evidence_of_one(peaks.beside, count, peaks.turning, domain)
        spread = log_evidence_of_spread(along, peaks.explained, count, peaks.turning, raised, beams.beamwidth)
        evidence[..., ONE] = single + log_evidence_of_level(along, count, raised)
        evidence[..., TWO], evidence[..., THREE] = single + more, single + 2 * more
        evidence[..., SPREAD] = single + spread
        return evidence

    def sigma(self, probability: F64, looks: Looks) -> F64:
        """Standard deviation (rad) of the elevations, on surfaces or of two that are a spread away from their middle.

        Args:
            probability: of the models, (rows, cols, ORDERS).
            looks: the pixels.
        """
        likely = probability[..., ONE] + probability[..., TWO] + probability[..., SPREAD]
        share = probability[..., TWO] / np.maximum(likely, 1e-300)
        on_surface = self.spread.deviation(self.spread.around, looks)
        return np.sqrt(self.estimate.sigma**2 + on_surface**2 + share * self.spread.own**2)
