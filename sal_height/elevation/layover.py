"""Layover and extended surfaces: which model each pixel is given, and what follows for its scatterers and its validity.

`order` weighs the models against each other. Only where one more scatterer beside the single one, or a spread of it,
would explain more than noise often does are pairs, triples and extended surfaces fitted; elsewhere the same gains say
how improbable they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.ndimage import uniform_filter

from sal_height.beams import Beams
from sal_height.elevation.bounds import Numbers
from sal_height.elevation.estimate import (
    ORDERS,
    ElevationEstimate,
    Fit,
    Scatterer,
    Validity,
    is_explained,
    noise_limit,
    sidelobe_limit,
)
from sal_height.elevation.extended import (
    LEAST_SPREAD,
    ExtendedSurfaces,
    Surfaces,
    first_surfaces,
    free_looks,
    spread_of,
)
from sal_height.elevation.likelihood import OBJECTIVES, ArraySettings, SinglePeaks, search_guard
from sal_height.elevation.looks import Looks
from sal_height.elevation.order import (
    NEIGHBOURS,
    NONE,
    ONE,
    SPREAD,
    THREE,
    TWO,
    detection_threshold,
    log_evidence_of_extended,
    log_evidence_of_level,
    log_evidence_of_one,
    log_evidence_of_several,
    log_evidence_of_spread,
    log_probabilities,
    path_length,
)
from sal_height.elevation.search import PeakSearches
from sal_height.elevation.several import LEAST_POWER, SeveralScatterers, search_several
from sal_height.numeric import F64, Index, in_parallel
from sal_height.settings import setting

SUSPICIOUS = 10.0  # several scatterers are tried for so many times the share of single ones that may be taken for two
PIXELS_AT_ONCE = 512  # pixels whose models are fitted at a time
LEAST_APART = 0.3  # beamwidths between the scatterers of a pixel; closer ones are those of one extended surface
MOST_SPREAD = 0.5  # beamwidths; the middle of a surface that is spread wider is nobody's height
IMPROBABLE = 10.0  # logarithm of how many times less probable a model is that need not be fitted
LEAST_PROBABILITY = 0.5  # of the model that a pixel is given
MOST = 3  # scatterers of a pixel at most
GREATEST_SIGMA = 0.25  # beamwidths; where sigma is greater, bounds to first order do not hold


class LayoverSettings(ArraySettings):
    """Settings of the estimators that look for several scatterers in a pixel."""

    layover: bool = setting(
        default=True, description="whether to search every pixel for several scatterers and extended surfaces"
    )
    layover_false_alarm: float = setting(
        1e-3,
        "share of single scatterers that may be taken for two",
        minimum=1e-9,
        maximum=0.1,
    )
    spread_false_alarm: float = setting(
        1e-2,
        "share of points that may be taken for extended surfaces; these keep a height",
        minimum=1e-9,
        maximum=0.1,
    )


@dataclass(frozen=True, eq=False)
class _Models:
    """The models fitted to some pixels, by their index in `order`; those that were not have explained nothing.

    Attributes:
        elevation: of their scatterers, rad, (ORDERS, pixels, MOST), NaN where there are fewer.
        sigma, cnr, spread: of them.
        explained: power, sum over looks, over the raised noise power, (ORDERS, pixels).
        directions: number of dimensions of the channels in which they may explain a look, (ORDERS, pixels).
        evidence: logarithm, against no scatterer, (ORDERS, pixels).
    """

    elevation: F64
    sigma: F64
    cnr: F64
    spread: F64
    explained: F64
    directions: F64
    evidence: F64

    @classmethod
    def of_single(
        cls,
        estimate: ElevationEstimate,
        spread: _Spread,
        evidence: F64,
        peaks: SinglePeaks,
        looks: Looks,
        here: tuple[Index, Index],
    ) -> Self:
        """Those of the pixels `here` that single peaks give: one scatterer, and one that is spread a little."""
        pixels, single = len(here[0]), estimate.first
        elevation, sigma, cnr, width = np.full((4, ORDERS, pixels, MOST), np.nan)
        elevation[[ONE, SPREAD], :, 0], cnr[[ONE, SPREAD], :, 0] = single.elevation[here], single.cnr[here]
        sigma[ONE, :, 0] = np.hypot(single.sigma, spread.deviation(spread.around, looks))[here]
        widest = np.maximum(spread.own, spread.around)
        sigma[SPREAD, :, 0] = np.hypot(single.sigma, spread.deviation(widest, looks))[here]
        width[ONE, :, 0], width[SPREAD, :, 0] = 0.0, spread.own[here]
        explained, directions = np.zeros((ORDERS, pixels)), np.zeros((ORDERS, pixels))
        directions[ONE:] = np.array([1.0, 2.0, 3.0, 2.0])[:, None]
        explained[ONE], explained[SPREAD] = peaks.explained[here], (peaks.explained + peaks.along_slope)[here]
        return cls(elevation, sigma, cnr, width, explained, directions, evidence[here].T.copy())

    def put_several(
        self, several: SeveralScatterers, raised: F64, uncertainty: float, evidence: F64, part: Index
    ) -> None:
        """Enter two or three scatterers of the pixels `part`, fitted in noise that is `raised` over the receivers'."""
        count = several.elevation.shape[1]
        here = count, part, slice(count)
        self.elevation[here], self.cnr[here] = several.elevation, raised[:, None] * several.power
        self.sigma[here] = np.hypot(several.sigma, several.deviation_by_beams(uncertainty))
        self.spread[here], self.explained[count, part], self.evidence[count, part] = 0.0, several.explained, evidence

    def put_extended(self, surfaces: ExtendedSurfaces, raised: F64, evidence: F64, part: Index) -> None:
        """Enter extended surfaces of the pixels `part`, fitted in noise that is `raised` over the receivers'."""
        here = SPREAD, part, 0
        self.elevation[here], self.spread[here], cnr = surfaces.found
        self.sigma[here], self.cnr[here] = surfaces.sigma, raised * cnr
        self.explained[SPREAD, part], self.directions[SPREAD, part] = surfaces.explained, surfaces.directions
        self.evidence[SPREAD, part] = evidence

    def deviation(self, elevation: F64, probability: F64) -> F64:
        """Standard deviation (rad) of elevations that may be those of any of the models, (pixels, MOST).

        Each model has its own idea of the scatterer next to an elevation: the variance over all of them is the mean of
        their variances and squared distances.

        Args:
            elevation: of the scatterers of the model that a pixel is given, rad, (pixels, MOST).
            probability: of the models, (pixels, ORDERS).
        """
        distance = np.abs(self.elevation[:, :, None] - elevation[:, :, None])  # models, pixels, published, scatterers
        nearest = np.argmin(np.where(np.isfinite(distance), distance, np.inf), axis=-1)
        sigma = np.take_along_axis(self.sigma, nearest, axis=-1)
        square = sigma**2 + np.take_along_axis(distance, nearest[..., None], axis=-1)[..., 0] ** 2
        weight = np.where(np.isfinite(square), probability.T[:, :, None], 0.0)
        total = np.sum(weight * np.where(weight > 0, square, 0.0), axis=0)
        return np.sqrt(
            np.divide(total, weight.sum(axis=0), where=weight.sum(axis=0) > 0, out=np.full_like(total, np.nan))
        )


