"""The ROS parameters of a node, declared from a `Settings` class and read as one frozen object."""

from __future__ import annotations

import sys
import threading
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height.errors import UserError
from sal_height.settings import Setting, Settings, settings_of

SettingsT = TypeVar("SettingsT", bound=Settings)

INTEGER_LIMITS = (-(2**63), 2**63 - 1)


class LiveParameters(Generic[SettingsT]):
    """The parameters of a running node.

    Every read of `current` gives an object whose values were set together: it is replaced as a whole after each change,
    so that a thread that reads while another one sets never sees a mixture.

    Attributes:
        current: present values.
    """

    def __init__(self, node: Node, model: type[SettingsT]) -> None:
        """Declare every field of `model` on `node`, and refuse values that it does not allow from now on.

        A whole number is accepted where the field is a float.

        Raises:
            UserError: an override has the wrong type, is out of range or is not one of the choices.
        """
        self._entries = settings_of(model)
        self._lock = threading.Lock()
        self.current = model(**{name: _override(node, entry) for name, entry in self._entries.items()})
        for name, entry in self._entries.items():
            node.declare_parameter(name, _to_ros(getattr(self.current, name)), _descriptor(entry), ignore_override=True)
        node.add_pre_set_parameters_callback(self._convert)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._replace)

    def _convert(self, parameters: list[Parameter]) -> list[Parameter]:
        """Make floats of whole numbers, which rclpy would refuse."""
        return [Parameter(p.name, value=float(p.value)) if self._takes_float(p) else p for p in parameters]

    def _takes_float(self, parameter: Parameter) -> bool:
        entry = self._entries.get(parameter.name)
        return entry is not None and entry.kind is float and type(parameter.value) is int

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._with(parameters)
        except UserError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _replace(self, parameters: list[Parameter]) -> None:
        with self._lock:
            self.current = self._with(parameters)

    def _with(self, parameters: list[Parameter]) -> SettingsT:
        return self.current.changed(
            **{p.name: _from_ros(p.value, self._entries[p.name]) for p in parameters if p.name in self._entries}
        )


def parameter_of(name: str, value: Any) -> Parameter:
    """A parameter; an empty list, of which rclpy cannot determine the type, is one of texts here."""
    value = list(value) if isinstance(value, tuple) else value
    return Parameter(name, Parameter.Type.STRING_ARRAY, []) if value == [] else Parameter(name, value=value)


def _override(node: Node, entry: Setting) -> Any:
    """The value that the parameter was given at the start, of whatever type, or its default.

    rclpy shows an override of the wrong type only to a parameter of any type. Such a parameter is declared for the
    moment.
    """
    default = None if isinstance(entry.default, tuple) else entry.default
    value = node.declare_parameter(entry.name, default, ParameterDescriptor(dynamic_typing=True)).value
    node.undeclare_parameter(entry.name)
    return _from_ros(value, entry)


def _from_ros(value: Any, entry: Setting) -> Any:
    """A value of ROS as the model accepts it: lists as tuples, and the default for a list that is not given."""
    if not isinstance(entry.default, tuple):
        return value
    return entry.default if value is None else tuple(value) if isinstance(value, list) else value


def _to_ros(value: Any) -> Any:
    """A value of a model as rclpy accepts it; an empty list, whose type rclpy cannot determine, is one of texts."""
    return (list(value) or Parameter.Type.STRING_ARRAY) if isinstance(value, tuple) else value


def _descriptor(entry: Setting) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=entry.text, read_only=entry.read_only)
    descriptor.additional_constraints = entry.allowed
    if entry.minimum is None and entry.maximum is None:
        return descriptor
    if entry.kind is float:
        most = sys.float_info.max  # of a parameter that is bounded on one side only: ROS knows no open ranges
        low, high = _limits(entry, -most, most)
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    else:
        low, high = _limits(entry, *INTEGER_LIMITS)
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return descriptor


def _limits(entry: Setting, lowest: float, highest: float) -> tuple[float, float]:
    return (
        lowest if entry.minimum is None else entry.minimum,
        highest if entry.maximum is None else entry.maximum,
    )
