"""A sensor, and a user of its heights, that know DDS and nothing of ROS: a program on Eclipse Cyclone DDS.

Its types are made of the texts in msg_defs/. It publishes what a bag holds to the nodes of a domain, and writes the
heights that these publish into a folder, one file for each, in plain CDR. In its process is neither rclpy nor
sal_height.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct, types
from cyclonedds.idl.annotations import final
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import Nodetype

MSG_DEFS = Path(__file__).parents[2] / "msg_defs" / "msg"
TIMEOUT_S = 120.0
"""Longest wait for one thing, less than that of the test for the whole program, so that it is said for what."""

ACCOUNTS = 4
"""Of ml_height, one every half second, that come between the first heights and the next: a second passes at least.

Fast DDS sends a heartbeat when it finds a reader. Cyclone has mostly not found the writer by then, and hears only the
next one, 0.2 s after the first message. What has not arrived completely when that comes, Cyclone takes for older than
its reader, and never asks for it.
"""

LOOPBACK = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces></General>
<Discovery>
<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>119</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers>
</Discovery>
</Domain></CycloneDDS>"""
"""Nodes that keep to their machine (ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST) hear no multicast: they are addressed."""

PRIMITIVES = {
    "bool": bool,
    "string": str,
    **dict.fromkeys(("byte", "octet", "char"), types.uint8),
    **{f"{sign}int{bits}": getattr(types, f"{sign}int{bits}") for sign in ("", "u") for bits in (8, 16, 32, 64)},
    **{f"float{bits}": getattr(types, f"float{bits}") for bits in (32, 64)},
}

RELIABLE = Policy.Reliability.Reliable(max_blocking_time=10_000_000_000)
PLAIN_CDR = Policy.DataRepresentation(use_cdrv0_representation=True)
FRAMES = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(256), PLAIN_CDR)
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1), PLAIN_CDR)
PUBLISHED = {"/sensor_info": LATCHED, "/platform/odometry": FRAMES, "/phase_history": FRAMES}


class RosTypes:
    """DDS types of ROS messages, by the names that these have in ROS: ``sal_height_msgs/msg/ChannelFrame``."""

    def __init__(self, folder: Path) -> None:
        """Read the messages of sal_height_msgs from a folder; those of other packages are known."""
        store = get_typestore(Stores.ROS2_JAZZY)
        for file in folder.glob("*.msg"):
            store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"sal_height_msgs/msg/{file.stem}"))
        self._fields = store.fielddefs
        self._made: dict[str, type[IdlStruct]] = {}

    def __getitem__(self, name: str) -> type[IdlStruct]:
        """The type of that name, with all its parts, as the middleware of ROS calls it and lays it out."""
        if name not in self._made:
            package, _, word = name.split("/")
            fields = {field: self._idl(*kind) for field, kind in self._fields[name][1]}
            self._made[name] = final(make_idl_struct(word, f"{package}.msg.dds_.{word}_", fields))
        return self._made[name]

    def _idl(self, kind: Nodetype, detail: Any) -> Any:
        if kind == Nodetype.BASE:
            return PRIMITIVES[detail[0]]
        if kind == Nodetype.NAME:
            return self[detail]
        element, length = self._idl(*detail[0]), detail[1]
        if kind == Nodetype.ARRAY:
            return types.array[element, length]
        return types.sequence[(element, length) if length else element]


