"""Reasons to distrust a product, and tests of the assumptions behind it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

ALL_CHANNELS = -1
"""Value of `channel`: the dwell as a whole."""


class Doubt(NamedTuple):
    """A reason to distrust a product: something that nobody stated, or that the data contradict.

    Attributes:
        name: short name that does not change from dwell to dwell.
        sentence: warning that states what is doubtful, by how much, and what to do about it.
        channel: number of the channel that it concerns; ALL_CHANNELS: the dwell.
        size: size of what was found; NaN: it has none.
        unit: unit of the size.
        p_value: probability of this size or a larger one if nothing is wrong; NaN: not tested.
    """

    name: str
    sentence: str
    channel: int = ALL_CHANNELS
    size: float = np.nan
    unit: str = ""
    p_value: float = np.nan


class Assumption(NamedTuple):
    """A standard deviation that is assumed because nobody states it.

    Attributes:
        what: quantity and value, as in a message.
        parameter: name of the parameter that states it.
    """

    what: str
    parameter: str


class Unknown(NamedTuple):
    """An accuracy that nobody states.

    Attributes:
        what: sentence on what is not stated, without its full stop.
        where: places other than parameters where it could be stated.
    """

    what: str
    where: str


UNKNOWN_SENSOR = Unknown(
    "Nobody states how well the sensor is known",
    "(0: exact) under uncertainty in the sensor's description, in sensor_info,",
)


def doubts_of_assumed(name: str, unknown: Unknown, assumed: Sequence[Assumption]) -> tuple[Doubt, ...]:
    """The doubt about standard deviations that are assumed; none if there are none.

    Args:
        name: name of the doubt.
        unknown: what nobody states.
        assumed: standard deviations.
    """
    if not assumed:
        return ()
    sentence = (
        f"{unknown.what}; assumed are standard deviations of {_listed([one.what for one in assumed])}. State what is "
        f"known {unknown.where} or by {_listed([one.parameter for one in assumed])}."
    )
    return (Doubt(name, sentence),)


def _listed(names: Sequence[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


class FitTest(NamedTuple):
    """A test of the data of a dwell or channel against what was assumed of the sensor.

    Attributes:
        name: name of what was tested.
        channel: number of the channel that was tested; ALL_CHANNELS: the dwell.
        statistic: value of the test.
        p_value: probability of this statistic or a larger one if the assumptions are true.
        size: departure that fits best; NaN: not estimated.
        sigma: standard deviation of `size`.
        unit: unit of `size` and `sigma`.
    """

    name: str
    channel: int = ALL_CHANNELS
    statistic: float = np.nan
    p_value: float = np.nan
    size: float = np.nan
    sigma: float = np.nan
    unit: str = ""
