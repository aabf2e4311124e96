"""Maximum-likelihood elevation from all detectors of the array at once (SAL paper, section 5).

A target at elevation theta gives detector m the amplitude A_k a_m(theta) in look k, plus noise of variance sigma^2.
With the covariance R = sum_k g_k g_k^H, profiling out the complex A_k leaves the objective

    normalised:  a^H R a / a^H a     (exact)
    numerator:   a^H R a             (the paper's, which takes a^H a as constant: biased inwards near the array's ends)

or w^H R w with the weights w = a / |a| or w = a.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sal_height.beams import Beams
from sal_height.elevation.array._kernels import NEAR_HIGHEST
from sal_height.elevation.array.beam_error import beam_deviation
from sal_height.elevation.array.bounds import stochastic_deviation, unit_vectors
from sal_height.elevation.array.estimate import (
    ElevationEstimate,
    Residue,
    Validity,
    array_fit,
    decide_validity,
    detection_limit,
)
from sal_height.elevation.array.height_settings import HeightSettings
from sal_height.elevation.array.search import Find, Objective, Peaks, PeakSearch, PeakSearches, Pixels
from sal_height.elevation.looks.looks import Covariance, Looks
from sal_height.numeric import F64
from sal_height.settings import setting

GUARD = 3.0
"""Beamwidths beyond both ends of the array that are searched, so that a target there is recognised by its sidelobes.

With two detectors the search stays inside: their one ratio is also that of some direction between them.
"""

AMBIGUOUS_RATIO = 100.0
"""Ratio of the likelihoods of the highest and the second peak below which a pixel is AMBIGUOUS.

With detectors half a beamwidth apart and 5 dB or more in every look, less than 1 % of the otherwise valid pixels are
ambiguous, and they include about half of those whose highest peak is a wrong one. Detectors farther apart than a
beamwidth receive the same from several directions, which this ratio reveals. Two detectors always do: `two_channels`
decides which of their pixels are AMBIGUOUS.
"""

Spectrum = Callable[[Covariance, F64], Covariance]
"""Function of covariances R (pixels, M, M) and numbers of looks (pixels,) that returns matrices S (pixels, M, M): the
search is for the highest peak of u^H S u with the unit response u = a / |a|."""


class ArraySettings(HeightSettings):
    """Settings of the estimators that use the whole array."""

    ambiguous_ratio: float = setting(
        AMBIGUOUS_RATIO,
        "likelihood of the highest peak over that of the second below which a pixel is marked AMBIGUOUS; 1: never",
        minimum=1.0,
        maximum=1e12,
    )

    @property
    def margin(self) -> float:
        """Least distance in log-likelihood between the highest peak and the second: ln(ambiguous_ratio)."""
        return float(np.log(self.ambiguous_ratio))


def _normalised(response: F64, slope: F64) -> tuple[F64, F64]:
    """The unit vector u = a / |a| and its slope, the part of a' perpendicular to u over |a|; 0 where |a| is."""
    norm = np.linalg.norm(response, axis=-1, keepdims=True)
    unit = unit_vectors(response)
    turn = slope - unit * np.sum(unit * slope, axis=-1, keepdims=True)
    return unit, turn * np.divide(1.0, norm, where=norm > 0, out=np.zeros_like(norm))


def _numerator(response: F64, slope: F64) -> tuple[F64, F64]:
    return response, slope


OBJECTIVES: dict[str, Objective] = {"normalised": _normalised, "numerator": _numerator}
"""Weights w and their slope from response a and slope a' (real, (..., detectors)); the paper's is "numerator"."""


def search_guard(beams: Beams) -> float:
    """Extent of the search beyond the array, rad: GUARD, but 0 for two detectors."""
    return GUARD * beams.beamwidth if beams.count > 2 else 0.0


