"""How far a source that is asked for its dwells may be ahead of nodes that work side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sal_height.messages import HEARD_AIR
from sal_height.nodes.dwell_stage import DwellParameters
from sal_height.nodes.height import CROWD
from sal_height.nodes.stage import FRAMES_QOS
from sal_height.runs.catalogue import CALIBRATOR, NodeParameters, parameters_of
from sal_height.sensor import Sensor

MOST_AHEAD = CROWD - 1
"""Of more dwells height nodes may process some at once, which may change the last bit of a height."""

SPACE = 2
"""Memory that is reckoned with for a dwell over the bytes of its samples, for images may have more pixels."""


@dataclass(frozen=True)
class Lead:
    """How far the source may be ahead.

    Attributes:
        dwells: that nodes need not be done with when the next one is asked for.
        channels: frames, and images, of a dwell.
    """

    dwells: int = 0
    channels: int = 1


IN_STEP = Lead()
"""No dwell is played before all nodes are done with the one before."""


def lead_of(sensor: Sensor, stages: Sequence[str], parameters: NodeParameters) -> Lead:
    """The lead with which all comes out as in step: no queue overflows, and nothing overtakes a dwell.

    Args:
        sensor: whose dwells are played.
        stages: the nodes that process them.
        parameters: of all nodes.

    Raises:
        UserError: a value is not allowed.
    """
    if sensor.mode == "stripmap":  # a dwell has not always images
        return IN_STEP
    channels = sensor.detector_count
    limits = [MOST_AHEAD, FRAMES_QOS.depth // channels - 1]
    for name in stages:
        now = parameters_of(name, parameters.get(name, {}))
        limits += [now.max_queued_dwells, now.max_memory_bytes // (SPACE * sensor.dwell_bytes) - 1]
        if isinstance(now, DwellParameters):
            limits.append(now.max_unfinished_dwells - 1)
        if now.latency_budget_s or name == CALIBRATOR or getattr(now, "air", "") == HEARD_AIR:
            return IN_STEP
    return Lead(max(0, min(limits)), channels)
