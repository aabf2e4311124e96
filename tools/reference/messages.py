"""The page of the messages: what the .msg files say, as text and tables."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, takewhile
from pathlib import Path

from tools.reference.markdown import page, plain, table

FOLDER = Path(__file__).parents[2] / "msg_defs" / "msg"

HEAD = """# Messages

The package `sal_height_msgs`. `tools/reference` makes this page from the files in [`msg_defs/msg`](../../msg_defs/msg);
a test fails if it is out of date. Angles are in rad and all else is in SI units, unless the field says otherwise;
complex numbers are stored as real and imaginary part in turn; a text that names one of several kinds has the constants
it may take beside it. The topics that carry them are in [topics.md](topics.md)."""

ENTRY = re.compile(r"(?P<type>[\w/]+(?:\[[<=\d]*\])?)\s+(?P<name>\w+)\s*(?:=\s*(?P<value>\"[^\"]*\"|[^\s#]+))?")
"""A field or a constant, without the comment beside it."""

OF_CONSTANTS = "One of the constants above."


@dataclass(frozen=True)
class Entry:
    """A field, or a constant with its value; the remark stands beside it."""

    kind: str
    name: str
    value: str
    remark: str


@dataclass(frozen=True)
class Group:
    """Lines of a .msg file between empty lines: a comment, and fields or constants that it is about."""

    comment: tuple[str, ...]
    entries: tuple[Entry, ...]

    @property
    def is_constants(self) -> bool:
        """True if the entries are constants."""
        return bool(self.entries and self.entries[0].value)


def document() -> str:
    """The text of docs/reference/messages.md."""
    files = {path.stem: groups_of(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.msg"))}
    used = {base for groups in files.values() for group in groups for base in map(_base, group.entries)}
    subjects = {name: _first_sentence(groups[0].comment) for name, groups in files.items()}
    whole = [_section(name, groups, subjects) for name, groups in files.items() if name not in used]
    parts = [_section(name, groups, subjects) for name, groups in files.items() if name in used]
    return page([HEAD, "## Messages on topics", *whole, "## Parts of messages", *parts])


def groups_of(text: str) -> list[Group]:
    """The groups of a .msg file, in their order.

    Raises:
        ValueError: a line is neither a comment above fields or constants nor one of these.
    """
    blocks = re.split(r"\n\s*\n", text.strip())
    return [group for block in blocks for group in _groups_of_block(block.splitlines())]


def _groups_of_block(lines: list[str]) -> Iterator[Group]:
    """The group of a block, or two if constants are followed by the fields that have their values."""
    above = list(takewhile(lambda line: line.startswith("#"), lines))
    comment = tuple(line[1:].removeprefix(" ") for line in above)
    entries = [_entry(line) for line in lines[len(above) :]]
    if not entries:
        yield Group(comment, ())
    for position, (_, some) in enumerate(groupby(entries, lambda entry: bool(entry.value))):
        yield Group(comment if position == 0 else (OF_CONSTANTS,), tuple(some))


def _entry(line: str) -> Entry:
    found = ENTRY.match(line)
    rest = line[found.end() :].strip() if found else line
    if found is None or rest[:1] not in {"", "#"}:
        raise ValueError(f"{line!r} is neither a field nor a constant, and no comment above them.")
    return Entry(found["type"], found["name"], found["value"] or "", rest.removeprefix("#").strip())


def _section(name: str, groups: Sequence[Group], subjects: Mapping[str, str]) -> str:
    sections = [f"### {name}", f"[`{name}.msg`](../../msg_defs/msg/{name}.msg)"]
    for kind, some in groupby(groups, lambda group: (bool(group.entries), group.is_constants)):
        if kind == (True, False):
            sections.append(table(("field", "type", "meaning"), [_fields(group, subjects) for group in some]))
        else:
            sections += [part for group in some for part in (_prose(group.comment), _constants(group.entries)) if part]
    return "\n\n".join(sections)


def _fields(group: Group, subjects: Mapping[str, str]) -> tuple[str, str, str]:
    """The row of fields that one comment is about; without one, it says what their own types are."""
    names = "<br>".join(f"`{entry.name}`" for entry in group.entries)
    kinds = "<br>".join(_type(entry.kind, subjects) for entry in group.entries)
    remarks = [entry.remark for entry in group.entries if entry.remark]
    said = [*group.comment, *remarks] or [subjects.get(_base(entry), "") for entry in group.entries]
    return names, kinds, plain(" ".join(said))


def _constants(entries: Sequence[Entry]) -> str:
    if not entries:
        return ""
    if not any(entry.remark for entry in entries):
        return table(("constant", "value"), [(f"`{entry.name}`", f"`{entry.value}`") for entry in entries])
    return table(
        ("constant", "value", "meaning"),
        [(f"`{entry.name}`", f"`{entry.value}`", plain(entry.remark)) for entry in entries],
    )


def _prose(lines: Sequence[str]) -> str:
    """Paragraphs of a comment; one with indented lines is laid out by hand and stays as it is."""
    paragraphs = [list(some) for is_text, some in groupby(lines, bool) if is_text]
    return "\n\n".join(
        "\n".join(["```text", *lines, "```"])
        if any(line.startswith("  ") for line in lines)
        else plain("\n".join(lines))
        for lines in paragraphs
    )


def _first_sentence(comment: Sequence[str]) -> str:
    return " ".join(comment).partition(". ")[0].removesuffix(".") + "."


def _base(entry: Entry) -> str:
    return entry.kind.partition("[")[0]


def _type(kind: str, subjects: Mapping[str, str]) -> str:
    """A type as code, which leads to its own section if it is one of this package."""
    base = kind.partition("[")[0]
    return f"[`{kind}`](#{base.lower()})" if base in subjects else f"`{kind}`"
