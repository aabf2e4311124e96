"""A simulated flight on the chain host: its messages are fed to stages that are joined by calls, without ROS."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import Any

from sal_height.bag.reader import BagMessage
from sal_height.engine.chain import Chain, Made
from sal_height.engine.compression import SENSOR
from sal_height.engine.stage import FOREVER_NS
from sal_height.messages import serialize
from sal_height.messages.flight import FlightMessage, dwell_messages, first_messages
from sal_height.messages.kinds import kind_of_topic
from sal_height.progress import Bar
from sal_height.runs.chain.chain_runs import COMPRESSION
from sal_height.runs.chain.stage_run import Fed, StageRun
from sal_height.simulation import SimulatedFlight
from sal_height.topics import TF_STATIC


class FlightRun(StageRun):
    """The dwells of a simulated flight, processed by stages that are joined by calls.

    As in a graph of nodes, a message is recorded when the last pulse of its dwell has been sent, and the next dwell
    follows once all that is due has been made of it.
    """

    def __init__(self, flight: SimulatedFlight, start_ns: int, settings: Mapping[str, Any], jobs: int) -> None:
        """Make the stages.

        Args:
            flight: flight.
            start_ns: stamp of its start, ns.
            settings: settings by the names of the stages, in the order of the data.
            jobs: dwells that are processed side by side.

        Raises:
            UserError: the settings of a stage contradict each other, or a file cannot be read.
        """
        super().__init__(settings, jobs)
        self._flight, self._start_ns = flight, start_ns

    @property
    def begin_ns(self) -> int:
        """Stamp of the start of the flight, ns."""
        return self._start_ns

    def results(self, doing: str = "", fed: Fed | None = None) -> Iterator[Made]:
        """Products that the stages make of the dwells, and their losses, as of `StageRun.results`."""
        with ExitStack() as stack:
            yield from self.accounted(self._made(self.joined(stack), doing, fed))

    def _made(self, chain: Chain, doing: str, fed: Fed | None) -> Iterator[Made]:
        yield from chain.start(self.begin_ns)
        yield from self._feed(chain, first_messages(self._flight, self.begin_ns), self.begin_ns, fed)
        yield from chain.nothing_before(TF_STATIC, FOREVER_NS)
        for dwell in Bar(range(self._flight.dwells), unit="dwell", desc=doing, disable=not doing):
            end_ns = self.begin_ns + self._flight.dwell_end_ns(dwell)
            yield from self._feed(chain, dwell_messages(self._flight, dwell, self.begin_ns), end_ns, fed)
            next_ns = self.begin_ns + self._flight.dwell_start_ns(dwell) + 1
            for port in SENSOR:
                yield from chain.nothing_before(port, next_ns)
        yield from chain.finish()

    def _feed(self, chain: Chain, published: Iterator[FlightMessage], now_ns: int, fed: Fed | None) -> Iterator[Made]:
        for topic, message, _ in published:
            cdr = serialize(message)
            items = kind_of_topic(topic).read(cdr, self.settings.get(COMPRESSION))
            if fed:
                fed(topic, BagMessage(topic, message.__msgtype__, cdr, now_ns, now_ns), items)
            for item in items:
                yield from chain.feed(topic, item)
