"""The parameters that the dwells of a bag were processed with at its first dwell, as far as the bag states them.

The provenance of products states every parameter of the nodes that made them, also those that were defaults when the
bag was recorded. All of these values are used, so that the defaults of today apply only to parameters that did not
exist then; standard deviations among these, which are assumed today where nobody states them, are 0. Where the
provenance says nothing, the custom data of the bag decide, and where these say nothing either, the parameter events of
the nodes. Three kinds of values are exceptions:

- Files. The provenance alone is no reason to open or write a file, for its path (`Setting.names_file`) may belong to
  another machine; custom data and parameter events decide on these parameters. A replay goes on without a file that
  only the provenance names, with a warning. Calibrations in the bag replace their file.
- The latency budget and `autostart` (`timeline.OF_MACHINE`). They suited the machine of the flight and change no
  height; but a latency budget leaves out the dwells that a slower machine is late with, and nodes that wait to be
  activated stop a replay. They are used from custom data only: `sal-height live` stores its latency budget there, and
  in lockstep no dwell waits for another one.
- The heights that a node uses (`estimator`). If these are not made, as where other estimators are requested, neither
  provenance nor parameter events count, with a warning.

A value that is not allowed today is refused with a message that says where it is stated and how to replace it. With
the default of today instead, heights would differ for a reason that is easily overlooked.
"""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from sal_height.bag.described import FRAMES, origin_of
from sal_height.bag.files import parameters_file
from sal_height.bag.reader import BagReader
from sal_height.engine.registry import STAGES, takes_heights
from sal_height.errors import UserError
from sal_height.graph.catalogue import HEIGHTS, SETTABLE, TRACKER, NodeParameters, check_parameters, placed
from sal_height.graph.reporting import PARAMETERS, PRESET, merged
from sal_height.renamed import BEFORE, ENDED, with_new_names
from sal_height.runs.chain.timeline import (
    EVENT,
    PROVENANCE,
    Change,
    Parameter,
    Timeline,
    Value,
    products_of,
    timeline_of,
)
from sal_height.sensor import AS_DESCRIBED
from sal_height.settings import settings_of
from sal_height.topics import MAP_ORIGIN

_LOG = logging.getLogger(__name__)

CUSTOM_DATA, TOPIC = "custom data of the bag", f"topic {MAP_ORIGIN} of the bag"
"""Origins of a value, in addition to the sources of `timeline.Value`."""

STATED_IN = {
    PROVENANCE: "the provenance of bag {}",
    EVENT: "a parameter event of bag {}",
    CUSTOM_DATA: "the custom data of bag {}",
    TOPIC: f"topic {MAP_ORIGIN} of bag {{}}",
}
"""The same as the subject of a message."""


@dataclass(frozen=True)
class RecordedParameters:
    """Values of parameters at the first dwell of a bag.

    Attributes:
        bag: path of the bag.
        values: values by node and name, as the bag states them: not checked.
        sources: origin of each of them.
        unmade: heights that nodes used, and that are not made; neither in `values` nor in `sources`.
    """

    bag: Path
    values: dict[str, dict[str, Any]]
    sources: dict[Parameter, str]
    unmade: dict[Parameter, Value]

    def check(
        self, values: NodeParameters, given: NodeParameters, settable: Sequence[str] = SETTABLE
    ) -> dict[str, dict[str, Any]]:
        """Do what `check_parameters` does with values of which some are those of the bag, and with given ones.

        Args:
            values: values by node and name.
            given: values of the user's, which override these.
            settable: nodes whose parameters may have values.

        Raises:
            UserError: a value is not allowed; the message also says where it is stated and how it can be replaced, if
                it is one of the bag's.
        """
        checked: dict[str, dict[str, Any]] = {}
        for node, of_node in merged(values, given).items():
            try:
                checked |= check_parameters({node: of_node}, settable)
            except UserError as error:
                raise self._refusal(error, node, of_node, given.get(node, {})) from error
        return checked

    def check_change(self, change: Change) -> Change:
        """A change in flight with its value as it is today.

        Raises:
            UserError: it is not allowed.
        """
        node, name = change.parameter
        try:
            return change._replace(value=check_parameters({node: {name: change.value}})[node][name])
        except UserError as error:
            whence = f" from dwell {change.dwell.number} on"
            raise _replaceable(error, self.bag, change.parameter, change.source, whence) from error

    def _refusal(self, error: UserError, node: str, values: Mapping[str, Any], given: Collection[str]) -> UserError:
        """Message on a node whose parameters are refused; if it names a bag's value, with what can be done."""
        if node not in SETTABLE or values.keys() - settings_of(STAGES[node].settings).keys():
            return error
        of_bag = self.values.get(node, {})
        for name, value in values.items():
            is_of_bag = name not in given and name in of_bag and of_bag[name] == value
            if is_of_bag and re.search(rf"\b{name}\b", str(error)):
                parameter = Parameter(node, name)
                return _replaceable(error, self.bag, parameter, self.sources[parameter])
        return error


def _replaceable(error: UserError, bag: Path, parameter: Parameter, source: str, whence: str = "") -> UserError:
    """Message on a value that is not allowed, with where the bag states it and how to replace it."""
    return UserError(
        f"{str(error).removesuffix('.')}; {STATED_IN[source].format(bag)} states the value{whence}, and --param "
        f"{'.'.join(parameter)}=VALUE replaces it."
    )


def recorded_parameters(reader: BagReader, makers: Collection[str] = tuple(HEIGHTS)) -> dict[str, dict[str, Any]]:
    """The values of `recorded_at_start` for all nodes, by node and name.

    Raises:
        UserError: custom data are not what this program writes.
    """
    return recorded_at_start(reader, makers=makers).values


