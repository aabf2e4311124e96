"""Stages in a chain that serialized messages are fed to: read and counted as nodes do it, without ROS."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

from chained import Hosted, Joined

from sal_height.engine.chain import Made
from sal_height.engine.registry import STAGES
from sal_height.engine.results import Answer, FileProduct, Product
from sal_height.errors import UserError
from sal_height.messages import deserialize, serialize
from sal_height.messages.codec import SHIPPED
from sal_height.messages.kinds import kind_of
from sal_height.stage_files import check_written, read_inputs, write_product


def with_fields(message: Any, values: Mapping[str, Any]) -> Any:
    """A message with other values of fields, which are named by their path, as in "surfaces.0.height"."""
    for path, value in values.items():
        *holders, last = path.split(".")
        holder = message
        for name in holders:
            holder = holder[int(name)] if name.isdigit() else getattr(holder, name)
        setattr(holder, last, value)
    return message


class StageGraph(Joined):
    """Stages of the registry that messages are fed to.

    Attributes:
        heard: messages that were published by stages, by topic.
        answers: results of commands.
        failure: why a file could not be written; empty: there was no failure.
    """

    def __init__(self) -> None:
        super().__init__()
        self.heard: defaultdict[str, list[Any]] = defaultdict(list)
        self.answers: list[Answer] = []
        self.failure = ""

    def add(self, name: str, **parameters: Any) -> Hosted:
        """Start a stage of the registry with these settings."""
        kind = STAGES[name]
        settings = kind.settings(**parameters)
        check_written(kind, settings)
        return self.join(kind(settings, read_inputs(kind, settings), name), settings)

    def publish(self, topic: str, *messages: Any) -> None:
        """Publish messages to all stages that subscribe to the topic."""
        for message in messages:
            cdr = message if isinstance(message, bytes) else serialize(message)
            for host in self.hosts.values():
                if topic in host.ports:
                    self._receive(host, topic, cdr)

    def _receive(self, host: Hosted, topic: str, cdr: bytes) -> None:
        port = host.ports[topic]
        kind = kind_of(port)
        try:
            items = kind.read(cdr, host.settings)
        except UserError as error:
            reason = getattr(error, "reason", "cannot be processed" if port.counted else topic)
            if port.counted:
                host.counts["in"] += 1
                host.drop(1, reason, str(error))
            else:
                host.ignore(kind.trouble or reason, str(error))
            return
        for item in items:
            host.receive(topic, item)
            host.ask(lambda item=item: host.stage.accept(topic, item, self.chain.now_s))

    def report(self, made: Made) -> None:
        one = made.result
        if isinstance(one, Product):
            settings = self.hosts[made.stage.name].settings
            (port,) = (port for port in made.stage.outputs(settings) if port.name == one.port)
            kind = kind_of(port)
            message_class = SHIPPED.message_class(kind.type_name)
            self.heard[one.port] += [deserialize(cdr, message_class) for cdr in kind.write(one.item, settings)]
        elif isinstance(one, Answer):
            self.answers.append(one)
        elif isinstance(one, FileProduct):
            try:
                write_product(one)
            except UserError as error:
                self.failure = str(error)
                self.hosts[made.stage.name].ignore("file", self.failure)
