"""`sal-height replay`: process a recorded bag with the same nodes, and compare the heights with the recorded ones."""

from __future__ import annotations

import json
import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sal_height.bag.compare import CHANGED, TopicComparison, compare_bags
from sal_height.bag.namespace import NamespacedReader, open_bag
from sal_height.bag.played import LOCKSTEP
from sal_height.bag.sensor_topics import FRAMES
from sal_height.bag.tolerance import ROUNDING, Tolerances
from sal_height.errors import UserError
from sal_height.graph.catalogue import HEIGHTS, TRACKER, NodeParameters, consumers, recorded_topics
from sal_height.graph.plan import DEFAULT, Execution, Outcome, Plan
from sal_height.graph.reporting import PARAMETERS, RELIEF_MAP, conclude, merged, reporting
from sal_height.io import new_folder, or_null, writing
from sal_height.response import measure_brightest
from sal_height.runs.chain.chain_runs import Scheme
from sal_height.runs.chain.entry import FROM_HEIGHTS, MAPPER, WHOLE, Part, chain_of
from sal_height.runs.chain.recorded_images import recorded_slc
from sal_height.runs.chain.replay_parameters import ReplayPlan, processing_of
from sal_height.runs.replay.judge import as_json, draw_worst_dwell
from sal_height.runs.replay.playing import IN_LOCKSTEP, Playing
from sal_height.runs.replay.remapping import remapping_of
from sal_height.runs.truth.accuracy import read_accuracy, recorded_flight
from sal_height.topics import CALIBRATION, SENSOR_INFO

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Against:
    """Tolerances and folder of the comparison with the golden heights.

    Attributes:
        golden: the bag whose heights are right; None: the bag that is replayed.
        tolerances: tolerances of values against the golden ones.
    """

    golden: Path | None = None
    tolerances: Tolerances = ROUNDING


RECORDED = Against()

HEIGHT_TOPICS = [f"{prefix}/height" for prefix in HEIGHTS.values()]


@dataclass(frozen=True)
class Replay:
    """Outcome of a replay.

    Attributes:
        outcome: outcome of the run.
        compared: comparison with the golden heights by topic; empty without common topics or after an interruption.
        accuracy: errors of each estimator (`report.statistics`) by prefix of its topics; empty unless the bag says from
            which simulated flight it is.
        images: measures of the brightest target of each image; empty unless the sensor has a single channel.
    """

    outcome: Outcome
    compared: Mapping[str, TopicComparison]
    accuracy: Mapping[str, Mapping[str, Any]]
    images: Sequence[Mapping[str, Any]]

    def shortfalls(self, changed: bool) -> list[str]:
        """Warnings on everything that the replay lacks or has differently.

        Args:
            changed: True if it was made with other parameters than the recording, so that values may differ.
        """
        made = self.images or any(
            account.published_on.get(f"{HEIGHTS[name]}/height")
            for name, account in self.outcome.stages.items()
            if name in HEIGHTS
        )
        lacks = [] if made else ["No image was made."]
        for topic, result in self.compared.items():
            if result.missing or result.extra:
                lacks.append(f"Topic {topic} misses {result.missing} images and has {result.extra} more than recorded.")
            elif not changed and result.verdict == CHANGED:
                lacks.append(f"Topic {topic} differs from the golden one by more than the tolerance.")
        return [*self.outcome.losses, *lacks]


