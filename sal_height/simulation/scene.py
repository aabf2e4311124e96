"""The ground: terrain heights, radar brightness and point targets, and its part that an aperture sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt

from sal_height.errors import UserError
from sal_height.geometry import ApertureState, Origin, angles_of, aperture_at, sphere_coordinates, sphere_point
from sal_height.numeric import F64, Bool, Index, ShortRepr, bilinear
from sal_height.simulation._terrain_kernels import divide_cuts, mark_lit, see
from sal_height.simulation.canopy import CANOPY_LAYERS, Canopy

SAMPLES_PER_CELL = 2
"""Scatterers per resolution cell in range and in azimuth, each: enough for fully developed speckle.

One in azimuth suffices where time matters: each amplitude is Gaussian, and the power of an unweighted image stays even
with strips as far apart as its resolution.
"""

LAYERS = 15
"""Layers of scatterers in height; odd, so that one is the terrain. An extent of 3.5 beams has 4 layers in a beam."""


def find_walls(north: F64, height: F64, elevation: F64) -> tuple[Bool, F64]:
    """Mask of the feet of walls that face the sensor and are lit in cuts through the terrain, and the walls' heights.

    Args:
        north: distance north of the nodes, going outwards from the sensor, m, shape (nodes,).
        height: height of the nodes in each cut, m, shape (cuts, nodes).
        elevation: elevation of the nodes as seen from the sensor, rad from nadir, shape (cuts, nodes).

    Returns:
        Both of shape (cuts, nodes); heights are in m, and 0 where there is no foot.
    """
    steep = np.diff(height, axis=1) > 2.0 * np.abs(np.diff(north))  # a wall is steeper than 63 degrees
    no_wall = np.zeros((len(height), 1), dtype=bool)
    starts = np.concatenate([steep & ~np.concatenate([no_wall, steep[:, :-1]], axis=1), no_wall], axis=1)
    # The top of the wall of a node: the next node at which no steep piece starts.
    nodes = np.arange(height.shape[1])
    ends = np.where(np.concatenate([steep, no_wall], axis=1), nodes[-1], nodes)
    top = np.minimum.accumulate(ends[:, ::-1], axis=1)[:, ::-1]
    rise = np.take_along_axis(height, top, axis=1) - height
    hidden_by = np.maximum.accumulate(np.nan_to_num(elevation, nan=-np.pi), axis=1)
    feet = starts & (elevation >= hidden_by)
    return feet, np.where(feet, rise, 0.0)


@dataclass(frozen=True)
class PointScatterer:
    """A single scatterer, at rest or on a straight path at constant speed.

    It is at `east`, `north` and `height` when the antenna is abeam of that position, in every pass again. Its radial
    velocity is along the line of sight from there (SAL paper, section 4), in spotlight from the middle of the dwell.

    Attributes:
        east: arc distance from the map origin, m.
        north: arc distance from the map origin, m.
        height: height above the sphere, m.
        power: power relative to a resolution cell of brightness 1 in an unweighted image. A range window raises the
            power of cell and noise by its `windows.noise_gain`, that of the point not at all. Neither terrain nor
            canopy shadows it.
        radial_velocity: velocity away from the antenna, m/s.
        along_velocity: velocity in the direction of flight, m/s.
    """

    east: float
    north: float
    height: float
    power: float
    radial_velocity: float = 0.0
    along_velocity: float = 0.0


@dataclass(frozen=True, eq=False)
class Scene(ShortRepr):
    """A terrain of heights and radar brightness on a regular grid, with point targets.

    Heights are bilinear between nodes; a step between two nodes is a wall. Brightness is beta-nought: mean power per
    slant range and azimuth, so that a cell of brightness 1 has the CNR that a simulation states, whatever its slope.

    Attributes:
        name: name for people.
        east: node arc distances from the map origin, m, increasing, shape (n_east,).
        north: node arc distances, m, increasing, shape (n_north,).
        height: height above the sphere, m, shape (n_north, n_east).
        brightness: relative radar brightness, shape (n_north, n_east).
        points: point targets.
        extent: extent of the scatterers in height, m: spread evenly from half of it below the terrain to half above, as
            in vegetation or on rough ground; 0: on the terrain. Where the terrain is hidden, so are all scatterers
            above and below it, and only there.
        canopy: vegetation above the terrain, hidden where the terrain under it is; None: no canopy.
        origin: map origin on the earth; None: unspecified.
        double_bounce: power of the double bounce at the foot of a wall 1 m high, relative to a resolution cell of
            brightness 1; it grows with the square of the height.

    Raises:
        UserError: fewer than 2 x 2 nodes, nodes that do not increase, values that are not finite, an extent or a double
            bounce below 0, or a canopy that is not on the nodes of the scene or has a number below 0.
    """

    name: str
    east: F64
    north: F64
    height: F64
    brightness: F64
    points: tuple[PointScatterer, ...] = ()
    extent: float = 0.0
    canopy: Canopy | None = None
    origin: Origin | None = None
    double_bounce: float = 0.0

    def __post_init__(self) -> None:
        shape = (len(self.north), len(self.east))
        if self.height.shape != shape or self.brightness.shape != shape or min(shape) < 2:
            raise UserError(
                f"Scene {self.name}: height {self.height.shape} and brightness {self.brightness.shape} must both be "
                f"(north, east) = {shape}, 2 x 2 or more."
            )
        if not (np.all(np.diff(self.east) > 0) and np.all(np.diff(self.north) > 0)):
            raise UserError(f"Scene {self.name}: east and north of the nodes must increase.")
        if not (np.all(np.isfinite(self.height)) and np.all(np.isfinite(self.brightness) & (self.brightness >= 0))):
            raise UserError(f"Scene {self.name}: heights must be finite, brightness finite and 0 or more.")
        if not (np.isfinite(self.extent) and self.extent >= 0):
            raise UserError(f"Scene {self.name}: extent is {self.extent} m; it must be finite and 0 or more.")
        if not (np.isfinite(self.double_bounce) and self.double_bounce >= 0):
            raise UserError(
                f"Scene {self.name}: double_bounce is {self.double_bounce}; it must be finite and 0 or more."
            )
        if self.canopy and self.canopy.top.shape != shape:
            raise UserError(
                f"Scene {self.name}: the canopy's top {self.canopy.top.shape} must be (north, east) = {shape}."
            )
        if self.canopy and not self.canopy.is_possible:
            raise UserError(
                f"Scene {self.name}: top, base, extinction and reflectivity of the canopy must be finite and 0 or more."
            )

    def heights(self, east: npt.ArrayLike, north: npt.ArrayLike) -> F64:
        """Terrain height (m) at arc distances `east`, `north` (m); NaN outside the terrain."""
        return bilinear(self.north, self.east, self.height, north, east)

    def brightnesses(self, east: npt.ArrayLike, north: npt.ArrayLike) -> F64:
        """Radar brightness at arc distances `east`, `north` (m); NaN outside the terrain."""
        return bilinear(self.north, self.east, self.brightness, north, east)

    @cached_property
    def reference_height(self) -> float:
        """Median terrain height and half the greatest height of the canopy, m: the aim point of a flight."""
        return float(np.median(self.height)) + (self.canopy.top.max() / 2 if self.canopy else 0.0)

    @property
    def layer_spacing(self) -> float:
        """Greatest spacing in height of the layers of scatterers, m; 0: all are on the terrain."""
        return max(self.extent / LAYERS, float(self.canopy.top.max()) / CANOPY_LAYERS if self.canopy else 0.0)

    def canopy_tops(self, east: npt.ArrayLike, north: npt.ArrayLike) -> F64:
        """Height of the canopy's top above the terrain (m) at arc distances `east`, `north` (m); 0 without a canopy."""
        tops = self.canopy.top if self.canopy else np.zeros_like(self.height)
        return bilinear(self.north, self.east, tops, north, east)

    def transmission(self, positions: F64, antenna: F64) -> F64:
        """Fraction of power that scatterers return through the canopy, over the path in both directions, (scatterers,).

        Args:
            positions: positions in map, m, shape (scatterers, 3).
            antenna: position in map from which each is seen, m, broadcasts with the positions.
        """
        if not self.canopy:
            return np.ones(len(positions))
        sight = (antenna - positions).T
        sight = sight / np.linalg.norm(sight, axis=0)
        points = np.stack(sphere_coordinates(positions))
        return np.exp(-2 * self.canopy.optical_depth(self.north, self.east, self.height, points, sight))


