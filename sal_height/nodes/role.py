"""Properties of a node that runs know, as attributes of its class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

Topics = Mapping[str, str]
"""Content of each topic of a node."""


class Role:
    """Part of a node's class; the defaults are those of a node that nothing special is known of."""

    inputs: ClassVar[Topics] = {}
    """Topics that the node subscribes to, with their content."""

    outputs: ClassVar[Topics] = {}
    """Topics that the node publishes, with their content."""

    answers: ClassVar[Topics] = {}
    """Services that the node offers, and what they do."""

    product: ClassVar[str] = ""
    """Prefix of the topics of the heights that the node publishes, `<product>/height`; empty: it publishes none."""

    begin_service: ClassVar[str] = "step"
    """Service of a source of dwells that has it deliver the next one, or all of them at their pace."""

    takes_images: ClassVar[bool] = False
    """True if the node processes the images of all channels, topic slc."""

    takes_heights: ClassVar[bool] = False
    """True if the node processes the heights of the estimator that its parameter `estimator` names."""

    settable: ClassVar[bool] = False
    """True if users may set the node's parameters in a run or replay."""

    completes_file: ClassVar[bool] = False
    """True if the node completes a file when it ends, so that it has to be asked to and waited for."""
