"""What stands in several places says the same in each."""

from __future__ import annotations

import ast
import importlib
import re
import shutil
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from importlib.metadata import entry_points, packages_distributions
from pathlib import Path
from zipfile import ZipFile

import pytest
import sal_height_msgs.msg as messages

import sal_height
from sal_height.elevation import ESTIMATORS

ROOT = Path(__file__).parents[1]

GROUPED = ("ImageGrid grid", "Aperture aperture", "Provenance provenance", "uint32 dwell")
"""Fields whose type says it all."""


def test_one_version() -> None:
    manifests = [ET.parse(ROOT / folder / "package.xml").getroot() for folder in (".", "msg_defs")]  # noqa: S314
    project = tomllib.loads((ROOT / "msg_defs" / "pyproject.toml").read_text())["project"]
    versions = {m.findtext("version") for m in manifests} | {project["version"], sal_height.__version__}
    versions |= set(re.findall(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE))
    assert len(versions) == 1


def test_the_changelog_is_one_page_on_the_release() -> None:
    """Its first section is of the version of the packages; DEVELOPMENT_LOG.md has the details."""
    lines = (ROOT / "CHANGELOG.md").read_text().splitlines()
    first = next(line for line in lines if line.startswith("## "))
    assert first.startswith(f"## {sal_height.__version__} (")
    assert len(lines) <= 60


BY_PIP = {
    "annotated-types",
    "cyclopts",
    "finufft",
    "isal",
    "lz4",
    "mcap",
    "numba",
    "pydantic",
    "rosbags",
    "threadpoolctl",
    "zstandard",
}
"""Requirements that package.xml leaves to pip, and names in a comment: rosdep has none that fit, or mcap needs them."""

NAMED_OTHERWISE = {"pillow": "python3-pil", "pyyaml": "python3-yaml"}

ROS_WHEELS = {"ros-jazzy-common-interfaces", "ros-jazzy-rclpy[fastrtps]"}
"""Wheels whose ROS packages package.xml lists one by one."""


def test_package_xml_has_the_requirements_of_setup_py() -> None:
    manifest = ROOT / "package.xml"
    listed = {tag.text for tag in ET.parse(manifest).getroot().iter("exec_depend")}  # noqa: S314 (our own file)
    pythonic = {name for name in listed if name and name.startswith("python3-")}
    text = (ROOT / "setup.py").read_text()
    block = text[text.index("install_requires") : text.index("extras_require")]
    required = {re.split(r"[\[<>=]", name)[0] for name in re.findall(r'"([^"]+)"', block)}
    assert required >= BY_PIP
    assert pythonic == {NAMED_OTHERWISE.get(name, f"python3-{name}") for name in required - BY_PIP}
    (comment,) = (part for part in re.findall(r"<!--(.*?)-->", manifest.read_text(), re.DOTALL) if "pip" in part)
    assert set(re.findall(r"[a-z][a-z0-9-]+", comment)) >= BY_PIP


def test_every_package_that_is_imported_is_required() -> None:
    """Packages of ROS and our messages come by their wheels; all others are in setup.py."""
    sources = [ast.parse(path.read_text()) for path in (ROOT / "sal_height").rglob("*.py")]
    nodes = [node for source in sources for node in ast.walk(source)]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module and not node.level}
    imported = {name.partition(".")[0] for name in names} - sys.stdlib_module_names - {"sal_height"}
    text = (ROOT / "setup.py").read_text()
    text = text[text.index("install_requires") : text.index("entry_points")]
    required = {re.split(r"[\[<>=;]", name)[0].lower() for name in re.findall(r'"([^"]+)"', text)}
    made_by = {"rerun": ["rerun-sdk"], **packages_distributions(), "pydantic_core": ["pydantic"]}
    assert {"PIL", "cycler", "yaml"} <= imported
    undeclared = {name for name in imported if not {one.lower() for one in made_by.get(name, [])} & required}
    assert not {name for name in undeclared if not any(one.startswith("ros-") for one in made_by[name])}


