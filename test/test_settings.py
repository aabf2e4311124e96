"""Settings: what is taken, what is refused and in what words."""

from __future__ import annotations

from typing import Any

import pytest
from helpers import refused
from pydantic import ValidationError

from sal_height.errors import UserError
from sal_height.settings import Settings, setting, settings_of


class Table(Settings):
    """One of each kind."""

    looks: int = setting(2, "pixels averaged", minimum=1, maximum=4096)
    cnr: float = setting(5.0, "lowest CNR", unit="dB", minimum=-60.0, maximum=100.0)
    spacing: float = setting(1, "pixel spacing", unit="m", minimum=0.0)
    depth: int = setting(3, "depth", maximum=9)
    plane: str = setting("slant", "plane of the image", choices=("slant", "ground"))
    bag: str = setting("", "path", read_only=True)
    layover: bool = setting(default=True, description="whether to look for two scatterers")
    weights: tuple[float, ...] = setting((1.0,), "weights")


class More(Table):
    """A table that adds to another one."""

    gate: float = setting(4.0, "gate", minimum=1.0)


class Nested(Settings):
    """Settings within settings."""

    table: Table = setting(Table(), "the table")


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("looks", 5000, "Parameter looks is 5000; it must be a whole number from 1 to 4096."),
        ("looks", "9", "Parameter looks is '9'; it must be a whole number from 1 to 4096."),
        ("looks", 2.0, "Parameter looks is 2.0; it must be a whole number from 1 to 4096."),
        ("looks", True, "Parameter looks is True; it must be a whole number from 1 to 4096."),
        ("looks", None, "Parameter looks has no value; it must be a whole number from 1 to 4096."),
        ("cnr", 101, "Parameter cnr is 101; it must be a number from -60 to 100."),
        ("cnr", float("nan"), "Parameter cnr is nan; it must be a number from -60 to 100."),
        ("cnr", False, "Parameter cnr is False; it must be a number from -60 to 100."),
        ("spacing", -1.0, "Parameter spacing is -1.0; it must be a number, 0 or more."),
        ("spacing", float("inf"), "Parameter spacing is inf; it must be a number, 0 or more."),
        ("depth", 10, "Parameter depth is 10; it must be a whole number, 9 or less."),
        ("plane", "up", "Parameter plane is 'up'; allowed are slant, ground."),
        ("plane", 3, "Parameter plane is 3; allowed are slant, ground."),
        ("bag", 7, "Parameter bag is 7; it must be a text."),
        ("layover", 1, "Parameter layover is 1; it must be true or false."),
    ],
)
def test_a_wrong_value_gets_one_clear_sentence(name: str, value: Any, sentence: str) -> None:
    for attempt in (lambda: Table(**{name: value}), lambda: Table().changed(**{name: value})):
        with pytest.raises(UserError) as refusal:
            attempt()
        assert str(refusal.value) == sentence


def test_an_unknown_name_is_refused_and_the_closest_one_is_named() -> None:
    with pytest.raises(UserError) as refusal:
        Table(look=3)
    assert str(refusal.value) == (
        "There is no parameter 'look' (did you mean 'looks'?); allowed are "
        "looks, cnr, spacing, depth, plane, bag, layover, weights."
    )


def test_a_wrong_element_names_its_place() -> None:
    with refused(UserError, "weights.1", "'heavy'"):
        Table(weights=(1.0, "heavy"))


def test_settings_within_settings_refuse_in_the_same_words() -> None:
    with pytest.raises(UserError) as refusal:
        Nested(table=Table().changed(looks=0))
    assert str(refusal.value) == "Parameter looks is 0; it must be a whole number from 1 to 4096."


def test_a_whole_number_is_taken_for_a_float_and_becomes_one() -> None:
    for value in (Table(cnr=10).cnr, Table().spacing):
        assert isinstance(value, float)


def test_settings_are_frozen_and_compare_by_value() -> None:
    table = Table(looks=4)
    with pytest.raises(ValidationError, match="frozen"):
        table.looks = 5
    assert table == Table(looks=4)
    assert table.changed(looks=2) == Table()
    assert hash(table) == hash(Table(looks=4))


def test_settings_describe_themselves_with_those_they_inherit() -> None:
    entries = settings_of(More)
    assert list(entries) == [*settings_of(Table), "gate"]
    assert (entries["cnr"].text, entries["looks"].text) == ("lowest CNR [dB]", "pixels averaged")
    assert (entries["cnr"].minimum, entries["cnr"].maximum, entries["cnr"].default) == (-60.0, 100.0, 5.0)
    assert (entries["plane"].choices, entries["plane"].allowed) == (("slant", "ground"), "allowed are slant, ground")
    assert [name for name, entry in entries.items() if entry.read_only] == ["bag"]
