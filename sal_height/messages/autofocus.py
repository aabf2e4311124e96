"""Where autofocus has put an image and what it leaves, in the provenance of what is made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from sal_height.errors import Rejected
from sal_height.imaging import Centroid, Placement, Slc

PLACEMENT, RESIDUAL = "placement", "residual.phase_rad"
"""Names, or what they begin with, beside the parameters of sar_compression; the others are those of `Placement`."""


def autofocus_values(slc: Slc) -> dict[str, Any]:
    """What provenance says of autofocus beside the parameters of sar_compression; nothing if there was none."""
    placed = slc.placement.centroid or slc.placement.by_beams
    return {
        **({PLACEMENT: asdict(slc.placement)} if placed else {}),
        **({RESIDUAL: slc.residual_phase} if slc.residual_phase else {}),
    }


def placement_of(stage: Mapping[str, Any]) -> Placement:
    """The placement of an image by what its provenance says of sar_compression.

    Raises:
        Rejected: it says numbers that are none.
    """
    names = "speed", "pointing", "speed_error", "beams_error", "own_error"
    speed, pointing, error, beams_error, own_error = (_number(stage, f"{PLACEMENT}.{name}") for name in names)
    found = [_number(stage, f"{PLACEMENT}.centroid.{name}") for name in ("speed", "error", "vibration")]
    centroid = Centroid(*found) if f"{PLACEMENT}.centroid.speed" in stage else None
    by_beams = bool(stage.get(f"{PLACEMENT}.by_beams", False))
    return Placement(speed, pointing, error, centroid, by_beams, beams_error, own_error)


def residual_phase_of(stage: Mapping[str, Any]) -> float:
    """The phase (rad) that autofocus leaves of each pulse, by what provenance says of sar_compression.

    Raises:
        Rejected: it says a number that is none.
    """
    return _number(stage, RESIDUAL)


def _number(stage: Mapping[str, Any], name: str) -> float:
    value = stage.get(name, 0.0)
    least = 0.0 if name.endswith(("error", "vibration", RESIDUAL)) else -math.inf
    if not isinstance(value, int | float) or not math.isfinite(value) or value < least:
        raise Rejected(
            "wrong provenance",
            f"Provenance.parameters has {value!r} for sar_compression.{name}; finite numbers are allowed, and errors, "
            "vibrations and phases of 0 or more.",
        )
    return float(value)
