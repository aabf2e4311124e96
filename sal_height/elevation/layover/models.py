"""One, two, three scatterers or an extended surface, fitted to the pixels that may have more than one point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.bounds import Numbers
from sal_height.elevation.array.estimate import ORDERS
from sal_height.elevation.array.likelihood import OBJECTIVES, search_guard
from sal_height.elevation.array.search import PeakSearch, PeakSearches
from sal_height.elevation.layover._layover_kernels import choose_scatterers
from sal_height.elevation.layover.extended import ExtendedSurfaces, explained_by, surfaces_over
from sal_height.elevation.layover.order import (
    ONE,
    SPREAD,
    THREE,
    TWO,
    log_evidence_of_one,
    log_evidence_of_several,
)
from sal_height.elevation.layover.several import SeveralScatterers, search_several
from sal_height.elevation.layover.single import SingleScatterers
from sal_height.elevation.looks.looks import Looks
from sal_height.numeric import F32, F64, Index, in_parallel

PIXELS_AT_ONCE = 512  # pixels whose models are fitted at a time
MOST = 3  # greatest number of scatterers of a pixel


@dataclass(frozen=True, eq=False)
class Models:
    """The models fitted to some pixels, by their index in `order`; other models explain no power.

    Attributes:
        elevation: elevations of their scatterers, NaN beyond their number, (ORDERS, pixels, MOST), rad.
        sigma, cnr, spread: those of the same scatterers.
        explained: power, sum over looks, over the raised noise power, (ORDERS, pixels).
        directions: number of dimensions of the channels in which they may explain a look, (ORDERS, pixels).
        evidence: log-evidence against no scatterer, (ORDERS, pixels).
    """

    elevation: F64
    sigma: F64
    cnr: F64
    spread: F64
    explained: F64
    directions: F64
    evidence: F64

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
        sigma[ONE, :, 0] = np.hypot(point.sigma, spread.deviation(spread.around, looks))[here]
        widest = np.maximum(spread.own, spread.around)
        sigma[SPREAD, :, 0] = np.hypot(point.sigma, spread.deviation(widest, looks))[here]
        width[ONE, :, 0], width[SPREAD, :, 0] = 0.0, spread.own[here]
        explained, directions = np.zeros((ORDERS, pixels)), np.zeros((ORDERS, pixels))
        directions[ONE:] = np.array([1.0, 2.0, 3.0, 2.0])[:, None]
        explained[ONE], explained[SPREAD] = peaks.explained[here], (peaks.explained + peaks.along_slope)[here]
        return cls(elevation, sigma, cnr, width, explained, directions, evidence[here].T.copy())

    def add_several(
        self, several: SeveralScatterers, raised: F64, uncertainty: float, evidence: F64, part: Index
    ) -> None:
        """Enter two or three scatterers of the pixels `part`, fitted in noise that is `raised` over the receivers'."""
        count = several.elevation.shape[1]
        here = count, part, slice(count)
        self.elevation[here], self.cnr[here] = several.elevation, raised[:, None] * several.power
        self.sigma[here] = np.hypot(several.sigma, several.deviation_by_beams(uncertainty))
        self.spread[here], self.explained[count, part], self.evidence[count, part] = 0.0, several.explained, evidence

    def add_extended(self, surfaces: ExtendedSurfaces, explained: tuple[F64, F64], raised: F64, part: Index) -> None:
        """Enter extended surfaces of the pixels `part`, fitted in noise that is `raised` over the receivers'.

        `explained` is their power, and the number of directions in which they have it.
        """
        here = SPREAD, part, 0
        self.elevation[here], self.spread[here], cnr = surfaces.found
        self.sigma[here], self.cnr[here] = surfaces.sigma, raised * cnr
        self.explained[SPREAD, part], self.directions[SPREAD, part] = explained

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
    searches = PeakSearches.over(beams, OBJECTIVES["normalised"], search_guard(beams))
    blocks = searches.blocks(looks.squint, here[1], PIXELS_AT_ONCE)

    def work(some: slice) -> None:
        for block in blocks[some]:
            part = block.items
            pixels = here[0][part], here[1][part]
            suspects = Suspects.at(pixels, single.noise.raised[pixels], looks, beams, searches.of(block))
            _fit_several(models, part, pixels, suspects, single, beams)
            _fit_extended(models, part, pixels, suspects, single, beams)

    in_parallel(work, len(blocks))
    return models


def _fit_several(
    models: Models, part: Index, pixels: tuple[Index, Index], suspects: Suspects, single: SingleScatterers, beams: Beams
) -> None:
    """Fit more scatterers to the pixels `part` of the models, as long as one more explains enough."""
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
            models.add_several(several, raised[some], beams.uncertainty, weighed, part[some])


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
