"""Results of stages: products, and what is said and counted of the rest."""

from __future__ import annotations

import traceback
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from sal_height.errors import Rejected, UserError


class DwellKey(NamedTuple):
    """Key that distinguishes dwells: a sensor that starts again may count them from 0 again.

    Attributes:
        sensor: config_hash of its description.
        number: number of the dwell.
        stamp_ns: time of its first pulse, ns.
    """

    sensor: str
    number: int
    stamp_ns: int


@dataclass(frozen=True, eq=False)
class Product:
    """An item for a port; rounded as its message is, so that readers of the message have the same item."""

    port: str
    item: Any


@dataclass(frozen=True, eq=False)
class FileProduct:
    """A product that the host writes to a file.

    Attributes:
        path: path of the file; an existing one is replaced.
        item: content; its class says how it is written.
        remark: message for the log once it is written; empty: no message.
    """

    path: str
    item: Any
    remark: str = ""


@dataclass(frozen=True)
class Loss:
    """Messages that a stage left out.

    Attributes:
        dwell: dwell of the messages; None: not known, or no dwell.
        messages: number of messages.
        reason: name under which they are counted.
        sentence: message on what is wrong, where, and what to do.
        trace: trace of an error that no input should cause; empty otherwise.
        is_dwell: True if the whole dwell is left out; False: messages that could not be part of it.
    """

    dwell: DwellKey | None
    messages: int
    reason: str
    sentence: str
    trace: str = ""
    is_dwell: bool = True


@dataclass(frozen=True)
class Notice:
    """A message of no dwell that could not be used, or a warning about a dwell that is used all the same.

    Attributes:
        kind: name under which it is counted.
        sentence: message on what is wrong, where, and what to do.
        dwell: dwell that it is about; None: no dwell.
        trace: trace of an error that no input should cause; empty otherwise.
    """

    kind: str
    sentence: str
    dwell: DwellKey | None = None
    trace: str = ""


@dataclass(frozen=True)
class Event:
    """Something worth counting that costs no message.

    Attributes:
        name: name under which it is counted.
        dwell: dwell before which the stage was reset; None: another event.
        times: number of times that it happened.
    """

    name: str
    dwell: DwellKey | None = None
    times: int = 1

    @property
    def loss(self) -> Loss | None:
        """A loss of no message, by which a bag states a reset."""
        if self.dwell is None:
            return None
        return Loss(self.dwell, 0, self.name, f"The node was reset before dwell {self.dwell.number}.")


@dataclass(frozen=True)
class Remark:
    """A message for the log that counts nothing."""

    sentence: str


@dataclass(frozen=True)
class Answer:
    """The result of a command, as reported to its caller."""

    success: bool
    sentence: str


Result: TypeAlias = Product | FileProduct | Loss | Notice | Event | Remark | Answer


def reason_of(error: Exception) -> str:
    """Name under which an error is counted."""
    if isinstance(error, Rejected):
        return error.reason
    return "cannot be processed" if isinstance(error, UserError) else "internal error"


def loss_of(error: Exception, dwell: DwellKey | None, messages: int) -> Loss:
    """The loss of messages by an error; one that no input should cause has its trace."""
    if isinstance(error, UserError):
        return Loss(dwell, messages, reason_of(error), str(error))
    trace = "".join(traceback.format_exception(error))
    return Loss(dwell, messages, reason_of(error), repr(error), trace)
