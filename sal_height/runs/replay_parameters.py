"""The parameters of a replay: those that the nodes had in flight, dwell by dwell, and those that the user sets."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import yaml

from sal_height.bag.files import parameters_file
from sal_height.bag.reader import BagReader, LogTimes
from sal_height.bag.sensor_topics import MAP_ORIGIN
from sal_height.errors import UserError
from sal_height.messages import to_ns
from sal_height.nodes.cues import Cue, DwellKey, cues_to_text
from sal_height.nodes.played import IMAGES, DwellRange
from sal_height.nodes.playlist import FRAMES
from sal_height.nodes.sar_compression import HEARD
from sal_height.runs.catalogue import NODES, NodeParameters, check_parameters, placed
from sal_height.runs.entry import Chain, Part, check_air, check_given, origin_of, sensors_of
from sal_height.runs.flight_record import FlightRecord
from sal_height.runs.reporting import PARAMETERS, merged
from sal_height.runs.timeline import PROVENANCE, Applied, Change, Parameter, Timeline, timeline_of
from sal_height.settings import settings_of

_LOG = logging.getLogger(__name__)

COMMAND_LINE, CUSTOM_DATA, DEFAULT, CHOSEN = "command line", "custom data of the bag", "default", "chosen by the replay"
TOPIC = f"topic {MAP_ORIGIN} of the bag"
"""Where the value of a parameter comes from, besides those of `timeline.Value`."""

APPLIED = Parameter("sar_compression", "calibration")
"""Says which calibration is applied."""


@dataclass(frozen=True)
class Processing:
    """How a replay processes its dwells.

    Attributes:
        values: of the nodes' parameters at the start.
        sources: where the values of all parameters of the nodes at work come from, by node and name.
        cues: what happens before dwells.
        changes: the same for the report, in the order of the dwells.
        warnings: a sentence on each thing of the flight that cannot be done again.
        dwells: those that are played.
        count: how many these are.
        begins_with_bag: whether the first dwell of the bag is among them: tracked heights follow from those before.
        frames: when the frames of each of them were recorded; none: it was not looked for.
    """

    values: dict[str, dict[str, Any]]
    sources: dict[str, dict[str, str]]
    cues: list[Cue]
    changes: list[dict[str, Any]]
    warnings: list[str]
    dwells: DwellRange
    count: int
    begins_with_bag: bool
    frames: Mapping[DwellKey, LogTimes] = field(default_factory=dict)

    @property
    def first(self) -> DwellKey | None:
        """The first of the dwells that are played, if it was looked for."""
        return next(iter(self.frames), None)

    @property
    def plays_calibrations(self) -> bool:
        """Whether calibrations of the bag are published."""
        return any(cue.calibrations for cue in self.cues)

    @property
    def for_player(self) -> dict[str, Any]:
        """Parameters of the player."""
        dwells = self.dwells
        bounds = {"first_dwell": dwells.first, "last_dwell": dwells.last}
        return {**bounds, "start_ns": dwells.start_ns, "end_ns": dwells.end_ns, "cues": cues_to_text(self.cues)}

    def plays(self, image: Any) -> bool:
        """Whether the dwell of a height image is played."""
        return DwellKey(image.dwell, to_ns(image.header.stamp)) in self.dwells

    def is_of_first_pass(self, image: Any) -> bool:
        """Whether a height image was made of a dwell with the stamp that is in the bag, not of a repetition."""
        return not self.frames or to_ns(image.header.stamp) <= self._last_stamp_ns

    @cached_property
    def _last_stamp_ns(self) -> int:
        return max(dwell.stamp_ns for dwell in self.frames)

    def report(self) -> dict[str, Any]:
        """What the report says of it."""
        return {"parameter_sources": self.sources, "changes_in_flight": self.changes, "warnings": self.warnings}


def processing_of(
    reader: BagReader,
    chain: Chain,
    part: Part,
    chosen: NodeParameters,
    given: NodeParameters,
    *,
    names_dwells: bool = False,
) -> Processing:
    """Find out how the dwells of a bag were processed in flight, and what of that the user wants otherwise.

    What cannot be done as it was in flight is warned of.

    Args:
        reader: of the bag.
        chain: the nodes at work.
        part: what of the bag is replayed.
        chosen: values where neither the bag nor the user says anything.
        given: values of the user's, which hold for all dwells.
        names_dwells: whether the dwells are looked for in any case, which may take a reading of the bag.

    Raises:
        UserError: the bag's parameters cannot be read, a value is not allowed today, or the bag lacks the air.
    """
    check_given(given, chain)
    timeline = timeline_of(reader, chain.dwell_topics)
    held = timeline.dwells
    if (part.is_limited or names_dwells) and not held:
        held = FlightRecord(reader, chain.dwell_topics).dwells
    dwells = part.dwells_of(list(held))
    played = {dwell: frames for dwell, frames in held.items() if dwell in dwells}
    own, sources = _at_start(reader, timeline, chosen, given)
    values = check_parameters(merged(own, given))
    wanted = [
        one
        for one in timeline.changes
        if one.parameter.node in chain.stages and one.parameter.name not in given.get(one.parameter.node, {})
    ]
    changes = [_checked(one) for one in wanted if not _is_read_only(one.parameter)]
    if chain.entry == FRAMES:
        sensors = list(sensors_of(reader)[0].values())
        for one in (values, *({parameter.node: {parameter.name: value}} for _, parameter, value, _ in changes)):
            check_air(one, sensors, chain.air, f"Bag {reader.path}")
    calibrations = timeline.calibrations if _applies_calibrations(chain, values) else []
    if not calibrations and given.get(APPLIED.node, {}).get(APPLIED.name) == HEARD:
        calibrations = timeline.come  # which nobody applied in flight
    warnings = [
        *([] if _custom_data(reader) is not None else _forgotten(timeline)),
        *(_restarted(one) for one in wanted if _is_read_only(one.parameter)),
        *(_not_held(one) for one in timeline.missing if _applies_calibrations(chain, values)),
    ]
    for warning in warnings:
        _LOG.warning("Bag %s: %s", reader.path, warning)
    return Processing(
        values,
        _of_stages(sources, chain.stages),
        _cues(timeline.dwells, dwells, changes, calibrations),
        _listed(timeline.dwells, changes, calibrations),
        warnings,
        dwells,
        len(played) or chain.dwells,
        not held or next(iter(held)) in dwells,
        played,
    )


def _checked(change: Change) -> Change:
    """The change with the value as it is today.

    Raises:
        UserError: it is not allowed.
    """
    node, name = change.parameter.node, change.parameter.name
    return change._replace(value=check_parameters({node: {name: change.value}})[node][name])


def recorded_parameters(reader: BagReader) -> dict[str, dict[str, Any]]:
    """Node parameters that a bag was made with, at its first dwell; none, with a warning, if it does not say.

    They are in the bag's custom data; older bags have a file parameters.yaml beside them instead. Other programs, such
    as rosbags-convert, leave both behind, and a recorder that was started by itself has neither. What nodes said of
    their parameters, and heights in the bag of their provenance, is used then.

    Raises:
        UserError: they are not what this program writes.
    """
    values, _ = _recorded(reader, timeline_of(reader) if _custom_data(reader) is None else Timeline())
    return values


def _at_start(
    reader: BagReader, timeline: Timeline, chosen: NodeParameters, given: NodeParameters
) -> tuple[dict[str, dict[str, Any]], dict[Parameter, str]]:
    """Values of parameters at the first dwell without those that are given, and where all of them come from."""
    recorded, sources = _recorded(reader, timeline)
    own = merged(chosen, recorded)
    sources = dict.fromkeys(_parameters(chosen), CHOSEN) | sources
    if timeline.calibrations and own.get(APPLIED.node, {}).get(APPLIED.name, HEARD) != HEARD:
        own[APPLIED.node][APPLIED.name] = HEARD  # for the file may be gone, or another one today
        sources[APPLIED] = CHOSEN
    return own, sources | dict.fromkeys(_parameters(given), COMMAND_LINE)


def _recorded(reader: BagReader, timeline: Timeline) -> tuple[dict[str, dict[str, Any]], dict[Parameter, str]]:
    """Parameters that a bag was made with, and where they come from.

    Custom data has what its maker set; heights in the bag say more of a value only if it was set anew before them. What
    is in the provenance alone may be a default of that time, for which custom data has the default of today.

    Raises:
        UserError: they cannot be read.
    """
    known = dict(timeline.start)
    custom = _custom_data(reader)
    if custom is None:
        if not known:
            _LOG.warning(
                "Bag %s does not hold the parameters it was made with; it is processed with the defaults of the nodes "
                "and what --param sets.",
                reader.path,
            )
        custom, sources = {}, {}
    else:
        sources = dict.fromkeys(_parameters(custom), CUSTOM_DATA)
        known = {
            one: value
            for one, value in known.items()
            if one in sources and value.source == PROVENANCE and value.value != custom[one.node][one.name]
        }
    on_earth = placed(origin_of(reader))
    sources = dict.fromkeys(_parameters(on_earth), TOPIC) | sources
    values = merged(on_earth, custom)
    for one, (value, source) in known.items():
        values.setdefault(one.node, {})[one.name] = value
        sources[one] = source
    return values, sources


def _custom_data(reader: BagReader) -> dict[str, dict[str, Any]] | None:
    """Node parameters in the custom data of a bag, or in a file beside it; None if there are neither.

    Raises:
        UserError: they are not what this program writes.
    """
    path = parameters_file(reader.path)
    try:
        text = reader.custom_data.get(PARAMETERS) or (path.read_text(encoding="utf-8") if path.is_file() else "")
        values = _read(text)
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise UserError(
            f"The parameters of bag {reader.path} cannot be read: {' '.join(str(error).split())}."
        ) from error
    if not text:
        return None
    values = values or {}
    if not (isinstance(values, dict) and all(isinstance(entry, dict) for entry in values.values())):
        raise UserError(f"The parameters of bag {reader.path} must map node names to mappings of names to values.")
    return values


def _read(text: str) -> Any:
    """What a text in JSON says, or else in YAML, for which 1e-05 is no number."""
    with suppress(json.JSONDecodeError):
        return json.loads(text)
    return yaml.safe_load(text)


def _parameters(values: NodeParameters) -> list[Parameter]:
    return [Parameter(node, name) for node, of_node in values.items() for name in of_node]


def _is_read_only(parameter: Parameter) -> bool:
    return settings_of(NODES[parameter.node].parameters)[parameter.name].read_only


def _applies_calibrations(chain: Chain, values: NodeParameters) -> bool:
    """Whether calibrations of the bag are applied, or were to the images that are played."""
    of_topic = values.get(APPLIED.node, {}).get(APPLIED.name) == HEARD
    return chain.entry == IMAGES or (chain.entry == FRAMES and of_topic)


def _of_stages(sources: Mapping[Parameter, str], stages: Sequence[str]) -> dict[str, dict[str, str]]:
    """Where the values of all parameters of some nodes come from, by node and name."""
    names = {node: settings_of(NODES[node].parameters) for node in stages}
    return {node: {name: sources.get(Parameter(node, name), DEFAULT) for name in names[node]} for node in stages}


def _listed(
    held: Iterable[DwellKey], changes: Sequence[Change], calibrations: Sequence[Applied]
) -> list[dict[str, Any]]:
    """What changed in flight, for the report, in the order of the dwells."""
    order = {dwell: place for place, dwell in enumerate(held)}
    happened: list[Change | Applied] = [*calibrations, *changes]
    return [
        {"dwell": one.dwell.number, **_described(one), "source": one.source}
        for one in sorted(happened, key=lambda one: order[one.dwell])
    ]


def _described(one: Change | Applied) -> dict[str, Any]:
    if isinstance(one, Applied):
        return {"calibration": one.calibration}
    return {"parameter": ".".join(one.parameter), "value": one.value}


def _cues(
    held: Iterable[DwellKey], dwells: DwellRange, changes: Sequence[Change], calibrations: Sequence[Applied]
) -> list[Cue]:
    """What happens before each dwell that is played; what happened before others holds for the next one."""
    cues: list[Cue] = []
    happened: dict[DwellKey, list[Change | Applied]] = {}
    for change in changes:
        happened.setdefault(change.dwell, []).append(change)
    for calibration in calibrations:
        happened.setdefault(calibration.dwell, []).append(calibration)
    values: dict[str, dict[str, Any]] = {}
    applied: list[str] = []
    for dwell in held:
        for one in happened.get(dwell, ()):
            if isinstance(one, Applied):
                applied.append(one.calibration)
            else:
                values.setdefault(one.parameter.node, {})[one.parameter.name] = one.value
        if dwell in dwells and (values or applied):
            cues.append(Cue(dwell, values, tuple(applied)))
            values, applied = {}, []
    return cues


def _forgotten(timeline: Timeline) -> list[str]:
    """Sentences on parameters that do not exist any more."""
    return [
        f"Node {node} had a parameter {name} in flight ({source}), which does not exist today and is left out."
        for (node, name), source in timeline.forgotten.items()
    ]


def _restarted(change: Change) -> str:
    node, name = change.parameter
    return (
        f"Node {node} was started again with {name}={change.value!r} before dwell {change.dwell.number}; a replay "
        "cannot change this parameter between dwells, and goes on with the value before."
    )


def _not_held(missing: Applied) -> str:
    return (
        f"Calibration {missing.calibration!r}, which was applied from dwell {missing.dwell.number} on, is not in the "
        "bag and is left out; record topic /calibration."
    )
