"""The one exception whose text is written for the user."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Self

LONGEST, LONGEST_END = 1000, 300
"""Characters that a message may have, and those that are left of the end of a longer one."""


class UserError(ValueError):
    """Something from outside (file, parameter, message) cannot be used.

    The text is one message: what is wrong, where, and what is allowed. The command line prints it and exits with
    status 2; nodes count it and carry on. A message may quote input of any length: of a long one the
    middle is left out, for nodes publish it with their diagnostics again and again.
    """

    def __init__(self, sentence: str = "") -> None:
        if len(sentence) > LONGEST:
            sentence = f"{sentence[: LONGEST - LONGEST_END - 3]} … {sentence[-LONGEST_END:]}"
        super().__init__(sentence)


class Rejected(UserError):  # noqa: N818 (not an error of the program)
    """A message that a node counts and leaves out.

    Attributes:
        reason: short name under which it is counted, e.g. "wrong size".
    """

    def __init__(self, reason: str, sentence: str) -> None:
        super().__init__(sentence)
        self.reason = reason

    def __reduce__(self) -> tuple[type[Self], tuple[str, str]]:
        """Class and arguments, for copies in other processes."""
        return type(self), (self.reason, str(self))


class NotDetermined(UserError):  # noqa: N818 (not an error of the program)
    """The data do not determine what was to be estimated.

    The message states what is missing, and what would be needed.
    """


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A hint at the closest of the known names, to stand behind a wrong one; empty: none is close."""
    closest = get_close_matches(name, list(known), n=1)
    return f" (did you mean {closest[0]!r}?)" if closest else ""
