"""Report of heights from passes, and the comparison with points of known position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sal_height.elevation import Validity
from sal_height.numeric import F64, error_statistics
from sal_height.passes import PassHeights, PassSettings, ReferencePoint

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
    sidelobe_of_note = 0.25  # fraction of the power above which the greatest sidelobe is warned of
    if ambiguity.sidelobe > sidelobe_of_note:
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
    lines = [f"{'pass':<28}{'elevation':>10}{'shift m':>9}{'offset m':>9}{'coherence':>10}"]
    for one in summary["passes"]:
        shift = float(np.hypot(one["shift_range_m"], one["shift_along_m"]))
        offset = float(np.hypot(one["offset_along_m"], one["offset_across_m"]))
        degrees = np.degrees(one["elevation_over_horizon_rad"])
        lines.append(f"{one['name'][:27]:<28}{degrees:9.3f}°{shift:9.3f}{offset:9.3f}{one['coherence']:10.3f}")
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
    if summary["references"]:
        lines.append(f"{'reference east':>15}{'north':>10}{'height':>9}{'error m':>9}{'+-':>8}")
    for one in summary["references"]:
        position = f"{one['east_m']:15.3f}{one['north_m']:10.3f}{one['height_m']:9.3f}"
        found = f"{one['error_height_m']:9.3f}{one['sigma_m']:8.3f}" if one["found"] else f"{'not found':>17}"
        lines.append(position + found + (" tied" if one["ties"] else ""))
    return "\n".join(lines)
