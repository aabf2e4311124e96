"""The settings of a campaign compared: fraction of heights, their sigma and error, and time, over a parameter."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from sal_height.picture import look_of, page

PANELS = {
    "with_height": "fraction of pixels with a height",
    "median_sigma_m": "median sigma [m]",
    "s68_m": "68 % of errors are below [m]",
    "within_1_sigma": "fraction of errors within 1 sigma",
}
"""Columns of each estimator that are drawn, and what they are."""

EXPECTED = {"within_1_sigma": 0.683}
"""Values at which a line is drawn for comparison."""


LINES = ("-", "--", "-.", ":")


def draw_settings(rows: Sequence[Mapping[str, Any]], varied: Sequence[str], file: Path) -> None:
    """Draw the summary of a campaign over the first parameter that is varied.

    Args:
        rows: rows of the summary; those that failed are left out.
        varied: names of the parameters; each combination of the others, each bag and estimator has a line.
        file: path of the picture.
    """
    done = [row for row in rows if not row["failure"]]
    values = list(dict.fromkeys(row[varied[0]] for row in done))
    with page(file, 5.2) as figure:
        axes = figure.subplots(2, 2, sharex=True)
        for panel, (column, title) in zip(axes.flat, PANELS.items(), strict=True):
            drawn: Counter[str] = Counter()
            for label, points in _lines(done, varied, column).items():
                estimator = label.partition(" ")[0]
                places = [values.index(value) for value in points]
                panel.plot(places, list(points.values()), label=label, **_style(estimator, drawn[estimator]))
                drawn[estimator] += 1
            _finish(panel, title, values, EXPECTED.get(column))
        for panel in axes[1]:
            panel.set_xlabel(varied[0])
        handles, labels = axes[0, 0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside lower center", ncols=3)


def _style(estimator: str, number: int) -> dict[str, Any]:
    """Colour and marker of the estimator; line, and then filling, of the bag and setting of that number."""
    look, fill = look_of(estimator), ("full", "none")[number // len(LINES) % 2]
    return {"color": look.colour, "marker": look.marker, "ls": LINES[number % len(LINES)], "fillstyle": fill}


def _lines(rows: Sequence[Mapping[str, Any]], varied: Sequence[str], column: str) -> dict[str, dict[Any, float]]:
    """Numbers of a column by the value of the first parameter, for each line of the picture."""
    lines: dict[str, dict[Any, float]] = {}
    for row in rows:
        others = ", ".join(f"{name}={row[name]}" for name in varied[1:])
        for name, number in row.items():
            prefix = name.removesuffix(f"_{column}")
            if prefix != name and number is not None:
                label = " ".join(filter(None, (prefix, Path(row["bag"]).parent.name, Path(row["bag"]).name, others)))
                lines.setdefault(label, {})[row[varied[0]]] = number
    return lines


def _finish(panel: Axes, title: str, values: Sequence[Any], expected: float | None) -> None:
    """Name the axes of a panel."""
    panel.set_title(title)
    panel.set_xticks(range(len(values)), [str(value) for value in values])
    panel.grid()
    if expected is not None:
        panel.axhline(expected, color="black", linestyle=":")
