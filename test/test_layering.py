"""What is to work without ROS knows none: not by import, not by import of an import, and not at run time."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from helpers import few

PACKAGE = Path(__file__).parents[1] / "sal_height"
LAYERS = (
    ("errors", "renamed", "topics", "doubts"),
    ("numeric", "extras", "io", "settings", "configuration", "tables", "array_files", "progress"),
    ("geometry",),
    ("response",),
    ("beams",),
    ("sensor",),
    ("elevation",),
    ("imaging", "relief", "simulation"),
    ("calibration", "adjustment", "movers"),
    ("theory", "picture"),
    ("pipeline",),
    ("rehearsal", "passes", "precompile"),
    ("engine", "figures"),
    ("messages", "stage_files", "workers"),
    ("bag",),
    ("nodes",),
    ("graph",),
    ("budget",),
    ("runs",),
    ("view", "exports", "imports", "pytest_plugin"),
    ("commands",),
    ("__main__",),
)
"""Packages and modules of sal_height in the order of the data: each imports from layers above it in this list only.

Packages of one layer do not know each other.
"""

LAYER = {name: number for number, names in enumerate(LAYERS) for name in names}

SHELL = {"messages", "bag", "nodes", "graph", "budget", "runs", "view", "exports", "imports"}
SHELL |= {"pytest_plugin", "commands", "__main__"}
"""Those that may know messages and MCAP; all others are the core."""

OF_ROS = {"nodes", "graph", "runs"}
"""Those that may import ROS; of the others one module does, which subscribes to topics."""

SUBSCRIBES = "sal_height.view.listener"

KNOWING_MESSAGES = ("messages", "bag", "imports")
"""Packages of the shell that do not even import modules that import ROS."""

ROOMS = (
    *("elevation.looks", "elevation.array", "elevation.layover", "elevation.monopulse", "elevation.vegetation"),
    *("elevation.fit", "elevation.estimators"),
    *("nodes.transport", "nodes.accounts", "nodes.playing", "nodes.recording"),
    *("runs.chain", "runs.responses", "runs.truth", "runs.replay", "runs.campaign", "runs.products", "runs.live"),
)
"""Sub-packages in the order of the data: each imports from those before it in this list only."""

BAG_RUNS = (
    *("chain.chain_runs", "chain.side_by_side", "chain.recording", "truth.flight_run", "campaign.batch"),
    *("products.adjust", "products.calibrate", "products.movers", "products.passes"),
)
"""Modules of `runs` that process bags without ROS."""


def name_of(path: Path) -> str:
    """Dotted name of the module in a file."""
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def package_of(module: str) -> str:
    """The package or module of sal_height that a module of ours is in."""
    return module.partition(".")[2].partition(".")[0]


CORE = sorted(name for name in MODULES if package_of(name) not in SHELL)
WITHOUT_ROS = sorted(
    [name for name in MODULES if package_of(name) in KNOWING_MESSAGES]
    + [f"sal_height.runs.{name}" for name in BAG_RUNS]
)
ROS = (
    *("rclpy", "sal_height_msgs", "std_msgs", "nav_msgs", "sensor_msgs", "geometry_msgs", "diagnostic_msgs"),
    *("builtin_interfaces", "rcl_interfaces", "std_srvs", "tf2_msgs", "lifecycle_msgs", "rosgraph_msgs"),
    *("rosidl_runtime_py", "rosidl_parser", "rpyutils", "ament_index_python"),
)
"""What a ROS installation has."""

FORBIDDEN = (*ROS, "mcap", *(f"sal_height.{name}" for name in sorted(SHELL)))
"""What the core does not know."""


def imports_of(source: str, package: str) -> set[str]:
    """Dotted names of all that a module imports, wherever in it; `package` is that of relative imports."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names |= {base} | {f"{base}.{alias.name}" for alias in node.names}
    return names