def resolve(
    estimate: ElevationEstimate, peaks: SinglePeaks, looks: Looks, beams: Beams, settings: LayoverSettings
) -> ElevationEstimate:
    """The estimate with several scatterers or an extended surface where the looks demand it, and probabilities.

    Args:
        estimate: of the single scatterers of `peaks`.
        peaks: with the gains of one more.
        looks: covariance of M channels of equal noise in each pixel.
        beams: of the M detectors, 3 or more.
        settings: rates of false alarms, and the least CNR.
    """
    noise = _Noise.of(peaks, looks, beams)
    peaks = peaks.over(noise.raised)
    evidence, levels = _evidence_of_gains(peaks, noise, looks, beams), _Levels.of(noise, looks, beams, settings)
    row, col = np.nonzero(looks.finite & ((peaks.beside > levels.tried) | (peaks.along_slope > levels.spread)))
    here = row, col
    spread = _Spread.of(peaks, noise, levels, looks)
    models = _fitted(here, estimate, spread, evidence, noise, levels, peaks, looks, beams)
    evidence[here] = models.evidence.T
    chances = log_probabilities(evidence, here)
    taken = _taken(models, chances[here].T, here, noise, levels, peaks, looks, beams, settings)
    probability = np.exp(chances)
    probability[~looks.finite] = np.nan
    sigma = _sigma_of_perhaps_two(estimate.sigma, probability, spread, looks)
    return _published(estimate.with_sigma(sigma), models, taken, here, probability, beams, settings)


