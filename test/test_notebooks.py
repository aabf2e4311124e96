"""The notebooks in examples/notebooks run, keep what their last cells claim, and draw figures that can be read.

In the percent format of jupytext a notebook is a program: running it runs its cells in their order, in far less time
than a Jupyter kernel takes. `make notebooks` runs them by such a kernel.
"""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from helpers import few
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from test_layering import imports_of, reachable_from

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "examples" / "notebooks"
NAMES = ("lidar_street", "sum_difference_relief", "calibrate_a_flight", "gotcha", "theory_and_monte_carlo")

ROS = {"rclpy", "sal_height_msgs", "sensor_msgs", "std_msgs"}
COLOURS = {"viridis", "cividis"}
"""Colour maps that are read alike with any colour vision, and in grey."""

ROUNDING = 0.02
"""Inches by which texts may reach beyond the edge of a figure."""


@pytest.fixture(autouse=True)
def drawing_in_memory() -> Iterator[None]:
    mpl.use("Agg")
    yield
    plt.close("all")


def run(name: str) -> None:
    runpy.run_path(str(FOLDER / f"{name}.py"))


@pytest.mark.parametrize("name", few(2, [NAMES[number] for number in (1, 3, 0, 2, 4)]))
def test_a_notebook_keeps_its_claims_in_figures_that_can_be_read(
    name: str, shared_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "gotcha":
        monkeypatch.setenv("GOTCHA_FOLDER", str(shared_data("afrl_gotcha")))
    run(name)
    figures = [plt.figure(number) for number in plt.get_fignums()]
    assert len(figures) >= 2
    for number, figure in enumerate(figures, 1):
        assert not faults_of(figure), f"figure {number}"


def faults_of(figure: Figure) -> list[str]:
    """Faults of a figure: axes without labels, parts that are cut off, colours that some readers cannot tell apart."""
    figure.canvas.draw()
    faults = [f"axis without a label: {which}" for axes in figure.axes for which in unlabelled(axes)]
    (left, bottom), (right, top) = figure.get_tightbbox().get_points()
    beyond = max(-left, -bottom, right - figure.get_figwidth(), top - figure.get_figheight())
    if beyond > ROUNDING:
        faults.append(f"{beyond:.2f} inches are cut off")
    drawn = [artist for axes in figure.axes for artist in (*axes.images, *axes.collections)]
    maps = {artist.get_cmap().name for artist in drawn if artist.get_array() is not None}
    return faults + [f"colours {name}" for name in sorted(maps - COLOURS)]


def unlabelled(axes: Axes) -> list[str]:
    """Which axes have no label: neither their own, nor that of the figure, nor that of the next panel in the grid."""
    labels = {"x": axes.get_xlabel(), "y": axes.get_ylabel()}
    if axes.get_label() == "<colorbar>":
        return [] if any(labels.values()) else ["colours"]
    figure, place = axes.figure, axes.get_subplotspec()
    labels["x"] = labels["x"] or figure.get_supxlabel() or ("" if place.is_last_row() else "below")
    labels["y"] = labels["y"] or figure.get_supylabel() or ("" if place.is_first_col() else "beside")
    if axes.name == "3d":
        labels["z"] = axes.get_zlabel()
    return [which for which, label in labels.items() if not label]


def test_faults_of_figures_are_found() -> None:
    figure, axes = plt.subplots(2, 2, layout="constrained")
    shown = axes[0, 0].imshow(np.eye(3), cmap="jet")
    figure.colorbar(shown)
    axes[1, 1].text(1.4, 0.5, "beyond the edge of the figure")
    faults = faults_of(figure)
    assert "colours jet" in faults
    assert "axis without a label: colours" in faults
    assert sum(fault.startswith("axis without") for fault in faults) == 5  # two below, two on the left, the colours
    assert any("cut off" in fault for fault in faults)


def test_without_data_the_notebook_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GOTCHA_FOLDER", str(tmp_path))
    with pytest.raises(SystemExit, match=rf"no Gotcha files \(\*\.mat\) in {re.escape(str(tmp_path))}; .+\.$"):
        run("gotcha")


def test_all_notebooks_are_lessons_and_described() -> None:
    page = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
    assert {path.stem for path in FOLDER.glob("*.py")} == set(NAMES)
    for name in NAMES:
        source = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
        header, *cells = re.split(r"^# %%", source, flags=re.MULTILINE)
        assert "format_name: percent" in header
        assert 6 <= len(cells) <= 12
        assert cells[0].startswith(" [markdown]\n# # ")
        assert "assert " in cells[-1]
        assert f"examples/notebooks/{name}.py" in page


@pytest.mark.parametrize("name", NAMES)
def test_notebooks_need_no_ros(name: str) -> None:
    modules = imports_of((FOLDER / f"{name}.py").read_text(encoding="utf-8"), "")
    reached = modules.union(*(reachable_from(module) for module in modules))
    assert "sal_height" in {module.partition(".")[0] for module in reached}
    assert not ROS & {module.partition(".")[0] for module in reached}
