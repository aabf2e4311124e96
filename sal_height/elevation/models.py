"""One, two, three scatterers or an extended surface, fitted to the pixels where one point may not be enough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.bounds import Numbers
from sal_height.elevation.estimate import ORDERS
from sal_height.elevation.extended import ExtendedSurfaces, Surfaces, first_surfaces
from sal_height.elevation.likelihood import OBJECTIVES, search_guard
from sal_height.elevation.looks import Looks
from sal_height.elevation.order import (
    ONE,
    SPREAD,
    THREE,
    TWO,
    log_evidence_of_extended,
    log_evidence_of_one,
    log_evidence_of_several,
)
from sal_height.elevation.search import PeakSearches
from sal_height.elevation.several import SeveralScatterers, power_of, search_several
from sal_height.elevation.single import SingleScatterers
from sal_height.numeric import F64, Index, in_parallel

PIXELS_AT_ONCE = 512  # pixels whose models are fitted at a time
IMPROBABLE = 10.0  # logarithm of how many times less probable a model is that need not be fitted
MOST = 3  # scatterers of a pixel at most


@dataclass(frozen=True, eq=False)
class Models:
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
    def of_single(cls, single: SingleScatterers, evidence: F64, looks: Looks, here: tuple[Index, Index]) -> Self:
        """Those of the pixels `here` that single peaks give: one scatterer, and one that is spread a little.

        Args:
            single: scatterers of all pixels.
            evidence: of all pixels, (rows, cols, ORDERS).
            looks: the pixels.
            here: rows and columns of some.
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


def fit_models(
    here: tuple[Index, Index], single: SingleScatterers, evidence: F64, looks: Looks, beams: Beams
) -> Models:
    """Fit two and three scatterers where one more explains enough, and extended surfaces where one is not enough.

    Args:
        here: rows and columns of the pixels.
        single: scatterers of all pixels.
        evidence: of all pixels without such fits, (rows, cols, ORDERS).
        looks: covariance of M channels of equal noise in each pixel.
        beams: of the M detectors.
    """
    peaks, noise, levels, spread = single.peaks, single.noise, single.levels, single.spread
    row, col = here
    models = Models.of_single(single, evidence, looks, here)
    domain, most = float(np.ptp(beams.span)), min(MOST, beams.count - 1)
    searches = PeakSearches.over(beams, OBJECTIVES["normalised"], search_guard(beams))
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
            some = np.flatnonzero(models.explained[TWO, part] - models.explained[ONE, part] > levels.several[pixels])
            chosen, whole = part[some], (row[part[some]], col[part[some]])
            power = power_of(peaks.explained[whole], count[some])
            narrow = Surfaces(peaks.elevation[whole], spread.own[whole], power / peaks.array_power[whole])
            first = first_surfaces(search, values[some], count[some], narrow, beams.beamwidth)
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
