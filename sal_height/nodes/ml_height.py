"""Node ml_height: slc → ml/height, by maximum likelihood over all detectors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.array_ml import OBJECTIVES, ml_elevation
from sal_height.beams import Beams
from sal_height.estimate import ElevationEstimate
from sal_height.looks import Looks
from sal_height.nodes.height_stage import HeightParameters, HeightStage
from sal_height.nodes.parameters import parameter
from sal_height.nodes.program import run_node


@dataclass(frozen=True)
class Parameters(HeightParameters):
    """Parameters of the node."""

    objective: str = parameter(
        "normalised",
        "what is maximised: normalised (exact) or numerator (as published; biased near the array's ends)",
        choices=tuple(OBJECTIVES),
    )


class MlHeight(HeightStage):
    """Array maximum-likelihood heights."""

    estimator = "ml"
    parameters = Parameters

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node."""
        super().__init__("ml_height", **node_arguments)

    def estimate(
        self, looks: Looks, beams: Beams, squint: npt.NDArray[np.float64], noise_power: float, parameters: Parameters
    ) -> ElevationEstimate:
        """Elevation of every pixel."""
        return ml_elevation(looks, beams, squint, noise_power, OBJECTIVES[parameters.objective], parameters.min_cnr)


def main() -> int:
    """Console script."""
    return run_node(MlHeight)


if __name__ == "__main__":
    raise SystemExit(main())