def peak_elevation(looks: Looks, beams: Beams, objective: Objective, guard: float) -> F64:
    """Elevation (rad) of the greatest objective in every pixel, shape (rows, cols).

    Args:
        looks: covariance of M channels in each pixel; complex if the beams are.
        beams: beams of the channels.
        objective: one of OBJECTIVES.
        guard: extent of the search beyond the array (`Beams.domain`), rad; `search_guard` reveals targets outside.

    Raises:
        UserError: the beams have no elevation in common, or are complex where the covariance is not.
    """
    searches = PeakSearches.over(beams, objective, guard)
    (elevation,) = searches.of_pixels(looks, 1, lambda search, pixels, *_: search.peaks(pixels).elevation)
    return elevation


@dataclass(frozen=True, eq=False)
class SinglePeaks:
    """A single scatterer fitted to each pixel; arrays (rows, cols), powers in units of the receivers' noise power.

    Attributes:
        elevation: elevation of the scatterer, rad.
        lead: power by which it explains more than any other peak; infinite without another peak.
        explained: power that it explains, sum over looks.
        array_power: |a|^2 there.
        turning: D / |a|^2 there (`bounds.information`), 1/rad^2.
        beside: power that one more scatterer would explain (`PeakSearch.gain_beside`); 0 if not computed.
        along_slope: power along the slope of its response; 0 if not computed.
    """

    elevation: F64
    lead: F64
    explained: F64
    array_power: F64
    turning: F64
    beside: F64
    along_slope: F64

    @classmethod
    def found_by(cls, find: Find, objective: Objective, looks: Looks, beams: Beams) -> Self:
        """Collect `elevation` to `along_slope`, which `find` gives for the pixels of a block in units of the looks."""
        searches = PeakSearches.over(beams, objective, search_guard(beams))
        elevation, lead, explained, array_power, turning, beside, along = searches.of_pixels(looks, 7, find)
        noise = looks.receiver_noise
        return cls(elevation, lead / noise, explained / noise, array_power, turning, beside / noise, along / noise)

    @classmethod
    def alone(cls, elevation: F64, explained: F64, array_power: F64, turning: F64) -> Self:
        """Scatterers without a search for other peaks or scatterers."""
        none = np.zeros_like(explained)
        return cls(elevation, np.full_like(explained, np.inf), explained, array_power, turning, none, none)

    @property
    def residue(self) -> Residue:
        """The fit as tests of the data need it."""
        return Residue(self.elevation, self.explained, np.maximum(self.beside, self.along_slope))

    def over(self, noise: F64) -> Self:
        """The same with powers in units of `noise`, a power of every pixel in units of the receivers'."""
        powers = {name: getattr(self, name) / noise for name in ("lead", "explained", "beside", "along_slope")}
        return replace(self, **powers)


def highest_peaks(looks: Looks, beams: Beams, settings: ArraySettings) -> SinglePeaks:
    """The highest peak of the likelihood over the array and the guard beyond.

    Where no signal can be detected no second peak is searched for: in shadow there are many, all of noise.

    Raises:
        UserError: a real covariance of complex beams.
    """
    margin, limit = settings.margin * looks.receiver_noise, detection_limit(looks, beams.count, settings)
    least = NEAR_HIGHEST * looks.receiver_noise * limit  # value on the grid below which the peak is not detected

    def find(search: PeakSearch, pixels: Covariance, here: Pixels) -> F64:
        values = search.on_grid(pixels)
        peaks = search.peaks_of(pixels, values, np.where(values.max(axis=1) < least[here], 0.0, margin))
        return np.vstack([_with_lead(search, pixels, peaks), search.gain_beside(pixels, values, peaks.elevation)])

    return SinglePeaks.found_by(find, OBJECTIVES["normalised"], looks, beams)


