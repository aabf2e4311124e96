"""Where autofocus has put an image, in the provenance of what is made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from sal_height.errors import Rejected
from sal_height.imaging import Centroid, Placement

PLACEMENT = "placement"
"""Beginning of names beside the parameters of sar_compression; the others are those of `Placement` and `Centroid`."""


def placement_values(placement: Placement) -> dict[str, Any]:
    """What provenance says of a placement beside the parameters of sar_compression; nothing if data told nothing."""
    return {PLACEMENT: asdict(placement)} if placement.centroid or placement.by_beams else {}


def placement_of(stage: Mapping[str, Any]) -> Placement:
    """The placement of an image by what its provenance says of sar_compression.

    Raises:
        Rejected: it says numbers that are none.
    """
    speed, pointing, error = (_number(stage, name) for name in ("speed", "pointing", "speed_error"))
    found = [_number(stage, f"centroid.{name}") for name in ("speed", "error", "vibration")]
    centroid = Centroid(*found) if f"{PLACEMENT}.centroid.speed" in stage else None
    return Placement(speed, pointing, error, centroid, bool(stage.get(f"{PLACEMENT}.by_beams", False)))


def _number(stage: Mapping[str, Any], name: str) -> float:
    value = stage.get(f"{PLACEMENT}.{name}", 0.0)
    least = 0.0 if name.endswith(("error", "vibration")) else -math.inf
    if not isinstance(value, int | float) or not math.isfinite(value) or value < least:
        raise Rejected(
            "wrong provenance",
            f"Provenance.parameters has {value!r} for sar_compression.{PLACEMENT}.{name}; finite numbers are allowed, "
            "and errors and vibrations of 0 or more.",
        )
    return float(value)
