"""The reference pages say what the code says."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import sal_height_msgs.msg as message_classes

import sal_height.commands
from sal_height.graph.node_classes import NODES
from tools.badges import FOLDER, badges
from tools.reference import messages, topics
from tools.reference.pages import DOCS, PAGES

OF_ROS = {"/parameter_events", "/rosout", "/tf"}
"""Topics that ROS gives to nodes, and /tf, which the frames of points are also on."""


@pytest.mark.parametrize(("file", "document"), PAGES.items(), ids=[path.name for path in PAGES])
def test_a_page_is_up_to_date(file: Path, document: Callable[[], str]) -> None:
    assert file.read_text(encoding="utf-8") == document(), (
        f"{file.name} is out of date: .venv/bin/python -m tools.reference"
    )


def test_the_badges_of_the_readme_say_what_the_package_says() -> None:
    made = badges()
    assert {path: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()} == made, "python -m tools.badges"
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    assert [path.name for path in made if f"docs/badges/{path.name}" not in readme] == []


def test_every_page_of_the_reference_is_made() -> None:
    assert set((DOCS / "reference").iterdir()) <= set(PAGES)


@pytest.mark.parametrize("path", sorted(messages.FOLDER.glob("*.msg")), ids=lambda path: path.stem)
def test_fields_and_constants_are_those_of_the_compiled_message(path: Path) -> None:
    """What rosidl has read of the same file."""
    entries = [entry for group in messages.groups_of(path.read_text()) for entry in group.entries]
    compiled = getattr(message_classes, path.stem)
    fields = {entry.name: in_rosidl(entry.kind) for entry in entries if not entry.value}
    assert list(fields.items()) == list(compiled.get_fields_and_field_types().items())
    constants = {entry.name: entry.value.strip('"') for entry in entries if entry.value}
    names = [name for name in vars(type(compiled)) if name.isupper() and not name.startswith("_")]
    assert constants == {name: str(getattr(compiled, name)) for name in names}


def in_rosidl(kind: str) -> str:
    """A type of a .msg file as rosidl names it in Python."""
    base, _, size = kind.partition("[")
    known = {"bool": "boolean", "float32": "float", "float64": "double"}
    name = f"sal_height_msgs/{base}" if hasattr(message_classes, base) else known.get(base, base)
    match size.removesuffix("]"):
        case "" if size:
            return f"sequence<{name}>"
        case bounded if bounded.startswith("<="):
            return f"sequence<{name}, {bounded[2:]}>"
        case _:
            return name + (f"[{size}" if size else "")


def test_a_message_that_is_laid_out_otherwise_is_refused() -> None:
    with pytest.raises(ValueError, match="neither a field"):
        messages.groups_of("# One.\nuint8 one\n# Two, without an empty line before it.\nuint8 two")


def test_nodes_have_no_topic_that_their_classes_do_not_tell() -> None:
    for name, node in NODES.items():
        told = {f"/{topic.lstrip('/')}" for topic in (*node.inputs, *node.outputs, *topics.ACCOUNTS, *topics.LEFT_OUT)}
        told |= {"/ml/height"} if node.takes_heights else set()  # what the parameter names by default
        assert {topic for _, topic in topics.ends_of_nodes()[name]} <= told | OF_ROS, name


def test_every_command_has_its_help() -> None:
    text = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    modules = Path(sal_height.commands.__file__).parent.glob("[a-z]*.py")
    names = {path.stem.rstrip("_").replace("_", "-") for path in modules}
    assert names <= set(re.findall(r"^## sal-height (.+)$", text, re.MULTILINE))
    assert text.count("\n```text\nUsage: sal-height") == text.count("\n## ")
