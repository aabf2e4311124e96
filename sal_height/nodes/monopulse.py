"""Node monopulse: slc → monopulse/height, from the strongest pair of detectors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sal_height.estimate import ElevationEstimate
from sal_height.looks import Looks
from sal_height.monopulse import DISCRIMINANTS, monopulse_elevation
from sal_height.nodes.height_stage import HeightStage
from sal_height.nodes.parameters import parameter
from sal_height.nodes.stage import run_node
from sal_height.sensor import Beams


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    range_looks: int = parameter(2, "pixels averaged in range", minimum=1, maximum=4096)
    azimuth_looks: int = parameter(2, "pixels averaged in azimuth", minimum=1, maximum=4096)
    discriminant: str = parameter(
        "tls",
        "estimate of Delta / Sigma: tls (total least squares) or ratio (as published; biased at low CNR)",
        choices=tuple(DISCRIMINANTS),
    )
    min_cnr_db: float = parameter(5.0, "least CNR of a valid pixel, dB", minimum=-60.0, maximum=100.0)
    timeout_s: float = parameter(5.0, "wait for missing detectors, s", minimum=0.01, maximum=3600.0, read_only=True)


class Monopulse(HeightStage):
    """Pairwise sum-difference heights."""

    estimator = "monopulse"
    parameters = Parameters

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node."""
        super().__init__("monopulse", **node_arguments)

    def estimate(
        self, looks: Looks, beams: Beams, squint: npt.NDArray[np.float64], noise_power: float, parameters: Parameters
    ) -> ElevationEstimate:
        """Elevation of every pixel."""
        min_cnr = 10 ** (parameters.min_cnr_db / 10)
        return monopulse_elevation(looks, beams, squint, noise_power, DISCRIMINANTS[parameters.discriminant], min_cnr)


def main() -> int:
    """Console script."""
    return run_node(Monopulse)


if __name__ == "__main__":
    raise SystemExit(main())
