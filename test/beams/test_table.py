"""Tables of measured beams: what they hold, and files of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from beam_tables import sample_pattern, write_beam_tables
from helpers import BEAMWIDTH, assert_one_sentence, make_sensor, refused

from sal_height.beams.pattern import pattern_named
from sal_height.beams.table import BeamTable
from sal_height.beams.table_files import COLUMNS, read_beam_tables
from sal_height.errors import UserError

TABLE = BeamTable((-0.2, -0.1, 0.0, 0.3), (0.0,), (0.5, 0.9, 1.0, 0.1), (0.0, -0.1, 0.0, 0.2))
HEADER = ",".join(COLUMNS)
FOUR_ROWS = [f"0,{e},0,1,0" for e in (-1, 0, 1, 2)]


def test_amplitudes_have_elevation_first() -> None:
    count = 4 * 5
    table = BeamTable((-1, 0, 1, 2), (0, 1, 2, 3, 4), tuple(range(count)), tuple(range(count, 2 * count)))
    assert table.values.shape == (4, 5)
    assert table.values[1, 2] == 7 + 27j


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"elevation": (0.0, 0.1, 0.2)}, ("3 offsets in elevation", "4 or more")),
        ({"elevation": (0.0, 0.1, 0.1, 0.2)}, ("4 offsets in elevation", "increasing")),
        ({"elevation": (0.0, 0.1, np.nan, 0.2)}, ("4 offsets in elevation", "finite")),
        ({"azimuth": (0.0, 0.1)}, ("2 offsets in azimuth", "4 or more (or one in azimuth)")),
        ({"azimuth": ()}, ("0 offsets in azimuth", "4 or more (or one in azimuth)")),
        ({"real": (1.0,) * 3}, ("3 real and 4 imaginary parts", "4 x 1 angles need 4 each")),
        ({"imaginary": (1.0,) * 8}, ("4 real and 8 imaginary parts", "need 4 each")),
        ({"real": (1.0, 1.0, np.inf, 1.0)}, ("not finite",)),
        ({"real": (0.0,) * 4, "imaginary": (0.0,) * 4}, ("all zero",)),
    ],
)
def test_table_that_makes_no_sense_is_refused(changes: dict[str, tuple[float, ...]], parts: tuple[str, ...]) -> None:
    with refused(UserError, "beam table", *parts):
        replace(TABLE, **changes)


def write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def assert_alike(table: BeamTable, other: BeamTable) -> None:
    """The same amplitudes at angles that have been divided by the beamwidth and multiplied by it."""
    assert (table.real, table.imaginary) == (other.real, other.imaginary)
    for angles, others in ((table.elevation, other.elevation), (table.azimuth, other.azimuth)):
        np.testing.assert_allclose(angles, others, rtol=1e-15)


def test_written_tables_are_read_again(tmp_path: Path) -> None:
    steps = np.arange(-10, 11) * 0.1 * BEAMWIDTH
    jinc = sample_pattern(pattern_named("jinc"), steps, steps[5:12] + 1e-7, BEAMWIDTH)
    path = tmp_path / "beams.csv"
    write_beam_tables(path, [jinc, TABLE], BEAMWIDTH)
    assert path.read_text().partition("\n")[0] == "detector,elevation_beamwidths,azimuth_beamwidths,real,imaginary"
    first, second = read_beam_tables(path, BEAMWIDTH)
    assert_alike(first, jinc)
    assert_alike(second, TABLE)


def test_read_tables_make_a_sensor(tmp_path: Path) -> None:
    steps = np.arange(-40, 41) * 0.1 * BEAMWIDTH
    write_beam_tables(tmp_path / "beams.csv", [sample_pattern(pattern_named("sinc"), steps, 0.0, BEAMWIDTH)], BEAMWIDTH)
    sensor = make_sensor(pattern="table", beam_tables=read_beam_tables(tmp_path / "beams.csv", BEAMWIDTH))
    elevation = np.pi / 4 + np.linspace(-1, 1, 21) * BEAMWIDTH
    np.testing.assert_allclose(
        sensor.beams.response(elevation, 0.0), make_sensor(pattern="sinc").beams.response(elevation, 0.0), atol=2e-5
    )


def test_offsets_are_in_beamwidths_and_rows_in_any_order(tmp_path: Path) -> None:
    rows = [
        f"{detector},{e},{a},{e + detector},{a}"
        for detector in (1, 0)
        for a in (0.5, -0.5, 0.0, 1.5)
        for e in (2, 0, 3, -1)
    ]
    path = write(tmp_path / "beams.csv", "\ufeff" + HEADER, *rows[::3], "", *rows[1::3], *rows[2::3])
    for detector, table in enumerate(read_beam_tables(path, 1e-4)):
        np.testing.assert_allclose(table.elevation, np.array([-1, 0, 2, 3]) * 1e-4, rtol=1e-15)
        np.testing.assert_allclose(table.azimuth, np.array([-0.5, 0.0, 0.5, 1.5]) * 1e-4, rtol=1e-15)
        expected = np.add.outer(np.array([-1, 0, 2, 3]) + detector, 1j * np.array([-0.5, 0.0, 0.5, 1.5]))
        np.testing.assert_array_equal(table.values, expected)


def test_file_without_azimuths_in_columns_of_another_order(tmp_path: Path) -> None:
    rows = [f"{e / 4}, {e} ,0,-0.5" for e in range(4)]
    path = write(tmp_path / "beams.csv", "real, elevation_beamwidths,detector,imaginary", *rows)
    (table,) = read_beam_tables(path, 2.0)
    assert table == BeamTable((0.0, 2.0, 4.0, 6.0), (0.0,), (0.0, 0.25, 0.5, 0.75), (-0.5,) * 4)


@pytest.mark.parametrize(
    ("lines", "parts"),
    [
        (["detector,elevation_beamwidths,real", "0,1,1"], ("line 1", "'detector, elevation", "real, imaginary")),
        ([HEADER + ",gain", *FOUR_ROWS], ("line 1", "gain", "once each")),
        ([HEADER + ",real", *FOUR_ROWS], ("line 1", "once each")),
        (["", *FOUR_ROWS], ("line 1", "'nothing'")),
        ([HEADER], ("no rows", "at least one")),
        ([HEADER, *FOUR_ROWS, "0,3,0,1"], ("line 6", "4 values", "5 columns")),
        ([HEADER, *FOUR_ROWS, "0,3,0,one,0"], ("line 6", "real is 'one'", "finite number")),
        ([HEADER, *FOUR_ROWS, "0,3,0,1,inf"], ("line 6", "imaginary is 'inf'", "finite number")),
        ([HEADER, *FOUR_ROWS, "0,,0,1,0"], ("line 6", "elevation_beamwidths is ''", "finite number")),
        ([HEADER, *FOUR_ROWS, "0.5,3,0,1,0"], ("line 6", "detector is '0.5'", "whole number of 0 or more")),
        ([HEADER, *FOUR_ROWS, "-1,3,0,1,0"], ("line 6", "detector is '-1'", "whole number of 0 or more")),
        ([HEADER, "9" * 400 + ",3,0,1,0"], ("line 2", "detector is '99", "whole number of 0 or more")),
        ([HEADER, *FOUR_ROWS, "0,1.0,0.0,1,0"], ("line 6", "elevation 1 and azimuth 0 of detector 0", "line 4")),
        ([HEADER, *FOUR_ROWS, "0,0,1,1,0"], ("detector 0", "elevation -1 and azimuth 1", "complete")),
        ([HEADER, *FOUR_ROWS[:3]], ("detector 0", "3 offsets in elevation", "4 or more")),
        ([HEADER, *(row[:-3] + "0,0" for row in FOUR_ROWS)], ("detector 0", "all zero")),
        ([HEADER, *FOUR_ROWS, "2" + FOUR_ROWS[0][1:]], ("2 detectors", "none of detector 1", "from 0")),
        ([HEADER, '"' + "x" * 200_000], ("no CSV text", "imaginary")),
    ],
)
def test_defect_of_a_file_is_named_with_its_place(tmp_path: Path, lines: list[str], parts: tuple[str, ...]) -> None:
    path = write(tmp_path / "beams.csv", *lines)
    with pytest.raises(UserError) as refusal:
        read_beam_tables(path, BEAMWIDTH)
    assert str(refusal.value).startswith(str(path))
    assert_one_sentence(str(refusal.value).replace(str(path), "File"), *parts)


@pytest.mark.parametrize("content", [b"", b"\x00\x01\x02", b"\xff\xfe\x80\x81" * 9, b"\x89PNG\r\n\x1a\n\x00\x00\x00"])
def test_empty_or_binary_file_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "beams.csv"
    path.write_bytes(content)
    with pytest.raises(UserError) as refusal:
        read_beam_tables(path, BEAMWIDTH)
    assert_one_sentence(str(refusal.value).replace(str(path), "File"), "columns", "elevation_beamwidths")


def test_file_that_cannot_be_opened_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(UserError) as refusal:
            read_beam_tables(path, BEAMWIDTH)
        assert_one_sentence(str(refusal.value).replace(str(tmp_path), "File"), "File", "cannot be")
