"""`sal-height tomogram`: a vertical cut through what a radar sees of vegetation, by three estimators of its profile."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.elevation import ESTIMATORS, PROFILES, Validity
from sal_height.errors import UserError
from sal_height.geometry import aperture_at, height_of, locate_at_elevation, sphere_coordinates
from sal_height.graph.reporting import PRESET
from sal_height.imaging import Slc
from sal_height.io import writing
from sal_height.numeric import F64
from sal_height.picture import page
from sal_height.pipeline import elevations
from sal_height.relief import height_field
from sal_height.runs.chain.recorded_images import recorded_slc
from sal_height.runs.truth.report import recorded_flight
from sal_height.sensor import Sensor
from sal_height.simulation import Scene

GROUND = ESTIMATORS["canopy_ground"]


_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class TomogramCut:
    """A row of pixels of one dwell, from near to far along the flight.

    Attributes:
        along: distance along the flight from the middle of the first dwell, m, shape (cols,).
        width: along-track width of a pixel, m.
        positions: positions of the nodes in map, m, shape (cols, nodes, 3).
        profiles: values of each estimator of a profile by its title, shape (cols, nodes).
        ground: estimated height of the ground, m, NaN where it cannot be estimated, shape (cols,).
        sigma: standard deviation of that height, m, shape (cols,).
    """

    along: F64
    width: float
    positions: F64
    profiles: dict[str, F64]
    ground: F64
    sigma: F64

    @property
    def heights(self) -> F64:
        """Heights of the nodes above the sphere, m, shape (cols, nodes)."""
        return height_of(self.positions)


def tomogram(bag: Path, folder: Path, looks: tuple[int, int], row: int | None, jobs: int = 1) -> int:
    """Draw tomogram.png: reflectivity over height and along-track distance, with ground and canopy if they are known.

    Args:
        bag: bag with the images of all channels (topic slc), or the phase history that gives them.
        folder: output folder, which is made.
        looks: range looks and azimuth looks of a pixel.
        row: row of the cut, in pixels of these looks; None: the middle one.
        jobs: number of dwells of which images are made side by side, if the bag has no images.

    Returns:
        The number of pixels of the cut whose ground can be estimated.

    Raises:
        UserError: the bag cannot be read, has no images, or they have no such row.
    """
    settings = GROUND.settings(range_looks=looks[0], azimuth_looks=looks[1])
    dwells = list(_dwells(bag, jobs))
    if not dwells:
        raise UserError(
            f"Bag {bag} has no images of all channels, and no phase history that gives some; record one of the topics "
            "slc and phase_history."
        )
    start, cuts = dwells[0][0].aperture.position, []
    for slc, sensor in dwells:
        estimate, seen, grid, beams = elevations(slc, sensor, GROUND, settings)
        chosen = grid.rows // 2 if row is None else row
        if not 0 <= chosen < grid.rows:
            raise UserError(
                f"Option --row is {chosen}; the images have rows 0 to {grid.rows - 1} of {looks[0]} pixels."
            )
        field = height_field(estimate, seen, slc.grid, grid, slc.aperture, sensor.look_side, 0.0, beams)
        profiles = {title: profile(seen, beams) for title, profile in PROFILES.items()}
        points = slc.grid.points(seen.row[chosen], seen.col[chosen])
        aperture = aperture_at(points, slc.aperture)
        sight = points - aperture.position
        nodes = next(iter(profiles.values())).elevation
        slant_range, ahead = np.linalg.norm(sight, axis=-1), sight @ aperture.direction
        cuts.append(
            TomogramCut(
                along=(points - start) @ aperture.direction,
                width=grid.col_spacing,
                positions=locate_at_elevation(nodes, slant_range[:, None], ahead[:, None], aperture, sensor.look_side),
                profiles={title: profile.values[chosen] for title, profile in profiles.items()},
                ground=np.where(field.validity[chosen] == Validity.OK, field.first.height[chosen], np.nan),
                sigma=field.first.sigma[chosen],
            )
        )
    folder.mkdir(parents=True, exist_ok=True)
    reader = BagReader(bag)
    flight = recorded_flight(reader)
    if flight is None and PRESET in reader.custom_data:
        _LOG.warning(
            "Bag %s: its simulated scene cannot be made again, so that the picture lacks the true ground.", bag
        )
    with writing(folder / "tomogram.png"):
        _draw(cuts, flight.scene if flight else None, folder / "tomogram.png")
    return sum(int(np.isfinite(cut.ground).sum()) for cut in cuts)


def _dwells(bag: Path, jobs: int) -> Iterator[tuple[Slc, Sensor]]:
    """Images of all channels of each dwell, with their sensor, in recorded order; without dwells that lack channels."""
    waiting: dict[int, list[Any]] = {}
    for _, message, _, _, sensor in recorded_slc(bag, jobs):
        waiting.setdefault(message.dwell, []).append(message)
        if len(waiting[message.dwell]) == len(sensor.noise_power):
            images = sorted(waiting.pop(message.dwell), key=lambda image: image.channel)
            yield messages.slc_from_messages(images), sensor


def _draw(cuts: Sequence[TomogramCut], scene: Scene | None, path: Path) -> None:
    """Write a PNG with one panel for each estimator of a profile."""
    shown_db = 25.0  # range of the colours below the greatest value of each cut, dB
    sides = _sides_of(cuts)
    with page(path, 2.1 * len(PROFILES)) as figure:
        for axis, title in zip(figure.subplots(len(PROFILES), 1, sharex=True, sharey=True), PROFILES, strict=True):
            most = max(np.nanmax(cut.profiles[title]) for cut in cuts)
            for cut, ends in zip(cuts, sides, strict=True):
                with np.errstate(divide="ignore"):
                    shade = np.maximum(10 * np.log10(cut.profiles[title] / most), -shown_db)
                # Each column is drawn at both of its sides, so that it is as wide as its pixel.
                heights, shade = np.repeat(cut.heights, 2, axis=0), np.repeat(shade, 2, axis=0)
                across = np.broadcast_to(ends.ravel()[:, None], heights.shape)
                shown = axis.pcolormesh(across, heights, shade, vmin=-shown_db, vmax=0, cmap="magma", shading="gouraud")
                axis.errorbar(cut.along, cut.ground, 2 * cut.sigma, fmt=".", color="cyan", ms=3, lw=1.0)
            if scene:
                _draw_truth(axis, cuts, scene)
            axis.set(title=title, ylabel="height (m)")
            figure.colorbar(shown, ax=axis, label="dB relative to maximum")
        axis.set_xlabel("distance along the flight (m)")
        lines = ["Reflectivity over height."]
        lines += ["Cyan: estimated ground, 2 sigma."] if any(np.isfinite(cut.ground).any() for cut in cuts) else []
        lines += ["White: true ground and canopy top."] if scene else []
        figure.suptitle(" ".join(lines))


def _sides_of(cuts: Sequence[TomogramCut]) -> list[F64]:
    """Distances along the flight of both sides of the columns of each cut, m, shape (cols, 2).

    Columns next to each other, also of different dwells, meet in the middle between them.
    """
    along = np.concatenate([cut.along for cut in cuts])
    width = np.concatenate([np.full(len(cut.along), cut.width) for cut in cuts])
    order = np.argsort(along)
    sides = along[order, None] + width[order, None] * np.array([-0.5, 0.5])
    meet = np.flatnonzero(np.diff(along[order]) < 1.5 * width[order][1:])
    sides[meet, 1] = sides[meet + 1, 0] = (along[order][meet] + along[order][meet + 1]) / 2
    sides[order] = sides.copy()
    return np.split(sides, np.cumsum([len(cut.along) for cut in cuts])[:-1])


def _draw_truth(axis: Axes, cuts: Sequence[TomogramCut], scene: Scene) -> None:
    """Draw the heights at which the circle of each pixel meets the ground, and leaves the canopy at its top."""
    along = np.concatenate([cut.along for cut in cuts])
    positions = np.concatenate([cut.positions for cut in cuts])
    east, north, height = sphere_coordinates(positions)
    above = height - scene.heights(east, north)
    inside = (above >= 0) & (above <= scene.canopy_tops(east, north))
    pixel = np.arange(len(along))
    ground = height[pixel, np.nanargmin(np.abs(above), axis=1)]
    top = np.where(inside.any(axis=1), np.max(np.where(inside, height, -np.inf), axis=1), np.nan)
    order = np.argsort(along)
    axis.plot(along[order], ground[order], color="w", lw=1.2)
    axis.plot(along[order], top[order], color="w", lw=1.2, ls="--")
