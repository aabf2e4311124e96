"""Heights as arrays with names and units of the CF conventions: the variables of datasets of xarray."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from sal_height.elevation import Validity
from sal_height.geometry import Projection, sphere_coordinates
from sal_height.numeric import F64

LAYERS = {
    "height": ("m", "height of the surface"),
    "sigma": ("m", "standard deviation of height"),
    "cnr_db": ("dB", "carrier-to-noise ratio of one look"),
    "spread": ("m", "standard deviation of the surface's heights within the pixel"),
}
"""Fields of a surface that become variables: unit and description."""


def labelled_heights(
    fields: Sequence[Any], projection: Projection | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Variables and coordinates of the heights of dwells, with the dimensions dwell, surface, row and col.

    Args:
        fields: `HeightField` of each dwell, all of one size.
        projection: coordinates on the earth; None: distances along the sphere of the map.
    """
    pixel, scatterer = ("dwell", "row", "col"), ("dwell", "surface", "row", "col")
    positions = np.stack([[surface.positions for surface in one.surfaces] for one in fields])
    coordinates = np.full(positions.shape, np.nan)
    there = np.isfinite(positions).all(axis=-1)
    coordinates[there] = map_coordinates(positions[there], projection)
    variables: dict[str, Any] = {
        name: (
            scatterer,
            np.stack([[getattr(surface, name) for surface in one.surfaces] for one in fields]).astype(np.float32),
            {"units": unit, "long_name": text},
        )
        for name, (unit, text) in LAYERS.items()
    }
    validity = {"long_name": "whether a pixel has heights, or why not", **flags(Validity)}
    # Single precision has 60 um of 1000 m.
    variables["height"] = (scatterer, coordinates[..., 2].astype(np.float32), height_attributes(projection))
    variables["validity"] = (pixel, np.stack([one.validity for one in fields]), validity)
    if fields[0].order_probability is not None:
        known = [np.asarray(one.order_probability, dtype=np.float32) for one in fields]
        text = "probability of 0, 1, 2 and 3 scatterers, and of one extended surface"
        variables["order_probability"] = ((*pixel, "order"), np.stack(known), {"units": "1", "long_name": text})
    places = {
        axis: (scatterer, coordinates[..., number], place_attributes(axis, projection))
        for number, axis in enumerate(("x", "y"))
    }
    surfaces = ("surface", np.arange(1, positions.shape[1] + 1), {"long_name": "surface, strongest first"})
    return variables, {"surface": surfaces, **places}


def map_coordinates(positions: F64, projection: Projection | None) -> F64:
    """Coordinates (m) of positions in map (m), both of shape (..., 3).

    They are easting, northing and height in the projection; without one, distances east and north along the sphere
    and the height above it, as in a local map.
    """
    if projection is None:
        return np.stack(sphere_coordinates(positions), axis=-1)
    return projection.coordinates(positions)


def height_attributes(projection: Projection | None) -> dict[str, Any]:
    """Attributes of a height above the sphere of the map, or in a projection."""
    attributes: dict[str, Any] = {"units": "m", "long_name": LAYERS["height"][1]}
    if projection is None:
        attributes["comment"] = "above the sphere of 6371008.8 m that touches the origin of the map"
    elif projection.has_geoid:
        attributes["standard_name"] = "height_above_geopotential_datum"
    else:
        attributes["standard_name"] = "height_above_reference_ellipsoid"
    return attributes


def place_attributes(axis: str, projection: Projection | None) -> dict[str, str]:
    """Attributes of coordinate "x" or "y"."""
    if projection is None:
        return {"units": "m", "long_name": {"x": "distance east", "y": "distance north"}[axis]}
    names = {"x": "easting", "y": "northing"}
    return {"units": "m", "long_name": names[axis], "standard_name": f"projection_{axis}_coordinate"}


def flags(kinds: type[IntEnum]) -> dict[str, Any]:
    """Values of an enumeration and their names, as CF attributes."""
    return {
        "flag_values": np.array([one.value for one in kinds], np.uint8),
        "flag_meanings": " ".join(one.name.lower() for one in kinds),
    }
