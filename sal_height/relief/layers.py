"""Layers: the pieces of surface that dwells have measured, each in one cell of a grid on the ground.

A cell has several layers where surfaces are above each other, as at a wall. Measurements of the same piece are merged
with the weights of their own errors, so that the memory of a map grows with the ground that was seen, not with the
dwells. Heights of rows that were estimated apart are joined here, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from typing import Any, Self

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from sal_height.elevation import Validity
from sal_height.geometry import ApertureState, aperture_at, sphere_coordinates
from sal_height.numeric import F64, I64, Bool, Index
from sal_height.relief.cell_map import cell_numbers
from sal_height.relief.heights import HeightField, Surface
from sal_height.relief.offsets import LEAST_SHARED, SharedError
from sal_height.relief.slope import median


def joined_rows(parts: Sequence[tuple[Bool, HeightField]]) -> HeightField:
    """A field in which each part has the rows of pixels that belong to it, shape (rows,); the rest is MISSING_DATA.

    Surfaces that a part has not searched for, and probabilities that it has not estimated, are NaN in its rows.
    """
    if len(parts) == 1 and parts[0][0].all():
        return parts[0][1]
    rows, parts_fields = [rows for rows, _ in parts], [field for _, field in parts]
    first, most = parts_fields[0], max(len(field.surfaces) for field in parts_fields)
    validity = np.full(first.validity.shape, Validity.MISSING_DATA, np.uint8)
    for some, field in parts:
        validity[some] = field.validity[some]
    surfaces = []
    for number in range(most):
        given = [field.surfaces[number] if number < len(field.surfaces) else None for field in parts_fields]
        values = {f.name: _joined(rows, [getattr(one, f.name, None) for one in given]) for f in fields(Surface)}
        surfaces.append(Surface(**values))
    probability = _joined(rows, [field.order_probability for field in parts_fields])
    return HeightField(first.grid, validity, tuple(surfaces), probability)


def _joined(rows: Sequence[Bool], arrays: Sequence[F64 | None]) -> Any:
    """An array with the rows of each array that exists, and NaN elsewhere; None if no array exists."""
    known = [(some, array) for some, array in zip(rows, arrays, strict=True) if array is not None]
    if not known:
        return None
    whole = np.full(known[0][1].shape, np.nan)
    for some, array in known:
        whole[some] = array[some]
    return whole


@dataclass(frozen=True, eq=False)
class Layers:
    """Pieces of surface, one entry each; distances in m.

    Attributes:
        place: arc distances east and north from the map's origin, and height above the sphere, shape (n, 3).
        own: covariance of their errors that no other layer shares, m^2, shape (n, 3, 3).
        common: covariance of those that all pixels of a dwell share, shape (n, 3, 3).
        towards: distance east and north along the line of sight to the sensor per metre of rise, m/m, shape (n, 2).
        dwells: number of dwells that have measured them, shape (n,).
        averaged: variance of the mean over these dwells of a shared error that varies, over that of one, shape (n,).
        last: covariance of that mean with the error at `time`, over the same, shape (n,).
        time: time of the latest of these dwells, or a later one, s, shape (n,).
    """

    place: F64
    own: F64
    common: F64
    towards: F64
    dwells: I64
    averaged: F64
    last: F64
    time: F64

    def __len__(self) -> int:
        return len(self.place)

    @property
    def sigma(self) -> F64:
        """Standard deviation of height but for the common errors, m, shape (n,)."""
        return np.sqrt(self.own[:, 2, 2])

    def cells(self, cell_size: float) -> I64:
        """Row (north) and column (east) of the cell that each lies in, shape (n, 2)."""
        return np.floor(self.place[:, 1::-1] / cell_size).astype(np.int64)

    def where(self, chosen: Bool | Index) -> Self:
        """Some of the layers."""
        return type(self)(*(getattr(self, entry.name)[chosen] for entry in fields(self)))

    def at(self, time: float, shared: SharedError) -> Self:
        """The layers with their covariance with the shared error at a later time, s."""
        return replace(
            self, last=self.last * shared.correlation_after(time - self.time), time=np.maximum(self.time, time)
        )

    def and_those(self, others: Layers) -> Self:
        """All layers of both."""
        return type(self)(
            *(np.concatenate([getattr(self, entry.name), getattr(others, entry.name)]) for entry in fields(self))
        )


def layers_of(field: HeightField, aperture: ApertureState, time: float = 0.0) -> Layers:
    """All surfaces of all pixels of a dwell seen from `aperture` at a time, s."""
    first, *others = (_layers_of_surface(surface, aperture, time) for surface in field.surfaces)
    return reduce(Layers.and_those, others, first)


def _layers_of_surface(surface: Surface, aperture: ApertureState, time: float) -> Layers:
    """One layer for each pixel.

    Errors along its circle add to the covariance: all of sigma if no covariance is known, and the spread of an extended
    surface, of which any part may be seen at a position. Pixels whose circle does not rise at all, right ahead of
    the platform, are left out: their heights say nothing.
    """
    seen = surface.is_determined & np.isfinite(surface.height)
    points = surface.positions[seen]
    sight = points - aperture_at(points, aperture).position
    circle = np.cross(sight, aperture.direction)
    circle /= circle[:, 2:]
    along_circle = circle[:, :, None] * circle[:, None, :]
    own = surface.own_covariance[seen]
    known = np.asarray(np.isfinite(own).all(axis=(1, 2)))
    variance = np.where(known, 0.0, surface.sigma[seen] ** 2) + surface.spread[seen] ** 2
    own = np.where(known[:, None, None], own, 0.0) + variance[:, None, None] * along_circle
    least_variance = 1e-12  # m^2; a message may state that all of its error is common
    own[:, 2, 2] = np.maximum(own[:, 2, 2], least_variance)
    common = np.zeros_like(own) if surface.common_covariance is None else surface.common_covariance[seen]
    layers = Layers(
        place=np.stack(sphere_coordinates(points), axis=-1),
        own=own,
        common=np.nan_to_num(common),
        towards=sight[:, :2] / sight[:, 2:],
        dwells=np.ones(len(points), dtype=np.int64),
        averaged=np.ones(len(points)),
        last=np.ones(len(points)),
        time=np.full(len(points), time),
    )
    rises = np.isfinite(layers.own).all(axis=(1, 2)) & np.isfinite(layers.towards).all(axis=1)
    return layers.where(np.asarray(rises))


def merged_dwell(layers: Layers, cell_size: float, gate: float) -> Layers:
    """Merge layers of one dwell; arguments and result as `_merged` has them."""
    return _merged(layers, layers.place[:, 2], cell_size, gate, np.maximum)


def joined_dwells(
    known: Layers, new: Layers, offset: float, shared: SharedError, cell_size: float, gate: float
) -> Layers:
    """Merge layers of a new dwell with those that are known; arguments and result as `_merged` has them.

    They are compared without the height `offset` (m) of the new dwell (`height_offset`), which remains in the heights:
    either may be right. `shared` is the course of the error that all pixels of a dwell share.
    """
    latest = np.concatenate([known.time, new.time]).max(initial=-np.inf)
    known, new = known.at(latest, shared), new.at(latest, shared)
    compared = np.concatenate([known.place[:, 2], new.place[:, 2] - offset])
    return _merged(known.and_those(new), compared, cell_size, gate, np.add)


def height_offset(known: Sequence[Layers], new: Layers, cell_size: float, gate: float) -> float:
    """Height of a new dwell above the layers that are known, m, which is the difference of their common errors.

    It is the median over the cells in which there is one layer of either, if there are LEAST_SHARED such cells or more,
    which are a quarter of those of the new dwell, and if the heights of three quarters of them are alike (`_merged`)
    once it is subtracted, and of less than half as many before. Otherwise it is 0: the difference may be that of a roof
    and the ground beside it. No common error that is stated enters.
    """
    if not known:
        return 0.0
    old_cells, old_heights, old_variances = (
        np.concatenate(parts) for parts in zip(*(single_layers(layers, cell_size) for layers in known), strict=True)
    )
    new_cells, new_heights, new_variances = single_layers(new, cell_size)
    _, ours, theirs = np.intersect1d(old_cells, new_cells, assume_unique=True, return_indices=True)
    if len(ours) < max(LEAST_SHARED, len(new_cells) / 4):
        return 0.0
    difference = new_heights[theirs] - old_heights[ours]
    limit = gate**2 * (new_variances[theirs] + old_variances[ours]) + cell_size**2
    offset = median(difference)
    before, after = (np.count_nonzero(apart**2 <= limit) for apart in (difference, difference - offset))
    return offset if after >= 0.75 * len(ours) and before < after / 2 else 0.0


def single_layers(layers: Layers, cell_size: float) -> tuple[I64, F64, F64]:
    """Number of each cell that has one layer, and the layer's height (m) and own variance (m^2)."""
    number, first, count = np.unique(cell_numbers(*layers.cells(cell_size).T), return_index=True, return_counts=True)
    single = first[count == 1]
    return number[count == 1], layers.place[single, 2], layers.own[single, 2, 2]


