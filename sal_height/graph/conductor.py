"""Starts a live graph: learns from the accounts of all nodes when they are ready, and asks the sensor to start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from sal_height.engine.air import AIR_PARAMETERS
from sal_height.errors import UserError
from sal_height.graph.catalogue import stage_inputs
from sal_height.graph.node_classes import NODES
from sal_height.graph.plan import RECORDER, UNCOUNTED, Plan
from sal_height.nodes.accounts.account import DIAGNOSTICS, OTHER, Account
from sal_height.nodes.transport.message_types import class_of
from sal_height.nodes.transport.qos import FRAMES_QOS
from sal_height.topics import ODOMETRY


class Conductor(Node):
    """Reads the accounts of all nodes, and asks the source to start.

    Attributes:
        accounts: accounts of the nodes of the plan, by name.
    """

    def __init__(self, plan: Plan, **node_arguments: Any) -> None:
        """Conduct the nodes of a plan; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a stage reads heights that no other stage makes.
        """
        super().__init__("conductor", **node_arguments)
        self.accounts: dict[str, Account] = {}
        inputs = stage_inputs(plan.stages, plan.parameters, plan.played)
        self._inputs = {plan.source: "", **dict(zip(inputs, plan.on_wire(inputs.values()), strict=True))}
        self._recorded, self._played = plan.on_wire(plan.recorded), plan.on_wire(plan.played)
        taken = [topic for name in plan.stages for topic in (ODOMETRY, *AIR_PARAMETERS) if topic in NODES[name].inputs]
        self._samples = plan.on_wire(taken)
        self._begin = self.create_client(Trigger, f"{plan.source}/{NODES[plan.source].begin_service}")
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 100)

    def connected(self) -> bool:
        """True if every topic has its subscribers, as its publisher counts them: nothing will be lost.

        Raises:
            UserError: a topic to record is published by no node.
        """
        if not {*self._inputs, RECORDER} <= self.accounts.keys():
            return False
        offered = {topic: n for account in self.accounts.values() for topic, n in account.subscribers.items()}
        recorded = set(self._recorded) - set(UNCOUNTED)
        if unknown := sorted(recorded - offered.keys()):
            raise UserError(f"No node of this run publishes topic {unknown[0]}; it has {', '.join(sorted(offered))}.")
        needed = Counter(topic for topic in self._inputs.values() if topic)
        needed.update([*(topic for topic in self._samples if topic in self._played), *recorded])
        alone = all(self.count_publishers(topic) == 1 for topic in self._played)
        return alone and all(offered[topic] >= n for topic, n in needed.items()) and self._begin.service_is_ready()

    def ready(self) -> bool:
        """True if all nodes are connected, and have done what they do before the first dwell."""
        return self.connected() and all(self.accounts[name].ready for name in self._inputs)

    def subscribe_raw(self, message_type: type, topic: str, receive: Callable[[bytes], None]) -> None:
        """Have the serialized messages of a topic received by `receive`."""
        self.create_subscription(class_of(message_type), topic, receive, FRAMES_QOS, raw=True)

    def ask(self) -> Future:
        """Ask the source to start; its answer is in the future."""
        return self._begin.call_async(Trigger.Request())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            account = Account.of_status(status)
            if account.kind != OTHER and status.name in {*self._inputs, RECORDER}:
                self.accounts[status.name] = account
