"""A node with the life cycle of ROS (`ros2 lifecycle`), which is active from the start unless set otherwise."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

INACTIVE = "the node is not active; activate it, as by `ros2 lifecycle set NODE activate`"


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