def test_everywhere_the_same_versions_of_python() -> None:
    """Those that setup.py allows, names and tests."""
    setup = (ROOT / "setup.py").read_text()
    lowest, beyond = map(int, re.findall(r'python_requires=">=3\.(\d+),<3\.(\d+)"', setup)[0])
    named = re.findall(r"for minor in \(([\d, ]+)\)", setup)[0]
    assert [int(minor) for minor in named.split(",")] == list(range(lowest, beyond))
    minors = ", ".join(f'"3.{minor}"' for minor in range(lowest, beyond))
    tested = f"matrix: {{ python: [{minors}] }}"
    workflow, release = ((ROOT / ".github" / "workflows" / f"{name}.yml").read_text() for name in ("test", "release"))
    assert tested in workflow
    assert tested in release
    assert all(f"- run: make {goal}" in workflow for goal in ("demo", "test"))
    recipe = tomllib.loads((ROOT / "msg_defs" / "pyproject.toml").read_text())
    assert recipe["project"]["requires-python"] == f">=3.{lowest},<3.{beyond}"
    wheels = [f"cp3{minor}-manylinux_x86_64" for minor in range(lowest, beyond)]
    assert recipe["tool"]["cibuildwheel"]["build"] == wheels


def test_ros_is_an_extra() -> None:
    """Arrays are measured and figures drawn without it."""
    (line,) = (line for line in (ROOT / "setup.py").read_text().splitlines() if '"ros": [' in line)
    assert set(re.findall(r'"([^"]+)"', line)) == {"ros", *ROS_WHEELS}


NODES = {
    "simulator",
    "navigation",
    "sar_compression",
    *(estimator.node for estimator in ESTIMATORS.values()),
    "relief_tracker",
    "height_adjuster",
    "mover_detection",
    "relief_mapper",
    "ground_mapper",
    "psf_calibration",
    "recorder",
    "live_host",
    "paced_player",
    "player",
}


def test_every_program_can_be_started() -> None:
    programs = {e.name: e.value for e in entry_points(group="console_scripts") if e.value.startswith("sal_height.")}
    assert {"sal-height", *(f"sal-height-{node}" for node in NODES)} == set(programs)
    for value in programs.values():
        module, function = value.split(":")
        assert callable(getattr(importlib.import_module(module), function))


@pytest.mark.parametrize("command", ["install", "develop"])
def test_ros2_run_knows_the_programs_by_the_names_of_the_nodes(command: str) -> None:
    """They are the commands that colcon runs, without and with --symlink-install."""
    program = (
        f"from setuptools import setup; from distutils.core import run_setup; "
        f"print(*run_setup('setup.py', ['{command}'], stop_after='init').entry_points['console_scripts'], sep='\\n')"
    )
    told = subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True).stdout  # noqa: S603 (our own file)
    assert {line.partition(" = ")[0] for line in told.splitlines()} == {"sal-height", *NODES}


def test_a_wheel_holds_all_that_programs_and_ros_read(tmp_path: Path) -> None:
    """In the package for those who use pip, and in share/ for ROS; presets are read by our programs only."""
    for name in ("setup.py", "setup.cfg", "pyproject.toml", "package.xml", "README.md"):
        shutil.copy(ROOT / name, tmp_path)
    for name in ("resource", "sal_height"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, "setup.py", "--quiet", "bdist_wheel", "--dist-dir", "."]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)  # noqa: S603 (our own file)
    (wheel,) = tmp_path.glob("*.whl")
    held = {name.partition(".data/data/")[2] or name for name in ZipFile(wheel).namelist()}
    package = ROOT / "sal_height"
    read = [path for name in ("config", "launch", "presets") for path in (package / name).iterdir()]
    files = [*read, package / "kernel_types.txt", package / "messages" / "definitions.json"]
    assert {str(path.relative_to(ROOT)) for path in files} <= held
    assert {"sal_height/py.typed", "sal_height/messages/types.pyi"} <= held
    shared = [path for path in read if path.parent.name != "presets"]
    assert {f"share/{path.relative_to(ROOT)}" for path in shared} <= held


def test_every_message_file_is_built() -> None:
    files = {path.stem for path in (ROOT / "msg_defs" / "msg").glob("*.msg")}
    listed = set(re.findall(r"msg/(\w+)\.msg", (ROOT / "msg_defs" / "CMakeLists.txt").read_text()))
    assert files == listed
    assert all(hasattr(messages, name) for name in files)


def test_every_message_field_is_documented() -> None:
    """A comment stands above each field's paragraph or beside the field."""
    for path in (ROOT / "msg_defs" / "msg").glob("*.msg"):
        explained = False
        for line in path.read_text().splitlines():
            if line.startswith("#"):
                explained = True
            elif not line.strip():
                explained = False
            else:
                assert explained or "#" in line or "=" in line or line.startswith(GROUPED), f"{path.name}: {line}"
