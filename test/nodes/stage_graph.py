"""Stages joined by serialized messages, without ROS and with a clock that only waiting moves.

Each stage reads, counts and writes messages as its node does; there is no middleware, and no thread.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from typing import Any

from sal_height.engine.registry import STAGES
from sal_height.engine.stage import Decision, Event, FileProduct, Job, Loss, Notice, Product, Rehearsal, Result
from sal_height.errors import UserError
from sal_height.messages import deserialize, serialize
from sal_height.messages.codec import SHIPPED
from sal_height.messages.kinds import kind_of
from sal_height.stage_files import check_written, read_inputs, write_product

TICK_S = 0.1
LONGEST_S = 60.0


class Host:
    """A stage that serialized messages are fed to.

    Attributes:
        last_rejection: reason and sentence of what was dropped or ignored last.
        last_drop: sentence of what was dropped last.
        failure: why a file could not be written; empty: there was no failure.
    """

    def __init__(self, graph: StageGraph, name: str, **parameters: Any) -> None:
        """Start a stage of the registry with these settings."""
        kind = STAGES[name]
        self._graph = graph
        self.settings = kind.settings(**parameters)
        check_written(kind, self.settings)
        self.stage = kind(self.settings, read_inputs(kind, self.settings), name)
        self._inputs = {port.name: port for port in kind.inputs(self.settings)}
        self._outputs = {port.name: port for port in kind.outputs(self.settings)}
        self._counts: Counter[str] = Counter()
        self.last_rejection = self.last_drop = self.failure = ""
        self.do(lambda: self.stage.start(0))

    def summary(self) -> dict[str, int]:
        """The account, as the tally of a node has it."""
        lost = sum(count for name, count in self._counts.items() if name.startswith("dropped."))
        always = {name: self._counts[name] for name in ("in", "processed", "out")}
        return {**self._counts, **always, "waiting": always["in"] - always["processed"] - lost}

    def counted(self, under: str) -> dict[str, int]:
        """Messages that were "dropped." or "ignored.", by reason."""
        return {name.removeprefix(under): count for name, count in self._counts.items() if name.startswith(under)}

    def set(self, **values: Any) -> None:
        """Set parameters."""
        self.settings = self.settings.changed(**values)
        self.do(lambda: self.stage.change(self.settings))

    def receive(self, topic: str, cdr: bytes) -> None:
        """A message arrives; topics that are no input are not subscribed to."""
        port = self._inputs.get(topic)
        if port is None:
            return
        kind = kind_of(port)
        try:
            items = kind.read(cdr, self.settings)
        except UserError as error:
            reason = getattr(error, "reason", "cannot be processed" if port.counted else topic)
            if port.counted:
                self._counts["in"] += 1
                self._drop(1, reason, str(error))
            else:
                self._ignore(kind.trouble or reason, str(error))
            return
        for item in items:
            self._counts["in"] += port.counted
            self.do(lambda item=item: self.stage.accept(topic, item, self._graph.now_s))

    def do(self, step: Callable[[], Sequence[Decision] | None]) -> None:
        """Do something with the stage, process the jobs that it makes, and report the rest."""
        for one in step() or ():
            if isinstance(one, Job):
                self._process(one)
            elif isinstance(one, Loss):
                self._drop(one.messages, one.reason, one.sentence)
            else:
                self._report(one)

    def tick(self) -> None:
        """Time has passed."""
        self.do(lambda: self.stage.advance(self._graph.now_s, busy=False))

    def forget(self) -> None:
        """Forget what has been gathered so far."""
        self.do(self.stage.reset)

    def conclude(self) -> None:
        """Nothing more arrives."""
        self.do(self.stage.finish)

    def _process(self, job: Job) -> None:
        results: Sequence[Result] = []
        if not isinstance(job.inputs, Rehearsal):
            (results,) = self.stage.process([job])
        self.do(lambda: self.stage.note_done(job, results))
        for one in results:
            if not isinstance(one, Loss):
                self._report(one)
        losses = [one for one in results if isinstance(one, Loss)]
        for one in losses:
            self._drop(job.messages, one.reason, one.sentence)
        if not losses:
            self._counts["processed"] += job.messages

    def _report(self, one: Result) -> None:
        if isinstance(one, Product):
            written = kind_of(self._outputs[one.port]).write(one.item, self.settings)
            self._counts["out"] += len(written)
            for cdr in written:
                self._graph.distribute(one.port, cdr, kind_of(self._outputs[one.port]).type_name)
        elif isinstance(one, Notice):
            self._ignore(one.kind, one.sentence)
        elif isinstance(one, Event):
            self._counts[one.name] += 1
        elif isinstance(one, FileProduct):
            try:
                write_product(one)
            except UserError as error:
                self.failure = str(error)
                self._ignore("file", self.failure)

    def _drop(self, messages: int, reason: str, sentence: str) -> None:
        self._counts[f"dropped.{reason}"] += messages
        self.last_drop, self.last_rejection = sentence, f"{reason}: {sentence}"

    def _ignore(self, kind: str, sentence: str) -> None:
        self._counts[f"ignored.{kind}"] += 1
        self.last_rejection = f"{kind}: {sentence}"


class StageGraph:
    """Stages that receive each other's messages at once.

    Attributes:
        hosts: the stages, by name.
        heard: messages that were published by stages, by topic.
        now_s: the clock of all stages, s.
    """

    def __init__(self) -> None:
        self.hosts: dict[str, Host] = {}
        self.heard: defaultdict[str, list[Any]] = defaultdict(list)
        self.now_s = 1000.0

    def add(self, name: str, **parameters: Any) -> Host:
        """Start a stage of the registry."""
        self.hosts[name] = Host(self, name, **parameters)
        return self.hosts[name]

    def publish(self, topic: str, *messages: Any) -> None:
        """Publish messages to all stages."""
        for message in messages:
            cdr = message if isinstance(message, bytes) else serialize(message)
            for host in self.hosts.values():
                host.receive(topic, cdr)

    def distribute(self, topic: str, cdr: bytes, type_name: str) -> None:
        """Hand a message of a stage to the others."""
        self.heard[topic].append(deserialize(cdr, SHIPPED.message_class(type_name)))
        self.publish(topic, cdr)

    def wait(self, condition: Callable[[], Any], what: str = "") -> None:
        """Let time pass until something has happened."""
        ticks = 0
        while not condition():
            accounts = {name: (host.summary(), host.last_rejection) for name, host in self.hosts.items()}
            assert ticks * TICK_S < LONGEST_S, f"waited in vain for {what}: {accounts}"
            ticks += 1
            self.now_s += TICK_S
            for host in self.hosts.values():
                host.tick()
