"""One, two, three scatterers or an extended surface, fitted to the pixels that may have more than one point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.bounds import Numbers
from sal_height.elevation.array.estimate import ORDERS, ElevationEstimate, Fit, Scatterer, Validity, is_explained
from sal_height.elevation.array.likelihood import OBJECTIVES, SinglePeaks, search_guard
from sal_height.elevation.array.search import Block, PeakSearch, PeakSearches
from sal_height.elevation.layover._layover_kernels import choose_scatterers
from sal_height.elevation.layover.extended import LEAST_SPREAD, ExtendedSurfaces, explained_by, surfaces_over
from sal_height.elevation.layover.order import (
    NONE,
    ONE,
    SPREAD,
    THREE,
    TWO,
    log_evidence_of_one,
    log_evidence_of_several,
    log_probabilities,
)
from sal_height.elevation.layover.several import SeveralScatterers, search_several
from sal_height.elevation.layover.single import LayoverSettings, SingleScatterers, spread_around, surface_deviation
from sal_height.elevation.looks.looks import Looks
from sal_height.numeric import F32, F64, Index, in_threads

DETECTED = np.ones(256, np.bool_)
DETECTED[[Validity.NO_SIGNAL, Validity.LOW_CNR, Validity.MISSING_DATA]] = False
"""True for each `Validity` of a pixel with a detected signal."""

PIXELS_AT_ONCE = 256  # pixels whose models are fitted at a time: few, so that all processors have some

MOST = 3  # greatest number of scatterers of a pixel


def resolve(
    estimate: ElevationEstimate, peaks: SinglePeaks, looks: Looks, beams: Beams, settings: LayoverSettings
) -> ElevationEstimate:
    """The estimate with several scatterers or an extended surface where the looks demand it, and probabilities.

    Args:
        estimate: estimate of the single scatterers of `peaks`.
        peaks: peaks with the gains of one more scatterer.
        looks: covariance of M channels of equal noise in each pixel.
        beams: beams of the M detectors, 3 or more.
        settings: rates of false alarms, and the least CNR.
    """
    single = SingleScatterers.of(estimate, peaks, looks, beams, settings)
    evidence = single.log_evidence(looks, beams)
    row, col = np.nonzero(looks.finite & single.suspicious)
    here = row, col
    models = fit_models(here, single, evidence, looks, beams)
    models.add_surfaces(here, single, looks)
    evidence[here] = models.evidence.T
    chances = log_probabilities(evidence, here, looks.columns)
    chosen = _chosen(models, chances[here].T, here, single, looks, beams, settings)
    probability = np.exp(chances)
    probability[~looks.finite] = np.nan
    widened = estimate.with_sigma(single.sigma(probability, looks))
    return _with_scatterers(widened, models, chosen, here, probability, beams, settings)


def where_single(estimate: ElevationEstimate, elevation: F64, sigma: F64) -> ElevationEstimate:
    """Another elevation and its sigma where the estimate has a single surface, and no height where it has several."""
    several = np.isin(estimate.validity, (Validity.TWO_SCATTERERS, Validity.THREE_SCATTERERS))
    validity = np.where(several, Validity.NOT_ONE_SCATTERER, estimate.validity).astype(np.uint8)
    first = replace(estimate.first, elevation=elevation, sigma=sigma)
    return replace(estimate, scatterers=(first,), validity=validity, order_probability=None)


def _chosen(
    models: Models,
    chances: F64,
    here: tuple[Index, Index],
    single: SingleScatterers,
    looks: Looks,
    beams: Beams,
    settings: LayoverSettings,
) -> Index:
    """The model of each pixel `here`: the most probable one that no test rejects, or NONE.

    A model is rejected if one more scatterer, or a spread, explains more than noise rarely does, or if it does not
    explain the pixel.
    """
    least_apart = 0.3  # beamwidths between the scatterers of a pixel; closer ones belong to one extended surface
    several, noise = single.levels.several[here], single.noise
    gains = np.diff(models.explained[ONE : THREE + 1], axis=0)
    # A spread far below a beamwidth is no more than a point's uncertainty.
    is_wide = models.spread[SPREAD, :, 0] > LEAST_SPREAD * beams.beamwidth
    is_spread = (single.peaks.along_slope > single.levels.spread)[here] & is_wide
    # Scatterers with less than misfit_fraction of the strongest one's power may be its sidelobes in range and azimuth.
    equal = [
        models.cnr[n, :, :n].min(axis=1) > settings.misfit_fraction * models.cnr[n, :, :n].max(axis=1) for n in (2, 3)
    ]
    # One more near the first is the same surface, which is spread or is not.
    spacing = np.abs(models.elevation[TWO, :, 1] - models.elevation[TWO, :, 0])
    is_beside = spacing < least_apart * beams.beamwidth
    is_two = (gains[0] > several) & equal[0] & (is_spread | ~is_beside)
    is_three = is_two & (gains[1] > several) & equal[1]
    holds = np.zeros(models.evidence.shape, np.bool_)
    holds[ONE], holds[TWO], holds[THREE] = ~is_two & ~is_spread, is_two & ~is_three, is_three
    holds[SPREAD] = is_two | is_spread
    # Scatterers close to each other belong to one surface.
    for order in (TWO, THREE):
        apart = np.diff(models.elevation[order, :, :order], axis=1) / beams.beamwidth
        holds[order] &= apart.min(axis=1) >= least_apart
    explained, number, channels = noise.raised[here] * models.explained[ONE:], models.directions[ONE:], beams.count
    # Each direction has an amplitude in every look, and an elevation.
    degrees, coherent = (channels - number) * looks.count[here] - number / 2, np.maximum(channels - 1.5 * number, 0.0)
    left, leaked = looks.power[here] / looks.receiver_noise - explained, looks.leaked[here]
    holds[ONE:] &= is_explained(
        Fit(explained, left, degrees, channels, leaked, coherent, noise.beam_error[here]), settings
    )
    score = np.where(holds, chances, -np.inf)
    return np.where(holds.any(axis=0), np.argmax(score, axis=0), NONE)


def _with_scatterers(
    estimate: ElevationEstimate,
    models: Models,
    chosen: Index,
    here: tuple[Index, Index],
    probability: F64,
    beams: Beams,
    settings: LayoverSettings,
) -> ElevationEstimate:
    """The estimate with the scatterers of the models chosen `here`, strongest first, and the validity of these."""
    validity = estimate.validity.copy()
    fields = np.full((4, MOST, *validity.shape), np.nan)
    fields[:, 0] = estimate.elevation, estimate.sigma, estimate.cnr, np.zeros(validity.shape)
    greatest_sigma = 0.25 * beams.beamwidth  # beyond it, bounds to first order do not hold
    found, inside, count = models.scatterers(chosen, probability[here], beams.span, settings.min_cnr, greatest_sigma)
    detected = DETECTED[validity[here]]
    resolved = detected & (chosen > NONE) & (count > 0)
    rows, cols = here[0][resolved], here[1][resolved]
    fields[:, :, rows, cols] = np.swapaxes(found[:, resolved], 1, 2)
    # A spread far below a beamwidth is that of level ground.
    is_spread = (chosen == SPREAD) & (found[3, :, 0] > LEAST_SPREAD * beams.beamwidth)
    # A point and a surface that is spread about it have the same height.
    chances = probability[here]
    chance = np.take_along_axis(chances, chosen[:, None], axis=1)[:, 0]
    chance = np.where((chosen == ONE) | (chosen == SPREAD), chances[:, ONE] + chances[:, SPREAD], chance)
    # The middle of a surface with a spread of more than half a beamwidth is the height of nothing.
    is_none = (chosen == NONE) | (chance < 0.5) | ((chosen == SPREAD) & (found[3, :, 0] > 0.5 * beams.beamwidth))
    reasons = np.array([Validity.NOT_ONE_SCATTERER, Validity.OK, Validity.TWO_SCATTERERS, Validity.THREE_SCATTERERS])
    reason = reasons[count]
    reason[is_spread] = Validity.EXTENDED
    reason[count == 0] = Validity.IMPRECISE
    reason[inside == 0] = Validity.OUTSIDE_ARRAY
    reason[is_none] = Validity.NOT_ONE_SCATTERER
    validity[here[0][detected], here[1][detected]] = reason[detected]
    scatterers = tuple(Scatterer(*fields[:, n]) for n in range(MOST))
    return ElevationEstimate(scatterers, validity.astype(np.uint8), probability)


@dataclass(frozen=True, eq=False)
class Models:
    """The models fitted to some pixels, by their index in `order`; other models explain no power.

    Attributes:
        elevation: elevations of their scatterers, NaN beyond their number, (ORDERS, pixels, MOST), rad.
        sigma, cnr, spread: those of the same scatterers.
        explained: power, sum over looks, over the raised noise power, (ORDERS, pixels).
        directions: number of dimensions of the channels in which they may explain a look, (ORDERS, pixels).
        evidence: log-evidence against no scatterer, (ORDERS, pixels).
        along_slopes: power along the slopes of two or three scatterers beyond that of level ground, and the same power
            of surfaces whose spread is 1 rad, sums over the scatterers, (2, ORDERS, pixels).
    """

    elevation: F64
    sigma: F64
    cnr: F64
    spread: F64
    explained: F64
    directions: F64
    evidence: F64
    along_slopes: F64

    @classmethod
    def of_single(cls, single: SingleScatterers, evidence: F64, looks: Looks, here: tuple[Index, Index]) -> Self:
        """Models of the pixels `here` from single peaks: one scatterer, and one with a small spread.

        Args:
            single: scatterers of all pixels.
            evidence: log-evidence of all pixels, (rows, cols, ORDERS).
            looks: covariance of the pixels.
            here: rows and columns of some pixels.
        """
        pixels, spread, point, peaks = len(here[0]), single.spread, single.estimate.first, single.peaks
        elevation, sigma, cnr, width = np.full((4, ORDERS, pixels, MOST), np.nan)
        elevation[[ONE, SPREAD], :, 0], cnr[[ONE, SPREAD], :, 0] = point.elevation[here], point.cnr[here]
        sigma[ONE, :, 0] = np.hypot(point.sigma, surface_deviation(spread.around, looks))[here]
        widest = np.maximum(spread.own, spread.around)
        sigma[SPREAD, :, 0] = np.hypot(point.sigma, surface_deviation(widest, looks))[here]
        width[ONE, :, 0], width[SPREAD, :, 0] = 0.0, spread.own[here]
        explained, directions = np.zeros((ORDERS, pixels)), np.zeros((ORDERS, pixels))
        directions[ONE:] = np.array([1.0, 2.0, 3.0, 2.0])[:, None]
        explained[ONE], explained[SPREAD] = peaks.explained[here], (peaks.explained + peaks.along_slope)[here]
        along = np.zeros((2, ORDERS, pixels))
        return cls(elevation, sigma, cnr, width, explained, directions, evidence[here].T.copy(), along)

    def add_several(
        self,
        several: SeveralScatterers,
        raised: F64,
        uncertainty: float,
        evidence: F64,
        level_spread: F64,
        along_slopes: tuple[F64, F64],
        part: Index,
    ) -> None:
        """Enter two or three scatterers of the pixels `part`, fitted in noise that is `raised` over the receivers'."""
        count = several.elevation.shape[1]
        self.along_slopes[:, count, part] = along_slopes
        here = count, part, slice(count)
        self.elevation[here], self.cnr[here] = several.elevation, raised[:, None] * several.power
        of_points = np.hypot(several.sigma, several.deviation_by_beams(uncertainty))
        self.sigma[here] = np.hypot(of_points, several.deviation_by_spread(level_spread))
        self.spread[here], self.explained[count, part], self.evidence[count, part] = 0.0, several.explained, evidence

    def add_extended(self, surfaces: ExtendedSurfaces, explained: tuple[F64, F64], raised: F64, part: Index) -> None:
        """Enter extended surfaces of the pixels `part`, fitted in noise that is `raised` over the receivers'.

        `explained` is their power, and the number of directions in which they have it.
        """
        here = SPREAD, part, 0
        self.elevation[here], self.spread[here], cnr = surfaces.found
        self.sigma[here], self.cnr[here] = surfaces.sigma, raised * cnr
        self.explained[SPREAD, part], self.directions[SPREAD, part] = explained

    def add_surfaces(self, here: tuple[Index, Index], single: SingleScatterers, looks: Looks) -> None:
        """Add to the sigma of several scatterers that of surfaces as much spread as those around them.

        Args:
            here: rows and columns of the pixels.
            single: scatterers of all pixels.
            looks: covariance of the pixels.
        """
        gains = np.diff(self.explained[ONE : THREE + 1], axis=0)
        for order, gain in zip((TWO, THREE), gains, strict=True):
            more = gain > single.levels.several[here]
            if not more.any():
                continue
            along = np.zeros((2, *looks.count.shape))
            along[:, *here] = np.where(more, self.along_slopes[:, order], 0.0)
            deviation = surface_deviation(spread_around(along[0], along[1], looks), looks)[here]
            self.sigma[order] = np.hypot(self.sigma[order], deviation[:, None])

    def scatterers(
        self, chosen: Index, probability: F64, span: tuple[float, float], least_cnr: float, greatest_sigma: float
    ) -> tuple[F64, Index, Index]:
        """The scatterers of the model `chosen` for each pixel that are inside the array, if all these are determined.

        Args:
            chosen: number of the model of each pixel, (pixels,).
            probability: probability of the models, (pixels, ORDERS).
            span: lowest and highest elevation inside, rad.
            least_cnr: least CNR of a scatterer.
            greatest_sigma: sigma from which a scatterer is not determined, rad.

        Returns:
            Elevation, sigma over all models, CNR and spread, strongest first, NaN beyond their number, (4, pixels,
            MOST); and the numbers of scatterers inside, and of those returned, (pixels,).
        """
        found, counts = np.full((4, len(chosen), MOST), np.nan), np.empty((2, len(chosen)), np.intp)
        models = self.elevation, self.sigma, self.cnr, self.spread
        choose_scatterers(models, chosen, probability, (*span, least_cnr, greatest_sigma), found, counts)
        return found, counts[0], counts[1]