def replay(
    bag: Path,
    out: Path,
    parameters: NodeParameters,
    execution: Execution = DEFAULT,
    against: Against = RECORDED,
    estimators: Collection[str] = (),
    part: Part = WHOLE,
    playing: Playing = IN_LOCKSTEP,
    remap: Sequence[str] = (),
    jobs: int | None = None,
) -> Replay:
    """Play the phase history of `bag` through the graph and record the products in `out`/bag.

    The images (topic slc) of a sensor with a single channel are recorded instead of heights. There is no relief map: it
    follows from the heights, which are compared. A replay from heights leaves relief_map.tif in `out`.

    Args:
        bag: folder of the recorded bag, or its .mcap file, with the parameters it was made with.
        out: output folder; must be new or empty.
        parameters: values that replace recorded parameters of nodes.
        execution: execution of the replay.
        against: tolerances and folder of the comparison.
        estimators: names of those whose heights are made; empty: those whose heights the bag has, or else all that
            suit the sensor and need not be requested.
        part: part of the bag that is played, if not all of its phase history.
        playing: time, rate and repetitions of the playback. Of several passes the first one is compared.
        remap: other names of topics of the bag and of nodes, each OLD:=NEW.
        jobs: dwells that are processed side by side without nodes; None: nodes process them one after the other,
            where ROS is installed.

    Raises:
        UserError: the bag cannot be used, a parameter is not allowed, or the replay failed.
    """
    remapping = remapping_of(remap, bag, part.entry)
    reader = part.open(bag, remapping.of_bag)
    golden = open_bag(against.golden, None, HEIGHT_TOPICS) if against.golden else reader
    chain = chain_of(reader, part.entry, estimators)
    processing = processing_of(reader, chain, part, consumers(chain.makers), parameters)
    playing.check(processing)
    jobs = jobs_without_ros(jobs)
    if jobs is not None and playing != IN_LOCKSTEP:
        raise UserError(
            f"The clock of the messages matters to nodes only; give --clock {playing.clock} without --jobs, where ROS "
            "is installed."
        )
    stages, values = chain.stages, processing.values
    played = chain.played(values)
    remapping.check(played, stages)
    folder = new_folder(out)
    made = folder / "bag"
    with reporting(folder, {"bag": bag.name}) as report:
        report.update(playing.report() | remapping.report() | processing.report())
        renamed = [f"{old}:={new}" for old, new in remapping.of_bag.items()]
        player = {"bag": str(bag), "namespace": reader.namespace, "renamed": renamed, "topics": played}
        nodes = merged(values, {"player": {**player, **processing.for_player, **playing.for_player}})
        if MAPPER in stages and "file" not in parameters.get(MAPPER, {}):
            nodes = merged(nodes, {MAPPER: {"file": str(folder / RELIEF_MAP) if find_spec("rasterio") else ""}})
        topics = recorded_topics(stages, values, played)
        topics += [CALIBRATION] if processing.plays_calibrations else []
        custom_data = {**reader.custom_data, PARAMETERS: json.dumps(values)}
        dwells = processing.count * playing.loops
        plan = Plan(
            "player",
            stages,
            topics,
            made,
            nodes,
            dwells,
            custom_data,
            played,
            remapping.of_nodes,
            playing.is_paced,
            processing.changes,
            processing.mountings,
            announces=playing.clock == LOCKSTEP and part.entry == FRAMES,
            frames=processing.frames,
        )
        outcome = _perform(plan, execution, reader, processing, jobs)
        conclude(outcome, values, report)
        compared = {}
        all_made = not estimators and part.entry != FROM_HEIGHTS
        prefixes = [prefix for name, prefix in HEIGHTS.items() if name in stages or all_made]
        judged = [f"/{p}/height" for p in prefixes if p != HEIGHTS[TRACKER] or processing.begins_with_bag]
        judged = [topic for topic in judged if topic in golden.topics]
        if judged and not outcome.interrupted:
            new = NamespacedReader(made, "", remapping.in_new_bag)
            first_pass = processing.is_of_first_pass if playing.loops > 1 else None
            compared = compare_bags(golden, new, against.tolerances, judged, processing.plays, first_pass)
            draw_worst_dwell(golden, new, compared, folder)
            report["comparison"] = as_json(golden, new, compared, against.tolerances) | {"passes": 1}
        flight = recorded_flight(reader)
        accuracy = read_accuracy(made, flight, stages).statistics if flight else {}
        images = [] if chain.makers else _measure_images(folder)
        report["estimators"] = accuracy
        report["images"] = images
    return Replay(outcome, compared, accuracy, images)


def _perform(
    plan: Plan, execution: Execution, reader: NamespacedReader, processing: ReplayPlan, jobs: int | None
) -> Outcome:
    """Process the dwells by nodes, or without them.

    Raises:
        UserError: the run has failed, or needs nodes where there is no ROS.
    """
    if jobs is None:
        from sal_height.graph.lockstep import perform  # noqa: PLC0415 (needs ROS)

        return perform(plan, execution)
    from sal_height.runs.replay.by_calls import perform_by_calls  # noqa: PLC0415 (not needed by nodes)

    scheme = Scheme(
        reader.path,
        reader.namespace,
        (),
        tuple(plan.stages),
        plan.parameters,
        tuple(plan.changes),
        plan.frames,
        plan.mountings,
        tuple(processing.warnings),
        tuple(topic for topic in plan.played if topic != SENSOR_INFO),
        processing.dwells,
        reader.renamed,
    )
    return perform_by_calls(plan, scheme, execution, jobs)


def jobs_without_ros(asked: int | None) -> int | None:
    """Jobs of a replay: as requested; 1 with a message if nodes are requested and ROS is not installed."""
    if asked is None and find_spec("rclpy") is None:
        _LOG.warning("ROS is not installed here: the dwells are processed without nodes, as with --jobs 1.")
        return 1
    return asked


def _measure_images(folder: Path) -> list[dict[str, Any]]:
    """Draw each image recorded in `folder`/bag and measure its brightest target."""
    from sal_height.runs.responses.image_picture import draw_image  # noqa: PLC0415 (brings Matplotlib)

    measured = []
    for _, message, image, grid, _ in recorded_slc(folder / "bag"):
        response = measure_brightest(image)
        title = f"dwell {message.dwell}: peak {response.peak_over_median_db:.1f} dB above the median"
        with writing(folder / f"image_{message.dwell}.png"):
            draw_image(image, grid, title, folder / f"image_{message.dwell}.png")
        measured.append(
            {
                "dwell": message.dwell,
                "peak_over_median_db": or_null(response.peak_over_median_db),
                "brightest_east_north_up_m": grid.points(response.row, response.col).tolist(),
                "row_width_3db_m": or_null(response.row_cut.width * grid.row_spacing),
                "col_width_3db_m": or_null(response.col_cut.width * grid.col_spacing),
            }
        )
    return measured
