"""The core alone makes the heights that the graph has recorded."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.elevation import ESTIMATORS
from sal_height.geometry import EXACT, Trajectory
from sal_height.imaging import ImageSettings
from sal_height.pipeline import Compressor, heights
from sal_height.runs.chain.recorded_parameters import recorded_parameters
from sal_height.runs.truth.simulate import fly
from sal_height.simulation.preset import BlankedRange, Preset


def test_the_core_makes_the_heights_of_the_graph(recorded: Path) -> None:
    """Value for value, but for the single precision of messages and the rounding of the earth's radius, 1e-9 m."""
    assert compared_heights(recorded / "bag") > 100


def test_the_core_makes_the_heights_of_the_graph_of_blanked_channels(two_dwells: Preset, tmp_path: Path) -> None:
    """Half of the rows have three channels less, and so larger sigmas."""
    ranges = tuple(BlankedRange(channel, 4990.0, 5000.0) for channel in (1, 4, 6))
    preset = replace(two_dwells, dwells=1, sensor=replace(two_dwells.sensor, blanked_ranges=ranges))
    fly(preset, 3, tmp_path / "run", {})
    assert compared_heights(tmp_path / "run" / "bag") > 50


def compared_heights(bag: Path) -> int:
    """Number of heights of a bag that are, and have to be, those that the core makes of its phase history."""
    reader = BagReader(bag)
    found = defaultdict(list)
    for message in reader.messages([topic for topic in reader.topics if topic != "/diagnostics"]):
        found[message.topic].append(reader.decode(message.type_name, message.cdr))
    sensor = messages.sensor_from_message(found["/sensor_info"][0])
    track = Trajectory(
        [messages.state_from_message(message) for message in found["/platform/odometry"]], accuracy=EXACT
    )
    size = recorded_parameters(reader)["sar_compression"]
    settings = ImageSettings(air="none", rows=size["rows"], cols=size["cols"])
    compressor, compared = Compressor(), 0
    for dwell in sorted({frame.dwell for frame in found["/phase_history"]}):
        frames = sorted((f for f in found["/phase_history"] if f.dwell == dwell), key=lambda frame: frame.channel)
        slc = compressor.add(messages.history_from_messages(frames), track, sensor, settings)
        assert slc
        for name in ("ml", "monopulse"):
            (image,) = [message for message in found[f"/{name}/height"] if message.dwell == dwell]
            estimator = ESTIMATORS[name]
            looks = {"range_looks": image.range_looks, "azimuth_looks": image.azimuth_looks}
            field = heights(slc, sensor, estimator, estimator.settings(**looks))
            height = messages.float_view(image.surfaces[0].height, field.grid.shape)
            np.testing.assert_array_equal(field.validity.ravel(), np.array(image.validity))
            np.testing.assert_allclose(field.first.height, height, rtol=1e-7, atol=1e-9)
            compared += int(np.isfinite(height).sum())
    return compared
