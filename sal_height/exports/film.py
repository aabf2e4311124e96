"""The heights of a bag as a moving picture: a cloud of points that grows dwell by dwell, beside the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from sal_height.errors import UserError
from sal_height.exports.heights import DwellHeights, RecordedHeights
from sal_height.geometry import sphere_coordinates
from sal_height.io import unfinished
from sal_height.numeric import F64, U8
from sal_height.runs.truth.report import recorded_flight
from sal_height.simulation import SimulatedFlight

SUFFIX = ".gif"

MOST_FRAMES, MOST_POINTS = 60, 1_000_000
"""Greatest numbers of frames and of points; of more dwells several appear at once, of more points some."""


def write_film(heights: RecordedHeights, path: Path) -> int:
    """Write all surfaces of all dwells as a GIF, at most ten seconds long, and return the number of frames.

    Below is what the scene of a simulated flight truly looks like where it is lit; a bag of real data has no truth.
    The file appears under its name when it is complete.

    Raises:
        UserError: another suffix, no valid height, or the file cannot be written.
    """
    from sal_height.exports.film_frames import frames_of  # noqa: PLC0415 (Matplotlib is slow)

    if path.suffix.lower() != SUFFIX:
        raise UserError(f"File {path} has the suffix {path.suffix!r}; a film is written as {SUFFIX}.")
    clouds = {}
    sight = np.zeros(3)
    for dwell in heights.dwells("film"):
        clouds[dwell.dwell] = _thinned(_points(dwell), MOST_POINTS // heights.count)
        sight = sight if sight.any() else _sight(dwell)
    if not any(map(len, clouds.values())):
        raise UserError(f"Topic {heights.topic} of bag {heights.reader.path} has no valid height.")
    flight = recorded_flight(heights.reader)
    truth = _lit_points(flight, list(clouds)) if flight else None
    frames = list(frames_of(list(clouds.values()), truth, sight, f"measured: {heights.topic}", MOST_FRAMES))
    with unfinished(path) as partial:
        _write_gif(frames, partial)
    return len(frames)


def _points(dwell: DwellHeights) -> F64:
    """East, north and height of all surfaces of a dwell, m, shape (points, 3)."""
    position = np.concatenate([surface.positions.reshape(-1, 3) for surface in dwell.field.surfaces])
    valid = np.concatenate([np.isfinite(surface.height).ravel() for surface in dwell.field.surfaces])
    return np.stack(sphere_coordinates(position[valid]), axis=-1)


def _thinned(points: F64, most: int) -> F64:
    """Points, or of more than `most` of them an even choice."""
    return points[:: -(-len(points) // max(1, most)) or 1]


def _sight(dwell: DwellHeights) -> F64:
    """Direction from the sensor to the middle of its image, of length 1."""
    grid = dwell.field.grid
    sight = grid.points(grid.rows / 2, grid.cols / 2) - dwell.aperture.position
    return np.asarray(sight / np.linalg.norm(sight))


def _lit_points(flight: SimulatedFlight, dwells: list[int]) -> F64:
    """East, north and height of what some dwells of a simulated flight light up, m, shape (points, 3)."""
    most = MOST_POINTS // len(dwells)
    seen = [_thinned(flight.surface(number).positions, most) for number in dwells]
    return np.stack(sphere_coordinates(np.concatenate(seen)), axis=-1)


def _write_gif(frames: list[U8], path: Path) -> None:
    """Write frames in the colours of the last one, so that what does not change between them takes no space."""
    longest_ms, slowest_ms, last_ms = 8000, 250, 2000  # time that the cloud grows, and that it is seen complete
    last = Image.fromarray(frames[-1]).quantize(255, dither=Image.Dither.NONE)
    pictures = [Image.fromarray(frame).quantize(palette=last, dither=Image.Dither.NONE) for frame in frames]
    each_ms = min(slowest_ms, longest_ms // len(frames)) // 10 * 10  # GIF counts hundredths of a second
    times = [each_ms] * (len(frames) - 1) + [last_ms]
    pictures[0].save(path, "GIF", save_all=True, append_images=pictures[1:], duration=times, loop=0, optimize=False)