@dataclass(frozen=True, eq=False)
class Suspects:
    """Pixels to which models are fitted, in the order of their squints; arrays (pixels, ...).

    Attributes:
        covariance: R in noise powers, double precision, (pixels, M, M).
        values: objective on the grid.
        looks: K.
        search: search with the normalised objective.
    """

    covariance: Numbers
    values: F32
    looks: F64
    search: PeakSearch

    @classmethod
    def at(cls, here: tuple[Index, Index], raised: F64, looks: Looks, beams: Beams, search: PeakSearch) -> Self:
        """The pixels in the rows and columns `here`, whose noise is `raised` over the receivers'."""
        covariance: Numbers = looks.covariance[here] / (looks.receiver_noise * raised[:, None, None])
        covariance = covariance.astype(np.complex128) if beams.is_complex else covariance.real.astype(np.float64)
        return cls(covariance, search.on_grid(covariance), looks.count[here], search)

    def of(self, some: Index) -> Suspects:
        """Some of the pixels, in their order."""
        if len(some) == len(self.looks):
            return self
        return Suspects(self.covariance[some], self.values[some], self.looks[some], self.search.of(some))


def fit_models(
    here: tuple[Index, Index], single: SingleScatterers, evidence: F64, looks: Looks, beams: Beams
) -> Models:
    """Fit two and three scatterers where one more explains enough, and extended surfaces where one is not enough.

    Args:
        here: rows and columns of the pixels.
        single: scatterers of all pixels.
        evidence: log-evidence of all pixels without such fits, (rows, cols, ORDERS).
        looks: covariance of M channels of equal noise in each pixel.
        beams: beams of the M detectors.
    """
    models = Models.of_single(single, evidence, looks, here)
    level_spread = np.broadcast_to(looks.level_spread, looks.count.shape)
    searches = PeakSearches.over(beams, OBJECTIVES["normalised"], search_guard(beams))
    blocks = searches.blocks(looks.squint, here[1], PIXELS_AT_ONCE)

    def work(block: Block) -> None:
        part = block.items
        pixels = here[0][part], here[1][part]
        suspects = Suspects.at(pixels, single.noise.raised[pixels], looks, beams, searches.of(block))
        _fit_several(models, part, pixels, suspects, single, level_spread[pixels], beams)
        _fit_extended(models, part, pixels, suspects, single, beams)

    # A thread that is done takes the next block: blocks differ in the number of pixels, and pixels in their models.
    in_threads(work, blocks)
    return models


