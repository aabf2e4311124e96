"""Files with the places of known targets."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import refused

from sal_height.adjustment import Target, read_targets
from sal_height.errors import UserError


def test_targets_are_read_whatever_the_order_of_the_columns(tmp_path: Path) -> None:
    file = tmp_path / "targets.csv"
    file.write_text("height_m, sigma_m, east_m, north_m\n1.02,0.02,-3.5,3\n\n 0.5,0.01,2,-1e1\n", encoding="utf-8")
    assert read_targets(file) == (Target(-3.5, 3.0, 1.02, 0.02), Target(2.0, -10.0, 0.5, 0.01))
    file.write_text("east_m,north_m,height_m\n1,2,3\n", encoding="utf-8-sig")
    assert read_targets(file) == (Target(1.0, 2.0, 3.0, 0.01),)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", ("the columns are none", "east_m, north_m, height_m")),
        ("east_m,north_m\n1,2\n", ("the columns are east_m, north_m;",)),
        ("east_m,north_m,height_m,height_m\n1,2,3,4\n", ("the columns are",)),
        ("east_m,north_m,height_m\n", ("has no targets",)),
        ("east_m,north_m,height_m\n1,2,3\n1,2\n", ("line 3, has 2 values", "must be 3")),
        ("east_m,north_m,height_m\n1,two,3\n", ("line 2: north_m is 'two'",)),
        ("east_m,north_m,height_m\n1,nan,3\n", ("line 2: north_m is 'nan'",)),
        ("east_m,north_m,height_m\n1,1e7,3\n", ("line 2: north_m is '1e7'; it must be a number of at most 1e+06 m",)),
        ("east_m,north_m,height_m,sigma_m\n1,2,3,0\n", ("line 2: sigma_m is 0; it must be 0.0001 to 1e+06 m",)),
        ("\x00\n", ("targets.csv",)),
        (b"\xff\xfe\xfa", ("targets.csv",)),
        (None, ("targets.csv", "No such file")),
    ],
)
def test_a_file_that_cannot_be_used_gets_one_sentence(
    content: str | bytes | None, says: tuple[str, ...], tmp_path: Path
) -> None:
    file = tmp_path / "targets.csv"
    if content is not None:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with refused(UserError, *says):
        read_targets(file)
