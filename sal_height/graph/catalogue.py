"""The stages of a run by the names of their nodes, their settings, and what connects them; without ROS."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from sal_height.elevation import ESTIMATORS, ElevationEstimator
from sal_height.engine.adjuster import ADJUSTED_ODOMETRY
from sal_height.engine.compression import HEARD, SENSOR
from sal_height.engine.movers import MOVERS
from sal_height.engine.registry import STAGES, product_of, takes_heights, takes_images
from sal_height.errors import UserError, did_you_mean
from sal_height.geometry import Origin
from sal_height.renamed import with_new_names
from sal_height.sensor import Sensor
from sal_height.settings import Settings, settings_of, unknown_name
from sal_height.topics import CALIBRATION, LOSSES, ODOMETRY, PHASE_HISTORY, SENSOR_INFO, SLC, TF, TF_STATIC

HEIGHTS = {name: product for name, stage in STAGES.items() if (product := product_of(stage))}
"""Stages whose products are height images, and the prefix of their topics."""

SETTABLE = tuple(name for name in STAGES if name != "navigation")
"""Stages of a run or replay whose settings users may set."""

TRACKER = "relief_tracker"
"""Node that tracks the heights of one estimator."""

ADJUSTER = "height_adjuster"
"""Node that adjusts the heights of one estimator to those of earlier dwells; asked for as if it were an estimator."""

DETECTOR = "mover_detection"
"""Node that finds movers; asked for as if it were an estimator, by the name of its topic."""

MAPPERS = ("relief_mapper", "ground_mapper")
"""Nodes that make maps."""

CALIBRATOR = "psf_calibration"
"""Node that calibrates the sensor on its images."""

NodeParameters = Mapping[str, Mapping[str, Any]]
"""Parameter values by node name and parameter name."""


def check_parameters(parameters: NodeParameters, settable: Sequence[str] = SETTABLE) -> dict[str, dict[str, Any]]:
    """Check parameters of `settable` nodes and convert them to the declared types (a whole number to a float).

    Raises:
        UserError: a node or parameter does not exist, or a value is not allowed.
    """
    checked: dict[str, dict[str, Any]] = {}
    for name, values in parameters.items():
        if name not in settable:
            raise UserError(
                f"There is no node {name!r}{did_you_mean(name, settable)} with parameters to set; allowed are "
                f"{', '.join(settable)}."
            )
        checked[name] = check_values(name, STAGES[name].settings, values)
    return checked


def check_values(node: str, model: type[Settings], values: Mapping[str, Any]) -> dict[str, Any]:
    """Check values of parameters of a node by old or new names, and convert them to the types that `model` declares.

    Raises:
        UserError: a parameter does not exist, or a value is not allowed.
    """
    values = with_new_names(values)
    if unknown := [key for key in values if key not in settings_of(model)]:
        raise UserError(unknown_name(unknown[0], settings_of(model), f"Node {node}"))
    try:
        accepted = _settings_with(model, values)
    except UserError as error:
        raise UserError(f"Node {node}: {error}") from error
    return {key: getattr(accepted, key) for key in values}


def parameters_of(node: str, values: Mapping[str, Any]) -> Any:
    """The parameters of a node with these values, and default ones for the others; lists stand for tuples.

    Raises:
        UserError: a value is not allowed.
    """
    return _settings_with(STAGES[node].settings, with_new_names(values))


def _settings_with(model: type[Settings], values: Mapping[str, Any]) -> Any:
    plain: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    return model(**plain)


def suited(sensor: Sensor, asked: Collection[str] = ()) -> list[str]:
    """The height nodes of a run: those of the estimators that are asked for, in the order of ESTIMATORS.

    Args:
        sensor: sensor whose channels the estimators read.
        asked: names of estimators; none: those that suit the sensor and need not be asked for. With the name of the
            adjuster's product that node follows them; it needs heights of an estimator. With that of the topic of
            movers the node that finds these is the last one.

    Raises:
        UserError: there is no estimator of that name, or it does not suit the sensor.
    """
    if MOVERS in asked:
        return [*suited(sensor, [name for name in asked if name != MOVERS]), DETECTOR]
    if HEIGHTS[ADJUSTER] in asked:
        return [*suited(sensor, [name for name in asked if name != HEIGHTS[ADJUSTER]]), ADJUSTER]
    suiting = _suiting(sensor)
    if not asked:
        return [estimator.node for estimator in suiting.values() if estimator.by_default]
    if wrong := [name for name in asked if name not in suiting]:
        raise _refusal(wrong[0], [*suiting, HEIGHTS[ADJUSTER], MOVERS] if suiting else [])
    return [estimator.node for name, estimator in suiting.items() if name in asked]


def check_estimator(name: str, sensor: Sensor) -> None:
    """Refuse what makes no heights of each dwell by itself, as do the products of the adjuster and of the detector.

    Raises:
        UserError: a name is unknown, or does not suit the sensor.
    """
    if name not in (suiting := _suiting(sensor)):
        raise _refusal(name, list(suiting))


def _suiting(sensor: Sensor) -> dict[str, ElevationEstimator]:
    """Estimators that suit the channels of a sensor, by name."""
    return {name: estimator for name, estimator in ESTIMATORS.items() if estimator.suits(sensor)}


def _refusal(name: str, allowed: Sequence[str]) -> UserError:
    """Message on an estimator that is not available."""
    reason = "does not suit the sensor's channels" if name in ESTIMATORS else "does not exist"
    hint = "" if name in ESTIMATORS else did_you_mean(name, allowed)
    return UserError(f"Estimator {name!r} {reason}{hint}; allowed are {', '.join(allowed) or 'none'}.")


def consumers(estimators: list[str]) -> dict[str, dict[str, str]]:
    """Parameters that connect nodes to heights that are made: of maximum likelihood, or the first.

    Mappers read adjusted ones where these are made.

    Args:
        estimators: height nodes of a run.
    """
    taken = {}
    if estimators and ESTIMATORS["ml"].node not in estimators:
        taken = dict.fromkeys((TRACKER, ADJUSTER, *MAPPERS), HEIGHTS[estimators[0]])
    if ADJUSTER in estimators:
        taken |= dict.fromkeys(MAPPERS, HEIGHTS[ADJUSTER])
    return {name: {"estimator": prefix} for name, prefix in taken.items()}


def placed(origin: Origin | None) -> dict[str, dict[str, float]]:
    """Parameters of mappers for the position of the map's origin on the earth; None: it is not known."""
    if origin is None:
        return {}
    latitude, longitude = math.degrees(origin.latitude), math.degrees(origin.longitude)
    values = {"origin_latitude_deg": latitude, "origin_longitude_deg": longitude, "origin_height_m": origin.height}
    return {name: dict(values) for name in MAPPERS}