@dataclass(frozen=True, eq=False)
class VisibleSurface(ShortRepr):
    """Scatterers that an aperture sees, dense enough that each resolution cell has several.

    Attributes:
        positions: positions in map in the middle of the aperture's time, m, shape (scatterers, 3).
        heights: heights above the sphere, m, shape (scatterers,).
        power: mean power relative to a resolution cell of brightness 1, shape (scatterers,).
        slant_range: slant range from the middle of the aperture, in stripmap from abeam, m.
        elevation: elevation in body axes, from there, rad from nadir.
        squint: squint, rad.
        deterministic: True for point targets, whose amplitude does not fluctuate.
        velocity: velocity in map, m/s, shape (scatterers, 3).
    """

    positions: F64
    heights: F64
    power: F64
    slant_range: F64
    elevation: F64
    squint: F64
    deterministic: Bool
    velocity: F64

    def after(self, seconds: float) -> Self:
        """The surface with its positions at a time (s) after these; ranges and angles stay."""
        return replace(self, positions=self.positions + seconds * self.velocity)

    def at_rest_and_moving(self) -> list[Index | slice]:
        """Scatterers at rest and moving scatterers, without empty groups."""
        if not np.any(self.velocity):
            return [slice(None)]
        moves = np.any(self.velocity, axis=-1)
        return [numbers for numbers in (np.flatnonzero(~moves), np.flatnonzero(moves)) if numbers.size]

    def where(self, chosen: Bool | Index) -> Self:
        """Some of the scatterers."""
        numbers = np.flatnonzero(chosen) if chosen.dtype == np.bool_ else chosen
        return type(self)(*(np.take(getattr(self, entry.name).T, numbers, axis=-1).T for entry in fields(self)))


