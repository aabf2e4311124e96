"""The heights of a bag, dwell by dwell, as a moving picture."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from sal_height.errors import UserError
from sal_height.exports.heights import DwellHeights, RecordedHeights
from sal_height.io import unfinished
from sal_height.numeric import F32

MOST_FRAMES = 500
"""Greatest number of frames; of more dwells, evenly spaced ones are shown."""

SIZE_INCHES, DOTS_PER_INCH = (9.6, 4.8), 100

SUFFIXES = {".gif": "pillow", ".mp4": "ffmpeg"}
"""Matplotlib's writers by the suffix of the film."""


class _Frame(NamedTuple):
    """A dwell: its number and stamp, and height and sigma of the strongest surface, shape (rows, cols)."""

    dwell: int
    stamp_ns: int
    height: F32
    sigma: F32

    @classmethod
    def of_dwell(cls, dwell: DwellHeights) -> Self:
        first = dwell.field.first
        return cls(dwell.dwell, dwell.stamp_ns, first.height.astype(np.float32), first.sigma.astype(np.float32))


def write_film(heights: RecordedHeights, path: Path) -> int:
    """Write the strongest surface of each dwell and its sigma as a GIF or MP4; returns the number of frames.

    Colours mean the same in all frames. The file appears under its name when it is complete.

    Raises:
        UserError: another suffix, no program ffmpeg for .mp4, no valid height, or the file cannot be written.
    """
    from matplotlib.animation import writers  # noqa: PLC0415 (Matplotlib is slow)

    if (suffix := path.suffix.lower()) not in SUFFIXES:
        raise UserError(f"File {path} has the suffix {path.suffix!r}; a film is written as {' or '.join(SUFFIXES)}.")
    if not writers.is_available(SUFFIXES[suffix]):
        raise UserError(
            f"Writing {path} needs the program ffmpeg; install it (sudo apt install ffmpeg), or write a .gif."
        )
    step = max(1, math.ceil(heights.count / MOST_FRAMES))
    shown = [_Frame.of_dwell(dwell) for number, dwell in enumerate(heights.dwells("film")) if number % step == 0]
    seen = [frame for frame in shown if np.isfinite(frame.height).any()]
    if not seen:
        raise UserError(f"Topic {heights.topic} of bag {heights.reader.path} has no valid height.")
    frames_per_second = 5
    with unfinished(path) as partial:
        _draw(heights, seen, writers[SUFFIXES[suffix]](fps=frames_per_second), partial)
    return len(seen)


def _draw(heights: RecordedHeights, frames: list[_Frame], writer: Any, path: Path) -> None:
    from matplotlib.colors import LogNorm, Normalize  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    height = np.concatenate([frame.height[np.isfinite(frame.height)] for frame in frames])
    sigma = np.concatenate([frame.sigma[np.isfinite(frame.sigma)] for frame in frames])
    scales = (
        ("height above the sphere (m)", "viridis", Normalize(*np.percentile(height, [1, 99]))),
        ("sigma (m)", "cividis", LogNorm(*np.percentile(sigma, [1, 99]) * [0.999, 1.001])),
    )
    figure = Figure(figsize=SIZE_INCHES, dpi=DOTS_PER_INCH, layout="constrained")
    pictures = []
    for axes, image, (label, colours, norm) in zip(
        figure.subplots(1, 2), (frames[0].height, frames[0].sigma), scales, strict=True
    ):
        pictures.append(axes.imshow(image, origin="lower", aspect="auto", cmap=colours, norm=norm))
        axes.set(xlabel="pixel along the track", ylabel="pixel in range", facecolor="0.85")
        figure.colorbar(pictures[-1], ax=axes, label=label, orientation="horizontal")
    begin_ns = frames[0].stamp_ns
    with writer.saving(figure, str(path), DOTS_PER_INCH):
        for frame in frames:
            for picture, image in zip(pictures, (frame.height, frame.sigma), strict=True):
                rows, cols = image.shape
                picture.set(data=image, extent=(-0.5, cols - 0.5, -0.5, rows - 0.5))
            figure.suptitle(f"{heights.topic}, dwell {frame.dwell}, {(frame.stamp_ns - begin_ns) * 1e-9:.2f} s")
            writer.grab_frame()
