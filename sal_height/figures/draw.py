"""Pictures of figures: axes and families of curves as in the SAL paper, so that both can be compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Picture
from PIL import Image

from sal_height.figures.curve import Curve, Figure

mpl.use("Agg")


def draw(figure: Figure, curves: Sequence[Curve], path: Path) -> None:
    """Write a PNG with axes for each quantity; black dots are the closed forms, bars the standard errors."""
    wide = 2 if len(figure.axes) == 4 else len(figure.axes)
    high = len(figure.axes) // wide
    picture = Picture(figsize=(7.2 * wide, 0.5 + 4.6 * high), dpi=110, layout="constrained")
    panels = picture.subplots(high, wide, squeeze=False).ravel()
    for panel, (quantity, (horizontal, vertical)) in zip(panels, figure.axes.items(), strict=True):
        for curve in (curve for curve in curves if curve.quantity == quantity):
            _draw_curve(panel, curve)
        panel.set(title=quantity, xlabel=horizontal, ylabel=vertical)
        panel.grid(alpha=0.3)
        panel.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    picture.suptitle(figure.title)
    canvas = FigureCanvasAgg(picture)
    canvas.draw()  # type: ignore[no-untyped-call] # once, and not twice as savefig does
    Image.fromarray(np.asarray(canvas.buffer_rgba())).save(path)  # type: ignore[no-untyped-call]


def _draw_curve(panel: Axes, curve: Curve) -> None:
    steps = curve.style.startswith("steps")
    panel.errorbar(
        curve.x,
        curve.value,
        yerr=curve.standard_error if np.any(curve.standard_error) else None,
        linestyle="-" if steps else curve.style,
        drawstyle=curve.style if steps else "default",
        color=f"C{curve.colour}",
        label=curve.case,
        linewidth=1.2,
        elinewidth=0.8,
    )
    panel.plot(curve.x, curve.closed_form, "k.", markersize=2.5)
