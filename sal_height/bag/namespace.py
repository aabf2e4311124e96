"""Bags of graphs in a namespace, read as if they had none."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

from sal_height.bag.reader import ALWAYS, BagMessage, BagReader, LogTimes
from sal_height.errors import UserError


class NamespacedReader(BagReader):
    """A bag whose topics of a namespace have their names without it; those outside keep their names.

    A topic outside that is called like one of the namespace is left out.

    Attributes:
        namespace: with a leading slash; empty: none.
    """

    def __init__(self, path: Path, namespace: str) -> None:
        """Read the index of the bag at `path`; UserError with the remedy if it is not a complete bag."""
        super().__init__(path)
        self.namespace = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
        within = {name.removeprefix(self.namespace): name for name in self.topics if self.holds(name)}
        self._recorded_names = {name: name for name in self.topics if not self.holds(name)} | within
        self._names = {recorded: name for name, recorded in self._recorded_names.items()}
        self.topics = {
            name: replace(self.topics[recorded], name=name) for name, recorded in self._recorded_names.items()
        }

    def holds(self, name: str) -> bool:
        """Whether a topic or node is in the namespace, by its whole name."""
        return name.startswith(f"{self.namespace}/")

    def recorded_messages(
        self, topics: Collection[str] | None = None, times: LogTimes = ALWAYS
    ) -> Iterator[BagMessage]:
        """Messages in order of log time, those of `topics` or all, as recorded but for the names of the topics.

        UserError if a checksum or a record is found to be wrong on the way.
        """
        wanted = self._recorded_names if topics is None else topics
        names = [self._recorded_names[name] for name in wanted if name in self._recorded_names]
        for message in super().recorded_messages(names, times):
            yield message._replace(topic=self._names[message.topic])


def open_bag(path: Path, namespace: str | None, needed: Collection[str]) -> NamespacedReader:
    """Read a bag in the namespace in which it has one of the topics that are needed.

    Args:
        path: of the bag.
        namespace: its name, with or without leading slash; None: none if there are such topics without one, or the only
            one that has them.
        needed: names of topics, of which one is enough, without leading slash.

    Raises:
        UserError: the bag cannot be used, or there are several namespaces that have them, or none of that name has.
    """
    endings = tuple(f"/{name}" for name in needed)
    topics = BagReader(path).topics
    having = {name[: -len(end)] for name in topics for end in endings if name.endswith(end)}
    listed = ", ".join(sorted(name or "/" for name in having)) or "none"
    if namespace is not None:
        reader = NamespacedReader(path, namespace)
        if reader.namespace not in having:
            raise UserError(
                f"Bag {path} has no topic {' or '.join(needed)} in namespace {namespace!r}; namespaces that have are "
                f"{listed}."
            )
        return reader
    if len(having) > 1 and "" not in having:
        raise UserError(
            f"Bag {path} has {' or '.join(needed)} in several namespaces ({listed}); choose one by --namespace."
        )
    return NamespacedReader(path, "" if "" in having or not having else having.pop())
