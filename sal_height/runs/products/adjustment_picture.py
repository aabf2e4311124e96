"""Picture of an adjustment: misalignment of each dwell, and agreement of comparisons before and after."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from sal_height.adjustment import Adjustment

mpl.use("Agg")

AXES = ("east", "north", "up")


def draw_adjustment(adjustment: Adjustment, path: Path) -> None:
    """Write a PNG: shifts of the dwells with their sigmas, and differences of comparisons before and after."""
    shifts, covariance = adjustment.shifts
    sigmas = np.sqrt([one.diagonal() for one in covariance])
    before, after = adjustment.differences
    figure = Figure(figsize=(13, 8), layout="constrained")
    for column, (axis, name) in enumerate(zip(figure.subplots(2, 3).T, AXES, strict=True)):
        top, below = axis
        top.errorbar(np.arange(len(shifts)), shifts[:, column], sigmas[:, column], fmt=".", ms=3, lw=0.8)
        top.set(title=f"How far {name} dwells were misaligned", xlabel="dwell", ylabel="m")
        top.axhline(0.0, color="k", lw=0.5)
        for values, label in ((before, "before"), (after, "after")):
            if len(values):
                size = np.sort(np.abs(values[:, column]))
                below.step(np.maximum(size, 1e-4), (np.arange(len(size)) + 1) / len(size), label=label, where="post")
        below.set(
            title=f"Differences {name} between dwells that overlap", xlabel="m", ylabel="share below", xscale="log"
        )
        if len(after):
            below.legend(loc="lower right")
    figure.savefig(path, dpi=110)
