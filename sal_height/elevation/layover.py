"""Layover and extended surfaces: which model each pixel is given, and what follows for its scatterers and its validity.

`order` weighs the models against each other. Only where one more scatterer beside the single one, or a spread of it,
would explain more than noise often does are pairs, triples and extended surfaces fitted; elsewhere the same gains say
how improbable they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

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
from sal_height.elevation.extended import LEAST_SPREAD, ExtendedSurface, directions, free_looks, spread_of
from sal_height.elevation.likelihood import OBJECTIVES, ArraySettings, SinglePeaks, search_guard
from sal_height.elevation.looks import Looks
from sal_height.elevation.order import (
    NONE,
    ONE,
    PRIOR,
    SPREAD,
    THREE,
    TWO,
    detection_threshold,
    log_evidence_of_extended,
    log_evidence_of_level,
    log_evidence_of_one,
    log_evidence_of_several,
    log_evidence_of_spread,
    path_length,
    probabilities,
)
from sal_height.elevation.search import PeakSearches
from sal_height.elevation.several import LEAST_POWER, SeveralScatterers, search_several
from sal_height.numeric import F64, Index, in_parallel
from sal_height.settings import setting

SUSPICIOUS = 10.0  # several scatterers are tried for so many times the share of single ones that may be taken for two
PIXELS_AT_ONCE = 512  # pixels whose models are fitted at a time
LEAST_APART = 0.3  # beamwidths between the scatterers of a pixel; closer ones are those of one extended surface
MOST_APART = 0.8  # beamwidths between two scatterers up to which they may be one extended surface
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
        evidence: logarithm, against no scatterer, (ORDERS, pixels).
    """

    elevation: F64
    sigma: F64
    cnr: F64
    spread: F64
    explained: F64
    evidence: F64

    @classmethod
    def none(cls, pixels: int) -> Self:
        """Of so many pixels, to be filled."""
        elevation, sigma, cnr, spread = np.full((4, ORDERS, pixels, MOST), np.nan)
        explained, evidence = np.zeros((ORDERS, pixels)), np.full((ORDERS, pixels), -np.inf)
        return cls(elevation, sigma, cnr, spread, explained, evidence)

    def put_several(
        self, several: SeveralScatterers, raised: F64, uncertainty: float, evidence: F64, part: Index
    ) -> None:
        """Enter two or three scatterers of the pixels `part`, fitted in noise that is `raised` over the receivers'."""
        count = several.elevation.shape[1]
        here = count, part, slice(count)
        self.elevation[here], self.cnr[here] = several.elevation, raised[:, None] * several.power
        self.sigma[here] = np.hypot(several.sigma, several.deviation_by_beams(uncertainty))
        self.spread[here], self.explained[count, part], self.evidence[count, part] = 0.0, several.explained, evidence

    def put_extended(self, surface: ExtendedSurface, cnr: F64, evidence: F64, part: Index) -> None:
        """Enter an extended surface of the pixels `part`."""
        here = SPREAD, part, 0
        self.elevation[here], self.sigma[here] = surface.elevation, surface.sigma
        self.cnr[here], self.spread[here] = cnr, surface.spread
        self.explained[SPREAD, part], self.evidence[SPREAD, part] = surface.explained, evidence


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
    models = _fitted(here, evidence, noise, levels, peaks, looks, beams)
    evidence[here] = models.evidence.T
    taken = _taken(models, here, noise, levels, peaks, looks, beams, settings)
    probability = probabilities(evidence)
    probability[~looks.finite] = np.nan
    return _published(estimate, models, taken, here, probability, noise, peaks, looks, beams, settings)


def _evidence_of_gains(peaks: SinglePeaks, noise: _Noise, looks: Looks, beams: Beams) -> F64:
    """Log-evidence of each model against noise, from the gains of one more scatterer alone, (rows, cols, ORDERS)."""
    domain, count = float(np.ptp(beams.span)), looks.count
    evidence = np.zeros((*count.shape, ORDERS))
    single = log_evidence_of_one(peaks.explained, count, peaks.turning, domain)
    more = log_evidence_of_one(peaks.beside, count, peaks.turning, domain)
    level = log_evidence_of_level(peaks.along_slope, count, noise.along_slope)
    spread = log_evidence_of_spread(peaks.along_slope, peaks.explained, count, peaks.turning, beams.beamwidth)
    evidence[..., ONE], evidence[..., TWO], evidence[..., SPREAD] = single + level, single + more, single + spread
    evidence[..., THREE] = single + 2 * more
    return evidence