def _fit_several(
    models: Models,
    part: Index,
    pixels: tuple[Index, Index],
    suspects: Suspects,
    single: SingleScatterers,
    level_spread: F64,
    beams: Beams,
) -> None:
    """Fit more scatterers to the pixels `part` of the models, as long as one more explains enough."""
    greatest = 2 * single.levels.spread[pixels] / single.noise.along_slope[pixels]  # power beyond is of one more
    peaks, domain, looks = single.peaks, float(np.ptp(beams.span)), suspects.looks
    turning, tried, raised = peaks.turning[pixels], single.levels.tried[pixels], single.noise.raised[pixels]
    some, start = np.arange(len(part)), peaks.elevation[pixels][:, None]
    for number in range(TWO, min(MOST, beams.count - 1) + 1):
        if not some.size:
            return
        these = suspects.of(some)
        elevation, explained, gain = search_several(these.search, these.covariance, these.values, start, tried[some])
        more = log_evidence_of_one(gain, looks[some], turning[some], domain)
        models.evidence[number, part[some]] = models.evidence[number - 1, part[some]] + more
        climbed = explained > 0
        some, start = some[climbed], elevation[climbed]
        if some.size:
            these = these.of(np.flatnonzero(climbed))
            several = SeveralScatterers.at(these.search, these.covariance, these.looks, start)
            weighed = log_evidence_of_several(several, domain)
            along = several.along_surfaces(level_spread[some], greatest[some])
            uncertainty, level = beams.uncertainty, level_spread[some]
            models.add_several(several, raised[some], uncertainty, weighed, level, along, part[some])


