"""The height images of a bag, their position on the earth, and their map as a Cloud-Optimized GeoTIFF."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from sal_height import messages
from sal_height.bag.described import origin_of
from sal_height.bag.namespace import open_bag
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.elevation import ORDERS, Validity, scatterer_count
from sal_height.errors import UserError
from sal_height.geometry import UTM, ApertureState, Origin, Projection
from sal_height.graph.catalogue import MAPPERS
from sal_height.numeric import F64
from sal_height.progress import Bar
from sal_height.relief import (
    HeightField,
    ProjectedAxes,
    ReliefMap,
    check_geotiff,
    fitting_cell_size,
    map_coordinates,
    write_geotiff,
)
from sal_height.runs.chain.recorded_parameters import recorded_parameters

_LOG = logging.getLogger(__name__)

PREFERRED = "/ml/height"
"""Topic of the heights that are read if the bag has several and none is named."""

LOCAL = "local"
"""Name for the coordinates of the map frame, which has no position on the earth."""


@dataclass(frozen=True, eq=False)
class DwellHeights:
    """The heights of a dwell.

    Attributes:
        dwell: number of the dwell.
        stamp_ns: time of its first pulse, ns since 1970.
        field: heights, sigmas and reasons of all pixels.
        aperture: state of the platform in the middle of the dwell.
    """

    dwell: int
    stamp_ns: int
    field: HeightField
    aperture: ApertureState


@dataclass(frozen=True, eq=False)
class RecordedHeights:
    """The height images on one topic of a bag.

    Attributes:
        reader: reader of the bag.
        topic: topic of the images.
        projection: coordinates of the export; None: those of the map frame.
    """

    reader: BagReader
    topic: str
    projection: Projection | None

    @classmethod
    def of_bag(cls, bag: Path, topic: str = "", origin: Origin | None = None, crs: str = UTM) -> Self:
        """The heights on a topic of a bag.

        Args:
            bag: folder or file.
            topic: topic of the images; empty: /ml/height, or the first in the bag.
            origin: origin of the map frame on the earth; None: that in the bag, if any.
            crs: name of the coordinate reference system of the export; LOCAL: the map frame.

        Raises:
            UserError: the bag cannot be read, it has no such heights, or the system does not suit the position.
        """
        reader = open_bag(bag, None, [topic] if topic else [PREFERRED])
        known = sorted(name for name, one in reader.topics.items() if one.type_name == HEIGHT_TYPE and one.count)
        if not known:
            raise UserError(f"Bag {bag} has no height images; make some: sal-height replay {bag}.")
        if topic and topic not in known:
            raise UserError(f"Bag {bag} has no heights on topic {topic!r}; there are {', '.join(known)}.")
        chosen = topic or (PREFERRED if PREFERRED in known else known[0])
        place = None if crs == LOCAL else origin or origin_in(reader)
        return cls(reader, chosen, None if place is None else Projection.of(crs, place))

    @cached_property
    def count(self) -> int:
        """Number of the images."""
        return self.reader.topics[self.topic].count

    def dwells(self, task: str) -> Iterator[DwellHeights]:
        """The images one after the other, with a progress bar; those that cannot be used are left out and logged."""
        left_out, why = 0, ""
        for recorded in Bar(self.reader.messages([self.topic]), total=self.count, desc=task, unit="dwell", delay=1):
            try:
                image = self.reader.decode(recorded.type_name, recorded.cdr)
                field = messages.field_from_message(image, image.header.frame_id)
                aperture = messages.aperture_from_message(image.aperture)
            except UserError as error:
                left_out, why = left_out + 1, str(error)
                continue
            yield DwellHeights(image.dwell, messages.to_ns(image.header.stamp), field, aperture)
        if left_out:
            _LOG.warning("Bag %s: %d images on %s were left out. %s", self.reader.path, left_out, self.topic, why)

    def coordinates(self, positions: F64) -> F64:
        """Coordinates (m) of positions in map (m), both of shape (..., 3).

        They are easting, northing and height in the projection; without one, distances east and north along the sphere
        and the height above it, as in a local map.
        """
        return map_coordinates(positions, self.projection)

    @property
    def facts(self) -> dict[str, str]:
        """Bag, topic and coordinate reference system, as texts by name."""
        system = self.projection.name if self.projection else LOCAL
        return {"bag": self.reader.path.name, "topic": self.topic, "crs": system}


def origin_in(reader: BagReader) -> Origin | None:
    """The origin of the map in a bag: on topic map_origin, or in the parameters of a mapper; None: not stated."""
    if found := origin_of(reader):
        return found
    recorded = recorded_parameters(reader)
    for name in MAPPERS:
        of_node = recorded.get(name, {})
        latitude, longitude = (of_node.get(f"origin_{axis}_deg", 0.0) for axis in ("latitude", "longitude"))
        if latitude or longitude:
            return Origin(math.radians(latitude), math.radians(longitude), of_node.get("origin_height_m", 0.0))
    return None


def probability_of_order(field: HeightField) -> F64:
    """Probability of the number of scatterers that was found in each pixel, shape (rows, cols); NaN: not known."""
    if field.order_probability is None:
        return np.full(field.validity.shape, np.nan)
    is_extended = field.validity == Validity.EXTENDED
    order = np.where(is_extended, ORDERS - 1, scatterer_count(field.validity)).astype(np.uint8)
    return np.take_along_axis(field.order_probability, order[..., None], axis=-1)[..., 0]


def write_map(heights: RecordedHeights, path: Path, cell_size: float = 0.0) -> tuple[int, int]:
    """Write the map of the scatterers of all dwells, as node relief_mapper makes it; returns its rows and columns.

    Args:
        heights: heights of a bag.
        path: file to write.
        cell_size: side of a cell, m; 0: that of the pixels.

    Raises:
        UserError: the package rasterio is not installed, there is no height, the map has too many cells, or the file
            cannot be written.
    """
    check_geotiff(path)
    axes = ProjectedAxes.around(heights.projection) if heights.projection else None
    grown, last_ns = None, 0
    most_cells = 100_000_000  # greatest number of cells of a map: 400 MB for each of its layers
    for dwell in heights.dwells("cog"):
        field, aperture = axes.field(dwell.field, dwell.aperture) if axes else (dwell.field, dwell.aperture)
        grown = grown or ReliefMap(cell_size or fitting_cell_size(field.grid, aperture), most_cells)
        grown.add(field)
        last_ns = max(last_ns, dwell.stamp_ns)
    relief = grown.relief() if grown else None
    if relief is None:
        raise UserError(f"Topic {heights.topic} of bag {heights.reader.path} has no valid height.")
    placed = axes.relief(relief) if axes else relief
    write_geotiff(path, placed, heights.projection, last_ns, heights.facts)
    rows, cols = placed.height.shape
    return rows, cols