class Client:
    """Endpoints of one participant.

    Attributes:
        inbox: messages that have come, by topic.
    """

    def __init__(self, domain: int, ros_types: RosTypes) -> None:
        self.inbox: dict[str, list[Any]] = {}
        self._types = ros_types
        self._participant = DomainParticipant(domain)
        self._readers: dict[str, DataReader[Any]] = {}

    def writer(self, topic: str, type_name: str, qos: Qos) -> DataWriter[Any]:
        """What publishes messages on a topic of ROS."""
        return DataWriter(self._participant, self._topic(topic, type_name), qos=qos)

    def read(self, topic: str, type_name: str) -> None:
        """Put what is published on a topic of ROS into the inbox, while `wait` waits."""
        self._readers[topic] = DataReader(self._participant, self._topic(topic, type_name), qos=FRAMES)
        self.inbox[topic] = []

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Take messages until a condition holds; end the program if it does not in time."""
        deadline = time.monotonic() + TIMEOUT_S
        while not condition():
            if time.monotonic() > deadline:
                sys.exit(f"waited in vain for {what}")
            for topic, reader in self._readers.items():
                self.inbox[topic] += [message for message in reader.take(N=100) if isinstance(message, IdlStruct)]
            time.sleep(0.01)

    def says(self, node: str, key: str) -> int:
        """The number of that name in the last message of a node on /diagnostics; 0: there is none."""
        return [0, *self.said(node, key)][-1]

    def said(self, node: str, key: str) -> list[int]:
        """The numbers of that name in all messages of a node on /diagnostics, the oldest first."""
        statuses = [status for message in self.inbox["/diagnostics"] for status in message.status]
        items = [item for status in statuses if status.name == node for item in status.values]
        return [int(item.value) for item in items if item.key == key]

    def _topic(self, topic: str, type_name: str) -> Topic[Any]:
        return Topic(self._participant, f"rt{topic}", self._types[type_name])


def main() -> None:
    """Publish a bag to sar_compression and ml_height, and keep the heights of as many dwells."""
    parser = argparse.ArgumentParser()
    parser.add_argument("domain", type=int)
    parser.add_argument("bag", type=Path)
    parser.add_argument("out", type=Path, help="folder for the heights")
    parser.add_argument("--msg-defs", type=Path, default=MSG_DEFS, help="folder of the definitions to publish with")
    parser.add_argument("--states", default="", help="what is stated of phase_history: typehash=RIHS01_...;")
    options = parser.parse_args()

    os.environ["CYCLONEDDS_URI"] = LOOPBACK
    known, ours = RosTypes(MSG_DEFS), RosTypes(options.msg_defs)
    client = Client(options.domain, ours)
    client.read("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    client.read("/ml/height", "sal_height_msgs/msg/HeightImage")
    with Reader(options.bag) as bag:
        types_of = {c.topic: c.msgtype for c in bag.connections}
        recorded = [
            (c.topic, known[c.msgtype].deserialize(cdr)) for c, _, cdr in bag.messages() if c.topic in PUBLISHED
        ]
    qualities = PUBLISHED | {"/phase_history": Qos(*FRAMES, Policy.Userdata(options.states.encode()))}
    writers = {topic: client.writer(topic, types_of[topic], qos) for topic, qos in qualities.items()}

    def write(topic: str, dwell: int | None = None) -> None:
        ours_now = ours[types_of[topic]]
        for message in (message for name, message in recorded if name == topic):
            if dwell not in {None, getattr(message, "dwell", None)}:
                continue
            writers[topic].write(ours_now(**{name: getattr(message, name) for name in ours_now.__annotations__}))

    def is_ready() -> bool:
        heard = client.says("ml_height", "subscribers./ml/height")
        return bool(heard and client.says("ml_height", "ready") and client.says("sar_compression", "ready"))

    def is_in_step() -> bool:
        return client.said("ml_height", "published./ml/height").count(1) >= ACCOUNTS

    # Nodes are ready once they know the sensor, and a publisher of everything else.
    write("/sensor_info")
    client.wait(is_ready, "the nodes to be ready")
    write("/platform/odometry")
    for dwell in sorted({message.dwell for topic, message in recorded if topic == "/phase_history"}):
        write("/phase_history", dwell)
        client.wait(lambda until=dwell: until in {image.dwell for image in client.inbox["/ml/height"]}, "heights")
        client.wait(is_in_step, "accounts after the first heights")
    for image in client.inbox["/ml/height"]:
        (options.out / f"{image.dwell}.cdr").write_bytes(image.serialize(use_version_2=False))


if __name__ == "__main__":
    main()
