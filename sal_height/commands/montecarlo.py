"""`sal-height montecarlo`: statistics of an estimator at one operating point."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from cyclopts import Parameter

from sal_height.commands._options import DONE, KINDS, THEORY, ElevationByAzimuth, Flag, Seed, Trials, command
from sal_height.figures import DEFAULT_TRIALS

if TYPE_CHECKING:
    from sal_height.beams import Beams
    from sal_height.figures.montecarlo import Experiment

Estimator: TypeAlias = Literal["ratio", "tls", "noise_subtraction", "ml"]

EXAMPLES = """
  sal-height montecarlo pair --theta 0.25 --cnr-db 5 --look-count 4
  sal-height montecarlo array --theta 1.75 --cnr-db 4.77 --look-count 4
"""

PAIR_EXAMPLES = """
  sal-height montecarlo pair --theta 0.25 --cnr-db 5 --look-count 4
  sal-height montecarlo pair --theta 0.25 --cnr-db 5 --look-count 4 \\
    --estimator tls --json
  sal-height montecarlo pair --pattern jinc --pitch 0.6 --size 0.6x1.2 \\
    --target steady --look-count 1
"""

ARRAY_EXAMPLES = """
  sal-height montecarlo array --theta 1.75 --cnr-db 4.77 --look-count 4
  sal-height montecarlo array --theta 3.5 --cnr-db 20 --look-count 16 \\
    --objective numerator --json
  sal-height montecarlo array --theta 0.1 --cnr-db 10 --look-count 16 \\
    --estimator tls
  sal-height montecarlo array --theta 0.1 --cnr-db 10 --look-count 16 \\
    --estimator capon
  sal-height montecarlo array --pattern beams.csv --pitch 0.5 --theta 0.1
"""

DESCRIPTION = """Print statistics of an estimator at one operating point.

