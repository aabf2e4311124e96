"""Double bounce at walls: the echo that goes from the ground to the wall and back, or the other way.

Level ground and an upright wall are a dihedral corner: whatever the height at which a ray meets the wall, its path is
twice that to the foot of the wall, where the echo seems to come from. A wall of the height h sends back a power that
grows with h^2 in a strip of given width, as the radar cross section of a dihedral corner does, which is
8 pi (width x height)^2 / wavelength^2, as long as the ground before it is lit.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64, Bool

STEEPEST_SLOPE = 2.0
"""Rise over run from which a slope is a wall: 63 degrees."""


def find_walls(north: F64, height: F64, elevation: F64) -> tuple[Bool, F64]:
    """Where cuts through the terrain have the foot of a wall that faces the sensor and is lit, and the wall's height.

    Args:
        north: of the nodes, m, going outwards from the sensor, shape (nodes,).
        height: of the nodes in each cut, m, shape (cuts, nodes).
        elevation: of the nodes, rad from nadir, as the sensor sees them, shape (cuts, nodes).

    Returns:
        Both of shape (cuts, nodes); heights are in m, and 0 where there is no foot.
    """
    steep = np.diff(height, axis=1) > STEEPEST_SLOPE * np.abs(np.diff(north))
    no_wall = np.zeros((len(height), 1), dtype=bool)
    begins = np.concatenate([steep & ~np.concatenate([no_wall, steep[:, :-1]], axis=1), no_wall], axis=1)
    # The top of the wall that a node stands in: the next node at which no steep piece begins.
    nodes = np.arange(height.shape[1])
    ends = np.where(np.concatenate([steep, no_wall], axis=1), nodes[-1], nodes)
    top = np.minimum.accumulate(ends[:, ::-1], axis=1)[:, ::-1]
    rise = np.take_along_axis(height, top, axis=1) - height
    hidden_by = np.maximum.accumulate(np.nan_to_num(elevation, nan=-np.pi), axis=1)
    feet = begins & (elevation >= hidden_by)
    return feet, np.where(feet, rise, 0.0)
