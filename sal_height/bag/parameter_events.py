"""The parameters of nodes in a bag: events."""

from __future__ import annotations

from sal_height.messages.types import ParameterEvent

PARAMETER_EVENTS, PARAMETER_EVENT_TYPE = "/parameter_events", "rcl_interfaces/msg/ParameterEvent"


def after(known: ParameterEvent | None, event: ParameterEvent) -> ParameterEvent:
    """All parameters of a node after an event, as an event of new parameters; `known`: the parameters before."""
    values = {parameter.name: parameter for parameter in (known.new_parameters if known else ())}
    values |= {parameter.name: parameter for parameter in (*event.new_parameters, *event.changed_parameters)}
    for parameter in event.deleted_parameters:
        values.pop(parameter.name, None)
    return ParameterEvent(node=event.node, stamp=event.stamp, new_parameters=list(values.values()))
