"""`sal-height run`: simulate a flight, process it with the graph, and compare the heights with the truth."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import yaml

from sal_height.engine.compression import SENSOR
from sal_height.engine.registry import STAGES, takes_images
from sal_height.engine.track import ACCURACY
from sal_height.errors import UserError
from sal_height.graph.air import check_air
from sal_height.graph.catalogue import (
    HEIGHTS,
    TRACKER,
    NodeParameters,
    check_parameters,
    consumers,
    height_sources,
    parameters_of,
    placed,
    recorded_topics,
    suited,
)
from sal_height.graph.plan import DEFAULT, Execution, Outcome, Plan
from sal_height.graph.reporting import PARAMETERS, PRESET, RELIEF_MAP, SEED, conclude, merged, reporting
from sal_height.imaging import STANDARD_AIR, VACUUM
from sal_height.io import new_folder, write_text, writing
from sal_height.messages import AIR
from sal_height.precompile import precompile
from sal_height.runs.chain.recording import jobs_without_ros, perform_by_calls
from sal_height.runs.truth.flight_run import FlightRun
from sal_height.runs.truth.report import Accuracy, read_accuracy, read_images
from sal_height.simulation import Preset, SimulatedFlight, flight_of
from sal_height.topics import MAP_ORIGIN

START_NS = 1_735_689_600_000_000_000
"""Stamp of the start of every flight, ns: 1 January 2025, so that the bags of two runs with one seed are equal."""


@dataclass(frozen=True)
class Flown:
    """A flight that was simulated, processed and compared with the truth.

    Attributes:
        flight: flight that was simulated.
        outcome: outcome of the run.
        accuracy: errors of each estimator, and the heights and grounds that they are of.
        source: prefix of the topics of the estimator whose heights are tracked.
    """

    flight: SimulatedFlight
    outcome: Outcome
    accuracy: Accuracy
    source: str


def run(
    preset: Preset,
    seed: int,
    out: Path,
    parameters: NodeParameters,
    execution: Execution = DEFAULT,
    jobs: int | None = None,
) -> Flown:
    """Do what `fly` does, and leave pictures with it in `out`; without any valid height there are no pictures.

    Raises:
        UserError: errors of `fly`, or a picture cannot be written.
    """
    flown = fly(preset, seed, out, parameters, execution, jobs)
    _draw(flown, preset, out)
    return flown


def fly(
    preset: Preset,
    seed: int,
    out: Path,
    parameters: NodeParameters,
    execution: Execution = DEFAULT,
    jobs: int | None = None,
) -> Flown:
    """Simulate and process all dwells of `preset`; leaves a bag, report, map and preset.yaml in `out`.

    Without any valid height there is no map. The map (relief_map.tif) needs the package rasterio.

    Args:
        preset: sensor, flight, scene and processing.
        seed: seed of all random numbers.
        out: output folder; must be new or empty.
        parameters: values that replace parameters of nodes that follow from the preset.
        execution: execution of the run.
        jobs: dwells that are processed side by side without nodes; None: nodes process them one after the other,
            where ROS is installed.

    Raises:
        UserError: a parameter is not allowed, the flight leaves its scene, or the run failed.
    """
    parameters = check_parameters(merged(preset.processing, parameters))
    precompile()
    flight = flight_of(preset, seed)
    estimators = suited(flight.sensor, preset.estimators)
    air = list(AIR) if preset.impairments.air else []
    check_air(parameters, [flight.sensor], air, "A simulated flight without air (impairments)")
    flight.surface(0)  # refuses a flight outside the scene before anything is started
    jobs = jobs_without_ros(jobs)
    folder = new_folder(out)
    settings = folder / "preset.yaml"
    values = merged(parameters_of_flight(flight, estimators), parameters)
    simulator = {"preset": str(settings), "seed": seed, "period_s": 0.0, "start_ns": START_NS}
    relief = {"file": str(folder / RELIEF_MAP)} if find_spec("rasterio") else {}
    stages = ["sar_compression", *estimators, TRACKER, "relief_mapper"]
    bag = folder / "bag"
    known = {"preset": preset.name, "seed": seed, "cnr_db": preset.cnr_db, "looks": list(preset.looks)}
    with reporting(folder, known) as report:
        flown = json.dumps(dataclasses.asdict(preset))
        write_text(settings, yaml.safe_dump(json.loads(flown), sort_keys=False))
        custom_data = {PARAMETERS: json.dumps(values), PRESET: flown, SEED: str(seed)}
        nodes = merged({"simulator": simulator, "relief_mapper": relief}, values)
        published = [*SENSOR, *air, *([MAP_ORIGIN] if flight.scene.origin else [])]
        topics = recorded_topics(stages, values, published)
        plan = Plan("simulator", stages, topics, bag, nodes, preset.dwells, custom_data, published, simulated_time=True)
        outcome = _perform(plan, execution, flight, jobs)
        conclude(outcome, values, report)
        report["relief_map"] = RELIEF_MAP if (folder / RELIEF_MAP).is_file() else None
        accuracy = read_accuracy(bag, flight, stages)
        report["estimators"] = accuracy.statistics
    return Flown(flight, outcome, accuracy, height_sources(stages, values)[TRACKER].removesuffix("/height"))


def _perform(plan: Plan, execution: Execution, flight: SimulatedFlight, jobs: int | None) -> Outcome:
    """Process the dwells by nodes, or without them.

    Raises:
        UserError: the run has failed.
    """
    if jobs is None:
        from sal_height.graph.lockstep import perform  # noqa: PLC0415 (needs ROS)

        return perform(plan, execution)
    settings = {name: parameters_of(name, plan.parameters.get(name, {})) for name in plan.stages}
    return perform_by_calls(plan, execution, FlightRun(flight, START_NS, settings, jobs))


def parameters_of_flight(flight: SimulatedFlight, estimators: list[str]) -> dict[str, dict[str, Any]]:
    """Parameters of the nodes that follow from a preset.

    They are the size of its images, looks, air, position on the earth, and the accuracy of its odometry, whose
    covariances are zeros where it is exact.
    """
    preset = flight.preset
    air = STANDARD_AIR if preset.impairments.air else VACUUM
    odometry = {name: getattr(flight.odometry_accuracy, number) for name, number in ACCURACY.items()}
    looks = {"range_looks": preset.looks[0], "azimuth_looks": preset.looks[1]}
    own: dict[str, dict[str, Any]] = {
        "sar_compression": {"rows": preset.image.rows, "cols": preset.image.cols, "air": air, **odometry},
        **{name: dict(looks) for name in estimators if name in HEIGHTS and takes_images(STAGES[name])},
    }
    return merged(merged(own, consumers(estimators)), placed(flight.scene.origin))


def _draw(flown: Flown, preset: Preset, folder: Path) -> None:
    """Write the pictures of a flight into the folder of its bag.

    Raises:
        UserError: a picture cannot be written, or none of the images lies on the scene.
    """
    from sal_height.runs.truth.doubt_picture import draw_doubts  # noqa: PLC0415
    from sal_height.runs.truth.height_picture import draw_heights  # noqa: PLC0415
    from sal_height.runs.truth.pictures import (  # noqa: PLC0415 (brings Matplotlib)
        cloud_of,
        draw_cloud,
        draw_errors,
        draw_ground,
    )
    from sal_height.runs.truth.profile import draw_profile  # noqa: PLC0415

    accuracy, source = flown.accuracy, flown.source
    if accuracy.heights and not any(one.ground.inside.any() for one in accuracy.heights.values()):
        raise UserError(
            "By the odometry none of the images lies on the scene, so that there is no true height to compare with and "
            f"no picture; lower the errors in impairments: odometry: of the preset. The bag is in {folder}."
        )
    if source in accuracy.grounds:
        with writing(folder / "ground.png"):
            draw_ground(*accuracy.grounds[source], folder / "ground.png")
    if accuracy.heights:
        images = read_images(folder / "bag")
        shown = source if source in images else next(iter(accuracy.heights))
        with writing(folder / "height.png"):
            draw_heights(accuracy.heights, images[shown], preset, folder / "height.png")
        with writing(folder / "errors.png"):
            draw_errors(accuracy.heights, folder / "errors.png")
        with writing(folder / "scene3d.png"):
            draw_cloud(*cloud_of(accuracy.heights), preset, folder / "scene3d.png")
        with writing(folder / "profile.png"):
            draw_profile(images, source, flown.flight, folder / "profile.png")
        with writing(folder / "doubts.png"):
            draw_doubts(images, folder / "doubts.png")
