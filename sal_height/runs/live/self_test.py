"""Test of the core before the sensor of a live run starts: it makes tables, and measures how fast the core is."""

from __future__ import annotations

import bisect
import math
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.elevation import ElevationEstimator
from sal_height.engine.heights import HeightStage
from sal_height.engine.registry import STAGES
from sal_height.errors import UserError
from sal_height.geometry import PlatformState, Trajectory
from sal_height.graph.catalogue import TRACKER
from sal_height.graph.node_classes import NODES
from sal_height.nodes.playing.playlist import Playlist
from sal_height.pipeline import Compressor, heights
from sal_height.rehearsal import made_up_heights, rehearse_heights
from sal_height.relief import PriorEstimate, track
from sal_height.sensor import Sensor

TEST_S = 0.25
"""Processor time of the test, s, after the first dwell, which is slower than the others."""


def make_tables(sensor: Sensor, stages: list[str], values: Mapping[str, Mapping[str, Any]]) -> None:
    """Process a made-up dwell, so that nodes that are forked later find all tables made and all code loaded.

    Args:
        sensor: sensor whose dwells will arrive.
        stages: names of the processing nodes.
        values: values of their parameters.
    """
    parameters = {name: NODES[name].parameters(**values.get(name, {})) for name in stages}
    rng = np.random.default_rng(0)
    with suppress(UserError):  # its node will say why
        estimators = [(estimator, parameters[name]) for name, estimator in _estimators(stages).items()]
        rehearse_heights(sensor, parameters["sar_compression"], estimators, rng)
        if TRACKER in stages:
            track(*made_up_heights(rng), PriorEstimate(), parameters[TRACKER])


def core_rate_hz(
    playlist: Playlist, sensor: Sensor, stages: list[str], values: Mapping[str, Mapping[str, Any]], processors: int
) -> float:
    """Dwells per second that N processors could compress, turn into heights and track, without any messages.

    It is an upper bound of what the graph achieves: messages need time as well. Infinity: there are too few
    dwells to estimate it.

    Args:
        playlist: dwells to process.
        sensor: sensor of the dwells.
        stages: names of the processing nodes.
        values: values of their parameters.
        processors: number of processors that the nodes may use.
    """
    parameters = {name: NODES[name].parameters(**values.get(name, {})) for name in stages}
    estimators = _estimators(stages)
    states = [messages.state_from_message(message) for message in playlist.odometry]
    compressor, prior = Compressor(), PriorEstimate()
    begun: float | None = None
    dwells, spent_s = 0, 0.0
    for frames in playlist.frames():
        try:
            history = messages.history_from_messages(frames)
            way = _track_of(states, history.stamp_ns, history.stamp_of_last_pulse_ns)
            slc = compressor.add(history, way, sensor, parameters["sar_compression"])
            if slc is None:
                continue
            fields = [heights(slc, sensor, estimators[name], parameters[name]) for name in estimators]
            if TRACKER in stages:
                _, _, prior = track(fields[0], slc.aperture, prior, parameters[TRACKER])
        except UserError:
            continue  # its node will say why
        if begun is None:
            begun = time.process_time()
            continue
        dwells, spent_s = dwells + 1, time.process_time() - begun
        if spent_s > TEST_S:
            break
    return processors * dwells / spent_s if dwells else math.inf


def _track_of(states: list[PlatformState], begin_ns: int, end_ns: int) -> Trajectory:
    """The odometry around a dwell: passes have turns between them, for which it has no states.

    Raises:
        UserError: it is empty, or contradicts itself.
    """
    stamps = [state.stamp_ns for state in states]
    first = max(0, bisect.bisect_right(stamps, begin_ns) - 1)
    return Trajectory(states[first : bisect.bisect_left(stamps, end_ns) + 1])


def _estimators(stages: list[str]) -> dict[str, ElevationEstimator]:
    """Estimators of the stages that estimate heights, by the name of the stage."""
    return {name: stage.estimator for name in stages if issubclass(stage := STAGES[name], HeightStage)}
