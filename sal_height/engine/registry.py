"""The stages that there are, by the names of their nodes, in the order of the data."""

from __future__ import annotations

from collections.abc import Mapping

from sal_height.elevation import ESTIMATORS
from sal_height.engine.adjuster import HeightAdjuster
from sal_height.engine.calibrator import PsfCalibration
from sal_height.engine.compression import Compression
from sal_height.engine.height_items import Heights
from sal_height.engine.heights import height_stage
from sal_height.engine.mapper import GroundMapper, ReliefMapper
from sal_height.engine.movers import MoverDetection
from sal_height.engine.navigation import NavigationStage
from sal_height.engine.stage import Stage
from sal_height.engine.tracker import Tracker
from sal_height.topics import SLC

_ALL: tuple[type[Stage], ...] = (
    NavigationStage,
    Compression,
    *map(height_stage, ESTIMATORS),
    PsfCalibration,
    MoverDetection,
    ReliefMapper,
    GroundMapper,
    Tracker,
    HeightAdjuster,
)

STAGES: Mapping[str, type[Stage]] = {stage.usual_name: stage for stage in _ALL}
"""Every stage by its usual name."""


def product_of(stage: type[Stage]) -> str:
    """Prefix of the ports of the heights that a stage makes; empty: it makes none."""
    ports = stage.outputs(stage.settings())
    return next((port.name.removesuffix("/height") for port in ports if port.kind is Heights), "")


def takes_heights(stage: type[Stage]) -> bool:
    """True if a stage processes the heights of the estimator that its setting `estimator` names."""
    return any(port.kind is Heights for port in stage.inputs(stage.settings()))


def takes_images(stage: type[Stage]) -> bool:
    """True if a stage processes the images of all channels."""
    return any(port.name == SLC for port in stage.inputs(stage.settings()))
