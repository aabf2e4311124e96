"""Double bounce at walls: the echo from the ground to the wall and back, or in the opposite direction.

Level ground and an upright wall are a dihedral corner: whatever the height at which a ray meets the wall, its path is
twice that to the foot of the wall, which is the apparent origin of the echo. A wall of the height h returns a power
that grows with h^2 in a strip of given width, as the radar cross section of a dihedral corner does, which is
8 pi (width x height)^2 / wavelength^2, as long as the ground before it is lit.
"""

from __future__ import annotations

import numpy as np

from sal_height.numeric import F64, Bool


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
