"""The parameters of a replay: those that the nodes had in flight, dwell by dwell, and those that the user sets."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from sal_height.bag.described import FRAMES, IMAGES, sensors_of
from sal_height.bag.played import DwellRange
from sal_height.bag.reader import BagReader, LogTimes
from sal_height.engine.compression import HEARD
from sal_height.engine.registry import STAGES
from sal_height.engine.results import DwellKey
from sal_height.geometry import Mounting
from sal_height.graph.air import check_air
from sal_height.graph.catalogue import NodeParameters, parameters_of
from sal_height.graph.plan import ALL_PROCESSED, AsFlown, DwellChanges
from sal_height.graph.reporting import merged
from sal_height.messages import to_ns
from sal_height.renamed import with_new_names
from sal_height.runs.chain.as_flown import as_flown
from sal_height.runs.chain.entry import Part, ReplayNodes, check_given
from sal_height.runs.chain.recorded_parameters import RecordedParameters, parameters_in, recorded_at_start
from sal_height.runs.chain.timeline import (
    NO_FILE,
    PROVENANCE,
    Applied,
    Change,
    FlightRecord,
    Parameter,
    Timeline,
    timeline_of,
)
from sal_height.settings import settings_of

_LOG = logging.getLogger(__name__)

COMMAND_LINE, DEFAULT, CHOSEN = "command line", "default", "chosen by the replay"
"""Origins of the value of a parameter, in addition to the sources of `RecordedParameters`."""

APPLIED = Parameter("sar_compression", "calibration")
"""Says which calibration is applied."""


@dataclass(frozen=True)
class ReplayPlan:
    """Dwells, parameters and changes of a replay.

    Attributes:
        reader: reader of the bag.
        chain: the nodes at work.
        values: values of the nodes' parameters at the start.
        sources: origins of the values of all parameters of the nodes at work, by node and name.
        changes: changes before dwells.
        listed: changes for the report, in the order of the dwells.
        warnings: warnings, one on each event of the flight that cannot be reproduced.
        dwells: range of the dwells that are played.
        count: number of the dwells that are played.
        begins_with_bag: True if the first dwell of the bag is among them: tracked heights follow from those before.
        frames: times when the frames of each of them were recorded.
        mountings: mountings of sensors (config_hash) on the platform, where the flight had others than described.
        as_flown: dwells that nodes left out in flight.
    """

    reader: BagReader
    chain: ReplayNodes
    values: NodeParameters
    sources: dict[str, dict[str, str]]
    changes: Sequence[DwellChanges]
    listed: list[dict[str, Any]]
    warnings: list[str]
    dwells: DwellRange
    count: int
    begins_with_bag: bool
    frames: Mapping[DwellKey, LogTimes] = field(default_factory=dict)
    mountings: Mapping[str, Mounting] = field(default_factory=dict)
    as_flown: AsFlown = ALL_PROCESSED

    @property
    def first(self) -> DwellKey | None:
        """The first of the dwells that are played, if it was searched for."""
        return next(iter(self.frames), None)

    @property
    def epoch_ns(self) -> int:
        """Time of the first pulse of the first dwell, ns."""
        return min(dwell.stamp_ns for dwell in self.frames)

    @property
    def plays_calibrations(self) -> bool:
        """True if calibrations of the bag are published."""
        return any(one.calibrations for one in self.changes)

    @property
    def for_player(self) -> dict[str, Any]:
        """Parameters of the player."""
        dwells = self.dwells
        bounds = {"first_dwell": dwells.first, "last_dwell": dwells.last}
        return {**bounds, "start_ns": dwells.start_ns, "end_ns": dwells.end_ns}

    def plays(self, image: Any) -> bool:
        """True if the dwell of a height image is played."""
        return _dwell_of(image) in self.dwells

    def is_judged(self, image: Any) -> bool:
        """True if a new height image has a recorded one: it is of no repetition, and the recorder had not lost it."""
        dwell = _dwell_of(image)
        is_of_first_pass = not self.frames or dwell.stamp_ns <= self._last_stamp_ns
        return is_of_first_pass and dwell not in self.as_flown.unrecorded.get(image.estimator, ())

    @cached_property
    def _last_stamp_ns(self) -> int:
        return max(dwell.stamp_ns for dwell in self.frames)

    def report(self) -> dict[str, Any]:
        """Entries of the report on the replay."""
        return {
            "parameter_sources": self.sources,
            "changes_in_flight": self.listed,
            "left_out_in_flight": self.as_flown.report(),
            "warnings": self.warnings,
        }


def _dwell_of(image: Any) -> DwellKey:
    return DwellKey(image.provenance.config_hash, image.dwell, to_ns(image.header.stamp))


def processing_of(
    reader: BagReader,
    chain: ReplayNodes,
    part: Part,
    chosen: NodeParameters,
    given: NodeParameters,
) -> ReplayPlan:
    """Find out how the dwells of a bag were processed in flight, and what of that the user wants otherwise.

    What cannot be done as it was in flight is warned of.

    Args:
        reader: reader of the bag.
        chain: the nodes at work.
        part: part of the bag that is replayed.
        chosen: values where neither the bag nor the user states any.
        given: values of the user's, which apply to all dwells.

    Raises:
        UserError: the bag's parameters cannot be read, a value is not allowed today, or the bag lacks the air.
    """
    given = {node: with_new_names(values) for node, values in given.items()}
    check_given(given, chain)
    timeline = timeline_of(reader, chain.dwell_topics)
    in_bag = timeline.dwells
    if not in_bag:
        in_bag = FlightRecord(reader, chain.dwell_topics).dwells
    dwells = part.dwells_of(list(in_bag))
    played = {dwell: frames for dwell, frames in in_bag.items() if dwell in dwells}
    recorded = recorded_at_start(reader, timeline, chain.stages, chain.makers)
    own, sources = _at_start(recorded, timeline, chosen, given)
    if timeline.mountings and own.get(APPLIED.node, {}).get("mounting_from_tf"):
        own[APPLIED.node]["mounting_from_tf"] = False  # for what was on /tf_static is in the provenance
        sources[Parameter(APPLIED.node, "mounting_from_tf")] = CHOSEN
    values = recorded.check(own, given)
    wanted = [
        one
        for one in timeline.changes
        if one.parameter.node in chain.stages and one.parameter.name not in given.get(one.parameter.node, {})
    ]
    changes = [recorded.check_change(one) for one in wanted if not _is_read_only(one.parameter)]
    if chain.entry == FRAMES:
        sensors = list(sensors_of(reader)[0].values())
        for one in (values, *({parameter.node: {parameter.name: value}} for _, parameter, value, _ in changes)):
            check_air(one, sensors, chain.air, f"Bag {reader.path}")
    calibrations = timeline.calibrations if _applies_calibrations(chain, values) else []
    if not calibrations and given.get(APPLIED.node, {}).get(APPLIED.name) == HEARD:
        calibrations = timeline.received  # which were not applied in flight
    flown = as_flown(timeline.flown, played, chain.stages, own, given)
    warnings = [
        *_forgotten(timeline, chain),
        *_unopened(timeline, chain, sources),
        *_unmade(recorded, values, given),
        *(_restarted(one) for one in wanted if _is_read_only(one.parameter)),
        *(_missing_calibration(one) for one in timeline.missing if _applies_calibrations(chain, values)),
    ]
    for warning in warnings:
        _LOG.warning("Bag %s: %s", reader.path, warning)
    return ReplayPlan(
        reader,
        chain,
        values,
        _of_stages(sources, chain.stages),
        _scheduled_changes(timeline.dwells, dwells, changes, calibrations, flown),
        _listed(timeline.dwells, changes, calibrations),
        warnings,
        dwells,
        len(played) or chain.dwells,
        not in_bag or next(iter(in_bag)) in dwells,
        played,
        timeline.mountings if chain.entry == FRAMES else {},
        flown,
    )


def _at_start(
    recorded: RecordedParameters, timeline: Timeline, chosen: NodeParameters, given: NodeParameters
) -> tuple[dict[str, dict[str, Any]], dict[Parameter, str]]:
    """Values of parameters at the first dwell without those that are given, and the origins of all of them."""
    own = merged(chosen, recorded.values)
    sources = dict.fromkeys(parameters_in(chosen), CHOSEN) | recorded.sources
    applied = own.get(APPLIED.node, {}).get(APPLIED.name, timeline.files.get(APPLIED, ""))
    if timeline.calibrations and applied not in NO_FILE:
        own.setdefault(APPLIED.node, {})[APPLIED.name] = HEARD  # for the file may be gone, or another one today
        sources[APPLIED] = CHOSEN
    return own, sources | dict.fromkeys(parameters_in(given), COMMAND_LINE)


def _is_read_only(parameter: Parameter) -> bool:
    return settings_of(STAGES[parameter.node].settings)[parameter.name].read_only


def _applies_calibrations(chain: ReplayNodes, values: NodeParameters) -> bool:
    """True if calibrations of the bag are applied, or were to the images that are played."""
    of_topic = values.get(APPLIED.node, {}).get(APPLIED.name) == HEARD
    return chain.entry == IMAGES or (chain.entry == FRAMES and of_topic)


def _of_stages(sources: Mapping[Parameter, str], stages: Sequence[str]) -> dict[str, dict[str, str]]:
    """Origins of the values of all parameters of some nodes, by node and name."""
    names = {node: settings_of(STAGES[node].settings) for node in stages}
    return {node: {name: sources.get(Parameter(node, name), DEFAULT) for name in names[node]} for node in stages}


def _listed(
    recorded: Iterable[DwellKey], changes: Sequence[Change], calibrations: Sequence[Applied]
) -> list[dict[str, Any]]:
    """Changes in flight, for the report, in the order of the dwells."""
    order = {dwell: number for number, dwell in enumerate(recorded)}
    happened: list[Change | Applied] = [*calibrations, *changes]
    return [
        {"dwell": one.dwell.number, **_described(one), "source": one.source}
        for one in sorted(happened, key=lambda one: order[one.dwell])
    ]


def _described(one: Change | Applied) -> dict[str, Any]:
    if isinstance(one, Applied):
        return {"calibration": one.calibration}
    return {"parameter": ".".join(one.parameter), "value": one.value}


def _scheduled_changes(
    recorded: Iterable[DwellKey],
    dwells: DwellRange,
    changes: Sequence[Change],
    calibrations: Sequence[Applied],
    flown: AsFlown = ALL_PROCESSED,
) -> list[DwellChanges]:
    """Changes before each dwell that is played; a change before a dwell that is left out applies to the next one.

    So does a change of a node that the dwell does not get as far as.
    """
    scheduled: list[DwellChanges] = []
    happened: dict[DwellKey, list[Change | Applied]] = {}
    for change in changes:
        happened.setdefault(change.dwell, []).append(change)
    for calibration in calibrations:
        happened.setdefault(calibration.dwell, []).append(calibration)
    values: dict[str, dict[str, Any]] = {}
    applied: list[str] = []
    for dwell in recorded:
        for one in happened.get(dwell, ()):
            if isinstance(one, Applied):
                applied.append(one.calibration)
            else:
                values.setdefault(one.parameter.node, {})[one.parameter.name] = one.value
        if dwell in dwells and (values or applied):
            scheduled.append(DwellChanges(dwell, values, tuple(applied)))
            lost_before = flown.lost_before
            values = {node: dict(of_node) for node, of_node in values.items() if dwell in lost_before.get(node, ())}
            applied = []
    return scheduled


def _forgotten(timeline: Timeline, chain: ReplayNodes) -> list[str]:
    """Warnings on parameters of nodes at work that do not exist any more, and on nodes that do not exist."""
    unknown = {node: source for (node, _), source in timeline.forgotten.items() if node not in STAGES}
    return [
        *(
            f"Node {node} had a parameter {name} in flight ({source}), which does not exist today and is left out."
            for (node, name), source in timeline.forgotten.items()
            if node in chain.stages
        ),
        *(
            f"No node of a replay is called {node}; the parameters that it had in flight ({source}) are left out."
            for node, source in unknown.items()
            if chain.entry == FRAMES
        ),
    ]


def _unopened(timeline: Timeline, chain: ReplayNodes, sources: Mapping[Parameter, str]) -> list[str]:
    """Warnings on files that only the provenance names."""
    return [
        f"Node {parameter.node} used the file {path!r} in flight ({PROVENANCE}); a replay opens no file that only the "
        f"provenance names, and goes on without it: set --param {'.'.join(parameter)}=FILE to use it."
        for parameter, path in timeline.files.items()
        if parameter.node in chain.stages and parameter not in sources
    ]


def _unmade(recorded: RecordedParameters, values: NodeParameters, given: NodeParameters) -> list[str]:
    """Warnings on heights that nodes used in flight, and that are not made."""
    return [
        f"Node {parameter.node} used the heights of {value!r} in flight ({source}), which are not made here; it uses "
        f"those of {parameters_of(parameter.node, values.get(parameter.node, {})).estimator!r}."
        for parameter, (value, source) in recorded.unmade.items()
        if parameter.name not in given.get(parameter.node, {})
    ]


def _restarted(change: Change) -> str:
    node, name = change.parameter
    return (
        f"Node {node} was started again with {name}={change.value!r} before dwell {change.dwell.number}; a replay "
        "cannot change this parameter between dwells, and goes on with the value before."
    )


def _missing_calibration(missing: Applied) -> str:
    return (
        f"Calibration {missing.calibration!r}, which was applied from dwell {missing.dwell.number} on, is not in the "
        "bag and is left out; record topic /calibration."
    )
