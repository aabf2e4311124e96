"""Results of an adjustment, in numbers, warnings and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.adjustment import (
    Adjustment,
    AdjustmentSettings,
    ObservedDwell,
    References,
    corrected_mounting,
    describe_ground,
    stated_sigmas,
)
from sal_height.geometry import Mounting
from sal_height.numeric import root_mean_square
from sal_height.picture import page
from sal_height.tables import ABSENT, aligned

NAMES = (
    *(f"boresight {axis} (rad)" for axis in "xyz"),
    *(f"lever arm {axis} (m)" for axis in "xyz"),
    "odometry delay (s)",
    "pitch of beams",
)
"""Parameters common to all dwells, in their order."""


def summary_of(
    adjustment: Adjustment,
    dwells: Sequence[ObservedDwell],
    mounting: Mounting,
    settings: AdjustmentSettings,
    references: References,
) -> tuple[dict[str, Any], list[str]]:
    """Numbers of the report, and warnings on what is not determined."""
    common, covariance = adjustment.common
    sigmas = np.sqrt(covariance.diagonal())
    prior = stated_sigmas(settings)
    estimated = np.flatnonzero(prior)
    shifts, spread = adjustment.shifts
    between, of_all = adjustment.spread
    met = {number for one in adjustment.comparisons for side in one.dwells for number in side if number >= 0}
    absolute = sum(one.is_absolute for one in adjustment.comparisons)
    better = corrected_mounting(mounting, adjustment)
    summary = {
        "parameters": {
            NAMES[number]: {
                "error": float(common[number]),
                "sigma": float(sigmas[number]),
                "known_to": float(prior[number]),
                "determined": bool(sigmas[number] <= 0.9 * prior[number]),  # else the prior alone decides
            }
            for number in estimated
        },
        "parameter_covariance": covariance[np.ix_(estimated, estimated)].tolist(),
        "mounting": {"lever_arm_m": list(better.lever_arm), "rotation": list(better.rotation)},
        "comparisons": len(adjustment.comparisons) - absolute,
        "comparisons_with_known_ground": absolute,
        "comparisons_that_contradict": adjustment.contradictions,
        "dwells_without_comparison": len(dwells) - len(met),
        "shifts_rms_m": root_mean_square(shifts, axis=0).tolist(),
        "sigma_between_dwells_m": np.sqrt(np.mean(between, axis=0).diagonal()).tolist(),
        "sigma_of_all_dwells_m": np.sqrt(of_all.diagonal()).tolist(),
        "shifts_m": shifts.tolist(),
        "shift_sigmas_m": np.sqrt([one.diagonal() for one in spread]).tolist(),
    }
    return summary, _warnings(summary, references, adjustment)


def _warnings(summary: dict[str, Any], references: References, adjustment: Adjustment) -> list[str]:
    warnings = []
    if references.targets and not any(one.is_target for one in adjustment.comparisons):
        warnings.append(
            f"None of the {len(references.targets)} targets was seen where it should be, brighter than all around it; "
            "the result is without them."
        )
    if adjustment.refused_ground is not None:
        warnings.append(
            f"{describe_ground(adjustment.refused_ground)}, more than --terrain-sigma and what is known of the dwells "
            "allow; the result is without it."
        )
    elif references.terrain and not any(one.is_absolute and not one.is_target for one in adjustment.comparisons):
        warnings.append(
            "The elevation model has no heights where the dwells lie, or agrees with none; the result is without it."
        )
    if not summary["comparisons"]:
        warnings.append(
            "No two dwells were found to show the same ground: they were compared with known ground, but not with each "
            "other. Fly passes that overlap."
            if summary["comparisons_with_known_ground"]
            else "No two dwells were found to show the same ground: nothing could be compared, and the new bag has the "
            "odometry as it was. Fly passes that overlap, or give targets or an elevation model."
        )
    elif lonely := summary["dwells_without_comparison"]:
        warnings.append(
            f"{lonely} dwells overlap with no other, or show too little to be recognised, and lie where odometry and "
            "their neighbours put them."
        )
    if against := summary["comparisons_that_contradict"]:
        warnings.append(
            f"{against} of {len(adjustment.comparisons)} comparisons contradict the others: some dwells were taken for "
            "another place, and may be off by more than is stated; fly longer passes, or give targets or an elevation "
            "model."
        )
    loose = [name for name, one in summary["parameters"].items() if not one["determined"]]
    if loose:
        warnings.append(f"These dwells do not determine: {', '.join(loose)}; what was known beforehand stays.")
    if not summary["comparisons_with_known_ground"]:
        east, north, up = summary["sigma_of_all_dwells_m"]
        warnings.append(
            f"Without known ground all dwells together may lie off by {east:.2g} m east, {north:.2g} m north and "
            f"{up:.2g} m up (1 sigma)."
        )
    return warnings


def has_comparisons(summary: dict[str, Any]) -> bool:
    """True if dwells were compared with others or with known ground, so that odometry was corrected."""
    return bool(summary["comparisons"] or summary["comparisons_with_known_ground"])


def determines_nothing(summary: dict[str, Any]) -> bool:
    """True if all priors stay: no dwell was compared, nor did Doppler centroids determine a parameter."""
    return not has_comparisons(summary) and not any(one["determined"] for one in summary["parameters"].values())


def adjustment_table(summary: dict[str, Any]) -> str:
    """The parameters common to all dwells, and the offsets of their surfaces, as a table.

    Of parameters that are not determined there are no values.
    """
    lines = []
    if summary["parameters"]:
        heading = ["shared by all dwells", "known to", "found", "+-"]
        rows = [heading]
        for name, one in summary["parameters"].items():
            found = [f"{one['error']:+.3g}", f"{one['sigma']:.2g}"] if one["determined"] else [ABSENT, ABSENT]
            rows.append([name, f"{one['known_to']:.3g}", *found])
        lines += [aligned(rows), ""]
    heading = ["surfaces of dwells", "east m", "north m", "up m"]
    kinds = {
        "misalignment before, rms": "shifts_rms_m",
        "sigma between dwells": "sigma_between_dwells_m",
        "sigma of the common offset": "sigma_of_all_dwells_m",
    }
    rows = [[kind, *(f"{value:.3g}" for value in summary[name])] for kind, name in kinds.items()]
    lines += [aligned([heading, *rows]), ""]
    known = summary["comparisons_with_known_ground"]
    lines.append(f"{summary['comparisons']} comparisons of dwells with others, {known} with known ground")
    return "\n".join(lines)


def draw_adjustment(adjustment: Adjustment, path: Path) -> None:
    """Write a PNG: shifts of the dwells with their sigmas, and differences of comparisons before and after."""
    shifts, covariance = adjustment.shifts
    sigmas = np.sqrt([one.diagonal() for one in covariance])
    before, after = adjustment.differences
    with page(path, 4.4) as figure:
        for column, (axis, name) in enumerate(zip(figure.subplots(2, 3).T, ("east", "north", "up"), strict=True)):
            top, below = axis
            top.errorbar(np.arange(len(shifts)), shifts[:, column], sigmas[:, column], fmt=".", ms=3, lw=0.8)
            top.set(title=f"How far {name} dwells were misaligned", xlabel="dwell", ylabel="m")
            top.axhline(0.0, color="k", lw=0.5)
            for values, label in ((before, "before"), (after, "after")):
                if len(values):
                    size = np.sort(np.abs(values[:, column]))
                    below.step(
                        np.maximum(size, 1e-4), (np.arange(len(size)) + 1) / len(size), label=label, where="post"
                    )
            below.set(
                title=f"Differences {name} between dwells that overlap",
                xlabel="m",
                ylabel="fraction below",
                xscale="log",
            )
            if len(after):
                below.legend(loc="lower right")
