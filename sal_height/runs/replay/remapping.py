"""Other names of topics in a replay: of topics of the bag, which nodes know by theirs, and of topics of the nodes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sal_height.bag.reader import BagReader
from sal_height.bag.sensor_topics import FRAMES, IMAGES
from sal_height.bag.topics import FRAME_TYPE, HEIGHT_TYPE, IMAGE_TYPE, ODOMETRY_TYPE, SENSOR_TYPE
from sal_height.errors import UserError
from sal_height.graph.catalogue import HEIGHTS
from sal_height.messages import AIR, AIR_TYPES
from sal_height.runs.chain.entry import FROM_HEIGHTS
from sal_height.topics import CALIBRATION, ODOMETRY, SENSOR_INFO

KNOWN: Mapping[str, str] = {
    f"/{SENSOR_INFO}": SENSOR_TYPE,
    f"/{ODOMETRY}": ODOMETRY_TYPE,
    f"/{FRAMES}": FRAME_TYPE,
    **{f"/{topic}": quantity.type_name for topic, quantity in AIR.items()},
    f"/{IMAGES}": IMAGE_TYPE,
    **{f"/{prefix}/height": HEIGHT_TYPE for prefix in HEIGHTS.values()},
}
"""Topics that a replay reads from a bag: the names by which nodes know them, and their types."""


@dataclass(frozen=True)
class Remapping:
    """Other names of topics, by their own.

    Attributes:
        of_bag: names of topics of nodes, by the topic of the bag, with leading slash, that is read as it.
        of_nodes: names, without leading slash, under which topics of the nodes are published and recorded.
    """

    of_bag: Mapping[str, str] = field(default_factory=dict)
    of_nodes: Mapping[str, str] = field(default_factory=dict)

    @property
    def in_new_bag(self) -> dict[str, str]:
        """The names by which nodes know the topics of the bag that is made, by those that they have there."""
        return {f"/{new}": f"/{old}" for old, new in self.of_nodes.items()}

    def check(self, played: Sequence[str], stages: Sequence[str]) -> None:
        """Refuse names of topics that no node of the run has, or that two topics would have in common.

        Args:
            played: topics of the player.
            stages: names of the nodes that process.

        Raises:
            UserError: there is such a name.
        """
        if not self.of_nodes:
            return
        known = _topics_of(played, stages)
        for old, new in self.of_nodes.items():
            if old not in known:
                raise UserError(
                    f"Option --remap: neither the bag nor a node of this replay has a topic {old!r}; nodes have "
                    f"{', '.join(sorted(known))}."
                )
            if new in known and new not in self.of_nodes:
                raise UserError(
                    f"Option --remap: {old} cannot be called {new!r}, for that is another topic of the nodes; choose "
                    "another name."
                )

    def report(self) -> dict[str, dict[str, str]]:
        """Entries of the report on the names."""
        return {"remapped": {**self.of_bag, **{f"/{old}": f"/{new}" for old, new in self.of_nodes.items()}}}


UNCHANGED = Remapping()


def remapping_of(rules: Sequence[str], bag: Path, entry: str) -> Remapping:
    """Find out which topics of a bag, and which of nodes, get other names.

    A rule is for the bag if that has OLD and nodes know NEW, apart from a namespace before it, and either NEW is played
    or nodes do not know OLD.

    Args:
        rules: rules of the form OLD:=NEW, as in ROS: the topic OLD gets the name NEW.
        bag: bag that is replayed.
        entry: topic that the replay starts with, one of `entry.ENTRIES`.

    Raises:
        UserError: the bag cannot be read, a rule has another form, a topic of the bag another type than its new name
            stands for, or two topics would get one name.
    """
    if not rules:
        return UNCHANGED
    topics, played = BagReader(bag).topics, _played_types(entry)
    of_bag: dict[str, str] = {}
    of_nodes: dict[str, str] = {}
    for rule in rules:
        old, new = _names_of(rule)
        if old in {**of_bag, **of_nodes} or new in {*of_bag.values(), *of_nodes.values()}:
            raise UserError(f"Option --remap {rule} renames a topic, or names one, that another --remap does, too.")
        kind = next((kind for name, kind in KNOWN.items() if new.endswith(name)), None)
        if old in topics and kind and (KNOWN.get(new) in played or old not in KNOWN):
            if topics[old].type_name != kind:
                raise UserError(
                    f"Option --remap {rule}: topic {old} of bag {bag} is of type {topics[old].type_name}, and {new} "
                    f"must be of {kind}."
                )
            of_bag[old] = new
        else:
            of_nodes[old] = new
    return Remapping(of_bag, {old[1:]: new[1:] for old, new in of_nodes.items()})


def _played_types(entry: str) -> set[str]:
    """Message types that are played from an entry on."""
    if entry == FROM_HEIGHTS:
        return {HEIGHT_TYPE}
    return {SENSOR_TYPE, IMAGE_TYPE} if entry == IMAGES else {SENSOR_TYPE, ODOMETRY_TYPE, FRAME_TYPE, *AIR_TYPES}


def _names_of(rule: str) -> tuple[str, str]:
    """The two topics of a rule, with leading slash.

    Raises:
        UserError: it has another form.
    """
    from rclpy.exceptions import InvalidTopicNameException  # noqa: PLC0415 (replays without rules need no ROS)
    from rclpy.validate_full_topic_name import validate_full_topic_name  # noqa: PLC0415

    names = rule.split(":=")
    try:
        old, new = (name if name.startswith("/") else f"/{name}" for name in names)
        validate_full_topic_name(old)
        validate_full_topic_name(new)
    except (ValueError, InvalidTopicNameException) as error:
        raise UserError(
            f"Option --remap is {rule!r}; it must be of the form OLD:=NEW with names of topics, for example "
            "/radar/raw:=phase_history."
        ) from error
    return old, new


def _topics_of(played: Sequence[str], stages: Collection[str]) -> set[str]:
    """The topics of the nodes of a replay but those of ROS itself, such as /clock."""
    from sal_height.graph.node_classes import NODES  # noqa: PLC0415 (replays without rules need no ROS)

    named = {topic for stage in stages for topic in (*NODES[stage].inputs, *NODES[stage].outputs)}
    return {*played, CALIBRATION, *(topic for topic in named if not topic.startswith(("/", "<")))}