def joined(surfaces: Sequence[VisibleSurface]) -> VisibleSurface:
    """All scatterers of some surfaces."""
    filled = [surface for surface in surfaces if surface.power.size] or surfaces[:1]
    if len(filled) == 1:
        return filled[0]
    names = [entry.name for entry in fields(VisibleSurface)]
    parts = ([getattr(surface, name).T for surface in filled] for name in names)
    return VisibleSurface(*(np.concatenate(values, axis=-1).T for values in parts))


def visible_surface(
    scene: Scene,
    aperture: ApertureState,
    look_side: int,
    cell: tuple[float, float],
    east_extent: tuple[float, float],
    range_extent: tuple[float, float],
    strips_per_cell: int = SAMPLES_PER_CELL,
) -> VisibleSurface:
    """Scatterers of the terrain that are lit and lie within the given extents, plus the point targets.

    Each strip of constant east is a vertical cut through the terrain. Going outwards from the sensor, a point is lit
    when its elevation exceeds that of all points before it.

    Args:
        scene: scene with the ground.
        aperture: aperture flying east or west (the strips are perpendicular to the flight).
        look_side: look side, +1 right, -1 left.
        cell: resolution in slant range and azimuth, m.
        east_extent: first arc distance east, and that where the next extent starts, m.
        range_extent: least and greatest slant range from the middle of the aperture, m.
        strips_per_cell: strips of scatterers in a resolution cell in azimuth.

    Raises:
        UserError: the scene has no terrain within the extents.
    """
    cuts = _Cuts.through(scene, aperture, look_side, cell, east_extent, strips_per_cell)
    ground, lit = _terrain_scatterers(scene, cuts, aperture, look_side, cell, range_extent)
    feet = _wall_feet(scene, cuts, aperture, look_side, cell[1])
    targets = _targets(scene.points, aperture, look_side)
    east = np.array([point.east for point in scene.points])
    ground = ground.where(lit & _within(ground.slant_range, range_extent))
    feet = feet.where(_within(feet.slant_range, range_extent))
    targets = targets.where(
        _within(targets.slant_range, range_extent) & (east >= east_extent[0]) & (east < east_extent[1])
    )
    if not ground.power.size:
        raise UserError(
            f"Scene {scene.name} has no terrain at slant ranges {range_extent[0]:.1f} to {range_extent[1]:.1f} m and "
            f"{east_extent[0]:.1f} to {east_extent[1]:.1f} m east; fly where the scene is, or choose a larger scene."
        )
    return joined([ground, feet, targets])


def _within(values: F64, extent: tuple[float, float]) -> Bool:
    return (values >= extent[0]) & (values <= extent[1])