def _evidence_of_gains(peaks: SinglePeaks, noise: _Noise, looks: Looks, beams: Beams) -> F64:
    """Log-evidence of each model against noise, from the gains of one more scatterer alone, (rows, cols, ORDERS)."""
    domain, count = float(np.ptp(beams.span)), looks.count
    evidence = np.zeros((*count.shape, ORDERS))
    single = log_evidence_of_one(peaks.explained, count, peaks.turning, domain)
    more = log_evidence_of_one(peaks.beside, count, peaks.turning, domain)
    along, beamwidth = peaks.along_slope, beams.beamwidth
    level = log_evidence_of_level(along, count, noise.along_slope)
    spread = log_evidence_of_spread(along, peaks.explained, count, peaks.turning, noise.along_slope, beamwidth)
    evidence[..., ONE], evidence[..., TWO], evidence[..., SPREAD] = single + level, single + more, single + spread
    evidence[..., THREE] = single + 2 * more
    return evidence


def _fitted(
    here: tuple[Index, Index],
    estimate: ElevationEstimate,
    spread: _Spread,
    evidence: F64,
    noise: _Noise,
    levels: _Levels,
    peaks: SinglePeaks,
    looks: Looks,
    beams: Beams,
) -> _Models:
    """Fit two and three scatterers to the pixels `here` where one more explains enough, and there extended surfaces."""
    row, col = here
    models = _Models.of_single(estimate, spread, evidence, peaks, looks, here)
    domain, most = float(np.ptp(beams.span)), min(MOST, beams.count - 1)
    searches = PeakSearches.over(beams, looks.squint, OBJECTIVES["normalised"], search_guard(beams))
    blocks = _blocks(looks.squint[col])

    def work(share: slice) -> None:
        for part in blocks[share]:
            pixels, search = (row[part], col[part]), searches.at(float(looks.squint[col[part[0]]]))
            raised = noise.raised[pixels]
            scaled = looks.covariance[pixels] / (looks.receiver_noise * raised[:, None, None])
            covariance = _in_double_precision(scaled, beams)
            count, values, turning = looks.count[pixels], search.on_grid(covariance), peaks.turning[pixels]
            # One scatterer more as long as it explains enough.
            some, start, tried = np.arange(len(part)), peaks.elevation[pixels][:, None], levels.tried[pixels]
            for number in range(TWO, most + 1):
                elevation, explained, gain = search_several(search, covariance[some], values[some], start, tried[some])
                more = log_evidence_of_one(gain, count[some], turning[some], domain)
                models.evidence[number, part[some]] = models.evidence[number - 1, part[some]] + more
                climbed = explained > 0
                some, start = some[climbed], elevation[climbed]
                several = SeveralScatterers.at(search, covariance[some], count[some], start)
                weighed = log_evidence_of_several(several, covariance[some], domain)
                models.put_several(several, raised[some], beams.uncertainty, weighed, part[some])
            # A surface where one is not enough.
            power = _power(peaks, looks)[pixels]
            some = np.flatnonzero(models.explained[TWO, part] - models.explained[ONE, part] > levels.several[pixels])
            chosen, whole = part[some], (row[part[some]], col[part[some]])
            single = Surfaces(peaks.elevation[whole], spread.own[whole], power[some] / peaks.array_power[whole])
            first = first_surfaces(search, values[some], count[some], single, beams.beamwidth)
            least = models.evidence[TWO : THREE + 1, chosen].max(axis=0) - IMPROBABLE
            surfaces = ExtendedSurfaces.fit(search, covariance[some], count[some], first, least, beams.beamwidth)
            surfaces = surfaces.with_uncertain_beams(beams.uncertainty, (turning * peaks.array_power[pixels])[some])
            weighed = log_evidence_of_extended(surfaces, domain, beams.beamwidth)
            models.put_extended(surfaces, raised[some], weighed, chosen)

    in_parallel(work, len(blocks))
    return models


def _blocks(squint: F64) -> list[Index]:
    """Numbers of pixels in blocks of the same squint, PIXELS_AT_ONCE at most."""
    order = np.argsort(squint, kind="stable")
    runs = np.split(order, np.flatnonzero(np.diff(squint[order])) + 1) if order.size else []
    return [block for run in runs for block in np.split(run, range(PIXELS_AT_ONCE, len(run), PIXELS_AT_ONCE))]


def _in_double_precision(covariance: Numbers, beams: Beams) -> Numbers:
    return covariance.astype(np.complex128) if beams.is_complex else covariance.real.astype(np.float64)


