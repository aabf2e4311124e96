"""Node relief_mapper: averages the heights of all dwells in one map, published and written as GeoTIFF at the end."""

from __future__ import annotations

from typing import Any

from sal_height.geometry import ApertureState
from sal_height.messages.types import ReliefLayer
from sal_height.nodes.map_stage import MapParameters, MapStage, map_topics
from sal_height.nodes.program import run_node
from sal_height.relief import HeightField
from sal_height.relief import map as relief_map
from sal_height.settings import setting

PREFIX = "map"
"""Prefix of the topics."""


class Parameters(MapParameters):
    """Parameters of the node."""

    cell_size_m: float = setting(
        0.0,
        "side of a cell of the map; 0: the smallest of 1, 2 or 5 times a power of ten that holds a pixel of the first "
        "height image",
        unit="m",
        minimum=0.0,
        maximum=1e5,
        read_only=True,
    )


class ReliefMapper(MapStage):
    """Averages the heights of all dwells in the cells of one map."""

    parameters = Parameters
    outputs = map_topics(PREFIX)
    layer = ReliefLayer.MEAN

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed, or the file could not be written at the end.
        """
        super().__init__("relief_mapper", PREFIX, **node_arguments)
        self._map: relief_map.ReliefMap | None = None

    def entered(self, field: HeightField, aperture: ApertureState) -> relief_map.ReliefMap:
        """Enter the scatterers of each pixel; the cells of the map hold a pixel of the first height image."""
        if self._map is None:
            cell_size = self._settings.cell_size_m or relief_map.fitting_cell_size(field.grid, aperture)
            grown = relief_map.ReliefMap(cell_size, self._settings.max_cells)
        else:
            grown = self._map
        grown.add(field)
        return grown


def main() -> int:
    """Console script; status 1 if the map could not be written."""
    return run_node(ReliefMapper)


if __name__ == "__main__":
    raise SystemExit(main())
