"""Write a bag of an older version of sal_height_msgs again, with the messages of today."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from sal_height.bag.files import ACCOUNT
from sal_height.bag.reader import BagReader, Topic, kept_custom_data, kept_packing
from sal_height.bag.versions import PACKAGE
from sal_height.bag.writer import BagWriter
from sal_height.errors import UserError
from sal_height.messages.definition import Definition, known_definition


def upgrade(path: Path, out_directory: Path) -> Counter[str]:
    """Write the bag at `path` with its messages converted to those of today, in one file.

    Messages of other packages, and those of sal_height_msgs that have not changed, stay byte for byte, with their
    times; custom data stay, and parameters from a file next to an older bag are added to them.

    Returns:
        Number of upgraded messages by topic.

    Raises:
        UserError: the bag is damaged or not complete, or the folder is not empty.
    """
    reader = BagReader(path)
    made: Counter[str] = Counter()
    account = reader.indexes[-1].records.get(ACCOUNT) if reader.indexes else None
    try:
        with BagWriter(out_directory, kept_custom_data(reader), kept_packing(reader)) as bag:
            for topic in reader.topics.values():
                bag.add_topic(topic.name, topic.type_name, topic.offered_qos, _definition_of(topic))
            for message in reader.messages():
                bag.write(message.topic, message.cdr, message.log_time_ns, message.publish_time_ns)
                made[message.topic] += reader.topics[message.topic].is_old
            bag.close({ACCOUNT: account} if account else {})
    except OSError as error:
        raise UserError(f"Bag {out_directory} cannot be written: {error}.") from error
    return +made


def _definition_of(topic: Topic) -> Definition:
    """Today's definition of the messages of a topic; that in the bag if they are of another package."""
    if topic.is_old:
        return known_definition(topic.type_name)
    if not topic.type_name.startswith(PACKAGE):
        return topic.definition
    try:
        known = known_definition(topic.type_name)
    except UserError:  # a type that no longer exists
        return topic.definition
    return known if topic.definition.same_layout(known) else topic.definition