@dataclass(frozen=True, eq=False)
class _Noise:
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
class _Levels:
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
    def of(cls, noise: _Noise, looks: Looks, beams: Beams, settings: LayoverSettings) -> Self:
        """The levels for the number of looks of every pixel."""
        length = max(path_length(beams, float(squint)) for squint in np.unique(looks.squint)[[0, -1]])
        counts, which = np.unique(looks.count, return_inverse=True)
        sidelobes = sidelobe_limit(looks.leaked, settings.sidelobe_rate)

        def level(of_noise: F64, rate: float) -> F64:
            # Errors of the beams are those of one look, too, but differ between directions.
            errors = sidelobe_limit(noise.beam_error, rate)
            return (of_noise[which.reshape(looks.count.shape)] + sidelobes + errors) / noise.raised

        rarely = settings.layover_false_alarm
        often = min(SUSPICIOUS * rarely, 0.5)
        spread = level(noise_limit(free_looks(counts), settings.spread_false_alarm), settings.spread_false_alarm)
        return cls(
            tried=level(detection_threshold(length, counts, often), often / beams.count),
            several=level(detection_threshold(length, counts, rarely), rarely / beams.count),
            spread=spread * noise.along_slope,
        )


def _taken(
    models: _Models,
    chances: F64,
    here: tuple[Index, Index],
    noise: _Noise,
    levels: _Levels,
    peaks: SinglePeaks,
    looks: Looks,
    beams: Beams,
    settings: LayoverSettings,
) -> Index:
    """The model of each pixel `here`: of those that no test rejects the most probable one; NONE if none is left.

    One more scatterer, or a spread, that explains more than noise rarely does rejects the models without; and each
    model is rejected that does not explain the pixel.
    """
    several, spread = levels.several[here], levels.spread[here]
    gains = np.diff(models.explained[ONE : THREE + 1], axis=0)
    # A spread far below a beamwidth is no more than a point's uncertainty.
    is_spread = (peaks.along_slope[here] > spread) & (models.spread[SPREAD, :, 0] > LEAST_SPREAD * beams.beamwidth)
    # Those with less than misfit_share of the strongest one's power may be its sidelobes in range and azimuth.
    equal = [
        models.cnr[n, :, :n].min(axis=1) > settings.misfit_share * models.cnr[n, :, :n].max(axis=1) for n in (2, 3)
    ]
    # One more beside the first is the same surface, which is spread or is not.
    spacing = np.abs(models.elevation[TWO, :, 1] - models.elevation[TWO, :, 0])
    is_beside = spacing < LEAST_APART * beams.beamwidth
    is_two = (gains[0] > several) & equal[0] & (is_spread | ~is_beside)
    is_three = is_two & (gains[1] > several) & equal[1]
    holds = np.zeros(models.evidence.shape, np.bool_)
    holds[ONE], holds[TWO], holds[THREE] = ~is_two & ~is_spread, is_two & ~is_three, is_three
    holds[SPREAD] = is_two | is_spread
    # Scatterers close to each other belong to one surface.
    for order in (TWO, THREE):
        apart = np.diff(models.elevation[order, :, :order], axis=1) / beams.beamwidth
        holds[order] &= apart.min(axis=1) >= LEAST_APART
    total, count, channels = looks.power[here] / looks.receiver_noise, looks.count[here], beams.count
    leaked, beam_error = looks.leaked[here], noise.beam_error[here]
    for order, number in enumerate(models.directions[ONE:], ONE):
        explained = noise.raised[here] * models.explained[order]
        # Each direction takes an amplitude of every look, and an elevation.
        degrees, coherent = (channels - number) * count - number / 2, np.maximum(channels - 1.5 * number, 0.0)
        fit = Fit(explained, total - explained, degrees, channels, leaked, coherent, beam_error)
        holds[order] &= is_explained(fit, settings)
    score = np.where(holds, chances, -np.inf)
    return np.where(holds.any(axis=0), np.argmax(score, axis=0), NONE)