def _fit_extended(
    models: Models, part: Index, pixels: tuple[Index, Index], suspects: Suspects, single: SingleScatterers, beams: Beams
) -> None:
    """Fit a surface where one scatterer is not enough, to the pixels `part` of the models."""
    peaks, domain = single.peaks, float(np.ptp(beams.span))
    gain = models.explained[TWO, part] - models.explained[ONE, part]
    some = np.flatnonzero(gain > single.levels.several[pixels])
    if not some.size:
        return
    chosen, whole = part[some], (pixels[0][some], pixels[1][some])
    these = suspects.of(some)
    least = models.evidence[TWO : THREE + 1, chosen].max(axis=0) - 10.0  # less probable models are not fitted
    raised = single.noise.raised[whole]
    first = surfaces_over(models.elevation[TWO, chosen, :TWO], models.cnr[TWO, chosen, :TWO] / raised[:, None])
    surfaces = ExtendedSurfaces.fit(these.search, these.covariance, these.looks, first, least, domain, beams.beamwidth)
    # Of a climb that was ended early, only the evidence is used.
    models.evidence[SPREAD, chosen] = surfaces.log_evidence
    likely = np.flatnonzero(surfaces.log_evidence > least)
    if not likely.size:
        return
    whole, surfaces = (whole[0][likely], whole[1][likely]), surfaces.at(likely)
    surfaces = surfaces.with_uncertain_beams(beams.uncertainty, peaks.turning[whole] * peaks.array_power[whole])
    these = these.of(likely)
    explained = explained_by(these.search, these.covariance, surfaces.found, beams.beamwidth)
    models.add_extended(surfaces, explained, raised[likely], chosen[likely])
