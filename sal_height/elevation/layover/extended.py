"""One surface that is spread over elevation within a pixel: a slope towards the sensor, rubble, foliage.

Its scatterers are many and independent. If their elevations are uniform about the middle t with the standard deviation
s, and p is their total CNR, the K looks of a pixel have the covariance

    C = p mean over x of a(t + s x) a(t + s x)^H + I,    |x| <= sqrt 3

in noise powers. Against noise alone its log-likelihood is tr(R) - tr(C^-1 R) - K ln det C, where R is the sum of
g g^H over the looks. Fisher's scoring climbs it over t, ln s and ln p; their information is K tr(C^-1 dC C^-1 dC')
(Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 15.7).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from sal_height.elevation.array.beam_error import beam_deviation
from sal_height.elevation.array.bounds import Numbers
from sal_height.elevation.array.search import PeakSearch, SearchTables
from sal_height.elevation.layover._extended_kernels import RIDGE, SurfacePrior, Table, all_responses, climb_surfaces
from sal_height.elevation.layover.several import CNR_RANGE, adjoint, deviations
from sal_height.numeric import F64, Bool, Index

LEAST_SPREAD, GREATEST_SPREAD = 0.05, 1.0  # standard deviation of a surface's elevation, beamwidths
QUADRATURES = (5, 0.235), (7, 0.45), (9, GREATEST_SPREAD)
"""Numbers of nodes of the quadrature (Gauss and Legendre), and the greatest spread of each, beamwidths.

In products of responses, whose shortest period is 1 beamwidth, the first two err by 1e-5 at their greatest spread, the
last one by 1e-2: a surface of 30 dB with this spread is modelled as nine scatterers.
"""

NODES, WEIGHTS = np.zeros((2, len(QUADRATURES), QUADRATURES[-1][0]))  # of the nodes, in spreads; and of the power
for _rule, (_count, _) in enumerate(QUADRATURES):
    _nodes, _weights = np.polynomial.legendre.leggauss(_count)
    NODES[_rule, :_count], WEIGHTS[_rule, :_count] = np.sqrt(3) * _nodes, _weights / 2

STEEPNESS = 1.75
"""Power of the spread with which the prior density of its logarithm falls: wide surfaces are rarer than narrow ones.