def recorded_topics(stages: list[str], parameters: NodeParameters, played: Sequence[str] = SENSOR) -> list[str]:
    """The topics that a run through `stages` records: its inputs, and its heights, or else its images.

    Images are left out if there are heights, for they can be formed again from the phase history; so is the relief map,
    which follows from the heights. For viewers that do not know our messages, heights are recorded as pictures and
    points, too, with the frames of these, of the platform and of the sensor.
    """
    products = [HEIGHTS[name] for name in stages if name in HEIGHTS]
    heights = [f"{product}/height" for product in products]
    applied = parameters.get("sar_compression", {}).get("calibration", "") not in {"", HEARD}
    calibration = [CALIBRATION] if applied else []
    odometry = [ADJUSTED_ODOMETRY] if ADJUSTER in stages else []
    found = [MOVERS] if DETECTOR in stages else []
    return [
        *played,
        "diagnostics",
        LOSSES,
        *calibration,
        *(heights or [SLC]),
        *odometry,
        *found,
        *_views(products, played),
    ]


def _views(products: Sequence[str], played: Sequence[str]) -> list[str]:
    """The topics for viewers: pictures and points of products, and the frames that are known."""
    views = [f"{product}/{view}" for product in products for view in ("image", "points")]
    moving = [TF.lstrip("/")] if products or ODOMETRY in played else []
    fixed = [TF_STATIC.lstrip("/")] if SENSOR_INFO in played else []
    return [*views, *moving, *fixed]


def height_sources(stages: list[str], parameters: NodeParameters, played: Sequence[str] = SENSOR) -> dict[str, str]:
    """Find, for each of the `stages` that uses heights, the topic on which they arrive.

    Args:
        stages: names of the processing nodes.
        parameters: values of the nodes' parameters; `estimator` says whose heights a node uses.
        played: topics that the source of the dwells publishes.

    Raises:
        UserError: none of the stages makes those heights, nor are they played.
    """
    given = [topic.removesuffix("/height") for topic in played if topic.endswith("/height")]
    sources = {}
    for name in (stage for stage in stages if takes_heights(STAGES[stage])):
        prefix = parameters.get(name, {}).get("estimator", "ml")
        makers = [*given, *(HEIGHTS[node] for node in stages if node in HEIGHTS and node != name)]
        if prefix not in makers:
            raise UserError(
                f"The heights of estimator {prefix!r}, which {name} takes, are not made here; allowed are "
                f"{', '.join(makers)}."
            )
        sources[name] = f"{prefix}/height"
    return sources


def stage_inputs(stages: list[str], parameters: NodeParameters, played: Sequence[str] = SENSOR) -> dict[str, str]:
    """Find the topic whose messages each stage counts as received.

    Args:
        stages: names of the processing nodes.
        parameters: values of the nodes' parameters.
        played: topics that the source of the dwells publishes.

    Raises:
        UserError: a stage reads heights that no other stage makes.
    """
    inputs = {name: SLC if takes_images(STAGES[name]) else PHASE_HISTORY for name in stages}
    return inputs | height_sources(stages, parameters, played)
