"""An array as a picture with axes and a bar of colours, for a look at a result in a notebook."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def draw_array(
    values: npt.ArrayLike,
    extent: tuple[float, float, float, float],
    names: tuple[str, str, str],
    colours: str = "viridis",
    axes: Any = None,
) -> Any:
    """Draw an array with row 0 at the bottom, and return the axes.

    Args:
        values: array of shape (rows, cols); NaN and infinities stay blank.
        extent: left, right, lower and upper edge.
        names: titles of the horizontal axis, the vertical axis and the colours, with units.
        colours: name of a colour map of Matplotlib.
        axes: axes to draw in; None: those of a new figure.
    """
    import matplotlib.pyplot as plt  # noqa: PLC0415 (slow to import)

    axes = plt.subplots(layout="constrained")[1] if axes is None else axes
    shown = np.ma.masked_invalid(np.asarray(values))
    picture = axes.imshow(shown, origin="lower", extent=extent, aspect="auto", cmap=colours, interpolation="nearest")
    axes.set(xlabel=names[0], ylabel=names[1])
    axes.figure.colorbar(picture, ax=axes, label=names[2])
    return axes
