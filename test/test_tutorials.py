"""The pages of docs/ that begin a subject run as they stand, and print what they show."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown_target import TARGET
from helpers import few
from tutorial_helpers import DOCS, assert_printed, blocks_of, run_page
from written_cphd import write_cphd

from sal_height.bag.reader import BagReader
from sal_height.elevation import Looks, MlSettings, ml_elevation
from sal_height.geometry import ApertureState, angles_of, height_of, locate_at_elevation, locate_at_height
from sal_height.imaging import image_beams
from sal_height.runs.replay.bag_replay import replay
from sal_height.simulation import load_preset

TUTORIALS = DOCS / "tutorials"
TIMEOUT_S = 600.0


@pytest.fixture(autouse=True)
def fresh_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pages run in a folder in which there is nothing."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("blank_pictures")
@pytest.mark.parametrize("page", few(2, ["first_steps", "read_a_report", "calibrate", "replay_and_compare"]))
def test_a_page_prints_what_it_shows(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    run_page(TUTORIALS / f"{page}.md", capsys)


def test_heights_of_an_own_sensor_are_those_of_its_targets(capsys: pytest.CaptureFixture[str]) -> None:
    """Each bright pixel is within three sigmas of a target in height, and within its own size on the ground."""
    names = run_page(TUTORIALS / "own_sensor.md", capsys)
    seen = set()
    for pixel in names["found"]:
        away = np.linalg.norm(names["targets"][:, :2] - [pixel.x.item(), pixel.y.item()], axis=-1)
        nearest = int(np.argmin(away))
        assert away[nearest] < 2.0
        assert abs(pixel.height.item() - names["targets"][nearest, 2]) < 3 * pixel.sigma.item() < 1.5
        seen.add(nearest)
    assert seen == {0, 1}


def test_heights_of_arrays_keep_their_sigma_and_reach_the_bound(capsys: pytest.CaptureFixture[str]) -> None:
    """The standard error of a root mean square of 1023 errors is 2.2 %, of a share within one sigma 1.5 %."""
    names = run_page(TUTORIALS / "heights_from_arrays.md", capsys)
    error, sigma, good = names["error"], names["sigma"], names["good"]
    assert good.sum() > 1000
    assert abs(np.mean(np.abs(error) < sigma) - 0.683) < 0.05
    assert 0.95 < error.std() / names["bound"].mean() < 1.15
    assert abs(names["off"].mean()) < 3 * names["off"].std() / np.sqrt(good.sum())


@pytest.mark.filterwarnings("ignore:(open|read)_text is:DeprecationWarning")  # of sarkit, which opens its types so
def test_an_image_of_a_file_of_others_shows_its_target(fresh_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_cphd(fresh_folder / "spotlight.cphd")
    names = run_page(TUTORIALS / "import_cphd.md", capsys)
    np.testing.assert_allclose(names["image"]["brightest_east_north_up_m"][:2], TARGET[:2], rtol=0, atol=0.05)


def test_a_node_of_ones_own_feeds_the_nodes(domain_id: int, fresh_folder: Path) -> None:
    """Its two programs are those of two terminals; the first one ends by Ctrl-C."""
    page = blocks_of(TUTORIALS / "feed_live.md")
    for block in page:
        if block.file:
            Path(block.file).write_text(block.content, encoding="utf-8")
    (nodes, _), (sensor, _) = [one for block in page if not block.language for one in block.commands]
    (shown,) = [block.content for block in page if block.language == "text"]
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain_id)}
    programs, said = Path(sys.executable).parent, fresh_folder / "nodes.log"
    with said.open("w") as log:
        command = [programs / nodes[0], *nodes[1:]]
        graph = subprocess.Popen(command, env=environment, stdout=log, stderr=log)  # noqa: S603 (our own document)
    try:
        command = [programs / sensor[0], *sensor[1:]]
        made = subprocess.run(  # noqa: S603 (our own document)
            command, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
    finally:
        graph.send_signal(signal.SIGINT)
        status = graph.wait(TIMEOUT_S)
    assert made.returncode == 0, made.stderr + said.read_text()
    assert status == 0, said.read_text()
    assert_printed(shown, made.stdout)
    for line in made.stdout.splitlines():
        height, sigma = map(float, re.findall(r"[-\d.]+", line))
        assert abs(height - 0.7) < 3 * sigma < 0.05


@pytest.mark.usefixtures("blank_pictures")
def test_the_error_budget_adds_up_and_its_sensitivities_are_slopes(capsys: pytest.CaptureFixture[str]) -> None:
    """Slopes of heights by differences, and the shift of the likelihood's peak by a gain that is wrong."""
    names = run_page(DOCS / "error_budget.md", capsys)
    good = names["good"]
    np.testing.assert_allclose(names["together"][good], names["field"].first.sigma[good], rtol=1e-6)
    heading, *rows = names["lines"]
    for name, *numbers in rows:
        elevation, by_range, _, gain, _ = map(float, numbers)
        assert measured_sensitivities(name) == pytest.approx((elevation, by_range, gain), rel=0.05), heading


