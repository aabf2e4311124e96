"""Node relief_tracker: <estimator>/height → tracked/height, image and points, neighbours telling of each other."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from sal_height_msgs.msg import HeightImage
from sensor_msgs.msg import Image, PointCloud2

from sal_height import messages
from sal_height.nodes.parameters import declare_parameters, parameter, read_parameters
from sal_height.nodes.program import run_node
from sal_height.nodes.stage import Stage
from sal_height.relief import GATE, ReliefPrior, track

PREFIX = "tracked"
"""Of the topics, and HeightImage.estimator."""


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    estimator: str = parameter(
        "ml", "whose heights are tracked", choices=("ml", "monopulse", "sum_difference"), read_only=True
    )
    correlation_length_m: float = parameter(
        0.0, "correlation length of the relief on the ground, m; 0: estimated from each image", minimum=0.0, maximum=1e6
    )
    relief_sigma_m: float = parameter(
        0.0, "standard deviation of the relief, m; 0: estimated from each image", minimum=0.0, maximum=1e5
    )
    along_track: bool = parameter(True, "whether neighbours along the flight have a say, too")
    gate: float = parameter(
        GATE, "heights farther from their prediction are outliers, standard deviations", minimum=1.0, maximum=1000.0
    )


@dataclass(frozen=True)
class _Recorded(Parameters):
    """What the provenance tells: the parameters, and the prior that was used."""

    prior: ReliefPrior | None = None


class ReliefTracker(Stage):
    """Tracks the heights of every image along range; its parameters are Parameters."""

    parameters = Parameters

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__("relief_tracker", **node_arguments)
        declare_parameters(self, Parameters)
        self._height = self.offer(HeightImage, f"{PREFIX}/height")
        self._image = self.offer(Image, f"{PREFIX}/image")
        self._points = self.offer(PointCloud2, f"{PREFIX}/points")
        self.listen(HeightImage, f"{read_parameters(self, Parameters).estimator}/height", self._on_height)

    def _on_height(self, message: HeightImage) -> None:
        self.tally.receive()
        self.submit(1, lambda: self.process(message))

    def process(self, message: HeightImage) -> int:
        """Track the heights of a dwell (on the worker) and publish them; returns the number of height images."""
        parameters = read_parameters(self, Parameters)
        field, aperture = messages.field_from_message(message), messages.aperture_from_message(message.aperture)
        known = parameters.correlation_length_m or None, parameters.relief_sigma_m or None
        tracked, prior = track(field, aperture, *known, parameters.gate, parameters.along_track)
        recorded = _Recorded(**dataclasses.asdict(parameters), prior=prior)
        provenance = messages.derived(message.provenance, self.get_name(), recorded)
        looks = message.range_looks, message.azimuth_looks
        image = messages.height_to_message(tracked, aperture, looks, PREFIX, message, provenance)
        self._image.publish(messages.height_picture(image))
        self._points.publish(messages.height_points(tracked, image))
        self._height.publish(image)
        return 1


def main() -> int:
    """Console script."""
    return run_node(ReliefTracker)


if __name__ == "__main__":
    raise SystemExit(main())
