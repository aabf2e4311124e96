"""Runs without nodes: the stages are joined by calls, and what nodes would publish is written to the new bag."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

from sal_height.bag import qos
from sal_height.bag.qos import Qos
from sal_height.bag.reader import BagMessage
from sal_height.bag.writer import BagWriter
from sal_height.engine.air import AIR_PARAMETERS
from sal_height.engine.chain import Made
from sal_height.engine.height_items import Heights
from sal_height.engine.image_items import count_messages
from sal_height.engine.results import DwellKey, Event, Loss, Notice, Product
from sal_height.engine.stage import Port
from sal_height.errors import UserError
from sal_height.extras import lacking_of_ros
from sal_height.graph.plan import UNCOUNTED, Execution, Outcome, Plan
from sal_height.messages.accounts import loss_to_message
from sal_height.messages.codec import SHIPPED, deserialize
from sal_height.messages.kinds import kind_of, kind_of_topic
from sal_height.messages.transforms import platform_transform, sensor_transform
from sal_height.messages.types import Image, Odometry, PointCloud2, SensorInfo, TFMessage
from sal_height.messages.views import height_picture, height_points, origin_frame
from sal_height.nodes.accounts.account import Account
from sal_height.runs.chain.stage_run import StageRun
from sal_height.topics import CALIBRATION, LOSSES, ODOMETRY, SENSOR_INFO, TF, TF_STATIC
from sal_height.workers.processes import Interruption

_LOG = logging.getLogger(__name__)

VIEWS = {"image": Image, "points": PointCloud2}

LOSS_TYPE = "sal_height_msgs/msg/DwellLoss"


def perform_by_calls(plan: Plan, execution: Execution, run: StageRun) -> Outcome:
    """Process dwells by calls, and write inputs and products to a new bag.

    Raises:
        UserError: no stage makes a topic that is to be recorded, or the bag cannot be made.
    """
    also = [topic.removeprefix("/") for topic in execution.record]
    wanted = [topic for topic in dict.fromkeys([*plan.recorded, *also]) if topic not in UNCOUNTED]
    failure: UserError | None = None
    interrupted = False
    began = time.monotonic()
    with ExitStack() as stack:
        interruption = stack.enter_context(Interruption())
        recording = _Recording(run, plan, wanted)
        stack.callback(recording.bag.close)
        try:
            for made in run.results(plan.bag.parent.name, recording.take):
                interruption.check()
                recording.enter(made)
        except KeyboardInterrupt:
            interrupted = True
        except UserError as error:
            failure = error
        except OSError as error:
            failure = UserError(f"Bag {plan.bag} cannot be written: {error.strerror}; make room on its disk.")
    accounts = recording.accounts()
    return Outcome(accounts, accounts[plan.source].dwells, interrupted, failure, time.monotonic() - began)


def jobs_without_ros(asked: int | None) -> int | None:
    """Jobs of a run: as requested; 1 with a message if nodes are requested and what they need is not installed."""
    if asked is None and (lacking := lacking_of_ros()):
        _LOG.warning("Module %s is not installed: the dwells are processed without nodes, as with --jobs 1.", lacking)
        return 1
    return asked


@dataclass
class _Counts:
    """Counts of a stage, or of the bag as the source of the dwells.

    Messages for viewers are counted by topic only, as nodes do: they are no products.
    """

    received: int = 0
    published: Counter[str] = field(default_factory=Counter)
    views: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    ignored: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    last_drop: str = ""

    def account(self, dwells: int = 0) -> Account:
        """The account of a node that has done the same."""
        return Account(
            received=self.received,
            processed=self.received - self.dropped.total(),
            published=self.published.total(),
            dwells=dwells,
            dropped=dict(self.dropped),
            ignored=dict(self.ignored),
            events=dict(self.events),
            published_on=dict(self.published + self.views),
            last_drop=self.last_drop,
        )


class _Recording:
    """Writes the new bag and counts as nodes do."""

    def __init__(self, run: StageRun, plan: Plan, wanted: Sequence[str]) -> None:
        """Start the bag.

        Raises:
            UserError: no stage makes a topic that is to be recorded, or the bag cannot be made.
        """
        self._run, self._plan = run, plan
        self._now_ns = run.begin_ns
        self._counts = {name: _Counts() for name in (plan.source, *plan.stages)}
        self._times_ns: dict[DwellKey, int] = {}
        """Time at which the last frame or image of a dwell was fed, ns; products of the dwell have the same."""
        self._consumers: dict[str, list[str]] = {}
        self._ports: dict[str, Port] = {}
        types: dict[str, tuple[str, Qos]] = {LOSSES: (LOSS_TYPE, qos.FRAMES)}
        for topic in plan.played:
            types[topic] = kind_of_topic(topic).type_name, _qos_of(topic, latched=topic == SENSOR_INFO)
        for name, stage in run.stages.items():
            for port in stage.inputs(run.settings[name]):
                if port.counted:
                    self._consumers.setdefault(port.name, []).append(name)
            for port in stage.outputs(run.settings[name]):
                self._ports[port.name] = port
                types[port.name] = kind_of(port).type_name, _qos_of(port.name, latched=port.latched)
                if port.kind is Heights:
                    types |= _view_types(port.name.removesuffix("/height"))
        types |= {TF[1:]: (TFMessage.__msgtype__, qos.ODOMETRY), TF_STATIC[1:]: (TFMessage.__msgtype__, qos.LATCHED)}
        types.setdefault(CALIBRATION, (kind_of_topic(CALIBRATION).type_name, qos.LATCHED))
        if unknown := [topic for topic in wanted if topic not in types]:
            raise UserError(
                f"Topic {unknown[0]} is not made by a replay without nodes; it has {', '.join(sorted(types))}. Leave "
                "--jobs out to record others."
            )
        names = dict(zip(wanted, plan.on_wire(wanted), strict=True))
        self._names = {topic: f"/{name}" for topic, name in names.items()}
        self.bag = BagWriter(plan.bag, plan.custom_data)
        for topic, name in self._names.items():
            self.bag.add_topic(name, types[topic][0], [types[topic][1]])

    def take(self, port: str, recorded: BagMessage, items: Sequence[Any] | None) -> None:
        """Write and count a message that is played; what cannot be decoded (None) is counted and left out."""
        self._now_ns = recorded.log_time_ns
        if items is None:
            self._counts[self._plan.source].ignored[f"broken {recorded.topic}"] += 1
            _LOG.warning("%s: ignored a message on %s that cannot be decoded.", self._plan.source, recorded.topic)
            return
        self._write(port, [recorded.cdr], self._now_ns)
        self._write_frames(port, recorded.cdr)
        self._counts[self._plan.source].published[port] += 1
        for item in items:
            if key := getattr(item, "key", None):
                self._times_ns[key] = self._now_ns
        self._count_received(port, max(1, len(items)))

    def enter(self, made: Made) -> None:
        """Write a product, or count what a stage left out or reports."""
        counts, result = self._counts[made.stage.name], made.result
        if isinstance(result, Product):
            count = count_messages(result.item)
            counts.published[result.port] += count
            self._count_received(result.port, count)
            if result.port in self._names:
                settings = self._run.settings[made.stage.name]
                serialized = kind_of(self._ports[result.port]).write(result.item, settings)
                self._write(result.port, serialized, self._time_of(made.dwell))
            if isinstance(result.item, Heights):
                views = self._write_views(result.port.removesuffix("/height"), result.item, self._time_of(made.dwell))
                counts.views.update(views)
        elif isinstance(result, Loss):
            counts.dropped[result.reason] += result.messages
            counts.last_drop = result.sentence
            if result.dwell not in self._plan.as_flown.unmade.get(made.stage.name, ()):
                _LOG.warning(
                    "%s: dropped %d (%s): %s", made.stage.name, result.messages, result.reason, result.sentence
                )
            self._write_loss(made.stage.name, result)
        elif isinstance(result, Notice):
            counts.ignored[result.kind] += 1
        elif isinstance(result, Event):
            counts.events[result.name] += result.times
            if result.loss:
                self._write_loss(made.stage.name, result.loss)

    def accounts(self) -> dict[str, Account]:
        """The account of the source and of every stage."""
        source = self._plan.source
        others = {name: counts.account() for name, counts in self._counts.items() if name != source}
        return {source: self._counts[source].account(len(self._times_ns)), **others}

    def _count_received(self, port: str, messages: int) -> None:
        for name in self._consumers.get(port, ()):
            self._counts[name].received += messages

    def _write_loss(self, stage: str, loss: Loss) -> None:
        self._write(LOSSES, [SHIPPED.serialize(loss_to_message(f"/{stage}", loss, self._now_ns))], self._now_ns)

    def _time_of(self, dwell: DwellKey | None) -> int:
        """Time at which products of a dwell are recorded, ns; None: of no dwell."""
        return self._times_ns.get(dwell, self._now_ns) if dwell else self._now_ns

    def _write_frames(self, port: str, cdr: bytes) -> None:
        """Write the frames that follow from a message that is played, as the player publishes them."""
        if port == ODOMETRY and TF[1:] in self._names:
            frames = platform_transform(deserialize(cdr, Odometry))
            self._write(TF[1:], [SHIPPED.serialize(frames)], self._now_ns)
        elif port == SENSOR_INFO and TF_STATIC[1:] in self._names:
            frames = sensor_transform(deserialize(cdr, SensorInfo))
            self._write(TF_STATIC[1:], [SHIPPED.serialize(frames)], self._now_ns)

    def _write_views(self, prefix: str, item: Heights, time_ns: int) -> list[str]:
        """Write the picture and the points of heights, as nodes publish them while somebody subscribes.

        Returns:
            The topics of the messages that nodes publish then.
        """
        written = list[str]()
        if f"{prefix}/image" in self._names:
            self._write(f"{prefix}/image", [SHIPPED.serialize(height_picture(item))], time_ns)
            written.append(f"{prefix}/image")
        if f"{prefix}/points" in self._names:
            frame, points = height_points(item, origin_frame(prefix))
            self._write(TF[1:], [SHIPPED.serialize(TFMessage(transforms=[frame]))], time_ns)
            self._write(f"{prefix}/points", [SHIPPED.serialize(points)], time_ns)
            written += [f"{prefix}/points", f"{prefix}/frame", TF[1:]]
        return written

    def _write(self, port: str, serialized: Sequence[bytes], time_ns: int) -> None:
        if port in self._names:
            for cdr in serialized:
                self.bag.write(self._names[port], cdr, time_ns, time_ns)


def _view_types(product: str) -> dict[str, tuple[str, Qos]]:
    """Types and quality of service of the picture and the points of heights."""
    return {f"{product}/{view}": (kind.__msgtype__, qos.FRAMES) for view, kind in VIEWS.items()}


def _qos_of(topic: str, *, latched: bool) -> Qos:
    """Quality of service of the publisher that a topic has in a graph of nodes."""
    if latched:
        return qos.LATCHED
    return qos.ODOMETRY if topic in (ODOMETRY, *AIR_PARAMETERS) else qos.FRAMES
