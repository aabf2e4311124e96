"""A stage of thirty lines: which part of each height image has a height."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from sal_height.elevation import USABLE
from sal_height.engine.height_items import Heights
from sal_height.engine.results import DwellKey, Product, Result
from sal_height.engine.stage import Job, Port, Stage, StageSettings
from sal_height.settings import setting


class CoverageSettings(StageSettings):
    estimator: str = setting("ml", "estimator whose heights are counted", read_only=True)


class Coverage(NamedTuple):
    key: DwellKey
    fraction: float


class CoverageStage(Stage):
    usual_name = "coverage"
    about = "Counts the pixels that have a height."
    settings = CoverageSettings

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:
        return [Port(f"{settings.estimator}/height", Heights, "heights", counted=True)]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        return [Port("coverage", Coverage, "part of the pixels that have a height")]

    def receive(self, port: str, item: Heights) -> None:  # noqa: ARG002
        self.apply_scheduled(item.key)
        self.add_job(item.key, item, size=item.size)

    def work(self, job: Job) -> Iterator[Result]:
        usable = np.isin(job.inputs.field.validity, list(USABLE))
        yield Product("coverage", Coverage(job.inputs.key, float(np.mean(usable))))
