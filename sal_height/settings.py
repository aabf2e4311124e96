"""Settings of an algorithm or a node: a frozen model whose fields carry description, unit and allowed values.

    class LookSettings(Settings):
        range_looks: int = setting(2, "pixels averaged in range", minimum=1, maximum=4096)
        min_cnr: float = setting(5.0, "lowest CNR of a valid pixel", unit="dB", minimum=-60.0, maximum=100.0)

    settings = LookSettings(range_looks=4)
    coarser = settings.changed(range_looks=8)

A node takes such a model as the class of its ROS parameters. The settings of an algorithm become parameters of a node
by inheritance: ``class Parameters(HeightParameters, LookSettings)``.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Self

from annotated_types import Ge, Le
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from sal_height.errors import UserError, did_you_mean
from sal_height.renamed import PARAMETERS, VALUES

KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}  # as messages call types


def setting(
    default: Any,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Sequence[str] = (),
    read_only: bool = False,
    names_file: bool = False,
) -> Any:
    """Declare a field of a `Settings` class.

    Args:
        default: value of the field if none is given.
        description: effect of the setting, without its unit.
        unit: unit of the value, for example "dB" or "m/s"; empty if it has none.
        minimum: least value allowed.
        maximum: greatest value allowed.
        choices: texts that are allowed; empty: every text.
        read_only: True if a node reads the value only when it starts.
        names_file: True if the value is the path of a file.
    """
    extra: Any = {"unit": unit, "choices": list(choices), "read_only": read_only, "names_file": names_file}
    return Field(default, description=description, ge=minimum, le=maximum, json_schema_extra=extra)


class Settings(BaseModel):
    """Base class of settings. The values are checked when an object is made, and cannot be changed afterwards.

    A whole number is accepted for a float. Unknown names, NaN, infinities and values of another type are refused.

    Raises:
        UserError: a name or value is not allowed; the message states which, and what is allowed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True, validate_default=True)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise UserError(_sentence(type(self), error)) from None

    def changed(self, **values: Any) -> Self:
        """A copy with other values of the fields that are named.

        Raises:
            UserError: a name or value is not allowed.
        """
        return type(self)(**{**dict(self), **values})

    @model_validator(mode="after")
    def _check_choices(self) -> Self:
        for name, entry in settings_of(type(self)).items():
            if entry.choices and getattr(self, name) not in entry.choices:
                raise UserError(entry.refusal(getattr(self, name)))
        return self


@dataclass(frozen=True)
class Setting:
    """One field of a `Settings` class, as tables and messages show it: its name, its type, and what `setting` says."""

    name: str
    kind: Any
    default: Any
    description: str
    unit: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]
    read_only: bool
    names_file: bool

    @property
    def text(self) -> str:
        """Description with the unit."""
        return f"{self.description} [{self.unit}]" if self.unit else self.description

    @property
    def allowed(self) -> str:
        """The values that are allowed, as the end of a message."""
        if self.choices:
            return f"allowed are {', '.join(self.choices)}"
        kind = KINDS.get(self.kind, "a list of texts" if self.kind == tuple[str, ...] else f"of type {self.kind}")
        if self.minimum is not None and self.maximum is not None:
            return f"it must be {kind} from {self.minimum:.10g} to {self.maximum:.10g}"
        if self.minimum is not None:
            return f"it must be {kind}, {self.minimum:.10g} or more"
        if self.maximum is not None:
            return f"it must be {kind}, {self.maximum:.10g} or less"
        return f"it must be {kind}"

    def refusal(self, value: Any) -> str:
        """A message that `value` is not allowed, and which values are."""
        if isinstance(value, (bool, str)) and (new := VALUES.get(self.name, {}).get(value)) in self.choices:
            return f"Parameter {self.name} is {value!r}, which is named {new!r} now."
        return f"Parameter {self.name} {'has no value' if value is None else f'is {value!r}'}; {self.allowed}."


@functools.cache
def settings_of(model: type[Settings]) -> Mapping[str, Setting]:
    """The fields of a `Settings` class by name, in the order of declaration."""
    return MappingProxyType({name: _entry(name, field) for name, field in model.model_fields.items()})


def unknown_name(name: str, known: Iterable[str], owner: str = "") -> str:
    """A message that there is no parameter `name`, with the closest one and a list of all.

    Args:
        name: name that does not exist.
        known: names that exist.
        owner: owner of the parameter, for example "Node ml_height"; empty: not stated.
    """
    names = list(known)
    if (new := PARAMETERS.get(name)) in names:
        return f"Parameter {name!r} {f'of {owner[0].lower()}{owner[1:]} ' if owner else ''}is named {new!r} now."
    beginning = f"{owner} has" if owner else "There is"
    return f"{beginning} no parameter {name!r}{did_you_mean(name, names)}; allowed are {', '.join(names) or 'none'}."


def _entry(name: str, field: FieldInfo) -> Setting:
    extra: Any = field.json_schema_extra or {}
    return Setting(
        name=name,
        kind=field.annotation,
        default=field.default,
        description=field.description or "",
        unit=extra.get("unit", ""),
        minimum=next((float(str(bound.ge)) for bound in field.metadata if isinstance(bound, Ge)), None),
        maximum=next((float(str(bound.le)) for bound in field.metadata if isinstance(bound, Le)), None),
        choices=tuple(extra.get("choices", ())),
        read_only=extra.get("read_only", False),
        names_file=extra.get("names_file", False),
    )


def _sentence(model: type[Settings], error: ValidationError) -> str:
    """The first problem of a validation error, as one message."""
    first = error.errors(include_url=False)[0]
    if isinstance(cause := first.get("ctx", {}).get("error"), UserError):
        return str(cause)
    entries = settings_of(model)
    name = str(first["loc"][0]) if first["loc"] else ""
    if first["type"] == "extra_forbidden":
        return unknown_name(name, entries)
    if name not in entries:
        return f"{first['msg']}."
    given = first["input"]
    if len(first["loc"]) > 1:  # an element of a sequence, or a field of settings within these
        inner = ".".join(str(part) for part in first["loc"])
        return f"Parameter {inner} is {given!r}: {first['msg'][0].lower()}{first['msg'][1:]}."
    return entries[name].refusal(given)
