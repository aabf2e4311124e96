"""`sal-height replay`: process a recorded bag with the same nodes, and compare the heights with the recorded ones."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sal_height.bag.compare import CHANGED, TopicComparison, compare_bags
from sal_height.bag.described import FRAMES, IMAGES
from sal_height.bag.namespace import NamespacedReader, open_bag
from sal_height.bag.played import LOCKSTEP, PACED
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import ROUNDING, Tolerances
from sal_height.bag.topics import FRAME_TYPE, HEIGHT_TYPE, IMAGE_TYPE, ODOMETRY_TYPE, SENSOR_TYPE
from sal_height.engine.height_items import Heights
from sal_height.engine.mapper import PlacedRelief
from sal_height.engine.registry import STAGES
from sal_height.errors import UserError
from sal_height.graph.catalogue import HEIGHTS, TRACKER, NodeParameters, consumers, recorded_topics
from sal_height.graph.plan import DEFAULT, Execution, Outcome, Plan
from sal_height.graph.reporting import PARAMETERS, RELIEF_MAP, conclude, merged, reporting
from sal_height.io import new_folder, or_null, writing
from sal_height.messages import AIR, AIR_TYPES
from sal_height.response import measure_brightest
from sal_height.runs.chain.as_flown import NOT_MADE, repeated_losses
from sal_height.runs.chain.chain_runs import run_of
from sal_height.runs.chain.entry import FROM_HEIGHTS, MAPPER, WHOLE, Part, chain_of
from sal_height.runs.chain.recorded_images import recorded_slc
from sal_height.runs.chain.recording import jobs_without_ros, perform_by_calls
from sal_height.runs.chain.replay_parameters import ReplayPlan, processing_of
from sal_height.runs.replay.judge import as_json, draw_worst_dwell
from sal_height.runs.truth.report import read_accuracy, recorded_flight
from sal_height.tables import counted
from sal_height.topics import CALIBRATION, ODOMETRY, SENSOR_INFO

KNOWN: Mapping[str, str] = {
    f"/{SENSOR_INFO}": SENSOR_TYPE,
    f"/{ODOMETRY}": ODOMETRY_TYPE,
    f"/{FRAMES}": FRAME_TYPE,
    **{f"/{topic}": quantity.type_name for topic, quantity in AIR.items()},
    f"/{IMAGES}": IMAGE_TYPE,
    **{f"/{prefix}/height": HEIGHT_TYPE for prefix in HEIGHTS.values()},
}
"""Topics that a replay reads from a bag: the names by which nodes know them, and their types."""

_LOG = logging.getLogger(__name__)

HEIGHT_TOPICS = [f"{prefix}/height" for prefix in HEIGHTS.values()]


@dataclass(frozen=True)
class Playing:
    """Start, rate and repetitions of the playback of a bag.

    Attributes:
        clock: name of the clock, one of `player.CLOCKS`.
        rate: seconds of the sensor in a second; None: 1, if the clock has a rate at all.
        loops: number of times that the bag is played.
    """

    clock: str = LOCKSTEP
    rate: float | None = None
    loops: int = 1

    def __post_init__(self) -> None:
        """Refuse values that contradict the clock.

        Raises:
            UserError: a value contradicts the clock.
        """
        if self.rate is not None and self.clock != PACED:
            raise UserError(f"Option --rate has no meaning with --clock {self.clock}; give it with --clock {PACED}.")
        if self.loops > 1 and self.clock == LOCKSTEP:
            raise UserError(
                f"Option --loop has no meaning with --clock {LOCKSTEP}; give it with --clock paced or burst."
            )

    def check(self, processing: ReplayPlan) -> None:
        """Refuse to repeat what changed in flight: the nodes would go into the next pass with what the last one left.

        Raises:
            UserError: something changed after the first dwell that is played.
        """
        if self.loops > 1 and (
            late := [one.dwell.number for one in processing.changes if one.dwell != processing.first]
        ):
            raise UserError(
                f"Option --loop cannot repeat what changed in flight before dwell {late[0]}; set the parameters for "
                "all dwells by --param, or choose dwells without a change by --dwells."
            )

    @property
    def is_paced(self) -> bool:
        """True if the player publishes the time of the sensor."""
        return self.clock == PACED

    @property
    def has_times(self) -> bool:
        """True if the nodes have the time of the bag."""
        return self.clock in (LOCKSTEP, PACED)

    @property
    def for_player(self) -> dict[str, Any]:
        """Parameters of the player."""
        rate = {} if self.rate is None else {"rate": float(self.rate)}
        return {"clock": self.clock, "loops": self.loops, **rate}

    def report(self) -> dict[str, Any]:
        """Entries of the report on the playback."""
        return {"clock": self.clock, "rate": (self.rate or 1.0) if self.is_paced else None, "loops": self.loops}


IN_LOCKSTEP = Playing()


@dataclass(frozen=True)
class Remapping:
    """Other names of topics, by their own.

    Attributes:
        of_bag: names of topics of nodes, by the topic of the bag, with leading slash, that is read as it.
        of_nodes: names, without leading slash, under which topics of the nodes are published and recorded.
    """

    of_bag: Mapping[str, str] = field(default_factory=dict)
    of_nodes: Mapping[str, str] = field(default_factory=dict)

    def check(self, played: Sequence[str], stages: Sequence[str]) -> None:
        """Refuse names of topics that no node of the run has, or that two topics would have in common.

        Raises:
            UserError: there is such a name.
        """
        if not self.of_nodes:
            return
        known = _topics_of(played, stages)
        for old, new in self.of_nodes.items():
            if old not in known:
                raise UserError(
                    f"Option --remap: neither the bag nor a node of this replay has a topic {old!r}; nodes have "
                    f"{', '.join(sorted(known))}."
                )
            if new in known and new not in self.of_nodes:
                raise UserError(
                    f"Option --remap: {old} cannot be called {new!r}, for that is another topic of the nodes; choose "
                    "another name."
                )

    def report(self) -> dict[str, dict[str, str]]:
        """Entries of the report on the names."""
        return {"remapped": {**self.of_bag, **{f"/{old}": f"/{new}" for old, new in self.of_nodes.items()}}}


UNCHANGED = Remapping()


def remapping_of(rules: Sequence[str], bag: Path, entry: str) -> Remapping:
    """Find out which topics of a bag, and which of nodes, get other names.

    A rule is for the bag if that has OLD and nodes know NEW, apart from a namespace before it, and either NEW is played
    or nodes do not know OLD.

    Args:
        rules: rules of the form OLD:=NEW, as in ROS: the topic OLD gets the name NEW.
        bag: bag that is replayed.
        entry: topic that the replay starts with, one of `entry.ENTRIES`.

    Raises:
        UserError: the bag cannot be read, a rule has another form, a topic of the bag another type than its new name
            stands for, or two topics would get one name.
    """
    if not rules:
        return UNCHANGED
    topics, played = BagReader(bag).topics, _played_types(entry)
    of_bag: dict[str, str] = {}
    of_nodes: dict[str, str] = {}
    for rule in rules:
        old, new = _names_of(rule)
        if old in {**of_bag, **of_nodes} or new in {*of_bag.values(), *of_nodes.values()}:
            raise UserError(f"Option --remap {rule} renames a topic, or names one, that another --remap does, too.")
        kind = next((kind for name, kind in KNOWN.items() if new.endswith(name)), None)
        if old in topics and kind and (KNOWN.get(new) in played or old not in KNOWN):
            if topics[old].type_name != kind:
                raise UserError(
                    f"Option --remap {rule}: topic {old} of bag {bag} is of type {topics[old].type_name}, and {new} "
                    f"must be of {kind}."
                )
            of_bag[old] = new
        else:
            of_nodes[old] = new
    return Remapping(of_bag, {old[1:]: new[1:] for old, new in of_nodes.items()})


def _played_types(entry: str) -> set[str]:
    """Message types that are played from an entry on."""
    if entry == FROM_HEIGHTS:
        return {HEIGHT_TYPE}
    return {SENSOR_TYPE, IMAGE_TYPE} if entry == IMAGES else {SENSOR_TYPE, ODOMETRY_TYPE, FRAME_TYPE, *AIR_TYPES}


def _names_of(rule: str) -> tuple[str, str]:
    """The two topics of a rule, with leading slash.

    Raises:
        UserError: it has another form.
    """
    names = [name if name.startswith("/") else f"/{name}" for name in rule.split(":=")]
    if len(names) != 2 or not all(map(_TOPIC.fullmatch, names)):
        raise UserError(
            f"Option --remap is {rule!r}; it must be of the form OLD:=NEW with names of topics, for example "
            "/radar/raw:=phase_history."
        )
    return names[0], names[1]


_TOPIC = re.compile(r"(?=.{1,247}$)(/[A-Za-z_][A-Za-z0-9_]*)+")
"""Name of a topic with its namespace (https://design.ros2.org/articles/topic_and_service_names.html)."""


def _topics_of(played: Sequence[str], stages: Collection[str]) -> set[str]:
    """The topics of the nodes of a replay but those of ROS itself, such as /clock."""
    kinds = [STAGES[stage] for stage in stages]
    named = {port.name for kind in kinds for port in (*kind.described_inputs(), *kind.described_outputs())}
    viewed = {
        port.name.rpartition("/")[0] for kind in kinds for port in kind.described_outputs() if port.kind in VIEWED
    }
    views = {f"{prefix}/{view}" for prefix in viewed for view in ("image", "points", "frame")}
    return {*played, CALIBRATION, *views, *(topic for topic in named if not topic.startswith(("/", "<")))}


VIEWED = (Heights, PlacedRelief)
"""Products of which nodes publish pictures and points."""


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
        """Warnings on what the replay lacks or, unless parameters of the recording were `changed`, has differently."""
        made = self.images or any(
            account.published_on.get(f"{HEIGHTS[name]}/height")
            for name, account in self.outcome.stages.items()
            if name in HEIGHTS
        )
        lacks = [] if made else ["No image was made."]
        for topic, result in self.compared.items():
            if result.missing or result.extra:
                missing = counted(result.missing, "image")
                lacks.append(f"Topic {topic} misses {missing} and has {result.extra} more than recorded.")
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
            playing.has_times,
            processing.changes,
            processing.mountings,
            announces=playing.clock == LOCKSTEP and part.entry == FRAMES,
            frames=processing.frames,
            as_flown=processing.as_flown,
        )
        outcome = _perform(plan, execution, processing, jobs)
        if outcome.failure is None:
            new = NamespacedReader(made, "", {f"/{name}": f"/{topic}" for topic, name in remapping.of_nodes.items()})
            outcome = replace(outcome, as_flown=repeated_losses(processing.as_flown.unmade, new))
        _warn_of_unknown_reasons(bag, outcome)
        conclude(outcome, values, report)
        compared = {}
        all_made = not estimators and part.entry != FROM_HEIGHTS
        prefixes = [prefix for name, prefix in HEIGHTS.items() if name in stages or all_made]
        judged = [f"/{p}/height" for p in prefixes if p != HEIGHTS[TRACKER] or processing.begins_with_bag]
        judged = [topic for topic in judged if topic in golden.topics]
        if judged and not outcome.interrupted:
            compared = compare_bags(
                golden, new, against.tolerances, judged, processing.plays, processing.is_judged, by_stamp=True
            )
            draw_worst_dwell(golden, new, compared, folder)
            report["comparison"] = as_json(golden, new, compared, against.tolerances) | {"passes": 1}
        flight = recorded_flight(reader)
        accuracy = read_accuracy(made, flight, stages).statistics if flight else {}
        images = [] if chain.makers else _measure_images(folder)
        report["estimators"] = accuracy
        report["images"] = images
    return Replay(outcome, compared, accuracy, images)


def _warn_of_unknown_reasons(bag: Path, outcome: Outcome) -> None:
    """Log that nodes left out dwells for the only reason that the bag has no heights of them, if they did."""
    nodes = [name for name, account in outcome.stages.items() if NOT_MADE in account.dropped]
    if nodes:
        _LOG.warning(
            "Bag %s: dwells of which it has no heights of %s were left out, as in flight; no message on topic losses "
            "says why. `sal-height batch` processes all dwells.",
            bag,
            ", ".join(nodes),
        )


def _perform(plan: Plan, execution: Execution, processing: ReplayPlan, jobs: int | None) -> Outcome:
    """Process the dwells by nodes, or without them.

    Raises:
        UserError: the run has failed, or needs nodes where there is no ROS.
    """
    if jobs is None:
        from sal_height.graph.lockstep import perform  # noqa: PLC0415 (needs ROS)

        return perform(plan, execution)
    return perform_by_calls(plan, execution, run_of(plan, processing, jobs))


def _measure_images(folder: Path) -> list[dict[str, Any]]:
    """Draw each image recorded in `folder`/bag and measure its brightest target."""
    from sal_height.runs.responses.pictures import draw_image  # noqa: PLC0415 (brings Matplotlib)

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
