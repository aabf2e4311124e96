"""Lengths of FFTs and blocks of rows."""

from __future__ import annotations

import pytest

from sal_height.numeric.transforms import BUFFER, blocks, fast_length, rows_at_once


@pytest.mark.parametrize("least", [1, 16, 17, 1000, 4097])
def test_fast_lengths_are_long_enough_and_have_small_factors(least: int) -> None:
    """At most a fifth longer than asked for, from a few vectors on."""
    length = rest = fast_length(least)
    assert least <= length <= max(32, 1.2 * least)
    assert length % 16 == 0
    for factor in (2, 3, 5):
        while rest % factor == 0:
            rest //= factor
    assert rest == 1


def test_blocks_cover_all_rows_once_and_fit_into_the_buffer() -> None:
    rows = rows_at_once(1000)
    assert rows == BUFFER // 1000
    assert rows_at_once(10 * BUFFER) == 1
    covered = [row for block in blocks(10, 4) for row in range(10)[block]]
    assert covered == list(range(10))
    assert blocks(0, 4) == []
