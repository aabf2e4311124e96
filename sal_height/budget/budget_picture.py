"""Picture of a budget: what heights a power gives, and where in the swath they are how good."""

from __future__ import annotations

from pathlib import Path

from sal_height.graph.picture import page
from sal_height.io import writing
from sal_height.numeric import F64


def draw_budget(
    name: str, by_power: tuple[F64, F64], by_place: tuple[F64, F64], point: tuple[float, float], path: Path
) -> None:
    """Write a PNG: sigma of a height by noise over the mean power, and over the swath.

    Args:
        name: name of the preset.
        by_power: mean power transmitted (W), and sigma (m) in the middle of the swath.
        by_place: elevation from the middle of the beams (beamwidths), and sigma (m).
        point: power (W) and sigma (m) of the budget.
        path: path of the picture.

    Raises:
        UserError: it cannot be written.
    """
    with writing(path), page(path, 2.6) as figure:
        power, swath = figure.subplots(1, 2)
        power.loglog(*by_power)
        power.plot(*point, "o", color="black", label=f"{point[0]:.3g} W: {point[1]:.2g} m")
        power.set(xlabel="mean power transmitted (W)", ylabel="sigma of a height by noise (m)")
        power.set_title(f"{name}: what a power gives, middle of the swath")
        power.legend(frameon=False)
        swath.plot(*by_place)
        swath.set(xlabel="elevation from the middle (beamwidths)", ylabel="sigma of a height by noise (m)")
        swath.set_title("over the swath, at that power")
        for axes in (power, swath):
            axes.grid(which="both")
        swath.set_ylim(bottom=0)
