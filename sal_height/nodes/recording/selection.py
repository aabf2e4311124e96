"""Selection of the topics that are recorded."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence

from sal_height.errors import UserError
from sal_height.nodes.accounts.account import PROGRESS

NEVER_BY_DEFAULT = ("/rosout", "/parameter_events", PROGRESS)
"""Topics that are recorded only if they are asked for."""


class Selection:
    """The topics that are asked for by name, by a pattern of names, or by type; nothing asked for: all there are.

    Attributes:
        names: names of topics that are asked for.
        is_open: True if there may always be one more, so that the search for topics does not end.
    """

    def __init__(
        self,
        names: Iterable[str] = (),
        patterns: Sequence[str] = (),
        types: Iterable[str] = (),
        excluded: Sequence[str] = (),
    ) -> None:
        """Select topics.

        Args:
            names: names of topics, with their namespace.
            patterns: regular expressions that the whole name of a topic matches.
            types: types of messages, such as nav_msgs/msg/Odometry.
            excluded: regular expressions of names; they count only for topics that are not asked for by name.

        Raises:
            UserError: a regular expression is invalid.
        """
        self.names = frozenset(names)
        self._patterns, self._excluded = _compiled("patterns", patterns), _compiled("excluded", excluded)
        self._types = frozenset(types)
        self._is_all = not (self.names or self._patterns or self._types)
        self.is_open = bool(self._is_all or self._patterns or self._types)

    def wants(self, name: str, types: Collection[str]) -> bool:
        """True if a topic is to be recorded, whose publishers have these types."""
        if name in self.names:
            return True
        if any(pattern.fullmatch(name) for pattern in self._excluded):
            return False
        if self._is_all:
            return name not in NEVER_BY_DEFAULT
        return any(pattern.fullmatch(name) for pattern in self._patterns) or not self._types.isdisjoint(types)


def _compiled(parameter: str, patterns: Sequence[str]) -> list[re.Pattern[str]]:
    compiled = []
    for pattern in patterns:
        try:
            compiled.append(re.compile(pattern))
        except re.error as error:
            raise UserError(
                f"Parameter {parameter} has {pattern!r}, which is no regular expression ({error}); '/ml/.*' is one."
            ) from error
    return compiled
