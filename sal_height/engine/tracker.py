"""Stage relief_tracker: smooths the heights of an estimator into tracked heights.

The prior with which a dwell is smoothed follows from it and from those before it of the same series: one sensor, and
heights made and tracked with the same parameters. The same dwells in the same order give the same heights.
"""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Hashable, Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from sal_height.elevation import ESTIMATORS
from sal_height.engine.geometry_items import Aperture
from sal_height.engine.height_items import Heights, heights_port, packed
from sal_height.engine.heights import HEIGHTS_ABOUT
from sal_height.engine.provenance import CACHED, LEFT_OUT, Provenance, Same
from sal_height.engine.results import DwellKey, Product, Result
from sal_height.engine.settings import MapFrameSettings
from sal_height.engine.stage import Job, Port, Rehearsal, Reset, Stage, StageSettings
from sal_height.rehearsal import made_up_heights
from sal_height.relief import PriorEstimate, TrackingSettings, track
from sal_height.settings import setting

PREFIX = "tracked"
"""Prefix of the topics, and estimator of the heights."""

SERIES_KEPT = 8
"""Number of series of dwells whose priors are kept: those that arrived last."""


_NOWHERE = DwellKey("", 0, 0)
"""Key of made-up heights."""


class TrackerSettings(MapFrameSettings, StageSettings, TrackingSettings):
    """Settings of the stage."""

    estimator: str = setting(
        "ml",
        "estimator whose heights are smoothed; they are received on topic <estimator>/height",
        choices=tuple(ESTIMATORS),
        read_only=True,
    )


class Tracker(Stage):
    """Smooths the heights of each image with a Gauss-Markov prior, along range and along track."""

    usual_name = "relief_tracker"
    about = "Smooths the heights of each image with a Gauss-Markov prior, along range and along track."
    settings = TrackerSettings

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self._rehearsed = False
        # The heavy side.
        self._priors: dict[Hashable, PriorEstimate] = {}

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:
        """Heights of an estimator."""
        return [heights_port(settings.estimator)]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        """The smoothed heights."""
        return [Port(f"{PREFIX}/height", Heights, HEIGHTS_ABOUT)]

    @property
    def is_ready(self) -> bool:
        """True if made-up heights have been tracked: the first dwell takes no longer then."""
        return self._rehearsed

    def begin(self, stamp_ns: int) -> None:  # noqa: ARG002
        """Rehearse."""
        self.add_own_job(Rehearsal())

    def receive(self, port: str, item: Heights) -> None:  # noqa: ARG002
        """Make a job of the heights of a dwell."""
        self.apply_scheduled(item.key)
        self.add_job(item.key, item, size=item.size, series=self.name)

    def forget(self) -> None:
        """Track the next dwell as the first one."""
        self.add_own_job(Reset(), self.own_series)

    def follow(self, job: Job, results: Sequence[Result]) -> None:  # noqa: ARG002
        """Be ready once it has rehearsed."""
        self._rehearsed = self._rehearsed or isinstance(job.inputs, Rehearsal)

    def work(self, job: Job) -> Iterator[Result]:
        """Smooth the heights of a dwell."""
        if isinstance(job.inputs, Reset):
            self._priors = {}
        elif isinstance(job.inputs, Heights):
            yield from self.smoothed(job.inputs, job.settings)
        else:
            self._rehearse(job.settings)

    def smoothed(self, heights: Heights, settings: TrackerSettings) -> Iterator[Result]:
        """The smoothed heights of a dwell, and a warning if it has bad pixels.

        Raises:
            UserError: the heights cannot be smoothed.
        """
        heights.check_frame(settings.map_frame)
        field = heights.field
        yield from heights.notices()
        series = _series_of(heights, settings)
        before = self._priors.pop(series, PriorEstimate())  # to be the last that is forgotten
        tracked, prior, after = track(field, heights.aperture.state, before, settings)
        self._priors = dict([*self._priors.items(), (series, after)][-SERIES_KEPT:])
        provenance = heights.provenance.derived(self.name, settings)
        product = dataclasses.replace(
            heights,
            estimator=PREFIX,
            aperture=Aperture.of(heights.aperture.state),
            provenance=provenance.stating(f"{self.name}.prior.", vars(prior)) if prior else provenance,
            **packed(tracked),
        )
        yield Product(f"{PREFIX}/height", product)

    def _rehearse(self, settings: TrackerSettings) -> None:
        list(Tracker(settings).smoothed(made_up_item(settings.map_frame), settings))


def made_up_item(frame_id: str) -> Heights:
    """Heights of level ground in a frame of coordinates, which a stage processes before the first real ones.

    They are as another process has sent them: compiled loops are loaded for arrays that may be written or may not.
    """
    field, aperture = made_up_heights(np.random.default_rng(0))
    item = Heights(
        key=_NOWHERE,
        frame_id=frame_id,
        estimator="ml",
        aperture=Aperture.of(aperture),
        looks=(1, 1),
        provenance=Provenance(),
        **packed(field),
    )
    received: Heights = pickle.loads(pickle.dumps(item, protocol=5))  # noqa: S301 (our own bytes)
    return received


def _series_of(heights: Heights, settings: TrackerSettings) -> tuple[Hashable, ...]:
    """Common properties of the heights of a series: sensor, calibration, and how they are made and tracked.

    Which channels had to be left out, and what was found in the data, whose names have a dot, may change from dwell to
    dwell, and does not end a series.
    """
    provenance = heights.provenance
    made = _parameters_of(Same(provenance))
    return provenance.config_hash, provenance.calibration_id, heights.estimator, made, settings


@lru_cache(CACHED)
def _parameters_of(same: Same[Provenance]) -> str:
    """The values in a provenance that are parameters of stages, as a text."""
    return repr(
        {
            stage: {name: value for name, value in values.items() if _is_set(name)}
            for stage, values in same.one.stages.items()
        }
    )


def _is_set(name: str) -> bool:
    """True if a name in the provenance is that of a parameter."""
    return "." not in name and name != LEFT_OUT
