"""Stages of a run that are joined by calls: in this process, or with worker processes for jobs side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import Any

from sal_height.bag.reader import BagMessage
from sal_height.engine.chain import Chain, Made
from sal_height.engine.losses import Losses
from sal_height.engine.registry import STAGES
from sal_height.engine.results import FileProduct, Loss, Notice
from sal_height.engine.stage import Stage
from sal_height.runs.chain.side_by_side import SideBySide
from sal_height.stage_files import read_inputs, write_product
from sal_height.topics import SENSOR_INFO

Fed = Callable[[str, BagMessage, Sequence[Any] | None], None]
"""Receives each message that is fed: its port, the message, and the items that were read from it; None: it cannot be
decoded, and is left out."""


class StageRun:
    """Stages with their settings, and what they have left out and written so far.

    Attributes:
        settings: settings of the stages, by their names.
        stages: stages by their names, in the order of the data.
        losses: losses so far.
        files: contents of the files that stages have made so far.
    """

    def __init__(self, settings: Mapping[str, Any], jobs: int = 1) -> None:
        """Make the stages.

        Args:
            settings: settings by the names of the stages, in the order of the data.
            jobs: dwells that are processed side by side.

        Raises:
            UserError: the settings of a stage contradict each other, or a file cannot be read.
        """
        self.settings = dict(settings)
        self.stages: dict[str, Stage] = {}
        for name, values in self.settings.items():
            kind = STAGES[name]
            self.stages[name] = kind(values, read_inputs(kind, values), name)
        self.losses = Losses()
        self.files: list[FileProduct] = []
        self._jobs = jobs

    @property
    def begin_ns(self) -> int:
        """Time of the first message, ns."""
        raise NotImplementedError

    def results(self, doing: str = "", fed: Fed | None = None) -> Iterator[Made]:
        """Products that the stages make of the dwells, and their losses, which are counted, too.

        Args:
            doing: label of a progress bar; empty: no progress bar.
            fed: callback that receives each message that is fed.

        Raises:
            UserError: a worker has ended, or a file cannot be read or written.
        """
        raise NotImplementedError

    def joined(self, stack: ExitStack) -> Chain:
        """The chain of the stages; `stack` ends its workers."""
        stages, values = list(self.stages.values()), list(self.settings.values())
        for stage in stages:
            stage.nothing_before(SENSOR_INFO, 0)  # from here on no time-out counts
        if self._jobs > 1:
            return stack.enter_context(SideBySide(stages, values, self._jobs))
        return Chain(stages, values)

    def accounted(self, results: Iterable[Made]) -> Iterator[Made]:
        """Results, of which losses are counted and files are written.

        Raises:
            UserError: a file cannot be written.
        """
        for made in results:
            if isinstance(made.result, Loss | Notice):
                self.losses.add(made.stage.name, made.result)
            elif isinstance(made.result, FileProduct):
                write_product(made.result)
                self.files.append(made.result)
            yield made
