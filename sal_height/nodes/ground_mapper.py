"""Node ground_mapper: estimates the ground from all surfaces of all dwells, with what is hidden and how it is known."""

from __future__ import annotations

from typing import Any

from sal_height.geometry import ApertureState
from sal_height.messages.types import ReliefLayer
from sal_height.nodes.map_stage import MapParameters, MapStage, map_topics
from sal_height.nodes.program import run_node
from sal_height.relief import GroundMap, GroundSettings, HeightField, fine_cell_size, ground_spacings
from sal_height.settings import setting

PREFIX = "ground"
"""Prefix of the topics."""


class Parameters(MapParameters, GroundSettings):
    """Parameters of the node."""

    cell_size_m: float = setting(
        0.0,
        "side of a cell; 0: the greatest of 1, 2 or 5 times a power of ten that is at most 3/4 of a pixel of the first "
        "height image on the ground",
        unit="m",
        minimum=0.0,
        maximum=1e5,
        read_only=True,
    )


class GroundMapper(MapStage):
    """Brings the estimate of the ground up to date with each dwell, and estimates all of it at once at the end."""

    parameters = Parameters
    outputs = map_topics(PREFIX)
    layer = ReliefLayer.GROUND

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: a parameter has a value that is not allowed, or the file could not be written at the end.
        """
        super().__init__("ground_mapper", PREFIX, **node_arguments)
        self._map: GroundMap | None = None

    def entered(self, field: HeightField, aperture: ApertureState) -> GroundMap:
        """Enter all surfaces of all pixels."""
        parameters = self.current_parameters()
        if self._map is None:
            cell_size = parameters.cell_size_m or fine_cell_size(field.grid)
            grown = GroundMap(cell_size, max(ground_spacings(field.grid)), parameters.max_cells, parameters)
        else:
            grown = self._map
        grown.add(field, aperture)
        return grown

    def settle(self) -> None:
        """Estimate all of the ground at once."""
        if self._map is not None:
            self._map.settle()


def main() -> int:
    """Console script; status 1 if the map could not be written."""
    return run_node(GroundMapper)


if __name__ == "__main__":
    raise SystemExit(main())
