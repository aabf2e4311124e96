"""A target that an aircraft flies past: what files of CPHD and CRSD about it share."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pyproj import Transformer
from scipy.constants import speed_of_light

LATITUDE, LONGITUDE, HEIGHT = 48.1, 11.3, 560.0
"""Of the image area reference point, degrees and m above the ellipsoid."""

CARRIER = 9.6e9
RANGE, ELEVATION, SPEED = 10_000.0, math.radians(50), 100.0
TARGET = np.array([30.0, -20.0, 0.0])
"""East, north and up of the image area reference point, m."""

BEGIN_S = 1.0
"""Time of the pulse in the middle, s."""


def to_space(positions: np.ndarray) -> np.ndarray:
    """Earth-centred, earth-fixed coordinates of positions in the map, by PROJ."""
    back = Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lat_0={LATITUDE} +lon_0={LONGITUDE} +h_0={HEIGHT}"
    )
    return np.stack(back.transform(*np.moveaxis(positions, -1, 0)), axis=-1)


def to_space_direction(direction: np.ndarray) -> np.ndarray:
    """The same of a direction."""
    return to_space(direction) - to_space(np.zeros(3))


def aircraft_at(seconds: np.ndarray) -> np.ndarray:
    """Positions in space: it flies east, south of the scene."""
    begin = np.array([0.0, -RANGE * math.sin(ELEVATION), RANGE * math.cos(ELEVATION)])
    return to_space(begin + (seconds - BEGIN_S)[:, None] * np.array([SPEED, 0.0, 0.0]))


def velocity() -> np.ndarray:
    """Velocity in space, m/s."""
    return to_space_direction(np.array([SPEED, 0.0, 0.0]))


def echo_delay(sent: np.ndarray, target: np.ndarray = TARGET) -> np.ndarray:
    """Time (s) after which the echo of a target comes back to the aircraft, which moves on meanwhile."""
    place = to_space(target)
    outward = np.linalg.norm(aircraft_at(sent) - place, axis=-1)
    delay = 2 * outward / speed_of_light
    for _ in range(3):
        delay = (outward + np.linalg.norm(aircraft_at(sent + delay) - place, axis=-1)) / speed_of_light
    return delay


def scene_coordinates(side_m: float) -> dict[str, Any]:
    """The element SceneCoordinates of a square in the tangential plane, whose axes point south and east."""
    to_place = Transformer.from_pipeline("+proj=pipeline +step +inv +proj=cart +ellps=WGS84")
    area = image_area(side_m)
    corners = [to_place.transform(*to_space(np.array([east, -south, 0.0]))) for south, east in area["Polygon"]]
    return {
        "EarthModel": "WGS_84",
        "IARP": {"ECF": to_space(np.zeros(3)), "LLH": [LATITUDE, LONGITUDE, HEIGHT]},
        "ReferenceSurface": {
            "Planar": {
                "uIAX": to_space_direction(np.array([0.0, -1.0, 0.0])),
                "uIAY": to_space_direction(np.array([1.0, 0.0, 0.0])),
            }
        },
        "ImageArea": area,
        "ImageAreaCornerPoints": [(latitude, longitude) for longitude, latitude, _ in corners],
        "ImageGrid": {
            "IARPLocation": [side_m / 2 - 0.5, side_m / 2 - 0.5],
            "IAXExtent": {"LineSpacing": 1.0, "FirstLine": 0, "NumLines": round(side_m)},
            "IAYExtent": {"SampleSpacing": 1.0, "FirstSample": 0, "NumSamples": round(side_m)},
        },
    }


def image_area(side_m: float) -> dict[str, Any]:
    """A square around the reference point."""
    half = side_m / 2
    return {
        "X1Y1": [-half, -half],
        "X2Y2": [half, half],
        "Polygon": [(-half, -half), (-half, half), (half, half), (half, -half)],
    }
