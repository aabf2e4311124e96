"""The paper's figures: what is written, that theory holds at every point, and that a wrong theory does not."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blank_pictures import blank_pictures
from helpers import assert_one_sentence, few, refused
from matplotlib.image import imread

from sal_height.commands import main
from sal_height.errors import UserError
from sal_height.figures import array_elevation, noise, patterns
from sal_height.figures.curve import Curve, check_of, exact_curve, holds, rows_of
from sal_height.figures.paper_figures import COLUMNS, FIGURES, LEAST_TRIALS, make_figures, summary

TRIALS, SEED = 2000, 1

Superposed = dict[str, dict[str, np.ndarray]]

FIELDS = {"figure", "curve", "x", "closed_form", "value", "standard_error", "z"}


def checks_of(curves: Iterator[Curve]) -> list[dict[str, Any]]:
    return [check for curve in curves for row in rows_of("figure", curve) if (check := check_of(row)) is not None]


@pytest.fixture(scope="module", params=few(1, [blank_pictures, nullcontext]), ids=["white", "drawn"])
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All figures, of few trials; in `make test` with white pictures."""
    out = tmp_path_factory.mktemp("figures") / "out"
    with request.param():
        assert main(["figures", "all", "--out", str(out), "--trials", str(TRIALS), "--seed", str(SEED)]) == 0
    return out


@pytest.fixture(scope="module")
def checks(folder: Path) -> list[dict[str, Any]]:
    return json.loads((folder / "checks.json").read_text())


