"""Node psf_calibration beside the compression of the same dwells."""

from __future__ import annotations

from collections.abc import Iterator

from rclpy.parameter import Parameter

from benchmarks.row import Row, medians, sized
from benchmarks.stage_jobs import job_of, read_items
from sal_height import messages
from sal_height.engine.results import Product
from sal_height.engine.stage import Job
from sal_height.messages import serialize
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.simulation import flight_of, load_preset

DWELLS = sized(640, 10)
"""After which there is a calibration, as the node has it by default: of every tenth."""


def beside_compression() -> Iterator[Row]:
    """A dwell of each radar and lidar through both nodes, all that they compute and publish; one calibration in 640."""
    for name in ("sal_spotlight", "xband_relief"):
        yield from _beside_compression(name)


def _beside_compression(name: str) -> Iterator[Row]:
    flight = flight_of(load_preset(name), seed=1)
    stamp = messages.to_stamp(0)
    described = serialize(messages.sensor_to_message(flight.sensor, stamp))
    frames = messages.history_to_messages(flight.phase_history(0), flight.sensor, 0, stamp)
    states = flight.platform_states(0)
    flown = [serialize(messages.state_to_message(state, messages.to_stamp(state.stamp_ns))) for state in states]
    unweighted = [Parameter("range_window", value="rectangular"), Parameter("cols", value=flight.preset.image.cols)]
    with Graph() as graph:
        compression = graph.add(PROCESSING["sar_compression"](context=graph.context, parameter_overrides=unweighted))
        calibration = graph.add(PROCESSING["psf_calibration"](context=graph.context))
        job = job_of(
            compression,
            [
                ("sensor_info", described),
                *(("platform/odometry", cdr) for cdr in flown),
                *(("phase_history", serialize(frame)) for frame in frames),
            ],
        )
        (images,) = [one.item for one in compression._results_of(job) if isinstance(one, Product)]
        for item in read_items(calibration, "sensor_info", [described]):
            calibration.stage.accept("sensor_info", item)
        (measured,) = [one for one in calibration.stage.accept("slc", images) if isinstance(one, Job)]

        def calibrate() -> None:
            for _ in range(DWELLS):
                calibration._process_job(measured)

        one, many = medians(lambda: compression._process_job(job), calibrate)
    yield Row(
        f"node psf_calibration over sar_compression, {name}",
        many / DWELLS / one,
        "1",
        "<= 0.1",
        f"{1e3 * many / DWELLS:.2f} ms a dwell, with a calibration every {DWELLS}, over {1e3 * one:.1f} ms",
    )
