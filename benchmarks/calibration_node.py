"""Node psf_calibration beside the compression of the same dwells."""

from __future__ import annotations

from collections.abc import Iterator

from rclpy.node import Node
from rclpy.parameter import Parameter

from benchmarks.row import Row, medians, sized
from sal_height import messages
from sal_height.messages.types import ComplexImage
from sal_height.nodes.graph import Graph
from sal_height.nodes.message_types import subscribe
from sal_height.nodes.psf_calibration import PsfCalibration
from sal_height.nodes.sar_compression import SarCompression
from sal_height.nodes.stage import FRAMES_QOS
from sal_height.sensor import Sensor
from sal_height.simulation import flight_of, load_preset

DWELLS = sized(640, 10)
"""After which there is a calibration, as the node has it by default: of every tenth."""

TIMEOUT_S = 10.0


def beside_compression() -> Iterator[Row]:
    """A dwell of each radar and lidar through both nodes, all that they compute and publish; one calibration in 640."""
    for name in ("sal_spotlight", "xband_relief"):
        yield from _beside_compression(name)


def _beside_compression(name: str) -> Iterator[Row]:
    flight = flight_of(load_preset(name), seed=1)
    sensor = messages.sensor_from_message(messages.sensor_to_message(flight.sensor, messages.to_stamp(0)))
    sent = messages.history_to_messages(flight.phase_history(0), flight.sensor, 0, messages.to_stamp(0))
    frames = [messages.ReceivedFrame.of(frame) for frame in sent]
    unweighted = [Parameter("range_window", value="rectangular"), Parameter("cols", value=flight.preset.image.cols)]
    with Graph() as graph:
        compression = graph.add(SarCompression(context=graph.context, parameter_overrides=unweighted))
        for state in flight.platform_states(0):
            message = messages.state_to_message(state, messages.to_stamp(state.stamp_ns))
            compression._on_odometry(messages.Pose.of(message))
        images = _images(graph, compression, frames, sensor)
        supplies = compression.supplies(frames, sensor)
        calibration = graph.add(PsfCalibration(context=graph.context))

        def calibrate() -> None:
            for _ in range(DWELLS):
                calibration.process(images, sensor, None)

        one, many = medians(lambda: compression.process(frames, sensor, supplies), calibrate)
    yield Row(
        f"node psf_calibration over sar_compression, {name}",
        many / DWELLS / one,
        "1",
        "<= 0.1",
        f"{1e3 * many / DWELLS:.2f} ms a dwell, with a calibration every {DWELLS}, over {1e3 * one:.1f} ms",
    )


def _images(
    graph: Graph, compression: SarCompression, frames: list[messages.ReceivedFrame], sensor: Sensor
) -> list[ComplexImage]:
    """The images that node sar_compression publishes of a dwell."""
    images: list[ComplexImage] = []
    listener = graph.add(Node("listener", context=graph.context))
    subscribe(listener, ComplexImage, "slc", images.append, FRAMES_QOS)
    if not graph.spin_until(lambda: compression._slc.subscribers > 0, TIMEOUT_S):
        raise TimeoutError("The images found no subscriber.")
    compression.process(frames, sensor, compression.supplies(frames, sensor))
    if not graph.spin_until(lambda: len(images) == sensor.detector_count, TIMEOUT_S):
        raise TimeoutError("The images did not arrive.")
    return sorted(images, key=lambda image: int(image.channel))
