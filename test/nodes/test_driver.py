"""The driver in C of examples/driver, compiled and run, feeds the nodes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from sal_height.engine.track import ACCURACY
from sal_height.messages.types import HeightImage
from sal_height.nodes.processing import PROCESSING
from sal_height.nodes.transport.graph import Graph
from sal_height.nodes.transport.message_types import subscribe
from sal_height.nodes.transport.qos import FRAMES_QOS

FOLDER = Path(__file__).parents[2] / "examples" / "driver"
TIMEOUT_S = 120.0
DWELLS = 3


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program, compiled against the environment that the tests run in."""
    if missing := [tool for tool in ("make", "cc", "nm") if shutil.which(tool) is None]:
        pytest.skip(f"{missing[0]} is not installed: the driver cannot be compiled")
    if not Path(sys.prefix, "include", "sal_height_msgs").is_dir():
        pytest.skip("sal_height_msgs is not installed in the prefix of this Python: its headers are missing")
    out = tmp_path_factory.mktemp("driver")
    command = ["make", "-C", FOLDER, f"PREFIXES={sys.prefix}", f"OUT={out}", "CFLAGS=-Werror"]
    made = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 (our own file)
    assert made.returncode == 0, made.stderr
    return out / "driver"


@pytest.mark.parametrize("height", [0.0, 0.7])
def test_heights_of_the_driver_in_c_are_those_of_its_posts(
    driver: Path, height: float, domain_id: int, graph: Graph
) -> None:
    stated = [Parameter("air", value="none"), *(Parameter(name, value=0.0) for name in ACCURACY)]
    compression = graph.add(PROCESSING["sar_compression"](context=graph.context, parameter_overrides=stated))
    graph.add(PROCESSING["ml_height"](context=graph.context))
    images: list[HeightImage] = []
    subscribe(graph.add(Node("listener", context=graph.context)), HeightImage, "ml/height", images.append, FRAMES_QOS)
    environment = {name: value for name, value in os.environ.items() if name != "LD_LIBRARY_PATH"}
    process = subprocess.Popen(  # noqa: S603 (our own program)
        [driver, str(height)], env=environment | {"ROS_DOMAIN_ID": str(domain_id)}
    )
    try:
        came = graph.spin_until(lambda: len(images) >= DWELLS, TIMEOUT_S)
        assert came, (compression.tally.summary(), compression.last_rejection)
    finally:
        process.terminate()
        status = process.wait(TIMEOUT_S)
    assert status == 0
    assert not compression.source_warning
    for image in images:
        surface = image.surfaces[0]
        post = int(np.nanargmax(surface.cnr_db))
        assert image.validity[post] == HeightImage.OK
        assert surface.sigma[post] < 0.02
        assert abs(surface.height[post] - height) < 3 * surface.sigma[post]
        assert np.isin(np.delete(image.validity, post), [HeightImage.OK, HeightImage.NO_SIGNAL]).all()