def highest_peaks_of(objective: Objective, looks: Looks, beams: Beams, settings: ArraySettings) -> SinglePeaks:
    """The highest peak of one of OBJECTIVES, as `highest_peaks`; without the gain of one more scatterer."""

    def find(search: PeakSearch, pixels: Covariance, _here: Pixels) -> F64:
        peaks = search.peaks(pixels, settings.margin * looks.receiver_noise)
        return np.vstack([_with_lead(search, pixels, peaks), np.zeros((2, len(pixels)))])

    return SinglePeaks.found_by(find, objective, looks, beams)


def peaks_by_spectrum(spectrum: Spectrum, looks: Looks, beams: Beams, settings: ArraySettings) -> SinglePeaks:
    """Maximum of the quadratic form of another spectrum, and the likelihood there; errors of `highest_peaks`."""

    def find(search: PeakSearch, pixels: Covariance, here: Pixels) -> F64:
        found = search.peaks(spectrum(pixels, looks.count[here])).elevation
        values = search.on_grid(pixels)
        likely = search.peaks_of(pixels, values, settings.margin * looks.receiver_noise)
        at_it = np.abs(likely.elevation - found) < 0.5 * beams.beamwidth  # peaks of the same scatterer
        fit = search.fit(pixels, found)
        lead = fit[0] - np.where(at_it, np.maximum(likely.second, 0.0), likely.height)
        return np.vstack([found, lead, fit, search.gain_beside(pixels, values, found)])

    return SinglePeaks.found_by(find, OBJECTIVES["normalised"], looks, beams)


def _with_lead(search: PeakSearch, pixels: Covariance, peaks: Peaks) -> F64:
    """Elevation, lead and fit of the highest peaks, (5, pixels)."""
    second = np.maximum(peaks.second, 0.0)  # it may not exist
    relative = np.divide(second, peaks.height, where=peaks.height > 0, out=np.zeros_like(peaks.height))
    fit = search.fit(pixels, peaks.elevation)
    return np.vstack([peaks.elevation, (1 - relative) * fit[0], fit])


def estimate_of(peaks: SinglePeaks, looks: Looks, beams: Beams, settings: ArraySettings) -> ElevationEstimate:
    """Sigma, CNR and validity of single scatterers.

    Sigma is `bounds.stochastic_crb` for the energy of these very looks, less the noise of two more, and
    `beam_error.beam_deviation`. It is that of errors about the scatterer's own peak: in some 1 % of the valid pixels at
    0 dB with 2 looks, and in fewer elsewhere, another peak is higher. A pixel is AMBIGUOUS where its likelihood is less
    than `ambiguous_ratio` times that of another peak; errors of the beams count as noise of every channel.
    """
    explained, gain, turning = peaks.explained, peaks.array_power, peaks.turning
    # The highest peak is where noise adds power, and among the valid pixels weak ones that noise has raised are more
    # frequent than strong ones that it has lowered: so the noise of two more looks is subtracted. From Monte Carlo
    # trials: without this, 60 % and 89 % of the valid pixels at 0 dB with 2 or 4 looks lie within one and two sigma;
    # with it 65 % and 93 %, and at 10 dB and above 68 to 72 % and 95 to 96 %.
    cnr, noise = (explained - looks.count) / gain / looks.count, looks.count + 2
    sigma = stochastic_deviation((explained - noise) / gain, noise, gain, turning * gain)
    sigma = np.hypot(sigma, beam_deviation(turning * gain, beams.uncertainty))
    fit, (first, last) = array_fit(looks, explained, gain, beams.uncertainty), beams.span
    strong, inside = cnr >= settings.min_cnr, (peaks.elevation >= first) & (peaks.elevation <= last)
    validity = decide_validity(looks, fit, strong, inside, Validity.OUTSIDE_ARRAY, settings)
    if beams.count > 2:
        lead = peaks.lead / (1 + fit.beam_error)
        validity[(validity == Validity.OK) & (lead < settings.margin)] = Validity.AMBIGUOUS
    return ElevationEstimate.of_one(peaks.elevation, sigma, cnr, validity)
