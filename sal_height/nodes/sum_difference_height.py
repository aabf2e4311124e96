"""Node sum_difference_height: slc of Sigma and Delta → sum_difference/height, by their discriminator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sal_height.beams import Beams
from sal_height.elevation import (
    DISCRIMINANTS,
    INVERSES,
    Discriminator,
    ElevationEstimate,
    Looks,
    read_slope_table,
    sum_difference_elevation,
)
from sal_height.errors import Rejected, UserError
from sal_height.nodes.height_stage import HeightParameters, HeightStage
from sal_height.nodes.program import run_node
from sal_height.numeric import C128, F64
from sal_height.sensor import Channels, sum_difference_channels
from sal_height.settings import setting


class Parameters(HeightParameters):
    """Parameters of the node."""

    discriminant: str = setting(
        "tls",
        "estimator of the ratio Delta / Sigma: tls (exact maximum likelihood), ratio (as published; biased at low CNR) "
        "or noise_subtraction (ratio, with the noise power subtracted from that of Sigma)",
        choices=tuple(DISCRIMINANTS),
    )
    inverse: str = setting(
        "exact",
        "how elevation follows from Delta / Sigma: exact (from the beams) or linear (as published: from the slope in "
        "the equisignal direction)",
        choices=tuple(INVERSES),
    )
    slope_table: str = setting(
        "",
        "path of a CSV file with a measured characteristic, which replaces inverse; its columns are angle_rad (from "
        "the equisignal direction) and gamma; empty: none",
        read_only=True,
    )


class SumDifferenceHeight(HeightStage):
    """Heights by the discriminator of a sensor whose two channels are sum and difference of two beams."""

    estimator = "sum_difference"
    parameters = Parameters

    def __init__(self, **node_arguments: Any) -> None:
        """Make the node; `node_arguments` go to rclpy's Node.

        Raises:
            UserError: the slope table cannot be used.
        """
        super().__init__("sum_difference_height", **node_arguments)
        table = self.current_parameters().slope_table
        self._table = read_slope_table(Path(table)) if table else None

    def channels(self, noise_covariance: C128, channel_matrix: C128) -> Channels:
        """Sigma and Delta with gains that are equal, each with its own noise.

        Raises:
            Rejected: the channels are no sum and difference of two beams, or their noise is correlated.
        """
        try:
            return sum_difference_channels(noise_covariance, channel_matrix)
        except UserError as error:
            raise Rejected("no sum and difference", str(error)) from error

    def estimate(
        self, looks: Looks, beams: Beams, squint: F64, noise_powers: F64, parameters: Parameters
    ) -> ElevationEstimate:
        """Elevation of every pixel."""
        inverse = self._table.invert if self._table else INVERSES[parameters.inverse]
        discriminator = Discriminator(DISCRIMINANTS[parameters.discriminant], inverse)
        powers = float(noise_powers[0]), float(noise_powers[1])
        return sum_difference_elevation(looks, beams, squint, powers, discriminator, parameters.min_cnr)


def main() -> int:
    """Console script."""
    return run_node(SumDifferenceHeight)


if __name__ == "__main__":
    raise SystemExit(main())
