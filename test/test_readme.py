"""README and documents: examples run as they stand, commands, parameters and links exist."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from sal_height.commands._program import program
from sal_height.nodes.processing import PROCESSING
from sal_height.settings import settings_of
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.preset import (
    Flight,
    HybridSettings,
    ImageSize,
    MountingSettings,
    Preset,
    SensorSettings,
    TargetSettings,
)

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
DOCUMENTS = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NODES = {
    **PROCESSING,
    "sar_compression": PROCESSING["sar_compression"],
    "psf_calibration": PROCESSING["psf_calibration"],
    "relief_mapper": PROCESSING["relief_mapper"],
}

EXAMPLES = re.findall(r"^```python\n(.*?)^```", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)

ALL_DOCUMENTS = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)


def commands_in(document: Path) -> list[list[str]]:
    """Words of the sal-height commands in code blocks and between backquotes, of those that leave no word open."""
    text = document.read_text(encoding="utf-8").replace("\\\n", " ")
    fenced = re.findall(r"^ *```(\w*)\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
    blocks = [content for language, content in fenced if not language]
    spans = re.findall(r"`(sal-height [^` ]+ [^`]+)`", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL))
    lines = [line.strip() for block in blocks for line in block.splitlines()] + spans
    words = [line.split("#")[0].split() for line in lines if line.startswith("sal-height ")]
    return [line[1:] for line in words if not re.search(r"\b[A-Z]{3,}\b|…|\*", " ".join(line))]


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_runs_as_it_stands(example: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(example, str(README), "exec"), {})  # noqa: S102 (our own text)
    assert capsys.readouterr().out


def test_there_is_an_example_of_ten_lines_from_preset_to_heights() -> None:
    (whole,) = [example for example in EXAMPLES if "load_preset" in example and "heights(" in example]
    assert len([line for line in whole.splitlines() if line.strip()]) <= 10


@ALL_DOCUMENTS
def test_commands_can_be_parsed_and_set_parameters_that_exist(document: Path) -> None:
    for words in commands_in(document):
        program().parse_args(words, exit_on_error=False, print_error=False)
        for node, name in re.findall(r"--param (\w+)\.(\w+)=", " ".join(words)):
            assert name in settings_of(NODES[node].parameters), f"{node}.{name} in {document.name}"


def test_readme_has_commands_to_check() -> None:
    assert len(commands_in(README)) >= 5


@pytest.mark.parametrize(
    "part", [Preset, SensorSettings, Flight, ImageSize, HybridSettings, MountingSettings, TargetSettings, Impairments]
)
def test_every_key_of_a_preset_is_described(part: type) -> None:
    pages = (ROOT / "docs" / name for name in ("presets.md", "presets_impairments.md"))
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    assert [entry.name for entry in fields(part) if not re.search(rf"\b{entry.name}\b", text)] == []


@ALL_DOCUMENTS
def test_files_of_tests_and_code_exist(document: Path) -> None:
    for name in re.findall(r"`([\w/]+/\w+\.py)`", document.read_text(encoding="utf-8")):
        assert (ROOT / name).exists() or (ROOT / "sal_height" / name).exists(), f"{name} in {document.name}"


@ALL_DOCUMENTS
def test_links_lead_to_files_and_headings(document: Path) -> None:
    for link in re.findall(r"\]\(([^)]+)\)", document.read_text(encoding="utf-8")):
        name, _, heading = link.partition("#")
        target = document.parent / name if name else document
        assert target.exists(), f"{link} in {document.name}"
        if heading:
            titles = re.findall(r"^#+ (.+)$", target.read_text(encoding="utf-8"), re.MULTILINE)
            assert heading in [re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles], link
