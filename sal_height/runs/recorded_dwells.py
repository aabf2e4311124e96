"""Dwells of a bag, compressed without a graph by the functions of its nodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from tqdm import tqdm

from sal_height import messages
from sal_height.bag.reader import BagMessage, BagReader, LogTimes
from sal_height.calibration import Calibration, load_calibration
from sal_height.errors import Rejected, UserError
from sal_height.imaging import Slc
from sal_height.nodes.air import AirHistory, heard_air
from sal_height.nodes.cues import Cue, DwellKey
from sal_height.nodes.dwell import Dwell, DwellAssembler, Key
from sal_height.nodes.dwell_stage import with_blanks
from sal_height.nodes.image_stage import applied_calibration
from sal_height.nodes.odometry import OdometryHistory
from sal_height.nodes.player import CALIBRATION_TOPIC
from sal_height.nodes.playlist import FRAMES, ODOMETRY
from sal_height.nodes.sar_compression import HEARD, Supplies, compress_dwell, longest_gap_s, warnings_of
from sal_height.pipeline import Compressor
from sal_height.runs.catalogue import NodeParameters, parameters_of
from sal_height.runs.entry import sensors_of
from sal_height.sensor import Sensor

COMPRESSION = "sar_compression"

GAP = "odometry gap"

MOST_DWELLS = 1_000_000
"""Of a bag that is read as one part."""

FRAME_TOPIC, ODOMETRY_TOPIC, CALIBRATIONS = f"/{FRAMES}", f"/{ODOMETRY}", f"/{CALIBRATION_TOPIC}"

AIR_TOPICS = {f"/{topic}": topic for topic in messages.AIR}
"""Topics that tell the air, in a bag and as nodes know them."""

WARNED = "warned by "
"""Begins the kinds of sentences on dwells that are used all the same."""

TAKEN = (ODOMETRY_TOPIC, *AIR_TOPICS, FRAME_TOPIC)
"""Topics that are gone through in the order of the bag."""


@dataclass(frozen=True)
class Work:
    """Dwells of a bag, and how they are processed.

    Attributes:
        bag: folder of the bag, or its file.
        namespace: of its topics; empty: none.
        makers: height nodes whose heights are made.
        parameters: of all nodes at the first of the dwells, by node and name.
        cues: what happens before dwells after it.
        calibrations: identities of those that have come before the first dwell, the last one last.
        dwells: which ones.
        times: when their frames were recorded.
    """

    bag: Path
    namespace: str
    makers: tuple[str, ...]
    parameters: NodeParameters
    cues: tuple[Cue, ...]
    calibrations: tuple[str, ...]
    dwells: frozenset[DwellKey]
    times: LogTimes


@dataclass
class Losses:
    """What was left out, and what nodes warn of.

    Attributes:
        dropped: number of dwells, or of messages that cannot be used, that a node left out, by node and reason.
        messages: how many of these were messages, by node and reason.
        warned: number of dwells that a node warns of, which are used all the same, by node and what it warns of.
        sentences: on the first of each kind, and of what was not used besides dwells and messages.
    """

    dropped: Counter[str] = field(default_factory=Counter)
    messages: Counter[str] = field(default_factory=Counter)
    warned: Counter[str] = field(default_factory=Counter)
    sentences: dict[str, str] = field(default_factory=dict)

    def drop(self, node: str, error: UserError, *, message: bool = False) -> None:
        """Count a dwell, or a message, that a node leaves out."""
        kind = f"{node}: {error.reason if isinstance(error, Rejected) else 'cannot be processed'}"
        self.dropped[kind] += 1
        self.messages[kind] += message
        self.warn(kind, error)

    def warn_of(self, node: str, error: Rejected) -> None:
        """Count a dwell that a node warns of."""
        kind = f"{node}: {error.reason}"
        self.warned[kind] += 1
        self.warn(f"{WARNED}{kind}", error)

    @property
    def dwells(self) -> int:
        """Number of dwells that were left out."""
        return self.dropped.total() - self.messages.total()

    def told(self, dwells: int) -> list[str]:
        """What became of so many dwells: of each kind how many, and the sentence on the first one."""
        return [f"{self._counted(kind, dwells)}{sentence}" for kind, sentence in self.sentences.items()]

    def counts(self) -> dict[str, Counter[str]]:
        """What a report says."""
        return {"dropped": self.dropped, "warned": self.warned}

    def _counted(self, kind: str, dwells: int) -> str:
        """A sentence on how many of a kind there are, and a space; empty if they are not counted."""
        if kind.startswith(WARNED):
            kind = kind.removeprefix(WARNED)
            return f"There is a warning on {self.warned[kind]} of {dwells} dwells ({kind}). "
        of_messages = self.messages[kind]
        of_dwells = self.dropped[kind] - of_messages
        said = [f"{of_dwells} of {dwells} dwells"] if of_dwells else []
        if of_messages:
            said.append(f"{of_messages} message{'s' if of_messages > 1 else ''}")
        verb = "was" if self.dropped[kind] == 1 else "were"
        return f"{' and '.join(said)} {verb} left out ({kind}). " if said else ""

    def warn(self, kind: str, error: UserError) -> None:
        """Keep the sentence if it is the first of its kind."""
        self.sentences.setdefault(kind, str(error))

    def add(self, other: Losses) -> None:
        """Take in what was left out elsewhere, later on."""
        self.dropped.update(other.dropped)
        self.messages.update(other.messages)
        self.warned.update(other.warned)
        self.sentences = {**other.sentences, **self.sentences}


class InForce:
    """The parameters of nodes, which cues change from dwell to dwell."""

    def __init__(self, parameters: NodeParameters, cues: Iterable[Cue]) -> None:
        """Begin with these; `cues` are those of all dwells to come."""
        self._values = {node: dict(of_node) for node, of_node in parameters.items()}
        self._cues = {cue.dwell: cue for cue in cues}
        self._made: dict[str, Any] = {}

    def go_on_to(self, dwell: DwellKey) -> tuple[str, ...]:
        """Change what changes before a dwell, and return the calibrations that come before it."""
        cue = self._cues.pop(dwell, None)
        if cue is None:
            return ()
        for node, values in cue.parameters.items():
            self._values.setdefault(node, {}).update(values)
            self._made.pop(node, None)
        return cue.calibrations

    def values(self) -> dict[str, dict[str, Any]]:
        """The values that are in force, by node and name."""
        return {node: dict(of_node) for node, of_node in self._values.items()}

    def of(self, node: str) -> Any:
        """The parameters of a node."""
        if node not in self._made:
            self._made[node] = parameters_of(node, self._values.get(node, {}))
        return self._made[node]


@dataclass(frozen=True, eq=False)
class Compressed:
    """The images of a dwell, or of what a block completes of a strip.

    Attributes:
        slc: the images.
        images: their messages, of all channels.
        frames: that they were made from.
        sensor: that took them.
        supplies: odometry and calibration.
        calibration: that was applied; None: none.
        time_ns: when the last frame was recorded.
    """

    slc: Slc
    images: Sequence[messages.ReceivedImage]
    frames: Sequence[messages.ReceivedFrame]
    sensor: Sensor
    supplies: Supplies
    calibration: Calibration | None
    time_ns: int


class RecordedDwells:
    """The dwells of a work, which are gathered and compressed in their order."""

    def __init__(self, work: Work, reader: BagReader) -> None:
        """Read what holds for all dwells.

        Raises:
            UserError: it cannot be processed without a graph.
        """
        self.losses = Losses()
        self.work = work
        self.in_force = InForce(work.parameters, work.cues)
        if self._compression.mounting_from_tf:
            raise UserError(
                f"Bag {work.bag} was processed with mounting_from_tf, which needs a graph; use `sal-height replay`."
            )
        self.sensors, refused = sensors_of(reader)
        for error in refused:
            self.losses.warn("sensor info", error)
        self._calibrations = self._calibrations_of(reader)
        self._heard: dict[str, Calibration] = {}
        self._listen(work.calibrations)
        self._odometry = OdometryHistory(self._compression.odometry_held_s)
        self._air = AirHistory()
        for topic in AIR_TOPICS:
            self.hear_air(islice(reader.messages([topic]), 1))  # dwells before the first message have waited for it
        self._assembler = DwellAssembler[messages.ReceivedFrame]()
        self._last_frame_ns: dict[Key, int] = {}
        self._compressor = Compressor()

    def made(self, compressed: Compressed) -> None:
        """Take the images of a dwell."""
        raise NotImplementedError

    @property
    def _compression(self) -> Any:
        """Parameters of the compression."""
        return self.in_force.of(COMPRESSION)

    def compression_of(self, sensor: Sensor) -> Any:  # noqa: ARG002 (subclasses use it)
        """The same for the dwells of a sensor."""
        return self._compression

    def read(self, reader: BagReader, doing: str) -> None:
        """Take in all frames, odometry and air of a bag, with a progress bar that says what is done."""
        count = sum(reader.topics[topic].count for topic in TAKEN if topic in reader.topics)
        for recorded in tqdm(reader.messages(TAKEN), total=count, unit="message", desc=doing):
            self.take(recorded)
        self.end()

    def take(self, recorded: BagMessage) -> None:
        """Take in a frame or a sample of odometry or air, and process the dwells that have all they need then."""
        self._give_up(recorded.log_time_ns)
        try:
            if recorded.topic == ODOMETRY_TOPIC:
                pose = messages.received_pose(recorded.cdr)
                self._odometry.add(messages.state_of_pose(pose, self._compression.frames))
            elif recorded.topic in AIR_TOPICS:
                self.hear_air([recorded])
            else:
                self._gather(messages.received_frame(recorded.cdr), recorded.log_time_ns)
        except UserError as error:
            self.losses.drop(COMPRESSION, error, message=True)
        except RuntimeError as error:
            broken = Rejected("broken", f"A message cannot be decoded: {error}.")
            self.losses.drop(COMPRESSION, broken, message=True)
        unfinished = self._assembler.held()
        surplus = len(unfinished) - self._compression.max_unfinished_dwells
        for place, dwell in enumerate(unfinished):
            if place >= surplus and not (dwell.is_whole and self._is_covered(dwell)):
                return
            self._process(dwell)

    def hear_air(self, recorded: Iterable[BagMessage]) -> None:
        """Take in messages on the air; those that cannot be used are told."""
        for one in recorded:
            topic = AIR_TOPICS[one.topic]
            if one.type_name != (quantity := messages.AIR[topic]).type_name:
                continue
            try:
                self._air.add(topic, messages.read_air(topic, messages.deserialize(one.cdr, quantity.message_type)))
            except (UserError, RuntimeError) as error:
                self.losses.warn("air", UserError(f"A message on {topic} is not used. {error}"))

    def _give_up(self, log_time_ns: int) -> None:
        """Wait no longer for channels of dwells of which none was recorded in the last `timeout_s`.

        Those behind them would wait as well, until their odometry is forgotten.
        """
        for dwell in self._assembler.held():
            if not dwell.is_whole and log_time_ns - self._last_frame_ns[dwell.key] > 1e9 * self._compression.timeout_s:
                self._process(dwell)

    def end(self) -> None:
        """Process the dwells that are left, as far as they can be."""
        for dwell in self._assembler.held():
            self._process(dwell)

    def _gather(self, frame: messages.ReceivedFrame, log_time_ns: int) -> None:
        """Add a frame to its dwell.

        Raises:
            Rejected: it cannot be used.
        """
        if DwellKey(frame.dwell, frame.stamp_ns) not in self.work.dwells:
            return
        sensor = self.sensors.get(frame.config_hash)
        if sensor is None:
            raise Rejected("no sensor info", f"No sensor info has the config_hash {frame.config_hash!r} of a frame.")
        messages.check_frame(frame, sensor)
        key = Key(frame.config_hash, frame.dwell, frame.stamp_ns)
        self._assembler.add(key, sensor, frame.channel, frame, 0.0)
        self._last_frame_ns[key] = log_time_ns

    def _is_covered(self, dwell: Dwell[messages.ReceivedFrame]) -> bool:
        """Whether there is odometry after the last pulse of a dwell."""
        span = self._odometry.span_ns
        return span is not None and span[1] >= dwell.messages[0].end_ns

    def _process(self, dwell: Dwell[messages.ReceivedFrame]) -> None:
        """Compress a dwell, or count it as left out."""
        self._assembler.take(dwell)
        self._listen(self.in_force.go_on_to(DwellKey(dwell.key.number, dwell.key.stamp_ns)))
        time_ns = self._last_frame_ns.pop(dwell.key)
        try:
            frames = self._frames_of(dwell)
            supplies = self._supplies(frames, dwell.sensor)
            parameters = self.compression_of(dwell.sensor)
            found = compress_dwell(frames, dwell.sensor, supplies, self._compressor, parameters)
        except UserError as error:
            self.losses.drop(COMPRESSION, error)
            return
        for warning in warnings_of(dwell.key.number, found[0] if found else None, self._compressor):
            self.losses.warn_of(COMPRESSION, warning)
        if found is None:
            return
        slc, serialized = found
        images = [messages.received_image(cdr) for cdr in serialized]
        applied = applied_calibration(images[0], dwell.sensor)
        calibration = self._calibrations[applied] if applied else None
        self.made(Compressed(slc, images, frames, dwell.sensor, supplies, calibration, time_ns))

    def _frames_of(self, dwell: Dwell[messages.ReceivedFrame]) -> list[messages.ReceivedFrame]:
        """The frames of all channels, blank ones for those that are absent if that is allowed.

        Raises:
            Rejected: it is not.
        """
        parameters = self._compression
        if dwell.is_whole:
            return dwell.messages
        if parameters.missing_channels != "proceed" or len(dwell.items) < parameters.min_channels:
            raise Rejected("incomplete dwell", f"Dwell {dwell.key.number}: channels {dwell.absent} are not in the bag.")
        return with_blanks(dwell)

    def _supplies(self, frames: Sequence[messages.ReceivedFrame], sensor: Sensor) -> Supplies:
        """Odometry, calibration and air of a dwell.

        Raises:
            UserError: odometry has a gap, the calibration cannot be read, or the air is not known.
        """
        delay_ns = self._compression.odometry_delay_ns
        states = self._odometry.around(frames[0].stamp_ns + delay_ns, frames[0].end_ns + delay_ns)
        limit = self._compression.max_odometry_gap_s
        if longest_gap_s(states) > limit:
            raise Rejected(
                GAP,
                f"Dwell {frames[0].dwell}: {ODOMETRY} in the bag does not reach from its first pulse to its last with "
                f"a sample every {limit:g} s (max_odometry_gap_s).",
            )
        air = heard_air(self._air, frames[0], sensor, states, self._compression)
        return Supplies(states, self._calibration_for(sensor), sensor.mounting, air)

    def _calibration_for(self, sensor: Sensor) -> Calibration | None:
        """The calibration to apply.

        Raises:
            UserError: its file cannot be read.
        """
        source = self._compression.calibration
        if source in {"", HEARD}:
            return self._heard.get(sensor.config_hash) if source else None
        if source not in self._calibrations:
            loaded = load_calibration(Path(source))
            self._calibrations |= {source: loaded, loaded.id: loaded}
        return self._calibrations[source]

    def _calibrations_of(self, reader: BagReader) -> dict[str, Calibration]:
        """The calibrations of a bag that can be used, by their identity."""
        calibrations = {}
        for recorded in reader.messages([CALIBRATIONS]):
            try:
                one = messages.calibration_from_message(reader.decode(recorded.type_name, recorded.cdr))
            except UserError as error:
                self.losses.warn("calibration", error)
            else:
                calibrations[one.id] = one
        return calibrations

    def _listen(self, calibrations: Iterable[str]) -> None:
        """Have these calibrations come; nodes do not use those that cannot be used either."""
        for one in filter(self._calibrations.__contains__, calibrations):
            calibration = self._calibrations[one]
            self._heard[calibration.config_hash] = calibration
