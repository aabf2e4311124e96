"""Pictures of runs and figures that are neither laid out nor drawn, for tests that look at other results."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from sal_height.numeric import U8


class BlankCanvas(FigureCanvasAgg):
    """A canvas on which a figure is neither laid out nor drawn."""

    def draw(self) -> None:
        """Draw nothing."""

    def buffer_rgba(self) -> U8:
        """White pixels."""
        width, height = self.figure.bbox.bounds[2:]
        return np.full((int(height), int(width), 4), 255, np.uint8)


@contextmanager
def blank_pictures() -> Iterator[None]:
    """Pictures are white, for tests that look at other results: layout and drawing cost more than a run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sal_height.picture.FigureCanvasAgg", BlankCanvas)
        yield