def _published(
    estimate: ElevationEstimate,
    models: _Models,
    taken: Index,
    here: tuple[Index, Index],
    probability: F64,
    beams: Beams,
    settings: LayoverSettings,
) -> ElevationEstimate:
    """The estimate with the scatterers of the models taken `here`, strongest first, and the reasons that follow."""
    validity = estimate.validity.copy()
    fields = np.full((4, MOST, *validity.shape), np.nan)
    fields[:, 0] = estimate.elevation, estimate.sigma, estimate.cnr, np.zeros(validity.shape)
    # Of the others, those that are inside the array and determined, the strongest first.
    found = np.stack([models.elevation, models.sigma, models.cnr, models.spread])
    found = found[:, taken, np.arange(len(taken))]
    found[1] = models.deviation(found[0], probability[here])
    (first, last), (elevation, deviation, cnr, _) = beams.span, found
    inside = (elevation >= first) & (elevation <= last) & (cnr >= settings.min_cnr) & (cnr > 0)
    determined = deviation < GREATEST_SIGMA * beams.beamwidth
    usable = inside & np.all(determined | ~inside, axis=1, keepdims=True)
    order = np.argsort(np.where(usable, -cnr, np.inf), axis=1)
    found = np.take_along_axis(np.where(usable, found, np.nan), order[None], axis=2)
    count = usable.sum(axis=1)
    detected = ~np.isin(validity[here], (Validity.NO_SIGNAL, Validity.LOW_CNR, Validity.MISSING_DATA))
    resolved = detected & (taken > NONE) & (count > 0)
    rows, cols = here[0][resolved], here[1][resolved]
    fields[:, :, rows, cols] = np.swapaxes(found[:, resolved], 1, 2)
    # A spread far below a beamwidth is that of level ground.
    is_spread = (taken == SPREAD) & (found[3, :, 0] > LEAST_SPREAD * beams.beamwidth)
    # A point and a surface that is spread about it have the same height.
    chance = np.take_along_axis(probability[here], taken[:, None], axis=1)[:, 0]
    chance = np.where(np.isin(taken, (ONE, SPREAD)), probability[here][:, [ONE, SPREAD]].sum(axis=1), chance)
    is_none = (
        (taken == NONE)
        | (chance < LEAST_PROBABILITY)
        | ((taken == SPREAD) & (found[3, :, 0] > MOST_SPREAD * beams.beamwidth))
    )
    reasons = np.array([Validity.NOT_ONE_SCATTERER, Validity.OK, Validity.TWO_SCATTERERS, Validity.THREE_SCATTERERS])
    reason = np.select(
        [is_none, ~inside.any(axis=1), count == 0, is_spread],
        [Validity.NOT_ONE_SCATTERER, Validity.OUTSIDE_ARRAY, Validity.IMPRECISE, Validity.EXTENDED],
        reasons[count],
    )
    changed = detected
    validity[here[0][changed], here[1][changed]] = reason[changed]
    scatterers = tuple(Scatterer(*fields[:, n]) for n in range(MOST))
    return ElevationEstimate(scatterers, validity.astype(np.uint8), probability)


@dataclass(frozen=True, eq=False)
class _Spread:
    """Standard deviation of elevation within surfaces that look like single scatterers, rad, (rows, cols).

    It is that beyond the spread of level ground.

    Attributes:
        own: as the power along the slope of the response shows it; it hardly tells a small spread from noise.
        around: of NEIGHBOURS pixels together.
    """

    own: F64
    around: F64

    @classmethod
    def of(cls, peaks: SinglePeaks, noise: _Noise, levels: _Levels, looks: Looks) -> Self:
        """The spreads behind the power along the slopes; beyond twice its level it is not that of a surface."""
        power = _power(peaks, looks)
        free = np.where(looks.finite, free_looks(looks.count), 0.0)
        along = np.where(looks.finite, np.minimum(peaks.along_slope, 2 * levels.spread), 0.0)
        excess, unit = along - free * noise.along_slope, np.where(looks.finite, free * power * peaks.turning, 0.0)
        pooled, units = (uniform_filter(part, NEIGHBOURS, mode="nearest") for part in (excess, unit))
        around = np.divide(np.maximum(pooled, 0.0), units, where=units > 0, out=np.zeros_like(units))
        level = noise.along_slope
        own = spread_of(peaks.along_slope / level, looks.count, power / level, peaks.turning)
        return cls(own, np.sqrt(around))

    def deviation(self, spread: F64, looks: Looks) -> F64:
        """Standard deviation of the middle of a surface of this spread at the range of its height, rad."""
        return spread * np.sqrt(looks.unplaced / (2 * np.maximum(looks.count, 1.0)))


def _power(peaks: SinglePeaks, looks: Looks) -> F64:
    """Power of one look of the single scatterer in the whole array, noise powers."""
    return np.maximum(peaks.explained / looks.count - 1, LEAST_POWER)


def _sigma_of_perhaps_two(sigma: F64, probability: F64, spread: _Spread, looks: Looks) -> F64:
    """Standard deviation (rad) of single scatterers, on a surface or two that are a spread away from their middle."""
    likely = probability[..., ONE] + probability[..., TWO] + probability[..., SPREAD]
    share = probability[..., TWO] / np.maximum(likely, 1e-300)
    return np.sqrt(sigma**2 + spread.deviation(spread.around, looks) ** 2 + share * spread.own**2)
