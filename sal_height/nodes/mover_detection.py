"""Node mover_detection: slc → movers, what moves in strips or over spotlight dwells, as points.

Dwells in spotlight are told some dwells later, when all that overlap with them have come; the last ones once no other
has come for timeout_s.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

from rclpy._rclpy_pybind11 import RCLError

from sal_height import messages
from sal_height.calibration import Calibration
from sal_height.errors import Rejected, UserError
from sal_height.messages import ReceivedImage
from sal_height.messages.types import PointCloud2
from sal_height.movers import ALONE, DwellMovers, Looked, MoverSettings, check_sensor
from sal_height.nodes.account import Account
from sal_height.nodes.dwell_stage import ChannelParameters
from sal_height.nodes.image_stage import ImageStage
from sal_height.nodes.program import run_node
from sal_height.nodes.role import Topics
from sal_height.pipeline import dwell_with_movers, movers
from sal_height.sensor import Sensor

MOVERS = "movers"
"""Topic of the movers of each dwell, and the name by which runs are asked for them."""


class Parameters(ChannelParameters, MoverSettings):
    """Parameters of the node."""


class MoverDetection(ImageStage):
    """Finds what moves in images, with place, height and radial velocity; a cloud of points for each dwell."""

    parameters = Parameters
    outputs: ClassVar[Topics] = {MOVERS: "what moves in each dwell, sensor_msgs/PointCloud2 in map"}

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed.
        """
        super().__init__("mover_detection", **node_arguments)
        self._points = self.offer(PointCloud2, MOVERS)
        self._settings = MoverSettings()
        self._dwells = DwellMovers[ReceivedImage](self._settings)
        self._ending = threading.Lock()  # the context may be shut down in another thread than the executor's
        self.context.on_shutdown(self.conclude)

    def check(self, message: ReceivedImage, sensor: Sensor) -> None:
        """Size of an image, and whether its sensor can tell movers."""
        messages.check_slc(message, sensor)
        try:
            check_sensor(sensor)
        except UserError as error:
            raise Rejected("movers", str(error)) from error

    def process(self, images: list[ReceivedImage], sensor: Sensor, calibration: Calibration | None) -> int:
        """Find what moves in a dwell, and publish it, or what was found in those that are complete now."""
        published = self._follow_parameters()
        slc = messages.slc_from_messages(images)
        if sensor.mode == "stripmap":
            self._publish(images[0], movers(slc, sensor, self._settings, calibration))
            return published + 1
        seconds = 1e-9 * images[0].stamp_ns
        dwell = dwell_with_movers(slc, seconds, sensor, self._settings, calibration)
        return published + self._tell(self._dwells.add(dwell, images[0]))

    def _follow_parameters(self) -> int:
        """Begin anew if settings have changed; returns the number of messages published."""
        wanted = self.current_parameters()
        settings = MoverSettings(**{name: getattr(wanted, name) for name in MoverSettings.model_fields})
        if settings == self._settings:
            return 0
        published = self._tell(self._dwells.end())
        self._settings, self._dwells = settings, DwellMovers[ReceivedImage](settings)
        return published

    def _tell(self, found: Sequence[tuple[ReceivedImage, Looked | None]]) -> int:
        """Publish what was found in dwells; returns the number of messages."""
        told = 0
        for image, looked in found:
            if looked is None:
                self.ignore("no overlap", UserError(ALONE.format(image.dwell)))
                continue
            self._publish(image, looked)
            told += 1
        return told

    def _publish(self, image: ReceivedImage, looked: Looked) -> None:
        self._points.publish(messages.mover_points(looked.movers, image.header))

    def advance(self) -> None:
        """Besides what dwells do: tell the last ones once no other has come for timeout_s."""
        super().advance()
        if self._dwells.untold and not self.jobs and self._waiting.waited_s > self.current_parameters().timeout_s:
            self._waiting.restart()
            self.submit(0, lambda: self._tell(self._dwells.end()))

    def _counts(self) -> Account:
        """Besides what all nodes count, the dwells that wait for later ones: a run ends when they have been told."""
        return replace(super()._counts(), unpublished=self._dwells.untold)

    def forget_results(self) -> int:
        """Begin anew with the next dwell, without what has not been told, which is counted."""
        for _ in range(self._dwells.untold):
            self.ignore("reset", UserError("The node was reset before the movers of a dwell were told."))
        self._dwells = DwellMovers[ReceivedImage](self._settings)
        return 0

    def conclude(self) -> None:
        """Tell what was found in the last dwells. May be called twice."""
        with self._ending:
            self.finish()
            with contextlib.suppress(RCLError):  # the context may have ended: nobody is left to publish to
                self._tell(self._dwells.end())

    def destroy_node(self) -> None:
        """Tell what was found in the last dwells, then end the node."""
        self.conclude()
        super().destroy_node()


def main() -> int:
    """Console script."""
    return run_node(MoverDetection)


if __name__ == "__main__":
    raise SystemExit(main())
