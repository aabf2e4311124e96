"""Layover and extended surfaces: the model of each pixel, and its scatterers and validity.

`order` gives the probability of the models. Pairs, triples and extended surfaces are fitted only where one more
scatterer, or a spread of the single one, would explain more than noise often does; elsewhere the same gains give their
probability.
"""

from __future__ import annotations

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array.estimate import ElevationEstimate, Fit, Scatterer, Validity, is_explained
from sal_height.elevation.array.likelihood import SinglePeaks
from sal_height.elevation.layover.extended import LEAST_SPREAD
from sal_height.elevation.layover.models import MOST, Models, fit_models
from sal_height.elevation.layover.order import NONE, ONE, SPREAD, THREE, TWO, log_probabilities
from sal_height.elevation.layover.single import LayoverSettings, SingleScatterers
from sal_height.elevation.looks.looks import Looks
from sal_height.numeric import F64, Index

DETECTED = np.ones(256, np.bool_)
DETECTED[[Validity.NO_SIGNAL, Validity.LOW_CNR, Validity.MISSING_DATA]] = False
"""True for each `Validity` of a pixel with a detected signal."""


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
    evidence[here] = models.evidence.T
    chances = log_probabilities(evidence, here, looks.columns)
    chosen = _chosen(models, chances[here].T, here, single, looks, beams, settings)
    probability = np.exp(chances)
    probability[~looks.finite] = np.nan
    widened = estimate.with_sigma(single.sigma(probability, looks))
    return _with_scatterers(widened, models, chosen, here, probability, beams, settings)


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
