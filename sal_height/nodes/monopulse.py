"""Node monopulse: slc → monopulse/height, from the strongest pair of detectors."""

from __future__ import annotations

from typing import Any

from sal_height.beams import Beams
from sal_height.elevation import DISCRIMINANTS, ElevationEstimate, Looks, monopulse_elevation
from sal_height.errors import Rejected
from sal_height.nodes.height_stage import HeightParameters, HeightStage
from sal_height.nodes.program import run_node
from sal_height.numeric import F64
from sal_height.settings import setting


class Parameters(HeightParameters):
    """Parameters of the node."""

    discriminant: str = setting(
        "tls",
        "estimator of the ratio Delta / Sigma: tls (total least squares), ratio (as published; biased at low CNR) or "
        "noise_subtraction (ratio, with the noise power subtracted from that of Sigma)",
        choices=tuple(DISCRIMINANTS),
    )


class Monopulse(HeightStage):
    """Pairwise sum-difference heights."""

    estimator = "monopulse"
    parameters = Parameters

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node."""
        super().__init__("monopulse", **node_arguments)

    def estimate(
        self, looks: Looks, beams: Beams, squint: F64, noise_powers: F64, parameters: Parameters
    ) -> ElevationEstimate:
        """Elevation of every pixel.

        Raises:
            Rejected: the channels are mixtures from which the detectors cannot be had with noise that is independent.
        """
        if beams.matrix is not None:
            raise Rejected(
                "mixed channels",
                "The channel matrix of SensorInfo is no lossless hybrid, so that the detectors' noise is dependent: "
                "they make no pairs; use ml_height, or sum_difference_height for a sum and a difference.",
            )
        discriminant, min_cnr = DISCRIMINANTS[parameters.discriminant], parameters.min_cnr
        return monopulse_elevation(looks, beams, squint, float(noise_powers[0]), discriminant, min_cnr)


def main() -> int:
    """Console script."""
    return run_node(Monopulse)


if __name__ == "__main__":
    raise SystemExit(main())
