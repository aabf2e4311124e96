"""`sal-height montecarlo`: statistics of one estimator at one operating point, with bounds and closed forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.beams import PATTERNS, Beams, detector_pattern, read_beam_tables, tabulated_pattern
from sal_height.elevation import (
    DISCRIMINANTS,
    ESTIMATORS,
    OBJECTIVES,
    Covariance,
    ElevationEstimator,
    HeightSettings,
    Looks,
    conditional_crb,
    covariance,
    discriminant,
    discriminant_domain,
    discriminant_slope,
    discriminate,
    speckle_crb,
    stochastic_crb,
    sum_and_difference,
)
from sal_height.errors import UserError, did_you_mean
from sal_height.figures.sample_statistics import Measured, mean, median, s68, share, std
from sal_height.figures.unit_arrays import array_of
from sal_height.numeric import F64, Bool
from sal_height.sensor import whitened_channels
from sal_height.theory import (
    TARGETS,
    TargetPixels,
    cnr_detector_of,
    gaussian_law,
    s68_of,
    steady_looks_mean,
    straight_power,
    with_streams,
)

DETECTORS, MOST_DETECTORS = 16, 128

FARTHEST_SEARCH = 200.0
"""Greatest half width of the search, beamwidths."""

ARRAY_ESTIMATORS = tuple(name for name, entry in ESTIMATORS.items() if entry.channels is whitened_channels)
"""Estimators of ESTIMATORS that use detectors of equal noise, as in the trials."""

BOUNDS = {
    "crb_conditional": conditional_crb,
    "crb_stochastic": stochastic_crb,
    "crb_speckle": speckle_crb,
}


@dataclass(frozen=True)
class Experiment:
    """Repeated observations of a target at one elevation in noise; angles in beamwidths.

    Attributes:
        beams: beams of the detectors, around 0, of a beamwidth of 1 rad.
        theta: elevation of the target above the middle of the detectors.
        cnr_db: CNR of one look, as each function defines it, dB.
        looks: number K of looks.
        target: name of the target, one of TARGETS.
        trials: number of estimates.
        seed: seed of all random numbers.

    Raises:
        UserError: a value out of its range.
    """

    beams: Beams
    theta: float
    cnr_db: float
    looks: int
    target: str
    trials: int
    seed: int

    def __post_init__(self) -> None:
        _require("The target's elevation", self.theta, -FARTHEST_SEARCH, FARTHEST_SEARCH, " beamwidths")
        _require("The CNR", self.cnr_db, -60, 100, " dB")
        _require("The number of looks", self.looks, 1, 10_000)
        _require("The number of trials", self.trials, 1, 10_000_000)
        if self.target not in TARGETS:
            raise UserError(f"The target is {self.target!r}; allowed are {', '.join(TARGETS)}.")

    @property
    def cnr(self) -> float:
        """CNR as a power ratio."""
        return float(10 ** (self.cnr_db / 10))


def array_with(pattern: str, pitch: float, detectors: int | None, size: tuple[float, float]) -> Beams:
    """The beams of an array around 0.

    Args:
        pattern: name of a pattern, one of PATTERNS, or the path of a CSV file of measured beams (`read_beam_tables`).
        pitch: pitch of the detectors, beamwidths.
        detectors: number of detectors; None: as many as the file has beams, or 16. A single beam is that of all.
        size: size of a detector along and across the axis, beamwidths; 0 with measured beams, which include it.

    Raises:
        UserError: an argument cannot be used.
    """
    _require("The pitch", pitch, 1e-3, 10, " beamwidths")
    count = DETECTORS if detectors is None else detectors
    _require("The number of detectors", count, 2, MOST_DETECTORS)
    if pattern in PATTERNS:
        return array_of((detector_pattern(pattern, size),), count, pitch)
    if not Path(pattern).exists():
        raise UserError(
            f"The beam pattern is {pattern!r}; allowed are {', '.join(sorted(PATTERNS))}, or a CSV file of beams."
        )
    if any(size):
        raise UserError(
            f"The beams in {pattern} are measured with their detectors; a size cannot be given in addition."
        )
    tables = read_beam_tables(Path(pattern), 1.0)
    _require(f"The number of detectors in {pattern}", len(tables), 1, MOST_DETECTORS)
    if len(tables) > 1 and detectors not in {None, len(tables)}:
        raise UserError(f"There are beams of {len(tables)} detectors in {pattern}; {detectors} were asked for.")
    patterns = tuple(tabulated_pattern(table, 1.0) for table in tables)
    return array_of(patterns, len(tables) if len(tables) > 1 else count, pitch)


def search_guard(beams: Beams, domain: float | None) -> float:
    """Extent of the search beyond half a pitch outside the array (beamwidths), if `domain` is its half width.

    None: 0, for a half width of M pitch / 2.

    Raises:
        UserError: a half width that is not positive, or too large.
    """
    first, last = beams.span
    half = (last - first) / 2 * beams.count / (beams.count - 1)
    _require("The half width of the search", half if domain is None else domain, 1e-3, FARTHEST_SEARCH, " beamwidths")
    return 0.0 if domain is None else domain - half


def array_statistics(experiment: Experiment, estimator: str, objective: str, domain: float | None) -> dict[str, Any]:
    """Statistics of the elevation by an array, beamwidths.

    Args:
        experiment: experiment whose `cnr` is that of one detector looking straight at the target.
        estimator: name in ARRAY_ESTIMATORS, with its node's default settings; or in DISCRIMINANTS: that of the
            strongest pair.
        objective: objective of "ml", one of OBJECTIVES.
        domain: half width of the search of "ml", beamwidths; None: M pitch / 2.

    Raises:
        UserError: there is no such estimator, or the target is outside the search.
    """
    if estimator not in (names := (*ARRAY_ESTIMATORS, *DISCRIMINANTS)):
        raise UserError(
            f"The estimator is {estimator!r}{did_you_mean(estimator, names)}; allowed are {', '.join(names)}."
        )
    beams, guard = experiment.beams, search_guard(experiment.beams, domain)
    low, high = beams.domain(guard)
    if not low <= experiment.theta <= high:
        raise UserError(
            f"The target is at {experiment.theta:g} beamwidths; the search goes from {low:g} to {high:g} beamwidths."
        )
    power = experiment.cnr / straight_power(beams)
    if estimator == "ml":
        estimates = _elevations(experiment, power, objective, guard)
        clipped = _at_edge(estimates, low, high)
    elif estimator in DISCRIMINANTS:
        pairs = ESTIMATORS["monopulse"]
        settings = pairs.settings.model_validate({"discriminant": estimator})
        estimates = _registered_elevations(experiment, power, pairs, settings)
        clipped = np.isnan(estimates)
    else:
        entry = ESTIMATORS[estimator]
        estimates = _registered_elevations(experiment, power, entry, entry.settings())
        clipped = np.isnan(estimates)
    return {
        "theta": experiment.theta,
        "cnr_detector": experiment.cnr,
        "domain": [low, high] if estimator == "ml" else None,
        **_statistics(estimates, experiment.theta, clipped),
        **_bounds(experiment, power, 1.0),
    }


def pair_statistics(experiment: Experiment, estimator: str, objective: str, domain: float | None) -> dict[str, Any]:
    """Statistics of the estimated discriminant of two detectors.

    The closed form is that of `ratio`: its mean, and for a fluctuating target its median, std and s68, else None.

    Args:
        experiment: experiment whose `cnr` is that of the sum channel at the target.
        estimator: name in DISCRIMINANTS, or "ml": the discriminant at the maximum-likelihood elevation.
        objective: objective of "ml", one of OBJECTIVES.
        domain: half width of the search of "ml", beamwidths; None: the pitch.

    Raises:
        UserError: not two detectors, or the target is where their discriminant cannot be inverted.
    """
    pair, theta = experiment.beams, experiment.theta
    if pair.count != 2:
        raise UserError(f"There are {pair.count} detectors; a pair has 2.")
    low, high = (float(end) for end in discriminant_domain(pair, 0.0))
    if not low <= theta <= high:
        raise UserError(
            f"The target is {theta:g} beamwidths above the middle of the pair, whose discriminant can be inverted from "
            f"{low:.6g} to {high:.6g} beamwidths."
        )
    detector = float(cnr_detector_of(experiment.cnr, pair, theta, 0.0))
    power = detector / straight_power(pair)
    kappa, slope = float(discriminant(pair, theta, 0.0)), float(discriminant_slope(pair, theta, 0.0))
    searched: list[float] | None = None
    if estimator == "ml":
        guard = search_guard(pair, domain)
        searched = list(pair.domain(guard))
        elevations = _elevations(experiment, power, objective, guard)
        estimates, stopped = discriminant(pair, elevations, 0.0), _at_edge(elevations, *pair.domain(guard))
    else:
        estimates = _discriminants(experiment, power, estimator)
        stopped = np.zeros(estimates.shape, dtype=bool)
    return {
        "theta": theta,
        "kappa": kappa,
        "cnr_sum": experiment.cnr,
        "cnr_detector": detector,
        "domain": searched,
        **_statistics(estimates, kappa, stopped | ~(np.abs(estimates) <= 1)),
        **_bounds(experiment, power, abs(slope)),
        "closed_form": _closed_form(experiment, kappa) if estimator == "ratio" else None,
    }


def statistics_table(statistics: Mapping[str, Any]) -> str:
    """The statistics as lines for people: name, value, standard error and, where there is one, closed form."""
    closed_form = statistics.get("closed_form") or {}
    lines = [f"{'':16}{'value':>13}{'std. error':>13}{'closed form':>13}"]
    for name, value in statistics.items():
        if name == "closed_form" or name.endswith("_se"):
            continue
        shown = " to ".join(f"{end:.6g}" for end in value) if isinstance(value, list) else _shown(value)
        error, expected = (_shown(others.get(key)) for others, key in ((statistics, f"{name}_se"), (closed_form, name)))
        lines.append(f"{name:16}{shown:>13}{error:>13}{expected:>13}".rstrip(" -"))
    return "\n".join(lines)


def _shown(number: float | None) -> str:
    return "-" if number is None else f"{number:.6g}"


def _pixels(experiment: Experiment, power: float) -> TargetPixels:
    return TargetPixels(experiment.beams, experiment.theta, power, experiment.looks, experiment.target)


def _elevations(experiment: Experiment, power: float, objective: str, guard: float) -> F64:
    pixels = _pixels(experiment, power)
    return pixels.peak_elevations(experiment.seed, experiment.trials, OBJECTIVES[objective], guard)


def _registered_elevations(
    experiment: Experiment, power: float, estimator: ElevationEstimator, settings: HeightSettings
) -> F64:
    """Elevations as the node of an estimator gives them, shape (trials,); NaN where invalid."""

    def elevations(matrices: Covariance) -> F64:
        looks = Looks.of(matrices[:, None], experiment.looks)
        return estimator.estimate(looks, experiment.beams, settings).elevation[:, 0]

    return _from_covariances(experiment, power, elevations)


def _discriminants(experiment: Experiment, power: float, estimator: str) -> F64:
    """Estimates of the discriminant of two detectors as the node makes them, shape (trials,)."""

    def discriminants(matrices: Covariance) -> F64:
        wide = matrices.astype(np.complex128)
        sums = sum_and_difference(wide[:, 0, 0].real, wide[:, 1, 1].real, wide[:, 0, 1], experiment.looks)
        return discriminate(sums, DISCRIMINANTS[estimator], (2.0, 2.0))

    return _from_covariances(experiment, power, discriminants)


def _from_covariances(experiment: Experiment, power: float, estimate: Callable[[Covariance], F64]) -> F64:
    """Estimate from the covariances of independent pixels, shape (trials,)."""
    pixels, estimates = _pixels(experiment, power), np.empty(experiment.trials)

    def work(rng: np.random.Generator, part: slice) -> None:
        samples = pixels.draw(rng, part.stop - part.start)
        estimates[part] = estimate(covariance(samples, experiment.beams.is_complex))

    with_streams(work, experiment.seed, experiment.trials, max(1, 8192 // experiment.looks))
    return estimates


def _at_edge(elevations: F64, low: float, high: float) -> Bool:
    margin = 1e-6  # beamwidths
    return (elevations <= low + margin) | (elevations >= high - margin)


def _statistics(estimates: F64, truth: float, clipped: Bool) -> dict[str, float | None]:
    """Statistics with their standard errors (_se); estimates that do not exist count in clipped_share alone."""
    finite = estimates[np.isfinite(estimates)]
    outliers = np.abs(estimates - truth) > 1.0  # beamwidths of an elevation, or a number of a discriminant
    named: list[tuple[str, Measured]] = [("outlier_share", share(outliers)), ("clipped_share", share(clipped))]
    if finite.size:
        average = mean(finite)
        bias = Measured(average.value - truth, average.standard_error)
        named = [
            *(
                ("mean", average),
                ("median", median(finite)),
                ("std", std(finite)),
                ("s68", s68(finite)),
                ("bias", bias),
            ),
            *named,
        ]
    return {
        name: _or_none(number) for key, pair in named for name, number in zip((key, f"{key}_se"), pair, strict=True)
    }


def _bounds(experiment: Experiment, power: float, scale: float) -> dict[str, float | None]:
    """Bounds on the standard deviation, times `scale`; None where infinite."""
    where = (experiment.beams, experiment.theta, 0.0, power, experiment.looks)
    return {name: _or_none(float(bound(*where)) * scale) for name, bound in BOUNDS.items()}


def _closed_form(experiment: Experiment, kappa: float) -> dict[str, float | None]:
    if experiment.target == "steady":
        expected = float(steady_looks_mean(kappa, experiment.cnr, experiment.looks))
        return {"mean": expected, "median": None, "std": None, "s68": None}
    law = gaussian_law(kappa, experiment.cnr, experiment.looks)
    centre = float(law.mean())
    return {"mean": centre, "median": centre, "std": _or_none(float(law.std())), "s68": s68_of(law)}


def _or_none(number: float) -> float | None:
    return number if np.isfinite(number) else None


def _require(what: str, value: float, least: float, most: float, unit: str = "") -> None:
    if not (np.isfinite(value) and least <= value <= most):
        raise UserError(f"{what} is {value:g}{unit}; allowed are {least:g} to {most:g}{unit}.")
