"""Losses of nodes, one message for each loss."""

from __future__ import annotations

from sal_height.engine.stage import DwellKey, Loss
from sal_height.messages.basics import to_stamp
from sal_height.messages.types import DwellLoss, Header


def loss_to_message(node: str, loss: Loss, stamp_ns: int) -> DwellLoss:
    """The message of a loss.

    Args:
        node: name of the node with its namespace.
        loss: loss of the node.
        stamp_ns: time of the loss, ns.
    """
    key = loss.dwell or DwellKey("", 0, 0)
    return DwellLoss(
        header=Header(stamp=to_stamp(max(0, stamp_ns))),
        node=node,
        of_dwell=loss.dwell is not None,
        config_hash=key.sensor,
        dwell=key.number,
        dwell_stamp=to_stamp(key.stamp_ns),
        messages=loss.messages,
        reason=loss.reason,
        sentence=loss.sentence,
    )
