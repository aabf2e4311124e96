"""The height nodes: slc → <estimator>/height, image and points, one node for each of `elevation.ESTIMATORS`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import create_model

from sal_height import messages
from sal_height.calibration import Calibration
from sal_height.elevation import ESTIMATORS, ElevationEstimator, Validity
from sal_height.errors import UserError
from sal_height.imaging import ImageSettings, Slc
from sal_height.messages import ReceivedImage
from sal_height.messages.types import HeightImage
from sal_height.nodes.dwell_stage import ChannelParameters, WholeDwell
from sal_height.nodes.height_outlets import HeightOutlets
from sal_height.nodes.image_stage import ImageStage
from sal_height.nodes.program import run_node
from sal_height.nodes.stage import height_topics
from sal_height.pipeline import heights_of_dwells, live_channels
from sal_height.rehearsal import once, rehearse_heights
from sal_height.relief import HeightField
from sal_height.sensor import Sensor

AT_ONCE, BYTES_AT_ONCE = 4, 8_000_000
"""Dwells that are processed at once, and bytes of their images, at most: more would save little, and be later."""

CROWD = 3
"""Dwells that wait before some are processed at once: fewer wait in a run step by step, whose results are the same, to
the last bit, whatever else the machine does."""

LEFT_OUT = "channels_left_out"
"""Name in the provenance, beside the node's parameters, of the channels without a signal; only if there are any."""


class Made(NamedTuple):
    """What has been made of a dwell: its images as arrays, and heights with these parameters."""

    parameters: Any
    slc: Slc
    field: HeightField


class HeightNode(ImageStage):
    """Turns the images of all channels of a dwell into one height image.

    Heights of small dwells that wait are made at once, which is faster, and published when their turn comes.

    Its parameters are the settings of its estimator, and those of ChannelParameters.
    """

    estimator: ElevationEstimator

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__(self.estimator.node, **node_arguments)
        self._made: dict[int, Made] = {}
        self._heights = HeightOutlets(self, self.product)

    def rehearse(self, sensor: Sensor) -> None:
        """Estimate the heights of made-up images."""
        estimators = [(self.estimator, self.current_parameters())]
        once(
            (sensor.digest, *estimators),
            lambda: rehearse_heights(sensor, ImageSettings(), estimators, np.random.default_rng(0)),
        )

    def process(self, images: list[ReceivedImage], sensor: Sensor, calibration: Calibration | None) -> int:
        """Estimate the heights of a dwell and publish them."""
        parameters, first = self.current_parameters(), images[0]
        _, slc, field = self._made_of(WholeDwell(images, sensor, calibration), parameters)
        if np.any(field.validity == Validity.SATURATED):
            share, limit = slc.saturated_share.max(), parameters.max_saturated_share
            sentence = (
                f"Dwell {first.dwell}: {share:.3g} of a channel's samples are clipped; heights need {limit:g} or "
            )
            self.ignore("saturated", UserError(f"{sentence}less (max_saturated_share)."))
        image = height_image(field, slc, images, sensor, self.estimator, parameters, self.get_name())
        self._heights.publish(image, field, messages.serialized_height(image))
        return 1

    def _made_of(self, dwell: WholeDwell, parameters: Any) -> Made:
        """The heights of a dwell, which may have been made ahead; if not, those of dwells alike are made with them."""
        made = self._made.pop(id(dwell.messages), None)
        if made is None or made.parameters is not parameters:
            slcs = {id(dwell.messages): messages.slc_from_messages(dwell.messages)}
            for other in self._alike(dwell):
                with suppress(UserError):  # told when its turn comes
                    slcs[id(other.messages)] = messages.slc_from_messages(other.messages)
            self._made = self._made_at_once(slcs, dwell, parameters)
            made = self._made.pop(id(dwell.messages))
        return made

    def _alike(self, dwell: WholeDwell) -> list[WholeDwell]:
        """The dwells that wait and can be processed with this one."""
        if len(waiting := self.waiting()) < CROWD:
            return []
        size = sum(4 * len(image.samples) for image in dwell.messages)
        alike = [one for one in waiting if one.sensor is dwell.sensor and one.supplies is dwell.supplies]
        return alike[: max(0, min(AT_ONCE, BYTES_AT_ONCE // max(1, size)) - 1)]

    def _made_at_once(self, slcs: dict[int, Slc], dwell: WholeDwell, parameters: Any) -> dict[int, Made]:
        """The heights of several dwells, whose sensor and calibration are those of `dwell`, or of this one alone."""
        try:
            found = heights_of_dwells(list(slcs.values()), dwell.sensor, self.estimator, parameters, dwell.supplies)
        except UserError:  # which of them is to blame is told when its turn comes
            if len(slcs) == 1:
                raise
            return self._made_at_once({id(dwell.messages): slcs[id(dwell.messages)]}, dwell, parameters)
        return {key: Made(parameters, slc, field) for (key, slc), field in zip(slcs.items(), found, strict=True)}


def height_image(
    field: HeightField,
    slc: Slc,
    images: Sequence[ReceivedImage],
    sensor: Sensor,
    estimator: ElevationEstimator,
    parameters: Any,
    node: str = "",
) -> HeightImage:
    """The message with the heights of a dwell.

    Args:
        field: the heights.
        slc: images of all channels that they were made of.
        images: the messages of these.
        sensor: that took them.
        estimator: that made them.
        parameters: of its node.
        node: name of that, for the provenance; empty: the usual one.
    """
    silent = sorted(set(range(len(images))) - set(live_channels(slc.images, sensor).tolist()))
    used = {**dict(parameters), LEFT_OUT: silent} if silent else parameters
    provenance = messages.derived(images[0].provenance, node or estimator.node, used)
    looks = (parameters.range_looks, parameters.azimuth_looks)
    return messages.height_to_message(field, slc.aperture, looks, estimator.name, images[0], provenance)


def height_node(estimator: ElevationEstimator) -> type[HeightNode]:
    """The class of an estimator's node."""
    parameters = create_model(f"{estimator.name}_parameters", __base__=(estimator.settings, ChannelParameters))
    attributes = {
        "estimator": estimator,
        "product": estimator.name,
        "outputs": height_topics(estimator.name),
        "parameters": parameters,
        "__doc__": f"Estimates heights from the images of all channels of a dwell; estimator: {estimator.title}.",
    }
    return type(f"HeightNode_{estimator.name}", (HeightNode,), attributes)


HEIGHT_NODES = {estimator.node: height_node(estimator) for estimator in ESTIMATORS.values()}
"""Classes of the height nodes by the name of the node."""


def main() -> int:
    """Console script of all height nodes; the name of the script says which node it is."""
    return run_node(HEIGHT_NODES[Path(sys.argv[0]).stem])


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in HEIGHT_NODES:
        sys.exit(f"Which height node is to be started must come first; allowed are {', '.join(HEIGHT_NODES)}.")
    sys.argv.pop(0)
    raise SystemExit(main())