def source_of(module: str) -> Path | None:
    """File of a module of ours, if there is one of that name."""
    path = PACKAGE.parent / Path(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


@cache
def imports_of_file(path: Path) -> frozenset[str]:
    """Dotted names of all that the module in a file of ours imports."""
    package = ".".join(path.parent.relative_to(PACKAGE.parent).parts)
    return frozenset(imports_of(path.read_text(), package))


@cache
def imports_of_module(module: str) -> frozenset[str]:
    """Dotted names of all that a module of ours imports; empty for others' modules."""
    file = source_of(module)
    return imports_of_file(file) if file else frozenset()


def reachable_from(module: str) -> set[str]:
    """Dotted names of all that a module imports, directly or through modules of ours."""
    found: set[str] = set()
    waiting = {module}
    while waiting:
        new = imports_of_module(waiting.pop()) - found
        found |= new
        waiting |= {name for name in new if name.partition(".")[0] == PACKAGE.name}
    return found


def is_among(module: str, packages: Sequence[str]) -> bool:
    """Whether a module is one of these, or in one."""
    return any(module == name or module.startswith(f"{name}.") for name in packages)


def reached(modules: Sequence[str], forbidden: Sequence[str]) -> dict[str, set[str]]:
    """What modules import that they must not, directly or through modules of ours; of those that do."""
    found = {module: {name for name in reachable_from(module) if is_among(name, forbidden)} for module in modules}
    return {module: names for module, names in found.items() if names}


def layer_of(module: str) -> tuple[int, str] | None:
    """Layer and package of a module of ours; None for the package sal_height itself and for others' modules."""
    top, _, rest = module.partition(".")
    name = rest.partition(".")[0]
    return (LAYER[name], name) if top == PACKAGE.name and name in LAYER else None


def wrong_imports(module: str) -> set[str]:
    """What a module imports from a layer that is not above its own."""
    own = layer_of(module)
    others = {name: layer_of(name) for name in imports_of_file(MODULES[module])}
    return {name for name, other in others.items() if own and other and other[1] != own[1] and other[0] >= own[0]}


def test_every_module_has_a_layer() -> None:
    assert not {name for name in MODULES if name != "sal_height" and not layer_of(name)}
    assert {"sal_height.elevation.array.likelihood", "sal_height.geometry.grid", "sal_height.simulation.scenes"} <= set(
        CORE
    )
    assert {"sal_height.engine.stage", "sal_height.engine.chain", "sal_height.stage_files"} <= set(CORE)
    assert {"sal_height.messages.kinds", "sal_height.bag.played", "sal_height.runs.campaign.batch"} <= set(WITHOUT_ROS)
    assert set(WITHOUT_ROS) <= MODULES.keys()


def test_modules_import_from_the_layers_above_theirs_only() -> None:
    wrong = {module: wrong_imports(module) for module in MODULES}
    assert not {module: names for module, names in wrong.items() if names}


def room_of(module: str) -> int | None:
    """Number of the sub-package in ROOMS that a module is in."""
    return next((number for number, room in enumerate(ROOMS) if is_among(module, [f"sal_height.{room}"])), None)


def test_every_sub_package_has_its_place() -> None:
    rooms = {name.removeprefix("sal_height.") for name in MODULES if (PACKAGE.parent / name.replace(".", "/")).is_dir()}
    parts = {name for name in rooms if name.partition(".")[0] in {"elevation", "nodes", "runs"} and "." in name}
    assert parts == set(ROOMS)


def test_sub_packages_import_from_those_before_them_only() -> None:
    wrong = {
        module: {name for name in imports_of_file(path) if (other := room_of(name)) is not None and other > own}
        for module, path in MODULES.items()
        if (own := room_of(module)) is not None
    }
    assert not {module: names for module, names in wrong.items() if names}


def test_no_module_imports_itself_through_others() -> None:
    """Not even through an import inside a function; that of its own package is one for all modules of the package."""
    order = TopologicalSorter[str]()
    for module, path in MODULES.items():
        order.add(
            module,
            *(name for name in imports_of_file(path) & MODULES.keys() if not f"{module}.".startswith(f"{name}.")),
        )
    order.prepare()


def test_an_import_against_the_order_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    wrong = tmp_path / "sal_height" / "imaging" / "wrong.py"
    wrong.parent.mkdir(parents=True)
    wrong.write_text("def f():\n    from sal_height.simulation.scene import Scene\n    import sal_height.nodes.host")
    monkeypatch.setitem(MODULES, "sal_height.imaging.wrong", wrong)
    monkeypatch.setattr(f"{__name__}.PACKAGE", tmp_path / "sal_height")
    assert {"sal_height.simulation.scene", "sal_height.nodes.host"} <= wrong_imports("sal_height.imaging.wrong")


def test_the_core_imports_no_messages_and_nothing_of_ros() -> None:
    assert not reached(CORE, FORBIDDEN)


def test_messages_bags_and_what_processes_bags_import_nothing_of_ros() -> None:
    assert not reached(WITHOUT_ROS, ROS)


def test_the_walk_finds_what_it_looks_for() -> None:
    """In the one module that imports messages, through another one, inside functions and relatively."""
    assert reached(["sal_height.nodes.transport.message_types"], ROS)
    assert "sal_height.messages" in reachable_from("sal_height.nodes.host")
    assert "sal_height.engine.stage" in reachable_from("sal_height.runs.chain.chain_runs")
    inner = imports_of(
        "def f():\n    import rclpy.node\n    from . import messages\n    from .nodes.transport import graph",
        "sal_height",
    )
    assert {"rclpy.node", "sal_height.messages", "sal_height.nodes.transport.graph"} <= inner


def test_ros_is_imported_by_nodes_and_what_runs_them_only() -> None:
    found = {
        module: {name for name in imports_of_file(path) if is_among(name, ROS)} for module, path in MODULES.items()
    }
    importing = {module for module, names in found.items() if names}
    assert {package_of(module) for module in importing - {SUBSCRIBES}} == OF_ROS
    assert SUBSCRIBES in importing


BLOCKED_IMPORT = """
import importlib, sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if any(name == other or name.startswith(other + ".") for other in {forbidden!r}):
            raise ImportError("blocked: " + name)

sys.meta_path.insert(0, Blocker())
for name in {modules!r}:
    importlib.import_module(name)
{then}
"""


def import_without(
    forbidden: Sequence[str], modules: Sequence[str], then: str = "", *arguments: str
) -> subprocess.CompletedProcess[str]:
    """Import modules where others cannot be imported, and then run a program with arguments."""
    code = BLOCKED_IMPORT.format(forbidden=tuple(forbidden), modules=list(modules), then=then)
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)  # noqa: S603 (our own code)


