"""The way from frames to heights in a chain: compression and estimators, joined by calls."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from flown_items import Item, flight_items, small_flight

from sal_height.engine.chain import Chain
from sal_height.engine.compression import Compression
from sal_height.engine.height_items import Heights
from sal_height.engine.heights import height_stage
from sal_height.engine.stage import Loss, Notice, Product
from sal_height.simulation import SimulatedFlight

IMAGE = {"rows": 46, "cols": 12}
DETECTORS = 8


class Chained:
    """A chain that items are fed to, and what has come of them.

    Attributes:
        heights: by estimator and dwell.
        losses: by stage.
        notices: of all stages.
    """

    def __init__(
        self,
        image: Mapping[str, Any] = MappingProxyType(IMAGE),
        heights: Mapping[str, Any] = MappingProxyType({}),
        estimators: Iterable[str] = ("monopulse", "ml"),
    ) -> None:
        """Settings: `image` of the compression, `heights` of the estimators."""
        kinds = [Compression, *map(height_stage, estimators)]
        settings = [Compression.settings(**image), *(kind.settings(**heights) for kind in kinds[1:])]
        stages = [kind(values) for kind, values in zip(kinds, settings, strict=True)]
        self.stages = {stage.name: stage for stage in stages}
        self.chain = Chain(stages, settings)
        self.chain._at_once = dict.fromkeys(stages, 1)  # so that nothing waits for other dwells
        self.heights: dict[tuple[str, int], Heights] = {}
        self.losses: dict[str, list[Loss]] = {name: [] for name in self.stages}
        self.notices: list[Notice] = []
        self._keep(self.chain.start())

    def feed(self, items: Iterable[Item]) -> Chained:
        """Items arrive."""
        for item in items:
            self._keep(self.chain.feed(*item))
        return self

    def finish(self) -> Chained:
        """Nothing more arrives."""
        self._keep(self.chain.finish())
        return self

    def announce(self, port: str, stamp_ns: int) -> None:
        """The source announces what will not arrive."""
        self._keep(self.chain.nothing_before(port, stamp_ns))

    def lost(self, stage: str = "sar_compression") -> dict[str, int]:
        """Messages that a stage has lost, by reason."""
        return {
            reason: sum(one.messages for one in self.losses[stage] if one.reason == reason)
            for reason in dict.fromkeys(one.reason for one in self.losses[stage])
        }

    def _keep(self, results: Iterable[Any]) -> None:
        for made in results:
            if isinstance(made.result, Product) and isinstance(made.result.item, Heights):
                item = made.result.item
                self.heights[item.estimator, item.key.number] = item
            elif isinstance(made.result, Loss):
                self.losses[made.stage.name].append(made.result)
            elif isinstance(made.result, Notice):
                self.notices.append(made.result)


_REFERENCE: dict[tuple[str, int], Heights] = {}


def reference() -> Mapping[tuple[str, int], Heights]:
    """Heights of the first dwells of the small flight when all is well."""
    if not _REFERENCE:
        _REFERENCE.update(Chained().feed(flight_items(small_flight(), dwells=range(2))).finish().heights)
    return _REFERENCE


def heights_of(flight: SimulatedFlight, dwells: Iterable[int] = (0,), **settings: Any) -> Chained:
    """What a chain makes of some dwells of a flight."""
    return Chained(**settings).feed(flight_items(flight, dwells=dwells)).finish()
