"""What happens before a dwell of a bag is played: parameters of nodes that change, a calibration that comes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from sal_height.errors import UserError


class DwellKey(NamedTuple):
    """What tells the dwells of a bag apart: a sensor that starts anew may count them from 0 again."""

    number: int
    stamp_ns: int


@dataclass(frozen=True)
class Cue:
    """What happens before a dwell.

    Attributes:
        dwell: the dwell.
        parameters: values that nodes get, by node and name.
        calibrations: identities of the calibrations that are published, in this order.
    """

    dwell: DwellKey
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    calibrations: tuple[str, ...] = ()


def cues_to_text(cues: Iterable[Cue]) -> str:
    """Cues as a text for a parameter of a node, in JSON; empty if there are none."""
    entries = [{"dwell": cue.dwell, "parameters": cue.parameters, "calibrations": cue.calibrations} for cue in cues]
    return json.dumps(entries) if entries else ""


def cues_of_text(text: str) -> dict[DwellKey, Cue]:
    """The cues that a text holds, by their dwell.

    Raises:
        UserError: it is none that `cues_to_text` makes.
    """
    try:
        cues = [
            Cue(DwellKey(*entry["dwell"]), dict(entry["parameters"]), tuple(entry["calibrations"]))
            for entry in json.loads(text or "[]")
        ]
    except (ValueError, TypeError, KeyError) as error:
        raise UserError(
            f"Parameter cues is {text[:80]!r}; it must be a list of dwell, parameters and calibrations in JSON."
        ) from error
    return {cue.dwell: cue for cue in cues}