def _targets(points: tuple[PointScatterer, ...], aperture: ApertureState, look_side: int) -> VisibleSurface:
    """Point targets, lit or not, with their positions in the middle of the aperture's time.

    Each is at the position of its point when the antenna is abeam of that: a moving target changes from dwell to dwell.
    """
    numbers = [(p.east, p.north, p.height, p.power, p.radial_velocity, p.along_velocity) for p in points]
    east, north, height, power, radial, along = np.array(numbers).reshape(-1, 6).T
    abeam = sphere_point(east, north, height)
    seen_from = np.broadcast_to(aperture_at(abeam, aperture).position, abeam.shape)
    sight = (abeam - seen_from) / np.linalg.norm(abeam - seen_from, axis=-1, keepdims=True)
    velocity = radial[:, None] * sight + along[:, None] * aperture.direction
    if aperture.sliding:
        seconds = (seen_from - aperture.position) @ aperture.velocity / (aperture.velocity @ aperture.velocity)
    else:
        seconds = (abeam - aperture.position)[:, 0] / aperture.velocity[0]
    positions = abeam - seconds[:, None] * velocity
    seen = abeam if aperture.sliding else positions
    angles = angles_of(seen, aperture_at(seen, aperture), look_side)
    return VisibleSurface(positions, height, power, *angles, np.ones(len(points), dtype=bool), velocity)


@dataclass(frozen=True, eq=False)
class _Cuts:
    """Vertical cuts through the terrain across the flight, the middles of strips, with nodes in the order outwards.

    Attributes:
        strip_width: width of a strip, m.
        north: arc distances of the nodes, m, shape (nodes,).
        place: arc distances east and north and height of the nodes, m, three arrays of shape (cuts, nodes).
        slant_range: slant range of the nodes, m, shape (cuts, nodes).
        elevation: elevation of the nodes, rad, shape (cuts, nodes).
    """

    strip_width: float
    north: F64
    place: tuple[F64, F64, F64]
    slant_range: F64
    elevation: F64

    @classmethod
    def through(
        cls,
        scene: Scene,
        aperture: ApertureState,
        look_side: int,
        cell: tuple[float, float],
        east_extent: tuple[float, float],
        strips_per_cell: int,
    ) -> Self:
        """The cuts of an extent, `strips_per_cell` in a resolution cell in azimuth, no piece over 16 range cells."""
        range_cell, azimuth_cell = cell
        strips = max(2, round((east_extent[1] - east_extent[0]) / azimuth_cell * strips_per_cell))
        width = (east_extent[1] - east_extent[0]) / strips
        east = east_extent[0] + width * (np.arange(strips) + 0.5)
        outwards = int(-look_side * np.sign(aperture.direction[0]))
        longest = 16  # longest piece of a cut, in range cells, over which range is assumed to be linear
        refine = int(np.ceil(np.diff(scene.north).max() / (longest * range_cell)))
        steps = np.arange((len(scene.north) - 1) * refine + 1) / refine
        north = np.interp(steps, np.arange(len(scene.north)), scene.north)[::outwards]
        height = scene.heights(east[:, None], north)
        place = np.broadcast_to(east[:, None], height.shape), np.broadcast_to(north, height.shape), height
        _, (slant_range, elevation, _) = _seen(*place, aperture, look_side)
        return cls(width, north, place, slant_range, elevation)


