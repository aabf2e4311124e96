"""YAML files as frozen dataclasses; an error in one is reported as a message."""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from annotated_types import Ge, Le
from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

from sal_height.errors import UserError

T = TypeVar("T")


class StrictKeys:
    """Base of the dataclasses: unknown keys, infinities and NaN are refused."""

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)


def _not_boolean(value: Any) -> Any:
    if isinstance(value, bool):
        raise PydanticCustomError("boolean", "it must be a number, not true or false")
    return value


Float = Annotated[float, BeforeValidator(_not_boolean)]
Int = Annotated[int, BeforeValidator(_not_boolean)]
Decibels = Annotated[Float, Ge(-60), Le(60)]
Angle = Annotated[Float, Ge(-math.pi), Le(math.pi)]

EXPECTED = {
    "dataclass_type": "a mapping of keys to values",
    "dict_type": "a mapping of keys to values",
    "tuple_type": "a list",
    "string_type": "a text",
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
}
"""Description of a valid value, by the type of the error that pydantic reports for an invalid one."""


def read_yaml(path: Path, source: str, unreadable: str) -> Any:
    """The content of a YAML file.

    Args:
        path: path of the file.
        source: name of the file in messages.
        unreadable: message if the file cannot be read.

    Raises:
        UserError: it cannot be read, or is no YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise UserError(unreadable) from error
    try:
        return yaml.safe_load(text)
    except RecursionError as error:
        raise UserError(f"{source} is nested too deeply; a few levels of keys are enough.") from error
    except (yaml.YAMLError, ValueError) as error:
        raise UserError(f"{source} is not valid YAML: {' '.join(str(error).split())}.") from error


def validated(kind: type[T], content: Any, source: str) -> T:
    """An object of a dataclass with that content (mappings as from YAML); `source` names it in messages.

    Raises:
        UserError: a key that is missing, unknown or out of its range: the first one found.
    """
    try:
        made: T = _adapter(kind).validate_python(content)  # type: ignore[arg-type]  # a class has a hash
    except ValidationError as error:
        raise UserError(f"{source}: {_refusal(error)}.") from error
    return made


@cache
def _adapter(kind: type[Any]) -> TypeAdapter[Any]:
    """Making one takes longer than many validations."""
    return TypeAdapter(kind)


def _refusal(error: ValidationError) -> str:
    """The first problem of a validation error: where, what is wrong, what is allowed."""
    first = error.errors()[0]
    key = " ".join(".".join(str(part) for part in first["loc"]).split()) or "the top level"
    if first["type"] == "missing":
        return f"{key} is missing; it is required"
    if first["type"] in ("unexpected_keyword_argument", "invalid_key"):
        return f"{key} is not a known key; remove it or correct its spelling"
    said = re.sub(r"^\w+ should ", "it must ", first["msg"].replace(" after validation", ""))
    allowed = f"it must be {EXPECTED[first['type']]}" if first["type"] in EXPECTED else _rounded(said)
    try:
        value = repr(first["input"]) if isinstance(first["input"], str) else _rounded(repr(first["input"]))
    except ValueError:
        value = "a number of thousands of digits"  # more than Python writes
    return f"{key} is {value if len(value) <= 100 else f'{value[:100]} ...'}; {allowed}"


def _rounded(text: str) -> str:
    """The text with numbers of more than seven characters rounded to six digits."""
    return re.sub(r"\d+(\.\d+)?(e[-+]?\d+)?", lambda n: n[0] if len(n[0]) <= 7 else f"{float(n[0]):.6g}", text)
