"""Node relief_tracker: smooths the heights of an estimator (<estimator>/height) into tracked/height.

The prior with which a dwell is smoothed follows from it and from those before it of the same series: one sensor, and
heights made and tracked with the same parameters. The same dwells in the same order give the same heights.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar

import numpy as np

from sal_height import messages
from sal_height.elevation import ESTIMATORS
from sal_height.messages.types import Header, HeightImage, Provenance
from sal_height.nodes.height import LEFT_OUT
from sal_height.nodes.height_outlets import HeightOutlets
from sal_height.nodes.parameters import MapFrameParameters
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Topics
from sal_height.nodes.stage import Stage, StageParameters, height_topics, payload_bytes
from sal_height.rehearsal import made_up_heights
from sal_height.relief import HeightField, PriorEstimate, TrackingSettings, track
from sal_height.settings import setting

PREFIX = "tracked"
"""Prefix of the topics, and value of HeightImage.estimator."""

HELD_SERIES = 8
"""Number of series of dwells whose priors are held: those that came last."""


class Parameters(MapFrameParameters, StageParameters, TrackingSettings):
    """Parameters of the node."""

    estimator: str = setting(
        "ml",
        "estimator whose heights are smoothed; they come on topic <estimator>/height",
        choices=tuple(ESTIMATORS),
        read_only=True,
    )


class ReliefTracker(Stage):
    """Smooths the heights of each image with a Gauss-Markov prior, along range and along track."""

    parameters = Parameters
    inputs: ClassVar[Topics] = {"<estimator>/height": "heights of the estimator that the parameter names"}
    outputs = height_topics(PREFIX)
    product = PREFIX
    takes_heights = True
    settable = True

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__("relief_tracker", **node_arguments)
        self._tracker = Tracker()
        self._heights = HeightOutlets(self, PREFIX)
        self._rehearsed = False
        self.submit(0, self._rehearse)
        topic = f"{self.current_parameters().estimator}/height"
        self.listen(HeightImage, topic, self._on_height, read=messages.received_height)

    @property
    def is_ready(self) -> bool:
        """Whether the node has tracked made-up heights: the first dwell takes no longer then."""
        return self._rehearsed and super().is_ready

    def _rehearse(self) -> int:
        parameters = self.current_parameters()
        made_up = made_up_height_image(np.random.default_rng(0), parameters.map_frame)
        image, tracked, _ = Tracker().track(made_up, parameters, self.get_name())
        messages.height_picture(image)
        messages.height_points(tracked, messages.frame_near(tracked.grid.origin, image.header, PREFIX))
        self._rehearsed = True
        return 0

    def _on_height(self, message: HeightImage) -> None:
        if self.takes():
            self.submit(1, lambda: self.process(message), payload_bytes(message))

    def forget_results(self) -> int:
        """Track the next dwell as the first one."""
        self._tracker = Tracker()
        return 0

    def process(self, message: HeightImage) -> int:
        """Smooth and publish the heights of a dwell (on the worker thread); returns the number of height images."""
        parameters = self.current_parameters()
        image, tracked, bad = self._tracker.track(message, parameters, self.get_name())
        if bad:
            self.ignore("bad pixels", messages.bad_pixel_warning(message, bad))
        self._heights.publish(image, tracked)  # whose provenance, with the prior, is that of no other dwell
        return 1


def made_up_height_image(rng: np.random.Generator, map_frame: str) -> HeightImage:
    """The heights of level ground, as they come from an estimator."""
    field, aperture = made_up_heights(rng)
    source = HeightImage(header=Header(frame_id=map_frame))
    return messages.height_to_message(field, aperture, (1, 1), "ml", source, Provenance())


class Tracker:
    """Smooths the heights of one dwell after the other, and holds the priors of their series."""

    def __init__(self) -> None:
        """Begin without any."""
        self._priors: dict[Hashable, PriorEstimate] = {}

    def track(
        self, message: HeightImage, parameters: Parameters, node: str = "relief_tracker"
    ) -> tuple[HeightImage, HeightField, int]:
        """Smooth the heights of a dwell.

        Args:
            message: the heights.
            parameters: of the node.
            node: its name, for the provenance.

        Returns:
            The message with the smoothed heights, the same as arrays, and the number of pixels with bad values.

        Raises:
            UserError: the message has no heights that can be smoothed.
        """
        field = messages.field_from_message(message, parameters.map_frame)
        aperture = messages.aperture_from_message(message.aperture)
        series = _series_of(message, parameters)
        before = self._priors.pop(series, PriorEstimate())  # to be the last that is forgotten
        tracked, prior, after = track(field, aperture, before, parameters)
        self._priors = dict([*self._priors.items(), (series, after)][-HELD_SERIES:])
        provenance = messages.derived(
            message.provenance, node, {**dict(parameters), "prior": dataclasses.asdict(prior)}
        )
        looks = message.range_looks, message.azimuth_looks
        image = messages.height_to_message(tracked, aperture, looks, PREFIX, message, provenance)
        return image, tracked, messages.bad_pixels(message, field)


def _series_of(message: HeightImage, parameters: Parameters) -> tuple[Hashable, ...]:
    """What the heights of a series have in common: sensor, calibration, and how they are made and tracked.

    Which channels had to be left out, and what was found in the data, whose names have a dot, may change from dwell to
    dwell, and does not end a series.
    """
    provenance = message.provenance
    stages = messages.held_stages(provenance)
    made = repr({node: {k: v for k, v in values.items() if _is_set(k)} for node, values in stages.items()})
    return provenance.config_hash, provenance.calibration_id, message.estimator, made, parameters


def _is_set(name: str) -> bool:
    """Whether a name in the provenance is that of a parameter."""
    return "." not in name and name != LEFT_OUT


def main() -> int:
    """Console script."""
    return run_node(ReliefTracker)


if __name__ == "__main__":
    raise SystemExit(main())