def recorded_at_start(
    reader: BagReader,
    timeline: Timeline | None = None,
    nodes: Collection[str] = SETTABLE,
    makers: Collection[str] = tuple(HEIGHTS),
) -> RecordedParameters:
    """Find the values that parameters of nodes had at the first dwell of a bag; if the bag has no values, warn.

    Custom data are in the bag; older bags have a file parameters.yaml next to them instead. Other programs, such as
    rosbags-convert, leave both behind, and a recorder that was started by itself has neither.

    Args:
        reader: reader of the bag.
        timeline: timeline of its flight; None: read from its products, or else from its parameter events.
        nodes: nodes at work; of others only values in custom data are found.
        makers: nodes whose heights are available, in addition to those of the tracker.

    Raises:
        UserError: custom data are not what this program writes.
    """
    custom = _custom_data(reader)
    if timeline is None:
        timeline = timeline_of(reader, products_of(reader) or [f"/{FRAMES}"])
    if custom is None and not timeline.start:
        _LOG.warning(
            "Bag %s does not contain the parameters it was made with; it is processed with the defaults of the nodes "
            "and what --param sets.",
            reader.path,
        )
    custom = custom or {}
    for node, name in [(node, name) for node, of_node in custom.items() for name in ENDED.keys() & of_node.keys()]:
        del custom[node][name]
        timeline.forgotten.setdefault(Parameter(node, name), CUSTOM_DATA)
    made = {HEIGHTS[node] for node in (*makers, TRACKER) if node in HEIGHTS}
    start = {parameter: value for parameter, value in timeline.start.items() if parameter.node in nodes}
    unmade = {parameter: value for parameter, value in start.items() if _is_unmade(parameter, value.value, made)}
    stated: dict[str, dict[str, dict[str, Any]]] = {EVENT: {}, PROVENANCE: {}}
    for parameter, (value, source) in start.items():
        if parameter not in unmade:
            stated[source].setdefault(parameter.node, {})[parameter.name] = value
    layers = [
        (CUSTOM_DATA, BEFORE if PRESET in reader.custom_data else {}),  # flights are simulated in vacuum
        (EVENT, stated[EVENT]),
        (TOPIC, _places_by_topic(reader, stated[EVENT])),
        (CUSTOM_DATA, custom),
        (PROVENANCE, _unlike(stated[PROVENANCE], custom)),
    ]
    values: dict[str, dict[str, Any]] = {}
    sources: dict[Parameter, str] = {}
    for source, layer in layers:  # the later ones replace the earlier ones
        values = merged(values, layer)
        sources |= dict.fromkeys(parameters_in(layer), source)
    # The provenance states all that nodes had, and so do the custom data of a flight that was simulated before.
    is_simulated = PRESET in reader.custom_data and not _states_deviations(custom)
    before = _before(values, merged(stated[PROVENANCE], custom if is_simulated else {}))
    values = merged(values, before)
    sources |= dict.fromkeys(parameters_in(before), PROVENANCE)
    unmade = {parameter: value for parameter, value in unmade.items() if parameter not in sources}
    return RecordedParameters(reader.path, values, sources, unmade)


def parameters_in(values: NodeParameters) -> list[Parameter]:
    """The parameters that have values."""
    return [Parameter(node, name) for node, of_node in values.items() for name in of_node]


def _is_unmade(parameter: Parameter, value: Any, made: Collection[str]) -> bool:
    """True if a value names heights that are not made."""
    names_heights = parameter.name == "estimator" and takes_heights(STAGES[parameter.node])
    return names_heights and isinstance(value, str) and value not in made


def _before(values: NodeParameters, stated: NodeParameters) -> dict[str, dict[str, Any]]:
    """Parameters that nodes with stated values did not have yet, with values by which they work as they did then.

    Standard deviations are 0: nothing was assumed.
    """
    found: dict[str, dict[str, Any]] = {}
    for node in STAGES.keys() & stated.keys():
        then = {**dict.fromkeys(_deviations(node), 0.0), **BEFORE.get(node, {})}
        found[node] = {name: value for name, value in then.items() if name not in values[node]}
    return found


def _deviations(node: str) -> list[str]:
    """Standard deviations of a node that are assumed where nobody states them."""
    return [name for name, entry in settings_of(STAGES[node].settings).items() if entry.default == AS_DESCRIBED]


def _states_deviations(values: NodeParameters) -> bool:
    """True if any of them is stated."""
    return any(name in values[node] for node in STAGES.keys() & values.keys() for name in _deviations(node))


def _unlike(stated: NodeParameters, others: NodeParameters) -> dict[str, dict[str, Any]]:
    """Values that are not the same in `others`."""
    return {
        node: {name: value for name, value in values.items() if others.get(node, {}).get(name, _NOTHING) != value}
        for node, values in stated.items()
    }


_NOTHING = object()


def _places_by_topic(reader: BagReader, stated: NodeParameters) -> dict[str, dict[str, float]]:
    """Parameters of mappers that say where the map is, by topic map_origin; not of those that stated it themselves."""
    return {
        node: values
        for node, values in placed(origin_of(reader)).items()
        if not any(stated.get(node, {}).get(f"origin_{axis}_deg") for axis in ("latitude", "longitude"))
    }


def _custom_data(reader: BagReader) -> dict[str, dict[str, Any]] | None:
    """Node parameters in the custom data of a bag, or in a file next to it; None if there are neither.

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
    return {node: with_new_names(entry) for node, entry in values.items()}


def _read(text: str) -> Any:
    """Value of a text in JSON, or else in YAML, for which 1e-05 is no number."""
    with suppress(json.JSONDecodeError):
        return json.loads(text)
    return yaml.safe_load(text)