def test_the_core_can_be_imported_where_neither_ros_nor_mcap_is() -> None:
    result = import_without(FORBIDDEN, CORE)
    assert result.returncode == 0, result.stderr


def test_shell_cannot_be_imported_where_ros_is_not() -> None:
    """Or else the tests of what can be imported there would prove nothing."""
    result = import_without(ROS, ["sal_height.graph.ensemble"])
    assert result.returncode != 0
    assert "blocked: " in result.stderr


BAGS_WITHOUT_ROS = """
from pathlib import Path
from sal_height import messages
from sal_height.bag.check import check_bag
from sal_height.bag.reader import BagReader
from sal_height.bag.copies import upgrade
from sal_height.bag.writer import BagWriter

for folder in map(Path, sys.argv[2:]):
    reader, out = BagReader(folder), Path(sys.argv[1]) / folder.name
    with BagWriter(out / "again") as bag:
        for topic in reader.topics.values():
            bag.add_topic(topic.name, topic.type_name, topic.offered_qos)
        for one in reader.messages():
            message = reader.decode(one.type_name, one.cdr)
            if one.type_name.endswith("HeightImage"):
                messages.field_from_message(message)
            bag.write(one.topic, messages.serialize(message), one.log_time_ns, one.publish_time_ns)
    upgrade(folder, out / "upgraded")
    for made in (out / "again", out / "upgraded"):
        assert not check_bag(made, lambda *_: None), made
    again, upgraded = (list(BagReader(out / name).messages()) for name in ("again", "upgraded"))
    assert len(again) == len(upgraded) == reader.message_count
    assert all(reader.decode(a.type_name, a.cdr) == reader.decode(b.type_name, b.cdr) for a, b in zip(again, upgraded))
    print(folder.name)
"""


@pytest.mark.parametrize("names", few(1, ["version_?", "*"]))
def test_bags_are_read_upgraded_written_and_checked_where_ros_is_not(names: str, tmp_path: Path) -> None:
    """Bags of every version of the messages, and in `make thorough` every bag of the package."""
    bags = sorted(path for path in (PACKAGE.parent / "bags").glob(names) if path.is_dir())
    result = import_without(ROS, WITHOUT_ROS, BAGS_WITHOUT_ROS, str(tmp_path), *map(str, bags))
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == [folder.name for folder in bags]
