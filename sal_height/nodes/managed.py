"""A node with the life cycle of ROS (`ros2 lifecycle`), active from the start by default, and its role in runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from sal_height.topics import ODOMETRY, PHASE_HISTORY, SENSOR_INFO

Topics = Mapping[str, str]
"""Content of each topic of a node."""

SENSOR_TOPICS: Topics = {
    SENSOR_INFO: "description of the sensor, latched",
    ODOMETRY: "state of the platform, nav_msgs/Odometry",
    PHASE_HISTORY: "samples of one channel and dwell in each message",
}
"""Topics of a sensor."""

INACTIVE = "the node is not active; activate it, as by `ros2 lifecycle set NODE activate`"


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


class Managed(LifecycleNode):
    """A node that is unconfigured, inactive or active; only an active one accepts the messages that it works on.

    While it is inactive it still accepts what describes the sensor and the platform, so that it can start at once.
    Cleaning it up forgets what it has gathered.

    Attributes:
        is_active: True if it works.
    """

    def __init__(self, name: str, **node_arguments: Any) -> None:
        """Make the node, unconfigured; `node_arguments` go to rclpy's LifecycleNode."""
        self.is_active = False
        super().__init__(name, **node_arguments)

    def start(self) -> None:
        """Make it active."""
        self.trigger_configure()
        self.trigger_activate()

    def forget(self) -> None:
        """Forget what has been gathered of the dwells so far."""

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Work from now on."""
        self.is_active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave out what arrives from now on; what waits is still processed."""
        self.is_active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget what has been gathered."""
        self.forget()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave out what arrives from now on."""
        self.is_active = False
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """End the node, and its state machine, which rclpy leaves alive and with it the node's participant."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()