def measured_sensitivities(name: str) -> tuple[float, float, float]:
    """Height of a preset (m) by a microradian, by a metre of range, and by 0.1 dB in the detector that matters most."""
    preset = load_preset(name)
    sensor, track = preset.make_sensor(), preset.flight
    position = track.slant_range_m * np.array([0.0, 0.0, np.cos(track.look_angle_rad)])
    aperture = ApertureState(position, np.array([track.speed_mps, 0.0, 0.0]), np.eye(3), 1.0, np.zeros((6, 6)))
    place = locate_at_height(0.0, track.slant_range_m, 0.0, aperture, sensor.look_side)
    slant_range, elevation, _ = angles_of(place, aperture, sensor.look_side)

    def height(turned: float = 0.0, longer: float = 0.0) -> float:
        found = locate_at_elevation(elevation + turned, slant_range + longer, 0.0, aperture, sensor.look_side)
        return float(height_of(found))

    beams, middle = image_beams(sensor, "taylor"), float(np.mean(sensor.beams.span))
    response = beams.response(middle, 0.0)
    gained = response * (1 + (10 ** (0.1 / 20) - 1) * np.eye(beams.count))
    looks = Looks.of(1e6 * gained[:, None, :, None] * gained[:, None, None, :], count=1)
    shift = ml_elevation(looks, beams, MlSettings(layover=False)).elevation - middle
    by_elevation = (height(turned=1e-6) - height(turned=-1e-6)) / 2
    by_range = (height(longer=1.0) - height(longer=-1.0)) / 2
    return abs(by_elevation), by_range, abs(by_elevation) * 1e6 * float(np.max(np.abs(shift)))


def python_of(document: str) -> str:
    """The only block of Python in a document."""
    (python,) = [block.content for block in blocks_of(DOCS / document) if block.language == "python"]
    return python


def test_your_own_sensor_becomes_a_bag_that_can_be_replayed(fresh_folder: Path) -> None:
    """What is in the arrays is noise, of which images can be made."""
    (description,) = [block for block in blocks_of(DOCS / "import.md") if block.file == "radar.yaml"]
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((2, 500, 300)) + 1j * rng.standard_normal((2, 500, 300))
    np.save("samples.npy", noise.astype(np.complex64))
    Path(description.file).write_text(description.content, encoding="utf-8")
    exec(compile(python_of("import.md"), "import.md", "exec"), {})  # noqa: S102 (our own document)
    assert BagReader(fresh_folder / "out" / "flight").topics["/phase_history"].count == 2
    values = {"sar_compression": {"rows": 64, "cols": 32}}
    outcome = replay(fresh_folder / "out" / "flight", fresh_folder / "again", values, estimators=["ml"]).outcome
    assert outcome.stages["sar_compression"].processed == 2, outcome.losses


@pytest.mark.thorough
@pytest.mark.parametrize("page", ["README.md", "docs/movers.md"])
def test_the_commands_of_a_page_run_and_print_what_it_shows(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    run_page(DOCS.parent / page, capsys)


def test_heights_are_an_xarray_dataset(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(DOCS.parent)
    exec(compile(python_of("export.md"), "export.md", "exec"), {})  # noqa: S102 (our own document)
    assert 0 < float(capsys.readouterr().out) < 2, "m, of the street"


def test_every_tutorial_is_run() -> None:
    tested = Path(__file__).read_text(encoding="utf-8")
    assert [page.name for page in TUTORIALS.glob("*.md") if f'"{page.stem}' not in tested] == []


@pytest.mark.parametrize(
    ("printed", "alike"),
    [
        ("ml 3 0.0127 m, then more", True),
        ("before\nml 3 0.0125 m, then\nafter", True),
        ("ml 3 0.0140 m, then", False),
        ("capon 3 0.0127 m, then", False),
        ("ml 3 0.0127 m", False),
        ("", False),
    ],
)
def test_what_a_page_shows_must_have_been_printed(printed: str, alike: bool) -> None:
    outcome: Any = None
    try:
        assert_printed("ml 3 0.0127 m, …\n", printed)
    except AssertionError as error:
        outcome = error
    assert (outcome is None) == alike
