"""Report and picture of heights from passes, and the comparison with points of known position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sal_height.elevation import Validity
from sal_height.numeric import F64, error_statistics
from sal_height.passes import PassHeights, PassSettings, ReferencePoint
from sal_height.picture import HEIGHTS, colour_bar, page
from sal_height.tables import ABSENT, aligned

FREE_GAUGE = (
    "No reference point ties the passes: heights count from the median of the bright points that tie them, which is "
    "put at ground_m; a common offset of all heights is not determined and not in their sigmas."
)
SEVERAL = (Validity.TWO_SCATTERERS, Validity.THREE_SCATTERERS)


@dataclass(frozen=True, eq=False)
class ReferenceComparison:
    """A reference point, and the point that was found there.

    Attributes:
        reference: the reference point.
        error: error of the position, m in map, shape (3,); None: no point was found.
        sigma: standard deviation of the height that was found, m.
        cnr_db: clutter-to-noise ratio of the point, dB.
    """

    reference: ReferencePoint
    error: F64 | None = None
    sigma: float = np.nan
    cnr_db: float = np.nan

    def summary(self) -> dict[str, Any]:
        """Entries of the report on the reference point."""
        east, north, up = self.reference.position.tolist()
        known = {"east_m": east, "north_m": north, "height_m": up, "ties": self.reference.ties}
        if self.error is None:
            return {**known, "found": False}
        return {
            **known,
            "found": True,
            "error_east_m": float(self.error[0]),
            "error_north_m": float(self.error[1]),
            "error_height_m": float(self.error[2]),
            "sigma_m": self.sigma,
            "cnr_db": self.cnr_db,
        }


def compared(reference: ReferencePoint, result: PassHeights, settings: PassSettings) -> ReferenceComparison:
    """The point that is seen nearest to a reference point, within `reference_radius_m`, at any height."""
    points, array = result.found.points, result.array
    if not len(points.height):
        return ReferenceComparison(reference)
    slant_range, along, _ = array.seen(reference.position)
    ranges, ways, _ = array.seen(points.positions)
    off = np.hypot(ranges - slant_range, ways - along)
    best = int(np.argmin(off))
    if off[best] > settings.reference_radius_m:
        return ReferenceComparison(reference)
    return ReferenceComparison(
        reference,
        points.positions[best] - reference.position,
        float(points.total_sigma[best]),
        float(points.cnr_db[best]),
    )


def warnings_of(result: PassHeights, comparisons: Sequence[ReferenceComparison], settings: PassSettings) -> list[str]:
    """Warnings on data left out, and on the limits of the heights."""
    found = list(result.warnings)
    if not result.tie.references:
        found.append(FREE_GAUGE)
    for one in comparisons:
        if one.error is None:
            east, north, up = one.reference.position.tolist()
            found.append(
                f"No point with a height was found within {settings.reference_radius_m:g} m of where the reference "
                f"point at {east:g}, {north:g}, {up:g} m is visible."
            )
    ambiguity = result.ambiguity
    if ambiguity.sidelobe > 0.25:  # fraction of the power
        found.append(
            f"The passes see {ambiguity.sidelobe:.2g} of a point's power {ambiguity.at:.3g} m above and below it, too; "
            "heights of weak points may be wrong by that."
        )
    return found


def summary_of(
    result: PassHeights, comparisons: Sequence[ReferenceComparison], settings: PassSettings
) -> dict[str, Any]:
    """The numbers of the report."""
    array, tie, ambiguity, points = result.array, result.tie, result.ambiguity, result.found.points
    passes, deviation = len(array.passes), np.sqrt(np.diag(tie.covariance))
    return {
        "passes": [
            {
                "name": one.name,
                "elevation_over_horizon_rad": float(np.pi / 2 - array.elevations[n]),
                "pulses": len(one.antenna),
                "shift_range_m": float(result.shifts[n, 0]),
                "shift_along_m": float(result.shifts[n, 1]),
                "phase_rad": float(tie.phase[n]),
                "phase_sigma_rad": float(deviation[n]),
                "offset_along_m": float(tie.offset[n, 0]),
                "offset_across_m": float(tie.offset[n, 1]),
                "offset_sigma_m": deviation[passes + 2 * n : passes + 2 * n + 2].tolist(),
                "coherence": float(tie.coherence[n]),
            }
            for n, one in enumerate(array.passes)
        ],
        "tie": {
            "points": tie.points,
            "references": tie.references,
            "amplitude_error": tie.uncertainty,
            "common_offset": "reference points" if tie.references else "undetermined",
            "level": "reference points" if tie.references else f"median of the points at {settings.ground_m:g} m",
        },
        "ambiguity": {
            "resolution_m": ambiguity.resolution,
            "width_m": ambiguity.width,
            "greatest_sidelobe": ambiguity.sidelobe,
            "greatest_sidelobe_at_m": ambiguity.at,
            "first_above_half_m": ambiguity.first_false if np.isfinite(ambiguity.first_false) else None,
            "looked_at_m": ambiguity.reach,
        },
        "bright_pixels": result.found.peaks,
        "bright_pixels_by_reason": {Validity(n).name: count for n, count in result.found.reasons.items()},
        "references": [one.summary() for one in comparisons],
        "reference_height_errors": _height_errors(comparisons),
        "points": [
            {
                "east_m": float(points.positions[n, 0]),
                "north_m": float(points.positions[n, 1]),
                "height_m": float(points.height[n]),
                "sigma_m": float(points.sigma[n]),
                "common_sigma_m": float(points.common_sigma[n]),
                "cnr_db": float(points.cnr_db[n]),
            }
            for n in np.argsort(-points.power)
        ],
    }


def _height_errors(comparisons: Sequence[ReferenceComparison]) -> dict[str, Any]:
    """Entries of the report on the errors of height at the reference points with a point."""
    found = [(one.error[2], one.sigma) for one in comparisons if one.error is not None]
    heights = error_statistics(*np.array(found).reshape(-1, 2).T)
    mean, rms, about_mean = heights.in_metres(("bias_m", "rms_m", "deviation_m")).values()
    return {"count": heights.count, "mean_m": mean, "rms_m": rms, "rms_about_mean_m": about_mean}


def passes_table(summary: dict[str, Any]) -> str:
    """The report as a table for the terminal."""
    rows = [["pass", "elevation", "shift m", "offset m", "coherence"]]
    for one in summary["passes"]:
        shift = float(np.hypot(one["shift_range_m"], one["shift_along_m"]))
        offset = float(np.hypot(one["offset_along_m"], one["offset_across_m"]))
        degrees = np.degrees(one["elevation_over_horizon_rad"])
        rows.append([one["name"], f"{degrees:.3f}°", f"{shift:.3f}", f"{offset:.3f}", f"{one['coherence']:.3f}"])
    lines = [aligned(rows)]
    ambiguity, tie = summary["ambiguity"], summary["tie"]
    lines.append(
        f"tied by {tie['points']} points, {tie['references']} of them references; heights resolved to "
        f"{ambiguity['width_m']:.3g} m, greatest sidelobe {ambiguity['greatest_sidelobe']:.2g} at "
        f"{ambiguity['greatest_sidelobe_at_m']:.3g} m"
    )
    sigmas = [float(np.hypot(one["sigma_m"], one["common_sigma_m"])) for one in summary["points"]]
    middle = f", sigma {np.median(sigmas):.3g} m in the median" if sigmas else ""
    lines.append(f"{len(sigmas)} points with a height{middle}")
    reasons = summary["bright_pixels_by_reason"]
    if several := sum(reasons.get(kind.name, 0) for kind in SEVERAL):
        lines.append(
            f"{several} of {summary['bright_pixels']} bright pixels contain several points, which get no height"
        )
    rows = [["reference", "east", "north", "height", "error m", "+-"]]
    for one in summary["references"]:
        position = [f"{one[key]:.3f}" for key in ("east_m", "north_m", "height_m")]
        found = [f"{one[key]:.3f}" if one["found"] else ABSENT for key in ("error_height_m", "sigma_m")]
        kind = "tied" if one["ties"] else "compared"
        rows.append([kind if one["found"] else f"{kind}, not found", *position, *found])
    return "\n".join([*lines, aligned(rows)] if summary["references"] else lines)


def draw_passes(result: PassHeights, comparisons: Sequence[ReferenceComparison], path: Path) -> None:
    """Write a PNG: the map of the points on the left; on the right heights over range, and the array response."""
    with page(path, 5.6) as figure:
        panels = figure.subplot_mosaic([["plan", "profile"], ["plan", "response"]], width_ratios=[1.2, 1.0])
        _draw_plan(panels["plan"], result, comparisons)
        _draw_profile(panels["profile"], result, comparisons)
        _draw_response(panels["response"], result)


def _draw_plan(axis: Axes, result: PassHeights, comparisons: Sequence[ReferenceComparison]) -> None:
    points = result.found.points
    east, north, height = points.positions.T
    limits = np.percentile(height, [1, 99]) if len(height) else (0.0, 1.0)
    size = 4 + 20 * np.clip(np.log10(np.maximum(points.power, 1.0)) / 4, 0, 1)
    drawn = axis.scatter(east, north, c=height, s=size, cmap=HEIGHTS, vmin=limits[0], vmax=limits[1], linewidths=0)
    for one in comparisons:
        axis.plot(*one.reference.position[:2], marker="+", color="k", ms=9)
    colour_bar(drawn, axis, "height (m)", height, orientation="horizontal", aspect=40, pad=0.02)
    axis.set(aspect="equal", xlabel="east (m)", ylabel="north (m)", title=f"{len(height)} points, + reference points")


def _draw_profile(axis: Axes, result: PassHeights, comparisons: Sequence[ReferenceComparison]) -> None:
    points, array = result.found.points, result.array
    sight = array.axes[0] * np.array([1.0, 1.0, 0.0])
    sight /= np.linalg.norm(sight)
    away = (points.positions - array.centre) @ sight
    axis.errorbar(away, points.height, 2 * points.total_sigma, fmt=".", ms=3, lw=0.6)
    for one in comparisons:
        axis.plot((one.reference.position - array.centre) @ sight, one.reference.position[2], "k+", ms=9)
    axis.set(xlabel="ground range (m)", ylabel="height (m), 2 sigma")


def _draw_response(axis: Axes, result: PassHeights) -> None:
    ambiguity = result.ambiguity
    axis.plot(ambiguity.offsets, ambiguity.response, lw=1.0)
    axis.set(
        xlabel="error of height (m)",
        ylabel="fraction of power",
        ylim=(0, 1),
        title=f"{len(result.array.passes)} passes: greatest sidelobe {ambiguity.sidelobe:.2g}",
    )