def _fitted(
    here: tuple[Index, Index],
    evidence: F64,
    noise: _Noise,
    levels: _Levels,
    peaks: SinglePeaks,
    looks: Looks,
    beams: Beams,
) -> _Models:
    """Fit an extended surface to the pixels `here`, and two and three scatterers where one more explains enough."""
    row, col = here
    models, domain = _Models.none(len(row)), float(np.ptp(beams.span))
    models.evidence[:] = evidence[here].T
    models.explained[ONE] = peaks.explained[here]
    most = min(MOST, beams.count - 1)
    searches = PeakSearches.over(beams, looks.squint, OBJECTIVES["normalised"], search_guard(beams))
    blocks = _blocks(looks.squint[col])

    def work(share: slice) -> None:
        for part in blocks[share]:
            pixels, search = (row[part], col[part]), searches.at(float(looks.squint[col[part[0]]]))
            raised = noise.raised[pixels]
            scaled = looks.covariance[pixels] / (looks.receiver_noise * raised[:, None, None])
            covariance = _in_double_precision(scaled, beams)
            count, single = looks.count[pixels], peaks.elevation[pixels]
            surface = ExtendedSurface.at(search, covariance, count, single, peaks.along_slope[pixels], beams.beamwidth)
            cnr = raised * (peaks.explained[pixels] / count - 1) / peaks.array_power[pixels]
            surface = surface.with_uncertain_beams(beams.uncertainty, peaks.array_power[pixels])
            models.put_extended(surface, cnr, log_evidence_of_extended(surface, domain, beams.beamwidth), part)
            # One scatterer more as long as it explains enough.
            some, start, tried = np.arange(len(part)), single[:, None], levels.tried[pixels]
            values, turning = search.on_grid(covariance), peaks.turning[pixels]
            for number in range(TWO, most + 1):
                elevation, explained, gain = search_several(search, covariance[some], values[some], start, tried[some])
                more = log_evidence_of_one(gain, count[some], turning[some], domain)
                models.evidence[number, part[some]] = models.evidence[number - 1, part[some]] + more
                climbed = explained > 0
                some, start = some[climbed], elevation[climbed]
                several = SeveralScatterers.at(search, covariance[some], count[some], start)
                weighed = log_evidence_of_several(several, covariance[some], domain)
                models.put_several(several, raised[some], beams.uncertainty, weighed, part[some])

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
    holds[ONE], holds[TWO], holds[THREE], holds[SPREAD] = ~is_two & ~is_spread, is_two & ~is_three, is_three, is_spread
    # Scatterers close to each other belong to one surface, and those far apart do not.
    for order in (TWO, THREE):
        apart = np.diff(models.elevation[order, :, :order], axis=1) / beams.beamwidth
        close = apart.min(axis=1) < LEAST_APART
        holds[SPREAD] |= close & holds[order]
        holds[order] &= ~close
        holds[SPREAD] &= ~(holds[order] & (apart.max(axis=1) > MOST_APART))
    total, count, channels = looks.power[here] / looks.receiver_noise, looks.count[here], beams.count
    leaked, beam_error = looks.leaked[here], noise.beam_error[here]
    for order, number in {ONE: 1, TWO: 2, THREE: 3, SPREAD: directions(channels)}.items():
        explained = noise.raised[here] * models.explained[order]
        # Each scatterer takes an amplitude of every look, and an elevation.
        degrees, coherent = (channels - number) * count - number / 2, max(channels - 1.5 * number, 0.0)
        fit = Fit(explained, total - explained, degrees, channels, leaked, coherent, beam_error)
        holds[order] &= is_explained(fit, settings)
    score = np.where(holds, models.evidence + np.log(PRIOR)[:, None], -np.inf)
    return np.where(holds.any(axis=0), np.argmax(score, axis=0), NONE)


