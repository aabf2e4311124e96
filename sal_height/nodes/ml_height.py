"""Node ml_height: slc → ml/height, by maximum likelihood over all detectors."""

from __future__ import annotations

from typing import Any

from sal_height.beams import Beams
from sal_height.elevation import (
    OBJECTIVES,
    RECOMMENDED_STRENGTH,
    ElevationEstimate,
    Looks,
    ml_elevation,
    prior_elevation,
    resolve_layover,
)
from sal_height.nodes.height_stage import HeightParameters, HeightStage
from sal_height.nodes.program import run_node
from sal_height.numeric import F64
from sal_height.settings import setting


class Parameters(HeightParameters):
    """Parameters of the node."""

    objective: str = setting(
        "normalised",
        "function that is maximised: normalised (exact) or numerator (as published; biased near the ends of the array)",
        choices=tuple(OBJECTIVES),
    )
    prior_strength: float = setting(
        0.0,
        f"weight of the spatial smoothness prior; 0: none; {RECOMMENDED_STRENGTH:g} is recommended at low CNR; "
        "small features may vanish",
        minimum=0.0,
        maximum=100.0,
    )
    layover: bool = setting(
        default=True, description="whether to search for two scatterers in pixels that a single one does not explain"
    )


class MlHeight(HeightStage):
    """Array maximum-likelihood heights."""

    estimator = "ml"
    parameters = Parameters

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node."""
        super().__init__("ml_height", **node_arguments)

    def estimate(
        self, looks: Looks, beams: Beams, squint: F64, noise_powers: F64, parameters: Parameters
    ) -> ElevationEstimate:
        """Elevation of every pixel."""
        noise_power, strength, min_cnr = float(noise_powers[0]), parameters.prior_strength, parameters.min_cnr
        if strength:
            estimate = prior_elevation(looks, beams, squint, noise_power, strength, min_cnr)
        else:
            objective = OBJECTIVES[parameters.objective]
            estimate = ml_elevation(looks, beams, squint, noise_power, objective, min_cnr)
        return resolve_layover(estimate, looks, beams, squint, noise_power, min_cnr) if parameters.layover else estimate


def main() -> int:
    """Console script."""
    return run_node(MlHeight)


if __name__ == "__main__":
    raise SystemExit(main())
