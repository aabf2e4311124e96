"""The page of the parameters: tables from the settings models of the nodes."""

from __future__ import annotations

from collections.abc import Mapping

from sal_height.elevation import HeightSettings
from sal_height.engine.settings import DwellSettings
from sal_height.engine.stage import StageSettings
from sal_height.graph.node_classes import NODES
from sal_height.settings import Setting, Settings, settings_of

HEAD = """# Parameters of the nodes

`tools/reference` makes this page from the settings models in the code; a test fails if it is out of date.
Set a parameter of a run or replay by `--param NODE.NAME=VALUE`, of a node by `--ros-args -p NAME:=VALUE`, and in a
preset under `processing`. `sal-height-NODE --help` prints the same. A parameter that is "set at the start" cannot be
changed while the node runs.
"""

SHARED: Mapping[str, type[Settings]] = {
    "All nodes but the recorder": StageSettings,
    "Nodes that take whole dwells": DwellSettings,
    "All height nodes": HeightSettings,
}
"""Parameters that several nodes have, by the title of their table; a model may be derived from an earlier one."""


def document() -> str:
    """The text of docs/parameters.md."""
    sections = [HEAD]
    for title, model in SHARED.items():
        sections.append(_section(title, _own(model)))
    for name, node in NODES.items():
        model = node.parameters
        tables = ", ".join(f"“{title}”" for title, shared in SHARED.items() if issubclass(model, shared))
        sections.append(_section(f"`{name}`", _own(model), f"Also: {tables}." if tables else ""))
    return "\n".join(sections)


def _own(model: type[Settings]) -> dict[str, Setting]:
    """The settings of a model that are in no table of a model that it is derived from."""
    inherited = [settings_of(shared) for shared in SHARED.values() if shared is not model and issubclass(model, shared)]
    return {name: entry for name, entry in settings_of(model).items() if not any(name in other for other in inherited)}


def _section(title: str, entries: Mapping[str, Setting], also: str = "") -> str:
    lines = [f"## {title}", ""]
    lines += [also, ""] if also else []
    if entries:
        lines += ["| parameter | default | meaning | allowed |", "|---|---|---|---|", *map(_row, entries.values()), ""]
    return "\n".join(lines)


def _row(entry: Setting) -> str:
    allowed = entry.allowed.removeprefix("it must be ").removeprefix("allowed are ")
    meaning = f"{entry.text}; set at the start" if entry.read_only else entry.text
    return f"| `{entry.name}` | {_shown(entry.default)} | {meaning} | {allowed} |".replace("  ", " ").replace(
        "<", "&lt;"
    )


def _shown(value: object) -> str:
    """A default as it is typed; nothing for an empty text or list."""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{value}`" if value not in ("", ()) else ""
