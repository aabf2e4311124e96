"""`sal-height calibrate`: measure receivers and beams on recorded data."""

from __future__ import annotations

from sal_height.commands._options import (
    DONE,
    GRAPH,
    INTERRUPTED,
    PROCESSING,
    Bag,
    GraphOptions,
    Jobs,
    NodeParameters,
    OutputFolder,
    command,
    complain,
    node_parameters,
    output_folder,
)
from sal_height.io import bag_name

EXAMPLES = """
  sal-height calibrate out/sal_spotlight/bag --out out/calibrated
  sal-height replay out/sal_spotlight/bag \\
    --param sar_compression.calibration=out/calibrated/calibration.npz
"""

app = command("calibrate", PROCESSING, EXAMPLES)


@app.default
def calibrate(
    bag: Bag, /, *, jobs: Jobs = 1, graph: GraphOptions = GRAPH, out: OutputFolder = None, param: NodeParameters = ()
) -> int:
    """Measure a sensor's receivers and beams on the scene of a recorded bag.

    The bag is focused without range weighting. From the images of all dwells, the
    command estimates
      receivers    the frequency response of each channel beyond that in
                   sensor_info: relative to the other channels by cross-spectra,
                   on any scene; the common response by point targets
      gains, width the complex gains of the detectors and the width of their
                   beams, by the scene. With two detectors only the phase can be
                   estimated, unless the images have a reflector at a known
                   position (east,north,height in m): --param
                   psf_calibration.target=12.5,-3,1.2

    The output folder holds calibration.npz, calibration.png and report.json. A
    calibration is valid for the sensor_info it was measured with. sar_compression
    applies it; images and heights then carry its id in their provenance. In
    flight, the node psf_calibration measures the same and publishes it on the
    topic calibration; sar_compression uses it if its parameter calibration is
    "topic".

    Args:
        out: Output folder, new or empty. Default: out/calibrate_BAG, or the next free of out/calibrate_BAG_2, ….
    """
    from sal_height.runs.products.calibrate import CALIBRATION, calibration_table
    from sal_height.runs.products.calibrate import calibrate as measure

    folder = output_folder(out, f"calibrate_{bag_name(bag)}")
    outcome, calibration = measure(bag, folder, node_parameters(param), graph.execution(), jobs)
    complain(outcome.losses)
    if calibration is None:
        print(f"interrupted; see {folder}/report.json")
        return INTERRUPTED
    print(calibration_table(calibration))
    print(f"see {folder}/calibration.png; apply it with --param sar_compression.calibration={folder / CALIBRATION}")
    return DONE