At 10 dB in four looks, two scatterers a beamwidth apart and a surface with a spread of half a beamwidth are similar.
"""


class Surfaces(NamedTuple):
    """Extended surfaces; arrays of shape (pixels,).

    Attributes:
        elevation: t, rad.
        spread: s, rad.
        cnr: p of one look in a detector that looks straight at the surface, sum over its scatterers.
    """

    elevation: F64
    spread: F64
    cnr: F64

    def within_bounds(self, tables: SearchTables, beamwidth: float) -> Surfaces:
        """The surfaces within the bounds of the model: with a least spread, and mostly within the search domain."""
        spread = np.clip(self.spread, LEAST_SPREAD * beamwidth, GREATEST_SPREAD * beamwidth)
        return Surfaces(np.clip(self.elevation, tables.first - spread, tables.last + spread), spread, self.cnr.copy())

    def at(self, index: Index | Bool | slice) -> Surfaces:
        """Some of the surfaces."""
        return Surfaces(*(part[index] for part in self))

    def in_steps(self, tables: SearchTables) -> F64:
        """T and s in steps of the table, and p, (3, pixels), for the compiled loops."""
        return np.array([(self.elevation - tables.first) / tables.step, self.spread / tables.step, self.cnr])


@dataclass(frozen=True, eq=False)
class ExtendedSurfaces:
    """Extended surfaces fitted to some pixels; arrays of shape (pixels, ...).

    Attributes:
        found: most likely surfaces.
        sigma: standard deviation of their elevation, (pixels,), rad.
        log_likelihood, log_evidence: logarithms against noise alone, (pixels,).
        information: Fisher information on t / s, ln s and ln p, (pixels, 3, 3).
    """

    found: Surfaces
    sigma: F64
    log_likelihood: F64
    log_evidence: F64
    information: F64

    @classmethod
    def fit(
        cls,
        search: PeakSearch,
        covariance: Numbers,
        looks: F64,
        start: Surfaces,
        least: F64,
        domain: float,
        beamwidth: float,
    ) -> Self:
        """Fit a surface to each pixel.

        Args:
            search: search of these pixels with the normalised objective.
            covariance: R in noise powers, (pixels, M, M).
            looks: K, (pixels,).
            start: start of the climb.
            least: log-evidence of interest, (pixels,); the climb ends in pixels that seem unable to reach it.
            domain: range of their elevations, rad.
            beamwidth: beamwidth of the antenna, rad.
        """
        tables, squints = search.tables, search.every(len(looks))
        values = start.within_bounds(tables, beamwidth).in_steps(tables)
        (likelihood, evidence), information = np.empty((2, len(looks))), np.empty((len(looks), 3, 3))
        spreads = LEAST_SPREAD * beamwidth / tables.step, GREATEST_SPREAD * beamwidth / tables.step
        prior = _prior(domain / tables.step, beamwidth / tables.step)
        found = values, likelihood, evidence, information
        climb_surfaces(covariance, squints, looks, least, table_of(tables, beamwidth), spreads, prior, found)
        surfaces = Surfaces(search.elevation(values[0]), tables.step * values[1], values[2])
        deviation = deviations(information + RIDGE * looks[:, None, None] * np.eye(3))[:, 0]
        sigma = deviation * np.sqrt(looks / free_looks(looks)) * surfaces.spread
        return cls(surfaces, sigma, likelihood, evidence, information)

    def at(self, index: Index | Bool) -> Self:
        """Some of the surfaces."""
        parts = self.sigma, self.log_likelihood, self.log_evidence, self.information
        return type(self)(self.found.at(index), *(part[index] for part in parts))

    def with_uncertain_beams(self, uncertainty: float, turning: F64) -> Self:
        """The surfaces with the sigma that `beam_deviation` adds; D in 1/rad^2, (pixels,)."""
        return replace(self, sigma=np.hypot(self.sigma, beam_deviation(turning, uncertainty)))


def log_prior(spread: F64) -> F64:
    """Logarithm of the prior density of ln `spread` (beamwidths) over that of a uniform one between the bounds."""
    return -STEEPNESS * np.log(spread) - math.log(_mean_density())


def _mean_density() -> float:
    """Mean of s^-STEEPNESS over ln s between the bounds, s in beamwidths."""
    least, greatest = LEAST_SPREAD**-STEEPNESS, GREATEST_SPREAD**-STEEPNESS
    return (least - greatest) / (STEEPNESS * math.log(GREATEST_SPREAD / LEAST_SPREAD))


def _prior(domain: float, beamwidth: float) -> SurfacePrior:
    """The prior in steps of the table, for the compiled loops."""
    density = STEEPNESS * math.log(beamwidth) - math.log(_mean_density())
    return SurfacePrior(domain, math.log(GREATEST_SPREAD / LEAST_SPREAD), CNR_RANGE, STEEPNESS, density)


def surfaces_over(elevation: F64, cnr: F64) -> Surfaces:
    """Surfaces with the power, the middle and the spread of some scatterers, as the start of a climb.

    Where a surface is wide, the best two scatterers are about its spread away from its middle. As the spread follows
    from them rather than from the power over elevation, sidelobes do not widen it.

    Args:
        elevation: elevations of the scatterers, (pixels, S), rad.
        cnr: CNR of one look of each, (pixels, S).
    """
    weight = np.maximum(cnr, 0.01)  # fitted CNRs may be 0 or less
    power = weight.sum(axis=1)
    middle = np.sum(weight * elevation, axis=1) / power
    variance = np.sum(weight * (elevation - middle[:, None]) ** 2, axis=1) / power
    return Surfaces(middle, np.sqrt(variance), power)


def explained_by(search: PeakSearch, covariance: Numbers, surfaces: Surfaces, beamwidth: float) -> tuple[F64, F64]:
    """Power of the pixels in the directions in which surfaces have power, and the number of these, (pixels,).

    It is the sum over looks, in noise powers. Arguments as in `ExtendedSurfaces.fit`.
    """
    least = 0.1  # noise powers: mean power in a direction below which a surface has none there
    most, tables, squints = QUADRATURES[-1][0], search.tables, search.every(len(covariance))
    rows = np.empty((len(covariance), most, covariance.shape[-1]), covariance.dtype)
    all_responses(surfaces.in_steps(tables), squints, table_of(tables, beamwidth), rows)
    responses = np.swapaxes(rows, 1, 2)
    strength, turn = np.linalg.eigh(adjoint(responses) @ responses)
    along = responses @ turn
    seen = np.sum(along.conj() * (covariance @ along), axis=1).real
    counted = strength > least
    counted[:, : max(most - covariance.shape[-1] + 1, 0)] = False
    return np.sum(seen * counted / np.maximum(strength, least), axis=1), counted.sum(axis=1).astype(np.float64)


def table_of(tables: SearchTables, beamwidth: float) -> Table:
    """The unit responses at all squints and the quadratures, for the compiled loops."""
    greatest = np.array([spread for _, spread in QUADRATURES]) * beamwidth / tables.step
    return tables.unit_pieces, tables.power, NODES, WEIGHTS, greatest


def free_looks(looks: F64) -> F64:
    """Number of complex dimensions of the power along the slope: K, less the real one that determines the peak."""
    return looks - 0.5


def spread_of(along_slope: F64, looks: F64, power: F64, turning: F64) -> F64:
    """Standard deviation of elevation, rad; 0 where the power along the slope is not greater than that of noise.

    Args:
        along_slope: power along the slope of the response, sum over looks, noise powers.
        looks: K.
        power: p of one look.
        turning: D / |a|^2, 1/rad^2.
    """
    excess = np.maximum(along_slope / free_looks(looks) - 1, 0.0)
    return np.sqrt(excess / np.maximum(power * turning, 1e-300))