A target is drawn in noise many times, and its position estimated each time
with the estimator that the nodes run. Angles are in beamwidths (wavelength /
antenna diameter)."""

app = command("montecarlo", THEORY, EXAMPLES)
app.help = DESCRIPTION
pair_app = command("pair", KINDS, PAIR_EXAMPLES)
array_app = command("array", KINDS, ARRAY_EXAMPLES)
app.command(pair_app)
app.command(array_app)


@Parameter(name="*")
@dataclass(frozen=True)
class Scenario:
    """Options that pairs and arrays share."""

    pattern: Annotated[
        str,
        Parameter(
            metavar="NAME|FILE",
            help="Beams: sinc, jinc or another pattern of presets, or a CSV file of measured beams.",
        ),
    ] = "sinc"
    pitch: Annotated[float, Parameter(help="Detector spacing in beamwidths.")] = 0.5
    size: Annotated[
        ElevationByAzimuth, Parameter(help="Detector size in beamwidths, elevation x azimuth; 0x0 for a point.")
    ] = (0.0, 0.0)
    look_count: Annotated[int, Parameter(metavar="K", help="Number of independent looks.")] = 4
    target: Annotated[
        Literal["gaussian", "steady"], Parameter(help="Target with speckle (gaussian) or constant amplitude (steady).")
    ] = "gaussian"
    theta: Annotated[float, Parameter(help="Target elevation in beamwidths from the middle of the detectors.")] = 0.0
    objective: Annotated[
        Literal["normalised", "numerator"],
        Parameter(help="Objective of maximum likelihood; the SAL paper's is the numerator alone."),
    ] = "normalised"
    search_half_width: Annotated[
        float | None,
        Parameter(
            metavar="X",
            help="Half width in beamwidths of the maximum-likelihood search. Default: number of detectors x pitch / 2.",
        ),
    ] = None
    trials: Trials = DEFAULT_TRIALS
    seed: Seed = 1
    json: Annotated[Flag, Parameter(help="Print JSON instead of a table.")] = False


DEFAULTS = Scenario()


@pair_app.default
def pair(
    *,
    detectors: Annotated[int, Parameter(metavar="M", help="Number of detectors; a pair has 2.")] = 2,
    estimator: Annotated[
        Estimator, Parameter(help="Estimator of the discriminant; ml estimates the elevation first.")
    ] = "ratio",
    cnr_db: Annotated[
        float, Parameter(metavar="X", help="CNR in dB of the sum channel at the target, in one look.")
    ] = 10.0,
    scenario: Scenario = DEFAULTS,
) -> int:
    """Statistics of the discriminant of two detectors (figures 5 and 6 of the SAL paper).

    Printed, each with its standard error (NAME_se), are
      mean, median, std, s68, bias   s68 is half the width from 16 to 84 %; bias
                                     is that of the mean
      outlier_share                     share of estimates more than 1 from the truth
      clipped_share                  share of estimates that do not exist or whose
                                     modulus exceeds 1; they are included in the
                                     other statistics
      crb_conditional, _stochastic   Cramer-Rao bounds for known and for unknown
                                     Gaussian amplitudes
      crb_speckle                    the conditional bound averaged over speckle;
                                     null (infinite) for one look
      kappa                          the discriminant without noise
      cnr_sum, cnr_detector          the CNR by both definitions, power ratios
      closed_form                    for the estimator ratio: mean, median, std
                                     and s68, where theory has them

    Not every distribution has all moments: ratio has no standard deviation with
    one look, tls and noise_subtraction have neither mean nor standard deviation;
    use median and s68 there.
    """
    from sal_height.figures.montecarlo import pair_statistics

    experiment = _experiment(scenario, detectors, cnr_db)
    statistics = pair_statistics(experiment, estimator, scenario.objective, scenario.search_half_width)
    return _print_statistics(statistics, scenario.json)


@array_app.default
def array(
    *,
    detectors: Annotated[
        int | None,
        Parameter(metavar="M", help="Number of detectors. Default: 16, or as many as the file of beams has."),
    ] = None,
    estimator: Annotated[
        str,
        Parameter(
            metavar="NAME",
            help="ml, capon, music and any other height estimator; or tls, ratio or noise_subtraction: the "
            "discriminant of the strongest pair.",
        ),
    ] = "ml",
    cnr_db: Annotated[
        float, Parameter(metavar="X", help="CNR in dB of a detector pointed at the target, in one look.")
    ] = 10.0,
    scenario: Scenario = DEFAULTS,
) -> int:
    """Statistics of the elevation estimated by all detectors (figures 10 and 11 of the SAL paper).

    Printed, each with its standard error (NAME_se), are
      mean, median, std, s68, bias   s68 is half the width from 16 to 84 %; bias
                                     is that of the mean
      outlier_share                     share of estimates more than 1 beamwidth from
                                     the truth
      clipped_share                  share of estimates that stopped at an end of
                                     the search, or have no pair; they are
                                     included in the other statistics
      crb_conditional, _stochastic   Cramer-Rao bounds for known and for unknown
                                     Gaussian amplitudes
      crb_speckle                    the conditional bound averaged over speckle;
                                     null (infinite) for one look
      domain                         ends of the search; at low CNR they determine
                                     the standard deviation
      cnr_detector                   power ratio
    """
    from sal_height.figures.montecarlo import array_statistics

    experiment = _experiment(scenario, detectors, cnr_db)
    statistics = array_statistics(experiment, estimator, scenario.objective, scenario.search_half_width)
    return _print_statistics(statistics, scenario.json)


def _experiment(scenario: Scenario, detectors: int | None, cnr_db: float) -> Experiment:
    from sal_height.figures.montecarlo import Experiment, array_with

    one = scenario
    beams: Beams = array_with(one.pattern, one.pitch, detectors, one.size)
    return Experiment(beams, one.theta, cnr_db, one.look_count, one.target, one.trials, one.seed)


def _print_statistics(statistics: dict[str, Any], as_json: bool) -> int:
    from sal_height.figures.montecarlo import statistics_table

    print(json.dumps(statistics, indent=2, allow_nan=False) if as_json else statistics_table(statistics))
    return DONE
