"""The command montecarlo: statistics beside closed forms and bounds, for formulas and measured beams."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from beam_tables import sample_pattern, write_beam_tables
from helpers import assert_one_sentence, refused
from scipy.stats import t as student

from sal_height.beams.pattern import detector_pattern, pattern_named
from sal_height.beams.table import BeamTable
from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.figures.montecarlo import Experiment, array_statistics, array_with
from sal_height.theory.discriminator_noise import NORMAL_SHARES, SteadyLaw, s68_of

STATISTICS = ("mean", "median", "std", "s68", "bias", "outlier_share", "clipped_share")
BOUNDS = ("crb_conditional", "crb_stochastic", "crb_speckle")


def montecarlo(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["montecarlo", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def z(result: dict[str, Any], name: str, expected: float) -> float:
    return (result[name] - expected) / result[f"{name}_se"]


@pytest.fixture(scope="module")
def beam_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixteen jinc beams as if they had been measured."""
    offsets = np.linspace(-12, 12, 961)
    table = sample_pattern(pattern_named("jinc"), offsets, np.zeros(1), 1.0)
    path = tmp_path_factory.mktemp("beams") / "beams.csv"
    write_beam_tables(path, [table] * 16, 1.0)
    return path


@pytest.mark.parametrize("kind", ["pair", "array"])
def test_json_has_all_statistics_with_standard_errors(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    result = montecarlo(capsys, kind, "--trials", "500", "--theta", "0.2")
    for name in STATISTICS:
        assert np.isfinite(result[name])
        assert result[f"{name}_se"] > 0
    assert all(result[name] > 0 for name in BOUNDS)
    truth = result["kappa"] if kind == "pair" else 0.2
    assert result["bias"] == pytest.approx(result["mean"] - truth, abs=1e-12)
    assert {"cnr_detector", "domain"} <= set(result)


def test_ratio_has_the_law_of_theory(capsys: pytest.CaptureFixture[str]) -> None:
    result = montecarlo(capsys, "pair", "--theta", "0.4", "--cnr-db", "3", "--look-count", "3", "--trials", "40000")
    t = 0.4
    kappa = (4 * t - np.tan(np.pi * t)) / (1 - 4 * t * np.tan(np.pi * t))
    assert result["kappa"] == pytest.approx(kappa, abs=1e-12)
    assert result["cnr_sum"] == pytest.approx(10**0.3)
    lower, upper = np.sinc(t + 0.25), np.sinc(t - 0.25)
    assert result["cnr_detector"] == pytest.approx(10**0.3 * 2 / (lower + upper) ** 2)
    for name in ("mean", "median", "std", "s68"):
        assert abs(z(result, name, result["closed_form"][name])) < 3.5
    assert result["closed_form"]["mean"] == pytest.approx(kappa * 10**0.3 / (10**0.3 + 1))
    share = student.sf(1, 6, result["closed_form"]["mean"], result["closed_form"]["std"] / np.sqrt(1.5))
    share += student.cdf(-1, 6, result["closed_form"]["mean"], result["closed_form"]["std"] / np.sqrt(1.5))
    assert abs(z(result, "clipped_share", share)) < 3.5


def test_ratio_of_a_steady_target_has_its_law(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("pair", "--theta", "0.3", "--cnr-db", "5", "--look-count", "1", "--target", "steady", "--trials", "40000")
    result = montecarlo(capsys, *words)
    law = SteadyLaw(result["kappa"], 10**0.5)
    assert abs(z(result, "mean", result["closed_form"]["mean"])) < 3.5
    assert abs(z(result, "median", law.ppf(0.5))) < 3.5
    assert abs(z(result, "s68", s68_of(law))) < 3.5
    assert result["closed_form"]["mean"] == pytest.approx(result["kappa"] * -np.expm1(-(10**0.5)))
    assert result["crb_speckle"] is None


def test_bounds_of_a_pair_are_those_of_its_discriminant(capsys: pytest.CaptureFixture[str]) -> None:
    """sqrt((1 + kappa^2) / (2 K C) (1 + 1 / (C (1 + kappa^2)))), and with K - 1 for speckle."""
    result = montecarlo(capsys, "pair", "--theta", "0.25", "--cnr-db", "7", "--look-count", "5", "--trials", "10")
    total, cnr = 1 + result["kappa"] ** 2, 10**0.7
    assert result["crb_conditional"] == pytest.approx(np.sqrt(total / (2 * 5 * cnr)), rel=1e-9)
    assert result["crb_stochastic"] == pytest.approx(np.sqrt(total / (2 * 5 * cnr) * (1 + 1 / (cnr * total))), rel=1e-9)
    assert result["crb_speckle"] == pytest.approx(np.sqrt(total / (2 * 4 * cnr)), rel=1e-9)


@pytest.mark.parametrize("estimator", ["tls", "ml", "noise_subtraction"])
def test_estimators_without_the_bias_of_the_ratio(estimator: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The median of ratio is 9 % low there, some 30 standard errors; theirs within 3.5 and 0.5 % of second order."""
    words = ("pair", "--theta", "0.25", "--cnr-db", "10", "--look-count", "16", "--trials", "20000")
    result = montecarlo(capsys, *words, "--estimator", estimator)
    slack = 3.5 * result["median_se"] + 0.005 * result["kappa"]
    assert result["median"] == pytest.approx(result["kappa"], abs=slack)
    biased = montecarlo(capsys, *words)
    assert abs(biased["median"] - biased["kappa"]) > 2 * slack
    assert result["closed_form"] is None


def test_maximum_likelihood_of_a_pair_is_total_least_squares_within_its_search(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ("pair", "--theta", "0.1", "--cnr-db", "20", "--look-count", "8", "--trials", "2000")
    ml = montecarlo(capsys, *words, "--estimator", "ml", "--search-half-width", "0.7")
    tls = montecarlo(capsys, *words, "--estimator", "tls")
    assert ml["domain"] == pytest.approx([-0.7, 0.7])
    assert tls["domain"] is None
    assert (ml["clipped_share"], tls["clipped_share"]) == (0, 0)
    for name in ("mean", "median", "std", "s68"):
        difference = np.hypot(ml[f"{name}_se"], tls[f"{name}_se"])
        assert ml[name] == pytest.approx(tls[name], abs=3.5 * difference)


def test_estimates_that_do_not_exist_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    """Without looks to speak of, noise often exceeds Sigma's power: P(Gamma_1 < 1 / (C + 1)) have no estimate."""
    words = ("pair", "--theta", "0", "--cnr-db", "-3", "--look-count", "1", "--estimator", "noise_subtraction")
    result = montecarlo(capsys, *words, "--trials", "20000")
    nothing = -np.expm1(-1 / (10**-0.3 + 1))
    assert result["clipped_share"] > nothing - 3.5 * np.sqrt(nothing / 20_000)
    assert np.isfinite(result["median"])


def test_array_at_high_cnr_is_as_exact_as_its_bound(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("array", "--theta", "1.75", "--cnr-db", "20", "--look-count", "16", "--trials", "20000")
    result = montecarlo(capsys, *words)
    assert abs(z(result, "mean", 1.75)) < 3.5
    assert abs(z(result, "std", result["crb_stochastic"] * np.sqrt(16 / 15))) < 3.5
    assert abs(z(result, "s68", result["crb_stochastic"] * student.ppf(NORMAL_SHARES[1], 32))) < 3.5
    assert (result["outlier_share"], result["clipped_share"]) == (0, 0)
    assert result["domain"] == [-4, 4]
    assert result["crb_stochastic"] == pytest.approx(result["crb_conditional"] * np.sqrt(1 + 1 / 200), rel=1e-3)
    assert result["crb_speckle"] == pytest.approx(result["crb_conditional"] * np.sqrt(16 / 15))


@pytest.mark.parametrize("estimator", ["ratio", "tls"])
def test_strongest_pair_of_an_array_has_the_bias_of_a_pair(estimator: str, capsys: pytest.CaptureFixture[str]) -> None:
    """At 15 dB with 16 looks the strongest pair is the one around the target, but for less than 1 in 1000."""
    words = ("array", "--theta", "0.125", "--cnr-db", "15", "--look-count", "16", "--trials", "20000")
    result = montecarlo(capsys, *words, "--estimator", estimator)
    t = 0.125
    kappa = (4 * t - np.tan(np.pi * t)) / (1 - 4 * t * np.tan(np.pi * t))
    cnr_sum = 10**1.5 * (np.sinc(t + 0.25) + np.sinc(t - 0.25)) ** 2 / 2
    slope = (kappa - 0.222031) / (t - 0.25)  # of the chord to a quarter beamwidth, within 2 % of the tangent
    expected = t - kappa / (cnr_sum + 1) / slope if estimator == "ratio" else t
    assert abs(z(result, "median", expected)) < 3.5
    assert result["domain"] is None
    assert result["clipped_share"] == 0


def test_the_numerator_alone_is_drawn_inwards_at_the_end_of_the_array(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("array", "--theta", "3.75", "--cnr-db", "40", "--look-count", "16", "--trials", "500")
    assert montecarlo(capsys, *words, "--objective", "numerator")["bias"] == pytest.approx(-0.166, abs=1e-3)
    assert abs(montecarlo(capsys, *words)["bias"]) < 1e-3


def test_noise_alone_is_spread_over_the_search(capsys: pytest.CaptureFixture[str]) -> None:
    """What stops at an end of the search is counted and stays in; a wider search makes the std greater."""
    words = ("array", "--cnr-db", "-30", "--look-count", "1", "--trials", "2000")
    narrow, wide = (montecarlo(capsys, *words, "--search-half-width", half) for half in ("2", "6"))
    assert narrow["domain"] == [-2, 2]
    assert wide["domain"] == [-6, 6]
    assert narrow["clipped_share"] > 0.05
    assert wide["std"] > 1.5 * narrow["std"]
    assert narrow["outlier_share"] > 0.3


def test_cnr_is_that_of_a_detector_of_the_size_given(capsys: pytest.CaptureFixture[str]) -> None:
    """At high CNR what counts is A^2 D: the size that dims a detector straight ahead must not dim it twice."""
    words = ("pair", "--pattern", "jinc", "--pitch", "0.6", "--size", "0.6x1.2", "--trials", "4000")
    result = montecarlo(capsys, *words)
    pattern = detector_pattern("jinc", (0.6, 1.2))
    gain = 2 * float(pattern.amplitude(0.3, 0.0)) ** 2 / float(pattern.amplitude(0.0, 0.0)) ** 2
    assert result["cnr_sum"] / result["cnr_detector"] == pytest.approx(gain, rel=1e-9)
    for name in ("median", "s68"):
        assert abs(z(result, name, result["closed_form"][name])) < 3.5


def test_measured_beams_are_as_good_as_the_formula(beam_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same draws: a spline through every fortieth of a beamwidth moves an estimate by 1e-4 at most."""
    words = ("array", "--theta", "0.4", "--cnr-db", "15", "--look-count", "4", "--trials", "1000")
    measured = montecarlo(capsys, *words, "--pattern", str(beam_file))
    formula = montecarlo(capsys, *words, "--pattern", "jinc")
    for name in ("mean", "median", "s68", *BOUNDS):
        assert measured[name] == pytest.approx(formula[name], abs=1e-4)


def test_beams_may_have_phases_of_their_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Sixteen detectors, each turned by its own phase that is known: nothing is lost of what the moduli tell."""
    offsets = np.linspace(-12, 12, 961)
    amplitude = pattern_named("jinc").amplitude(offsets, 0.0)
    phases = np.random.default_rng(72).uniform(0, 2 * np.pi, 16)
    turned = [amplitude * np.exp(1j * phase) for phase in phases]
    tables = [BeamTable(tuple(offsets), (0.0,), tuple(t.real), tuple(t.imag)) for t in turned]
    write_beam_tables(tmp_path / "beams.csv", tables, 1.0)
    words = ("array", "--theta", "0.4", "--cnr-db", "20", "--look-count", "16")
    result = montecarlo(capsys, *words, "--pattern", str(tmp_path / "beams.csv"), "--trials", "4000")
    straight = montecarlo(capsys, *words, "--pattern", "jinc", "--trials", "1")
    assert result["crb_stochastic"] == pytest.approx(straight["crb_stochastic"], rel=1e-4)
    assert abs(z(result, "mean", 0.4)) < 3.5
    assert abs(z(result, "std", result["crb_stochastic"] * np.sqrt(16 / 15))) < 3.5


def test_one_measured_beam_is_that_of_all_detectors(
    tmp_path: Path, beam_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = sample_pattern(pattern_named("jinc"), np.linspace(-12, 12, 961), np.zeros(1), 1.0)
    write_beam_tables(tmp_path / "one.csv", [table], 1.0)
    words = ("array", "--theta", "0.3", "--trials", "200", "--pattern")
    assert montecarlo(capsys, *words, str(tmp_path / "one.csv")) == montecarlo(capsys, *words, str(beam_file))


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["montecarlo", "array", "--pattern", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"sal-height: {tmp_path} cannot be read: Is a directory.\n"


def test_the_same_seed_gives_the_same_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("pair", "--trials", "20000", "--look-count", "2")
    first, again, other = (montecarlo(capsys, *words, "--seed", seed) for seed in ("4", "4", "5"))
    assert first == again
    assert first["mean"] != other["mean"]


def test_table_shows_what_json_has(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("pair", "--trials", "500", "--theta", "0.2")
    result = montecarlo(capsys, *words)
    assert main(["montecarlo", *words]) == 0
    lines = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()[1:]}
    for name in ("mean", "median", "std", "s68"):
        shown = [f"{number:.6g}" for number in (result[name], result[f"{name}_se"], result["closed_form"][name])]
        assert lines[name] == shown
    assert lines["outlier_share"][0] == f"{result['outlier_share']:.6g}"
    assert main(["montecarlo", "array", "--trials", "50"]) == 0
    assert "domain                -4 to 4\n" in capsys.readouterr().out


@pytest.mark.parametrize("trials", ["1", "2"])
@pytest.mark.parametrize("kind", ["pair", "array"])
def test_hardly_any_trials_still_have_statistics(kind: str, trials: str, capsys: pytest.CaptureFixture[str]) -> None:
    result = montecarlo(capsys, kind, "--trials", trials)
    assert np.isfinite(result["mean"])
    assert result["std"] == 0 or trials == "2"


REFUSED_BY_BOTH = [
    (["--pitch", "0"], ["pitch is 0"]),
    (["--pitch", "-0.5"], ["pitch is -0.5"]),
    (["--pitch", "nan"], ["pitch is nan"]),
    (["--look-count", "0"], ["looks is 0", "1"]),
    (["--trials", "0"], ["trials is 0", "1"]),
    (["--cnr-db", "nan"], ["CNR is nan"]),
    (["--cnr-db", "inf"], ["CNR is inf"]),
    (["--cnr-db", "500"], ["CNR is 500", "100 dB"]),
    (["--theta", "nan"], ["elevation is nan"]),
    (["--theta", "4.5"], ["4.5 beamwidths"]),
    (["--pattern", "airy"], ["'airy'", "gaussian, jinc, sinc", "CSV"]),
    (["--search-half-width", "0"], ["half width of the search is 0"]),
    (["--search-half-width", "inf"], ["half width of the search is inf"]),
]
"""Words that pairs and arrays refuse, and parts of the message."""


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        *((["array", *words], parts) for words, parts in REFUSED_BY_BOTH),
        *((["pair", "--estimator", "ml", *words], parts) for words, parts in REFUSED_BY_BOTH),
        (["array", "--detectors", "1"], ["detectors is 1", "2"]),
        (["array", "--detectors", "0"], ["detectors is 0", "2"]),
        (["array", "--detectors", "1000"], ["128"]),
        (["array", "--theta", "1.2", "--search-half-width", "1"], ["1.2 beamwidths", "-1 to 1"]),
        (["pair", "--detectors", "3"], ["3 detectors", "2"]),
        (["pair", "--detectors", "1"], ["detectors is 1", "2"]),
        (["pair", "--theta", "0.8"], ["0.8 beamwidths", "0.75"]),
        (["array", "--pattern", "{file}", "--detectors", "8"], ["16 detectors", "8"]),
        (["pair", "--pattern", "{file}"], ["16 detectors", "2"]),
        (["array", "--pattern", "{file}", "--size", "0.5x0.5"], ["size"]),
        (["array", "--pattern", "{file}", "--pitch", "3"], ["overlap"]),
    ],
)
def test_what_cannot_be_used_is_named_in_one_sentence(
    words: list[str], parts: list[str], beam_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["montecarlo", *(word.format(file=beam_file) for word in words)]) == 2
    printed = capsys.readouterr()
    assert not printed.out
    assert_one_sentence(printed.err.strip().removeprefix("sal-height: "), *parts)


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--target", "moving"], 'Choose from: "gaussian", "steady"'),
        (["--size", "0.6x1e"], "not of the form ExA"),
        (["--size", "infx1"], "not of the form ExA"),
        (["--objective", "best"], 'Choose from: "normalised", "numerator"'),
    ],
)
def test_values_of_another_form_are_refused(words: list[str], part: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["montecarlo", "array", *words]) == 2
    assert part in capsys.readouterr().err


@pytest.mark.parametrize("estimator", ["capon", "music"])
def test_any_estimator_of_the_registry_can_be_tried(estimator: str) -> None:
    """With 64 looks its standard deviation is that of maximum likelihood, within 10 %, and not that of a pair."""
    experiment = Experiment(array_with("sinc", 0.5, 8, (0.0, 0.0)), 0.1, 10.0, 64, "gaussian", 2000, 1)
    spread = {
        name: array_statistics(experiment, name, "normalised", None)["s68"] for name in (estimator, "ml", "monopulse")
    }
    assert spread[estimator] == pytest.approx(spread["ml"], rel=0.1)  # standard error of each 2.5 %
    assert spread["monopulse"] > 1.2 * spread["ml"]


def test_the_pairs_of_the_registry_are_those_of_total_least_squares() -> None:
    experiment = Experiment(array_with("sinc", 0.5, 8, (0.0, 0.0)), 0.1, 10.0, 4, "gaussian", 500, 1)
    by_name = [array_statistics(experiment, name, "normalised", None) for name in ("monopulse", "tls")]
    assert by_name[0] == by_name[1]


def test_an_estimator_that_does_not_exist_is_refused() -> None:
    experiment = Experiment(array_with("sinc", 0.5, 8, (0.0, 0.0)), 0.1, 10.0, 4, "gaussian", 10, 1)
    with refused(UserError, "capn", "monopulse, ml, capon, music"):
        array_statistics(experiment, "capn", "normalised", None)