def _published(
    estimate: ElevationEstimate,
    models: _Models,
    taken: Index,
    here: tuple[Index, Index],
    probability: F64,
    noise: _Noise,
    peaks: SinglePeaks,
    looks: Looks,
    beams: Beams,
    settings: LayoverSettings,
) -> ElevationEstimate:
    """The estimate with the scatterers of the models taken `here`, strongest first, and the reasons that follow."""
    # What passes for one scatterer may be spread, or two.
    sigma = _sigma_of_perhaps_several(estimate.sigma, probability, noise, peaks, looks)
    validity = estimate.validity.copy()
    fields = np.full((4, MOST, *validity.shape), np.nan)
    fields[:, 0] = estimate.elevation, sigma, estimate.cnr, np.zeros_like(sigma)
    # Of the others, those that are inside the array and determined, the strongest first.
    found = np.stack([models.elevation, models.sigma, models.cnr, models.spread])
    found = found[:, taken, np.arange(len(taken))]
    # What passes for an extended surface may be two scatterers.
    chances = probability[here]
    doubt = np.where(taken == SPREAD, chances[:, TWO] / np.maximum(chances[:, TWO] + chances[:, SPREAD], 1e-300), 0.0)
    found[1] = np.sqrt(found[1] ** 2 + doubt[:, None] * found[3] ** 2)
    (first, last), (elevation, deviation, cnr, _) = beams.span, found
    inside = (elevation >= first) & (elevation <= last) & (cnr >= settings.min_cnr) & (cnr > 0)
    usable = inside & (deviation < GREATEST_SIGMA * beams.beamwidth)
    order = np.argsort(np.where(usable, -cnr, np.inf), axis=1)
    found = np.take_along_axis(np.where(usable, found, np.nan), order[None], axis=2)
    count = usable.sum(axis=1)
    detected = ~np.isin(validity[here], (Validity.NO_SIGNAL, Validity.LOW_CNR, Validity.MISSING_DATA))
    resolved = detected & (taken > ONE) & (count > 0)
    rows, cols = here[0][resolved], here[1][resolved]
    fields[:, :, rows, cols] = np.swapaxes(found[:, resolved], 1, 2)
    # A spread far below a beamwidth is that of level ground.
    is_spread = (taken == SPREAD) & (found[3, :, 0] > LEAST_SPREAD * beams.beamwidth)
    reasons = np.array([Validity.NOT_ONE_SCATTERER, Validity.OK, Validity.TWO_SCATTERERS, Validity.THREE_SCATTERERS])
    reason = np.select(
        [taken == NONE, ~inside.any(axis=1), count == 0, is_spread],
        [Validity.NOT_ONE_SCATTERER, Validity.OUTSIDE_ARRAY, Validity.IMPRECISE, Validity.EXTENDED],
        reasons[count],
    )
    changed = detected & (taken != ONE)
    validity[here[0][changed], here[1][changed]] = reason[changed]
    scatterers = tuple(Scatterer(*fields[:, n]) for n in range(MOST))
    return ElevationEstimate(scatterers, validity.astype(np.uint8), probability)


def _sigma_of_perhaps_several(sigma: F64, probability: F64, noise: _Noise, peaks: SinglePeaks, looks: Looks) -> F64:
    """Standard deviation (rad) of single scatterers, which may be extended surfaces or two close to each other.

    The middle of an extended surface of the spread s has the variance s^2 / 2K, each of two scatterers that look like
    it is s away from the middle.
    """
    likely = probability[..., ONE] + probability[..., TWO] + probability[..., SPREAD]
    share = (probability[..., SPREAD] / (2 * looks.count) + probability[..., TWO]) / np.maximum(likely, 1e-300)
    power = np.maximum(peaks.explained / looks.count - 1, LEAST_POWER)
    level = noise.along_slope
    spread = spread_of(peaks.along_slope / level, looks.count, power / level, peaks.turning)
    return np.sqrt(sigma**2 + share * spread**2)
