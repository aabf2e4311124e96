"""`sal-height figures`: figures of the papers as tables and pictures, with checks against theory."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sal_height.errors import UserError, did_you_mean
from sal_height.figures.array_elevation import WEIGHTS, fig10, fig11
from sal_height.figures.curve import Curve, Figure, check_of, holds, rows_of
from sal_height.figures.noise import CNR_DB, fig5, fig6
from sal_height.figures.patterns import fig3, fig4, fig8, fig9
from sal_height.figures.psf_point_targets import PSF_FIGURES
from sal_height.figures.relief_tracking import relief_tracking
from sal_height.figures.sum_difference_radar import RELIEF_FIGURES
from sal_height.io import new_folder, write_text, writing
from sal_height.picture import COLOURS, letter_panels, page
from sal_height.progress import Bar
from sal_height.tables import counted

COLUMNS = ("figure", "curve", "x", "value", "standard_error", "closed_form")

LEAST_TRIALS = 100
"""Least number of trials; with fewer, standard errors of quantiles mean nothing."""

_ELEVATION = "elevation (beamwidths)"

_PAIR_AXES = {
    "amplitude": (_ELEVATION, "amplitude of sum and difference"),
    "discriminant": (_ELEVATION, "discriminant"),
}

_NOISE_AXES = ("discriminant without noise", "of the estimated discriminant")

_TRUE = "true elevation (beamwidths)"

_LENGTH = "correlation length of the relief (m)"

FIGURES = {
    "fig3": Figure("Figure 3: point detectors half a beamwidth apart", _PAIR_AXES, 9, lambda _trials, _seed: fig3()),
    "fig4": Figure(
        "Figure 4: detectors 0.6 beamwidths apart, circular aperture", _PAIR_AXES, 6, lambda _trials, _seed: fig4()
    ),
    "fig5": Figure(
        "Figure 5: steady target, one look (CNR of the sum channel)",
        {
            "standard deviation": (_NOISE_AXES[0], "standard deviation of the sample"),
            "half 16-84 % width": (_NOISE_AXES[0], f"half 16-84 % width {_NOISE_AXES[1]}"),
            "mean": (_NOISE_AXES[0], f"mean {_NOISE_AXES[1]}"),
        },
        4 * len(CNR_DB),
        fig5,
    ),
    "fig6": Figure(
        "Figure 6: fluctuating target, four looks (CNR of the sum channel in one look)",
        {
            "standard deviation": (_NOISE_AXES[0], f"standard deviation {_NOISE_AXES[1]}"),
            "mean": (_NOISE_AXES[0], f"mean {_NOISE_AXES[1]}"),
        },
        2 * len(CNR_DB),
        fig6,
    ),
    "fig8": Figure(
        "Figure 8: spotlight, detector axis turned by psi",
        {"elevation": ("discriminant", _ELEVATION)},
        6,
        lambda _trials, _seed: fig8(),
    ),
    "fig9": Figure(
        "Figure 9: stripmap, detector axis turned by psi",
        {"elevation": ("discriminant", _ELEVATION)},
        6,
        lambda _trials, _seed: fig9(),
    ),
    "fig10": Figure(
        "Figure 10: maximum likelihood with 16 detectors half a beamwidth apart (CNR of one detector)",
        {
            f"{quantity}, {objective}": (_TRUE, f"{quantity} of the estimate (beamwidths)")
            for quantity in ("mean", "standard deviation")
            for objective in WEIGHTS
        },
        48,
        fig10,
    ),
    "fig11": Figure(
        "Figure 11: maximum likelihood, CNR 3, four looks, target at 1.75 beamwidths",
        {"density": ("estimated elevation (beamwidths)", "probability density")},
        4,
        fig11,
    ),
    **RELIEF_FIGURES,
    "relief_tracking": Figure(
        "Relief paper: heights tracked along range, a relief of 1 m measured to 1 m every 0.5 m",
        {
            "RMSE": (_LENGTH, "RMSE of heights (m)"),
            "gain": (_LENGTH, "gain over single cells (dB)"),
            "RMSE with noise that varies": (_LENGTH, "RMSE of heights (m)"),
            "RMSE over SNR": ("SNR of the sum channel in a cell (dB)", "RMSE of heights (m)"),
        },
        9,
        relief_tracking,
    ),
    **PSF_FIGURES,
}
"""Figures by name: those of the SAL paper by its numbers, then those on the relief paper and the PSF paper."""


def draw(figure: Figure, curves: Sequence[Curve], path: Path) -> None:
    """Write a PNG with a panel for each quantity; black dots are the closed forms, bars the standard errors."""
    with page(path, 0.4 + 2.6 * len(figure.axes)) as picture:
        panels = picture.subplots(len(figure.axes), 1, squeeze=False).ravel()
        for panel, (quantity, (horizontal, vertical)) in zip(panels, figure.axes.items(), strict=True):
            own = [curve for curve in curves if curve.quantity == quantity]
            for curve in own:
                _draw_curve(panel, curve)
            if any(np.isfinite(curve.closed_form).any() for curve in own):
                panel.plot([], [], "k.", label="closed form")
            panel.set(title=quantity, xlabel=horizontal, ylabel=vertical)
            panel.grid()
            panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        if len(panels) > 1:
            letter_panels(panels)
        picture.suptitle(figure.title)


def _draw_curve(panel: Axes, curve: Curve) -> None:
    steps = curve.style.startswith("steps")
    panel.errorbar(
        curve.x,
        curve.value,
        yerr=curve.standard_error if np.any(curve.standard_error) else None,
        linestyle="-" if steps else curve.style,
        drawstyle=curve.style if steps else "default",
        color=COLOURS[curve.colour % len(COLOURS)],
        label=curve.case,
        elinewidth=0.6,
    )
    panel.plot(curve.x, curve.closed_form, "k.", markersize=2.0)


def make_figures(names: Sequence[str], out: Path, trials: int, seed: int) -> list[dict[str, Any]]:
    """Make figures, leaving NAME.csv and NAME.png of each and checks.json in `out`.

    The table has a row for each point of each curve: COLUMNS, with closed_form empty where theory has none. checks.json
    is a list of the points that have a closed form, see `curve.check_of`: z is null for values from no random numbers.

    Args:
        names: names in FIGURES; each once, in any order.
        out: output folder; must be new or empty.
        trials: number of Monte Carlo trials at each point.
        seed: seed of all random numbers.

    Returns:
        The entries of checks.json.

    Raises:
        UserError: an unknown name, too few or too many trials, or a file cannot be written.
    """
    for name in names:
        if name not in FIGURES:
            raise UserError(
                f"There is no figure {name!r}{did_you_mean(name, FIGURES)}; allowed are {', '.join(FIGURES)} and all."
            )
    most = 1_000_000  # all estimates of a curve are kept in memory at a time
    if not LEAST_TRIALS <= trials <= most:
        raise UserError(f"Figures take {trials} trials; allowed are {LEAST_TRIALS} to {most}.")
    folder = new_folder(out)
    chosen = {name: figure for name, figure in FIGURES.items() if name in names}
    checks: list[dict[str, Any]] = []
    with Bar(total=sum(figure.curve_count for figure in chosen.values()), unit="curve", desc="figures") as progress:
        for name, figure in chosen.items():
            progress.set_description(name)
            curves = []
            for curve in figure.curves(trials, seed):
                curves.append(curve)
                progress.update()
            checks += _write(name, figure, curves, folder)
    write_text(folder / "checks.json", json.dumps(checks, indent=1, allow_nan=False) + "\n")
    return checks


def summary(checks: Sequence[dict[str, Any]]) -> str:
    """Summarise the checks in one line."""
    existing = [check for check in checks if check["value"] is not None]
    exact = [abs(check["value"] - check["closed_form"]) for check in existing if check["z"] is None]
    z = [abs(check["z"]) for check in checks if check["z"] is not None]
    failed = sum(not holds(check) for check in checks)
    parts = [f"{counted(len(checks), 'point')} checked, {failed} off"]
    if exact:
        parts.append(f"greatest difference of {len(exact)} exact ones {max(exact):.1e}")
    if z:
        parts.append(f"greatest |z| of {len(z)} Monte Carlo ones {max(z):.2f}")
    return "; ".join(parts)


def _write(name: str, figure: Figure, curves: Sequence[Curve], folder: Path) -> list[dict[str, Any]]:
    """Write table and picture of a figure, and return its checks."""
    rows = [row for curve in curves for row in rows_of(name, curve)]
    checks = [check_of(row) for row in rows]
    with writing(folder / f"{name}.csv"), (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.DictWriter(stream, COLUMNS)
        table.writeheader()
        table.writerows(
            row | {"closed_form": "" if check is None else row["closed_form"]}
            for row, check in zip(rows, checks, strict=True)
        )
    with writing(folder / f"{name}.png"):
        draw(figure, curves, folder / f"{name}.png")
    return [check for check in checks if check is not None]
