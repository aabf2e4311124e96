"""CPHD and CRSD files by the standard; those that are damaged, of other versions, or something else are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import written_cphd
import written_crsd
from helpers import assert_one_sentence
from phase_history_files import complaint
from sarkit.verification import CphdConsistency, CrsdConsistency
from written_cphd import write_cphd
from written_crsd import write_crsd

pytestmark = pytest.mark.filterwarnings("ignore:(open|read)_text is:DeprecationWarning")  # of sarkit, which opens so


class Format(NamedTuple):
    """Writer of files and its kinds, checker with the least number of checks that pass, samples at a file's end."""

    write: Callable[..., Path]
    kinds: dict[str, dict[str, Any]]
    checker: Any
    least: int
    samples: int


FORMATS = {
    "cphd": Format(write_cphd, written_cphd.CONVENTIONS, CphdConsistency, 50, 240 * written_cphd.PULSES),
    "crsd": Format(
        write_crsd, written_crsd.CONVENTIONS, CrsdConsistency, 80, written_crsd.SAMPLES * written_crsd.PULSES
    ),
}


@pytest.mark.parametrize(("name", "kind"), [(name, kind) for name, one in FORMATS.items() for kind in one.kinds])
def test_the_files_are_what_the_standard_says(name: str, kind: str, tmp_path: Path) -> None:
    """So says the checker of sarkit: geometry, waveform, times, sizes and the schema fit each other."""
    known = FORMATS[name]
    with known.write(tmp_path / "a", **known.kinds[kind]).open("rb") as file:
        check = known.checker.from_file(file, thorough=True)
        check.check()
    assert not check.failures()
    assert len(check.passes()) > known.least


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("cphd", b"nothing", "is not CPHD"),
        ("cphd", b"CPHD/2.0\n\f\n", "is CPHD of version 2.0; versions 1.0 and 1.1 are read"),
        ("cphd", b"CPHD/0.3\n\f\n", "is CPHD of version 0.3; versions 1.0 and 1.1 are read"),
        ("cphd", b"CPHD/1.1.0\nXML_BLOCK_SIZE := 5\n\f\n", "not a readable CPHD file"),
        ("crsd", b"nothing", "is not CRSD"),
        ("crsd", b"CRSD/1.0.0\n\f\n", "is not CRSD: it does not begin with the word CRSDsar/"),
        ("crsd", b"CRSDrcv/1.0\n\f\n", "is CRSDrcv, one way only"),
        ("crsd", b"CRSDsar/1.1\n\f\n", "is CRSD of version 1.1; version 1.0 is read"),
        ("crsd", b"CRSDsar/1.0\nXML_BLOCK_SIZE := 5\n\f\n", "not a readable CRSD file"),
    ],
)
def test_files_that_are_none_or_of_other_versions_are_refused(
    name: str, content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.file").write_bytes(content)
    assert_one_sentence(complaint(name, tmp_path / "a.file", capsys), "a.file", words)


PLACES = {"samples": {"cphd": -1000, "crsd": -1000}, "parameters": {"cphd": 20_000, "crsd": 40_000}}
PLACES |= {"metadata": {"cphd": 2000, "crsd": 2000}, "header": {"cphd": 100, "crsd": 100}}


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("place", PLACES)
def test_a_file_that_is_cut_off_is_refused(
    name: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = FORMATS[name].write(tmp_path / "a")
    path.write_bytes(path.read_bytes()[: PLACES[place][name]])
    assert_one_sentence(complaint(name, path, capsys), f"not a readable {name.upper()} file")


@pytest.mark.parametrize("name", FORMATS)
def test_samples_in_little_endian_order_are_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The standards have big-endian ones; swapped, some of many look infinite."""
    path = FORMATS[name].write(tmp_path / "a")
    content, size = bytearray(path.read_bytes()), 8 * FORMATS[name].samples
    content[-size:] = np.frombuffer(content[-size:], ">f4").astype("<f4").tobytes()
    path.write_bytes(content)
    said = complaint(name, path, capsys)
    assert_one_sentence(said, "NaN or infinite; all must be finite, and stored in")