def _terrain_scatterers(
    scene: Scene,
    cuts: _Cuts,
    aperture: ApertureState,
    look_side: int,
    cell: tuple[float, float],
    range_extent: tuple[float, float],
) -> tuple[VisibleSurface, Bool]:
    """Scatterers along vertical cuts through the terrain, SAMPLES_PER_CELL in each cell of a cut, and the lit ones.

    Between two nodes of a cut there are enough that neither range nor the arc across it steps by more than their
    spacing. Each has its part of the piece's extent in range, as brightness is power per slant range; in the canopy,
    which is a volume, of the range that level ground would extend over. They are ordered layer after layer from the
    lowest to the highest, each strip after strip, outwards, those of the canopy last. Where the terrain, the middle
    layer of the others, is lit, all layers are.
    """
    range_cell, azimuth_cell = cell
    east, north, height = cuts.place
    node_range, node_elevation = cuts.slant_range, cuts.elevation

    step = np.abs(np.diff(node_range))
    span = np.maximum(step, np.abs(np.diff(node_elevation)) * node_range[:, :-1])
    pieces = np.ceil(np.nan_to_num(span) / range_cell * SAMPLES_PER_CELL).astype(np.int64)
    # Ground nearer or farther than any that the height of scatterers above the terrain brings into the range window
    # has no scatterers; it hides the ground behind it.
    reach = scene.extent / 2 + (float(scene.canopy.top.max()) if scene.canopy else 0.0)
    nearer, farther = (
        np.minimum(node_range[:, :-1], node_range[:, 1:]),
        np.maximum(node_range[:, :-1], node_range[:, 1:]),
    )
    outside = (farther < range_extent[0] - reach) | (nearer > range_extent[1] + reach)
    pieces[outside] = 0
    before = np.where(outside, np.nan_to_num(node_elevation[:, 1:], nan=-np.pi), -np.pi)
    horizon = np.maximum.accumulate(before, axis=1)
    points = np.empty((4, int(pieces.sum())))
    strip, node = (np.empty(points.shape[1], dtype=np.int32) for _ in range(2))
    divide_cuts(pieces, np.stack([east, north, height, scene.brightnesses(east, north)]), points, strip, node)
    place, brightness = points[:3], points[3]

    def raised(heights: F64, power: F64) -> VisibleSurface:
        """Scatterers above the points of the cuts: heights above the terrain, m, and powers, both (layers, points)."""
        above = (place[2] + heights).ravel()
        east, north = (np.broadcast_to(values, heights.shape).ravel() for values in place[:2])
        positions, angles = _seen(east, north, above, aperture, look_side)
        fluctuating, at_rest = np.zeros(heights.size, dtype=bool), np.zeros_like(positions)
        return VisibleSurface(positions, above, power.ravel(), *angles, fluctuating, at_rest)

    layers = scene.extent * ((np.arange(LAYERS) + 0.5) / LAYERS - 0.5) if scene.extent else np.zeros(1)
    cells = cuts.strip_width / azimuth_cell / pieces[strip, node] / range_cell  # of a cut of unit length
    power = brightness * step[strip, node] * cells
    ground = raised(np.tile(layers[:, None], len(power)), np.tile(power / len(layers), (len(layers), 1)))
    terrain_elevation = ground.elevation.reshape(len(layers), -1)[len(layers) // 2]
    lit = np.empty(len(power), dtype=bool)
    mark_lit(terrain_elevation, strip, node, horizon, lit)
    if not scene.canopy:
        return ground, np.tile(lit, len(layers))

    heights, thickness = scene.canopy.layers(scene.canopy_tops(*place[:2]))
    level = np.abs(np.diff(cuts.north))[node] * np.sin(terrain_elevation) * cells
    volume = raised(heights, scene.canopy.reflectivity * thickness * level)
    chosen = np.concatenate([np.ones(len(ground.power), dtype=bool), volume.power > 0])
    surface = joined([ground, volume]).where(chosen)
    through = scene.transmission(surface.positions, aperture_at(surface.positions, aperture).position)
    lit_layers = np.tile(lit, len(layers) + len(heights))[chosen]
    return replace(surface, power=surface.power * through), lit_layers


def _wall_feet(
    scene: Scene, cuts: _Cuts, aperture: ApertureState, look_side: int, azimuth_cell: float
) -> VisibleSurface:
    """The double bounces of walls, one in each strip, at their feet, as far as the canopy lets them through."""
    feet, rise = find_walls(cuts.north, cuts.place[2], cuts.elevation)
    feet &= scene.double_bounce > 0
    east, north, height = (values[feet] for values in cuts.place)
    positions, angles = _seen(east, north, height, aperture, look_side)
    through = scene.transmission(positions, aperture_at(positions, aperture).position)
    power = scene.double_bounce * rise[feet] ** 2 * cuts.strip_width / azimuth_cell * through
    fluctuating, at_rest = np.zeros(len(power), dtype=bool), np.zeros_like(positions)
    return VisibleSurface(positions, height, power, *angles, fluctuating, at_rest)


def _seen(
    east: F64, north: F64, height: F64, aperture: ApertureState, look_side: int
) -> tuple[F64, tuple[F64, F64, F64]]:
    """Positions, m, shape (points, 3), of points by arc distances and height, m, in any shape, and their view.

    The view is slant range, m, elevation and squint, rad, in that shape; in stripmap from abeam.
    """
    positions, seen = np.empty((3, height.size)), np.empty((3, height.size))
    glide = aperture.velocity / (aperture.velocity @ aperture.forward) if aperture.sliding else np.zeros(3)
    x, y, z = (np.ascontiguousarray(values, dtype=np.float64).reshape(-1) for values in (east, north, height))
    rotation = np.ascontiguousarray(aperture.rotation, dtype=np.float64)
    see(x, y, z, np.asarray(aperture.position, dtype=np.float64), glide, rotation, look_side, positions, seen)
    slant_range, elevation, squint = seen.reshape(3, *height.shape)
    return positions.T, (slant_range, elevation, squint)