def test_every_figure_is_a_table_and_a_picture(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == {
        "checks.json",
        *(f"{name}.{kind}" for name in FIGURES for kind in ("csv", "png")),
    }
    for name in FIGURES:
        assert imread(folder / f"{name}.png").shape[0] > 300


@pytest.mark.parametrize("name", FIGURES)
def test_table_has_all_curves_and_those_alone(name: str, folder: Path, checks: list[dict[str, Any]]) -> None:
    with (folder / f"{name}.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == COLUMNS
    assert len({row["curve"] for row in rows}) == FIGURES[name].curve_count
    assert {row["figure"] for row in rows} == {name}
    quantities = {row["curve"].split(", ")[0] for row in rows}
    assert all(drawn.split(", ")[0] in quantities for drawn in FIGURES[name].axes)
    checked = [(c["curve"], c["x"], c["closed_form"]) for c in checks if c["figure"] == name]
    expected = [(r["curve"], float(r["x"]), float(r["closed_form"])) for r in rows if r["closed_form"]]
    assert checked == expected


def test_every_check_has_its_fields_and_z_is_null_without_random_numbers(checks: list[dict[str, Any]]) -> None:
    assert all(set(check) == FIELDS for check in checks)
    assert {check["figure"] for check in checks} == set(FIGURES)
    deterministic = {"fig3", "fig4", "fig8", "fig9", "relief_discriminator", "relief_geometry"}
    for check in checks:
        assert (check["z"] is None) == (check["figure"] in deterministic)
        if check["z"] is None:
            assert check["standard_error"] == 0.0
        else:
            assert check["z"] == pytest.approx((check["value"] - check["closed_form"]) / check["standard_error"])


@pytest.mark.parametrize("name", FIGURES)
def test_theory_holds_at_every_point(name: str, checks: list[dict[str, Any]]) -> None:
    """Deterministic ones within 1e-9, Monte Carlo within 3 standard errors; that seed was not chosen for it."""
    mine = [check for check in checks if check["figure"] == name]
    assert mine
    assert [check for check in mine if not holds(check)] == []


@pytest.fixture(scope="module")
def superposed(folder: Path) -> Superposed:
    """Columns of the table of psf_superposition, on four tapes of each kind, by curve."""
    with (folder / "psf_superposition.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    return {
        curve: {
            column: np.array([float(row[column] or "nan") for row in rows if row["curve"] == curve])
            for column in ("value", "closed_form")
        }
        for curve in {row["curve"] for row in rows}
    }


def test_a_linear_system_shows_what_the_paper_takes_for_a_sign_of_another(superposed: Superposed) -> None:
    """A sawtooth shallower by a quarter or more and a pedestal in speckle, without any noise; the more so with it."""
    depth, pedestal = (
        [superposed[f"depth and pedestal, {name}, {whose}"]["closed_form"] for whose in ("targets", "speckle")]
        for name in ("depth", "pedestal")
    )
    assert np.all(depth[1] < 0.8 * depth[0])
    assert depth[1][-1] < 0.95 * depth[1][0]
    assert pedestal[1][0] == pytest.approx(0.041, abs=0.003)
    assert pedestal[1][-1] > 0.2


def test_a_limiter_is_noticed_where_it_is_low(superposed: Superposed) -> None:
    share = superposed["share of limited tapes, p-value below 0.05"]["value"]
    assert share[0] == 1.0
    assert share[-1] <= 0.5


def test_the_same_seed_makes_the_same_figures() -> None:
    for name in ("fig6", "fig11"):
        first, second, other = (
            [curve.value for curve in FIGURES[name].curves(LEAST_TRIALS, seed)] for seed in (5, 5, 6)
        )
        np.testing.assert_array_equal(np.concatenate(first), np.concatenate(second))
        assert not np.array_equal(np.concatenate(first), np.concatenate(other))


def test_trials_of_all_blocks_are_independent() -> None:
    """20 000 are three blocks; equal ones would repeat each other's numbers."""
    sample = noise.discriminants(np.random.SeedSequence(3), noise.steady, 1.0, 1, 2 * noise.BLOCK + 5)
    assert sample.shape == (len(noise.KAPPAS), 2 * noise.BLOCK + 5)
    assert len(np.unique(sample[0])) == sample.shape[1]


@pytest.mark.parametrize(
    ("figure", "module", "theory", "wrong"),
    [
        (noise.fig5, noise, "steady_mean", lambda kappa, cnr: kappa * cnr / (cnr + 1)),
        (noise.fig6, noise, "gaussian_mean", lambda kappa, cnr: kappa * -np.expm1(-cnr)),
        (noise.fig6, noise, "FLUCTUATING_LOOKS", 3),
        (array_elevation.fig11, array_elevation, "limit", lambda *_arguments: 1.76),
    ],
)
def test_a_wrong_closed_form_is_noticed(
    figure: Callable[[int, int], Iterator[Curve]],
    module: Any,
    theory: str,
    wrong: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The other target's mean; an elevation off by 0.01; a law of four looks for three."""
    if theory == "FLUCTUATING_LOOKS":
        right = noise.gaussian_law
        monkeypatch.setattr(module, "gaussian_law", lambda kappa, cnr, _looks: right(kappa, cnr, wrong))
    else:
        monkeypatch.setattr(module, theory, wrong)
    failed = [check for check in checks_of(figure(20_000, SEED)) if not holds(check)]
    assert failed
    assert f"{len(failed)} off" in summary(failed)


def test_a_wrong_inversion_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """By 2e-9 beamwidths; and where it finds nothing at all."""
    right = patterns.invert

    def spoilt(error: float) -> Callable[..., Any]:
        def wrong(*arguments: Any) -> Any:
            found = right(*arguments)
            return replace(found, elevation=found.elevation + error)

        return wrong

    for error in (2e-9, np.nan):
        monkeypatch.setattr(patterns, "invert", spoilt(error))
        assert not any(holds(check) for check in checks_of(patterns.fig8()))


def test_what_should_exist_and_does_not_is_null_and_off() -> None:
    curve = exact_curve("a", "b", np.zeros(1), np.full(1, np.nan), np.ones(1))
    (check,) = checks_of(iter([curve]))
    assert check["value"] is None
    assert check["z"] is None
    assert not holds(check)
    assert summary([check]) == "1 point checked, 1 off"


def test_a_point_without_theory_is_no_check() -> None:
    assert checks_of(iter([exact_curve("a", "b", np.zeros(1), np.ones(1), np.full(1, np.nan))])) == []


@pytest.mark.parametrize(("z", "kept"), [(2.99, True), (3.01, False), (-3.01, False)])
def test_three_standard_errors_are_allowed(z: float, kept: bool) -> None:
    curve = Curve("a", "b", np.zeros(1), np.array([1 + 0.1 * z]), np.array([0.1]), np.ones(1))
    assert [holds(check) for check in checks_of(iter([curve]))] == [kept]


def test_numerator_is_drawn_inwards_beyond_the_array_and_normalised_is_not() -> None:
    """Infinite CNR, edge of the array at 3.75: -0.166 beamwidths for a square aperture, whatever the looks."""
    beams = array_elevation.example_array()
    assert array_elevation.limit(beams, "numerator", 3.75, 1e12) - 3.75 == pytest.approx(-0.166, abs=5e-4)
    assert array_elevation.limit(beams, "normalised", 3.75, 1e12) == pytest.approx(3.75, abs=1e-6)
    trial = array_elevation.estimates(3.75, 1e6, 16, "numerator", 200, 1)
    assert np.mean(trial) == pytest.approx(array_elevation.limit(beams, "numerator", 3.75, 1e6), abs=2e-4)


def test_spread_of_normalised_estimates_is_the_bound_averaged_over_speckle() -> None:
    from sal_height.elevation.array.bounds import stochastic_crb

    beams = array_elevation.example_array()
    for elevation in (0.0, 1.1, 3.5):
        bound = float(stochastic_crb(beams, elevation, 0.0, 50.0, 8)) * np.sqrt(8 / 7)
        assert array_elevation.limit_std(beams, "normalised", elevation, 50.0, 8) == pytest.approx(bound, rel=1e-5)


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["fig7"], ["fig7", "fig3", "fig11"]),
        (["fig5", "--trials", "0"], ["0 trials", "100"]),
        (["fig5", "--trials", "99999999999"], ["trials"]),
    ],
)
def test_what_cannot_be_used_is_named_in_one_sentence(
    words: list[str], parts: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["figures", *words, "--out", str(tmp_path / "out")]) == 2
    complaint = capsys.readouterr().err.splitlines()[-1]
    assert_one_sentence(complaint.removeprefix("sal-height: "), *parts)
    assert not (tmp_path / "out").exists()


def test_a_folder_with_something_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("x")
    with refused(UserError, "not empty"):
        make_figures(["fig3"], tmp_path, LEAST_TRIALS, 1)


def test_figures_are_made_once_and_in_their_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["figures", "fig8", "fig3", "fig8", "--out", str(tmp_path / "out")]) == 0
    checks = json.loads((tmp_path / "out" / "checks.json").read_text())
    assert list(dict.fromkeys(check["figure"] for check in checks)) == ["fig3", "fig8"]
    assert len(checks) == 9 * 81 + 6 * 37
    assert f"{len(checks)} points checked, 0 off" in capsys.readouterr().out
    for name in ("fig3", "fig8"):
        assert np.ptp(imread(tmp_path / "out" / f"{name}.png")) > 0.9, "it is drawn"
