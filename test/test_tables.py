"""Numbers as texts for users."""

from __future__ import annotations

import math

import pytest

from sal_height.tables import counted, with_prefix


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.536e-8, "15.36 nW"),
        (42_980_000.0, "42.98 MW"),
        (999.96, "1 kW"),
        (-0.7071, "-707.1 mW"),
        (1.0, "1 W"),
        (0.0, "0 W"),
        (2e-15, "0.002 pW"),
        (3e16, "3e+04 TW"),
        (math.nan, "nan W"),
        (math.inf, "inf W"),
    ],
)
def test_a_unit_has_the_prefix_by_which_its_number_is_from_1_to_1000(value: float, text: str) -> None:
    assert " ".join(with_prefix(value, "W")) == text


def test_one_thing_is_no_plural() -> None:
    assert [counted(count, "dwell") for count in (0, 1, 2)] == ["0 dwells", "1 dwell", "2 dwells"]
