"""Provenance: what a product was made from, by which programs and with which parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from sal_height_msgs.msg import Provenance

from sal_height import __version__
from sal_height.settings import Settings


def derived(before: Provenance, stage: str, values: Settings | Mapping[str, Any]) -> Provenance:
    """Provenance of what `stage` with the parameters `values` made of a product with the provenance `before`.

    All that `before` says of the images stays: sensor, calibration, and the phase that autofocus took off.
    """
    return Provenance(
        code_version=__version__,
        config_hash=before.config_hash,
        calibration_id=before.calibration_id,
        parameters=as_json(stage, values, before.parameters),
        autofocus_phase=before.autofocus_phase,
    )


def as_json(stage: str, values: Settings | Mapping[str, Any], before: str = "{}") -> str:
    """Provenance.parameters: the JSON object `before` with the parameters of `stage` added.

    If `before` is no JSON object (another program wrote it), it is kept under the key "before".
    """
    try:
        stages = json.loads(before or "{}")
    except ValueError:
        stages = before
    if not isinstance(stages, dict):
        stages = {"before": stages}
    return json.dumps(stages | {stage: dict(values)}, sort_keys=True)


def recorded(parameters: str, stage: str, name: str) -> Any:
    """Value of the parameter `name` of `stage` in a Provenance.parameters; None if it is not there."""
    try:
        stages = json.loads(parameters)
    except ValueError:
        return None
    values = stages.get(stage) if isinstance(stages, dict) else None
    return values.get(name) if isinstance(values, dict) else None
