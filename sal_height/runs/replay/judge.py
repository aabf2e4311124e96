"""Judge a bag by a golden one: equal, within the tolerance, or changed; a picture of the worst dwell, and latencies."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.bag.compare import CHANGED, EQUAL, WITHIN, TopicComparison
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import Tolerances
from sal_height.errors import UserError
from sal_height.io import writing
from sal_height.nodes.accounts.account import DIAGNOSTICS, Account
from sal_height.numeric import F64
from sal_height.topics import TF, TF_STATIC

PICTURE = "comparison.png"

PASSING = frozenset({DIAGNOSTICS, "/parameter_events", "/progress", "/rosout"})
"""Topics that say how a run went, which is another time never the same."""


def draw_worst_dwell(golden: BagReader, made: BagReader, compared: Mapping[str, TopicComparison], folder: Path) -> None:
    """Draw the worst dwell of a comparison in `folder`/comparison.png, if the heights of any differ.

    Raises:
        UserError: a bag cannot be read, or the picture cannot be written.
    """
    from sal_height.runs.replay.difference_picture import draw_difference, worst_height_image  # noqa: PLC0415 (Matplotlib)

    if worst := worst_height_image(compared, golden):
        with writing(folder / PICTURE):
            draw_difference(golden, made, *worst, folder / PICTURE)


def verdict_of(compared: Mapping[str, TopicComparison]) -> str:
    """The worst verdict of all topics; EQUAL, WITHIN or CHANGED, which it also is without topics."""
    verdicts = {one.verdict for one in compared.values()} or {CHANGED}
    return next(verdict for verdict in (CHANGED, WITHIN, EQUAL) if verdict in verdicts)


def as_json(
    golden: BagReader, made: BagReader, compared: Mapping[str, TopicComparison], tolerances: Tolerances
) -> dict[str, Any]:
    """Entries of a report on a comparison of two bags; latencies are the last ones that the nodes published.

    Raises:
        UserError: a bag cannot be read.
    """
    latencies = [
        {node: float(rows[1, -1]) for node, rows in published_latencies(one).items()} for one in (golden, made)
    ]
    return {
        "verdict": verdict_of(compared),
        "golden": golden.path.name,
        "tolerances": tolerances.as_json(),
        "topics": {topic: one.as_json() for topic, one in compared.items()},
        "latency_p50_ms": {
            node: {"golden": latencies[0].get(node), "made": latencies[1].get(node)}
            for node in sorted({*latencies[0], *latencies[1]})
        },
    }


def topics_to_compare(golden: BagReader, made: BagReader, named: Collection[str]) -> list[str]:
    """Topics of two bags whose content can be compared: those named, or all but those that say how a run went.

    Pictures, points and frames for viewers are compared only if both bags have them.

    Raises:
        UserError: a bag cannot be read, or a topic that is named is in neither.
    """
    known = list(dict.fromkeys([*golden.topics, *made.topics]))
    wanted = [f"/{topic.removeprefix('/')}" for topic in named]
    if lost := [topic for topic in wanted if topic not in known]:
        raise UserError(f"Neither bag has topic {lost[0]}; they have {', '.join(known)}.")
    both = golden.topics.keys() & made.topics.keys()
    return wanted or [topic for topic in known if topic not in PASSING and (topic in both or not _is_view(topic))]


def _is_view(topic: str) -> bool:
    """True if a topic is for viewers: what it shows is on other topics, too."""
    return topic in {TF, TF_STATIC} or topic.endswith(("/image", "/points"))


def published_latencies(bag: BagReader) -> dict[str, F64]:
    """Latencies that the nodes published in a bag, by node.

    Returns:
        Time since the first diagnostics (s), median and 95th percentile (ms) of the node's last thousand dwells, shape
        (3, times); nodes that published none are left out.
    """
    published: dict[str, list[tuple[float, float, float]]] = {}
    begin_ns = None
    for recorded in bag.messages([DIAGNOSTICS]) if DIAGNOSTICS in bag.topics else ():
        begin_ns = recorded.log_time_ns if begin_ns is None else begin_ns
        for status in bag.decode(recorded.type_name, recorded.cdr).status:
            account = Account.of_status(status)
            latencies = account.latency_p50_ms, account.latency_p95_ms
            if all(map(math.isfinite, latencies)):
                time_s = (recorded.log_time_ns - begin_ns) * 1e-9
                published.setdefault(status.name, []).append((time_s, *latencies))
    return {node: np.array(rows).T for node, rows in published.items()}
