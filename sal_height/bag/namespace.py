"""Bags whose topics have other names than those of the nodes, read under the names of the nodes."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from sal_height.bag.reader import ALWAYS, BagMessage, BagReader, LogTimes
from sal_height.errors import UserError


class NamespacedReader(BagReader):
    """A bag whose topics of a namespace have their names without it; those outside keep their names.

    A topic outside with the name of one in the namespace is left out. So is one whose name has been given to another
    topic.

    Attributes:
        namespace: namespace with a leading slash; empty: none.
        renamed: other names of topics by recorded names.
    """

    def __init__(self, path: Path, namespace: str, renamed: Mapping[str, str] = MappingProxyType({})) -> None:
        """Read the index of the bag at `path`; UserError with the remedy if it is not a complete bag.

        Args:
            path: path of the bag.
            namespace: namespace of topics that are read without it; empty: none.
            renamed: other names of topics by recorded names, both with leading slash and namespace.
        """
        super().__init__(path)
        self.renamed = renamed
        self.namespace = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
        kept = {name: name for name in self.topics if name not in {*renamed, *renamed.values()}}
        known = kept | {new: old for old, new in renamed.items() if old in self.topics}
        within = {name.removeprefix(self.namespace): old for name, old in known.items() if self.contains(name)}
        self._recorded_names = {name: old for name, old in known.items() if not self.contains(name)} | within
        self._names = {recorded: name for name, recorded in self._recorded_names.items()}
        self.topics = {
            name: replace(self.topics[recorded], name=name) for name, recorded in self._recorded_names.items()
        }

    def contains(self, name: str) -> bool:
        """True if a topic or node is in the namespace, by its whole name."""
        return name.startswith(f"{self.namespace}/")

    def _recorded_name(self, topic: str) -> str:
        """The name under which a topic was recorded."""
        return self._recorded_names[topic]

    def recorded_messages(
        self, topics: Collection[str] | None = None, times: LogTimes = ALWAYS
    ) -> Iterator[BagMessage]:
        """Messages in order of log time, those of `topics` or all, as recorded but for the names of the topics.

        UserError if a checksum or a record is found to be wrong.
        """
        wanted = self._recorded_names if topics is None else topics
        names = [self._recorded_names[name] for name in wanted if name in self._recorded_names]
        for message in super().recorded_messages(names, times):
            yield message._replace(topic=self._names[message.topic])


def open_bag(
    path: Path, namespace: str | None, needed: Collection[str], renamed: Mapping[str, str] = MappingProxyType({})
) -> NamespacedReader:
    """Read a bag in the namespace in which it has one of the topics that are needed.

    Args:
        path: path of the bag.
        namespace: name of the namespace, with or without leading slash; None: the empty one if it has such topics, or
            the only one that has them.
        needed: names of topics without leading slash, of which one is enough.
        renamed: other names of topics by recorded names, both with leading slash and namespace.

    Raises:
        UserError: the bag cannot be used, or several namespaces have them, or the named one has none of them.
    """
    endings = tuple(f"/{name}" for name in needed)
    topics = NamespacedReader(path, "", renamed).topics
    having = {name[: -len(end)] for name in topics for end in endings if name.endswith(end)}
    listed = ", ".join(sorted(name or "/" for name in having)) or "none"
    if namespace is not None:
        reader = NamespacedReader(path, namespace, renamed)
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
    return NamespacedReader(path, "" if "" in having or not having else having.pop(), renamed)