def _merged(layers: Layers, compared: F64, cell_size: float, gate: float, count: np.ufunc) -> Layers:
    """Merge layers of the same cell that do not differ by more than `gate` standard deviations and one cell in height.

    What all pixels of a dwell share cancels where they are compared, so that the own errors alone decide and weigh:
    with w = 1 / own variance of height, they average, sum w^2 C / (sum w)^2. Common errors remain, sum w C / sum w,
    those of different dwells, too: no message says how alike they are, and a mean cannot err more. What is stated of
    them is in `averaged` and `last`.

    Args:
        layers: layers in any order.
        compared: height by which each is compared, m, shape (n,).
        cell_size: side of a cell, m.
        gate: greatest difference of layers that are merged, standard deviations.
        count: function of the numbers of dwells of two layers, for their number together.
    """
    if not len(layers):
        return layers
    cells = layers.cells(cell_size)
    order = np.lexsort((compared, cells[:, 1], cells[:, 0]))
    layers, cells, compared = layers.where(order), cells[order], compared[order]
    variance = layers.own[:, 2, 2]
    apart = np.diff(compared) ** 2 > gate**2 * (variance[1:] + variance[:-1]) + cell_size**2
    begins = np.flatnonzero(np.r_[True, apart | (np.diff(cells, axis=0) != 0).any(axis=1)])
    if len(begins) == len(layers):
        return layers
    weight = 1 / variance
    total = np.add.reduceat(weight, begins)

    def mean(values: F64, weights: F64, sums: F64) -> F64:
        shape = (-1,) + (1,) * (values.ndim - 1)
        return np.add.reduceat(values * weights.reshape(shape), begins) / sums.reshape(shape)

    # Errors of which no more is known than their variance and their covariance with the last one may be all alike.
    last = mean(layers.last, weight, total)
    older = mean(np.sqrt(np.maximum(layers.averaged - layers.last**2, 0.0)), weight, total)
    return Layers(
        place=mean(layers.place, weight, total),
        own=mean(layers.own, weight**2, total**2),
        common=mean(layers.common, weight, total),
        towards=mean(layers.towards, weight, total),
        dwells=count.reduceat(layers.dwells, begins),
        averaged=last**2 + older**2,
        last=last,
        time=np.maximum.reduceat(layers.time, begins),
    )


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Pairs of layers whose positions on the ground are near each other.

    Attributes:
        first: number of the first layer of each pair, shape (pairs,).
        second: number of the second layer, shape (pairs,).
        distance: distance on the ground, m.
        rise: height of the second less that of the first, m.
        error: standard deviation of the rise, times `gate`, m.
    """

    first: Index
    second: Index
    distance: F64
    rise: F64
    error: F64

    def among(self, chosen: Bool) -> Self:
        """The pairs of which both layers are chosen, numbered as in `Layers.where`."""
        number = np.cumsum(chosen) - 1
        both = chosen[self.first] & chosen[self.second]
        first, second = number[self.first[both]], number[self.second[both]]
        return type(self)(first, second, self.distance[both], self.rise[both], self.error[both])


def neighbours(layers: Layers, reach: float, gate: float) -> Neighbours:
    """All pairs of layers at most `reach` (m) from each other on the ground."""
    first, second = cKDTree(layers.place[:, :2]).query_pairs(reach, output_type="ndarray").T
    offset = layers.place[second] - layers.place[first]
    error = gate * np.hypot(layers.sigma[first], layers.sigma[second])
    return Neighbours(first, second, np.hypot(offset[:, 0], offset[:, 1]), offset[:, 2], error)


def supported(layers: Layers, pairs: Neighbours, reach: float, least: int) -> Bool:
    """Layers that are connected to `least` or more in space, shape (n,): surfaces, and not ghosts among surfaces.

    Two layers are connected if their distance, but for their errors, is at most `reach` (m). A layer with fewer than
    `least` layers around it on the ground is not contradicted, and counts as supported.
    """
    beyond = np.maximum(np.abs(pairs.rise) - pairs.error, 0.0)
    together = pairs.distance**2 + beyond**2 <= reach**2
    ends = pairs.first[together], pairs.second[together]
    graph = coo_array((np.ones(len(ends[0]), dtype=bool), ends), (len(layers), len(layers)))
    _, piece = connected_components(graph, directed=False)
    around = np.bincount(np.concatenate([pairs.first, pairs.second]), minlength=len(layers))
    return (np.bincount(piece)[piece] >= least) | (around < least)


def on_walls(layers: Layers, pairs: Neighbours, reach: float) -> Bool:
    """Layers with another one within `reach` (m) steeply above them, and another one steeply below, shape (n,)."""
    steepest_ground = 1.7  # greatest slope of ground; what rises more steeply, 60 degrees, is a wall
    steep = (np.abs(pairs.rise) > np.maximum(steepest_ground * pairs.distance, pairs.error)) & (pairs.distance < reach)
    lower = np.where(pairs.rise > 0, pairs.first, pairs.second)[steep]
    upper = np.where(pairs.rise > 0, pairs.second, pairs.first)[steep]
    return (np.bincount(lower, minlength=len(layers)) > 0) & (np.bincount(upper, minlength=len(layers)) > 0)
