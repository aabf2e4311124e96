"""What runs know of a node, as attributes of its class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

Topics = Mapping[str, str]
"""What each topic of a node carries."""


class Role:
    """Part of a node's class; the defaults are those of a node that nothing special is known of."""

    inputs: ClassVar[Topics] = {}
    """Topics that the node subscribes to, and what comes on them."""

    outputs: ClassVar[Topics] = {}
    """Topics that the node publishes, and what they are."""

    answers: ClassVar[Topics] = {}
    """Services that the node offers, and what they do."""

    product: ClassVar[str] = ""
    """Prefix of the topics of the heights that the node publishes, `<product>/height`; empty: it publishes none."""

    begin_service: ClassVar[str] = "step"
    """Service of a source of dwells that has it deliver the next one, or all of them at their pace."""

    takes_images: ClassVar[bool] = False
    """Whether the node takes the images of all channels, topic slc."""

    takes_heights: ClassVar[bool] = False
    """Whether the node takes the heights of the estimator that its parameter `estimator` names."""

    settable: ClassVar[bool] = False
    """Whether users may set the node's parameters in a run or replay."""

    completes_file: ClassVar[bool] = False
    """Whether the node completes a file when it ends, so that it has to be asked to and waited for."""
