"""`sal-height figures`: compute the papers' figures and check them against theory."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from sal_height.commands._options import (
    DONE,
    FAILED,
    THEORY,
    OutputFolder,
    Seed,
    Trials,
    command,
    output_folder,
)
from sal_height.figures import DEFAULT_TRIALS

EXAMPLES = """
  sal-height figures                            all, about two minutes
  sal-height figures fig5 fig6 --trials 200000 --seed 7 --out out/noise
"""

app = command("figures", THEORY, EXAMPLES, "a point differs from theory by more than is allowed")


@app.default
def figures(
    names: Annotated[tuple[str, ...], Parameter(name="NAME", show_default=False)] = (),
    /,
    *,
    trials: Trials = DEFAULT_TRIALS,
    seed: Seed = 1,
    out: OutputFolder = None,
) -> int:
    """Compute the papers' figures and check every point for which theory has a closed form.

    fig3 to fig6 and fig8 to fig11 are those of the SAL paper. relief_* are those
    of the relief paper: discriminator, geometry, noise, hybrids, orders of
    accumulation, and heights tracked along range, which the paper leaves to
    Bayesian filtering. psf_* are those of the PSF paper, on synthetic tapes:
    responses of targets and of speckle, superposition, the point-spread function
    with its echoes, and errors.

    The output folder holds, for each figure,
      NAME.csv     figure, curve, x, value, standard_error (0: no random numbers),
                   closed_form (empty: none known)
      NAME.png     the same axes and families of curves as in the paper; black
                   dots are the closed forms
    and checks.json with every point that has a closed form: figure, curve, x,
    closed_form, value, standard_error, and z, the difference in standard errors.
    Without random numbers z is null, and a difference of 1e-9 is allowed.

    Figures 3, 4, 8 and 9 are checked against quadrature, 5 and 6 against closed
    forms, 10 and 11 against the asymptotic theory of high CNR and many looks
    where it holds, relief_* against closed forms and linear algebra, and psf_*
    against closed forms and quadrature at every fifth frequency. For psf_*, one
    tape is made per 1000 trials, but at least 4 and at most 40. All points of a
    figure share their random numbers, except the frequencies of psf_*. No Monte
    Carlo point should differ by 3 standard errors or more; by chance alone, one
    does in about one seed of three.

    Args:
        names: Names of figures, or all. Default: all.
        out: Output folder, new or empty. Default: out/figures, or the next free of out/figures_2, ….
    """
    from sal_height.figures.curve import holds
    from sal_height.figures.paper_figures import FIGURES, make_figures, summary

    chosen = [name for name in names if name != "all"]
    everything = not names or "all" in names
    folder = output_folder(out, "figures")
    checks = make_figures([*chosen, *(FIGURES if everything else ())], folder, trials, seed)
    print(f"{summary(checks)}; see {folder}/checks.json")
    return DONE if all(holds(check) for check in checks) else FAILED
