"""Dwells and messages that were left out, by stage and reason."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from sal_height.engine.results import Loss, Notice

WARNED = "warned by "
"""Prefix of the kinds of warnings on dwells that are used all the same."""


@dataclass
class Losses:
    """Dwells and messages that were left out, and warnings of stages.

    Attributes:
        dropped: number of dwells, or of messages that cannot be used, that a stage left out, by stage and reason.
        messages: number of messages among these, by stage and reason.
        warned: number of dwells that a stage warns of, which are used all the same, by stage and kind.
        ignored: number of messages of no dwell that could not be used, by stage and kind.
        sentences: messages to users on the first of each kind, and on anything else that was not used, by kind.
    """

    dropped: Counter[str] = field(default_factory=Counter)
    messages: Counter[str] = field(default_factory=Counter)
    warned: Counter[str] = field(default_factory=Counter)
    ignored: Counter[str] = field(default_factory=Counter)
    sentences: dict[str, str] = field(default_factory=dict)

    def add(self, stage: str, result: Loss | Notice) -> None:
        """Count a loss or a warning of a stage."""
        if isinstance(result, Notice):
            self.warn_of(stage, result)
            return
        kind = f"{stage}: {result.reason}"
        self.dropped[kind] += 1 if result.is_dwell else result.messages
        self.messages[kind] += 0 if result.is_dwell else result.messages
        self.note(kind, result.sentence)

    def warn_of(self, stage: str, notice: Notice) -> None:
        """Count a dwell that a stage warns of, or a message of no dwell that it could not use."""
        kind = f"{stage}: {notice.kind}"
        if notice.dwell is None:
            self.ignored[kind] += 1
            self.note(kind, notice.sentence)
            return
        self.warned[kind] += 1
        self.note(f"{WARNED}{kind}", notice.sentence)

    def note(self, kind: str, sentence: str) -> None:
        """Keep a message if it is the first of its kind."""
        self.sentences.setdefault(kind, sentence)

    @property
    def dwells(self) -> int:
        """Number of dwells that were left out."""
        return self.dropped.total() - self.messages.total()

    def described(self, dwells: int) -> list[str]:
        """Number of each kind out of `dwells`, and the message on the first one."""
        return [f"{self._counted(kind, dwells)}{sentence}" for kind, sentence in self.sentences.items()]

    def counts(self) -> dict[str, Counter[str]]:
        """Counts for a report."""
        return {"dropped": self.dropped, "warned": self.warned, "ignored": self.ignored}

    def _counted(self, kind: str, dwells: int) -> str:
        """Message on the number of a kind, and a space; empty if they are not counted."""
        if kind.startswith(WARNED):
            kind = kind.removeprefix(WARNED)
            return f"There is a warning on {self.warned[kind]} of {dwells} dwells ({kind}). "
        if ignored := self.ignored[kind]:
            return f"{ignored} message{'s were' if ignored > 1 else ' was'} not used ({kind}). "
        of_messages = self.messages[kind]
        of_dwells = self.dropped[kind] - of_messages
        said = [f"{of_dwells} of {dwells} dwells"] if of_dwells else []
        if of_messages:
            said.append(f"{of_messages} message{'s' if of_messages > 1 else ''}")
        verb = "was" if self.dropped[kind] == 1 else "were"
        return f"{' and '.join(said)} {verb} left out ({kind}). " if said else ""

    def as_json(self) -> dict[str, Any]:
        """All counts and messages."""
        return vars(self)
