"""The command irf: the same numbers from arrays and bags, a picture, and refusals in one sentence."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blank_pictures import blank_pictures
from helpers import assert_one_sentence, make_aperture, make_sensor
from matplotlib.image import imread

from sal_height import messages
from sal_height.bag.writer import BagWriter
from sal_height.commands import main
from sal_height.geometry.grid import Grid
from sal_height.imaging.focus import Slc
from sal_height.messages import serialize
from sal_height.messages.types import ChannelFrame, Provenance
from sal_height.runs.responses import irf as irf_module

REFERENCE = Path(__file__).parents[3] / "bags" / "version_3"

ROWS, COLS = 60, 80
CELLS = (1.6, 2.2)
"""Resolution in range and azimuth, pixels."""

HALF_POWER = 0.88589
"""Width of a sinc at -3 dB, resolution cells."""

GRID = Grid(
    np.array([3.0, -3500.0, 1.0]), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.05, 0.02, ROWS, COLS
)

PLACES = [(28.3, 41.6), (31.0, 38.2), (29.5, 40.0)]
"""Row and column of a point, one for each detector."""


def point_image(place: tuple[float, float]) -> np.ndarray:
    """A point's image, complex64, with a background 80 dB below."""
    down, across = ((np.arange(n) - p) / cell for n, p, cell in zip((ROWS, COLS), place, CELLS, strict=True))
    return (np.outer(np.sinc(down), np.sinc(across)) + 1e-4).astype(np.complex64)


def write_bag(path: Path, dwells: int = 2, info: bool = True, **changes: Any) -> Path:
    """A bag with the images of PLACES in each dwell, with the phase of range; `changes` are made to each message."""
    sensor, aperture = make_sensor(), make_aperture()
    distance = np.linalg.norm(GRID.pixels() - aperture.position, axis=-1)
    slc = np.array([point_image(place) for place in PLACES]) * np.exp(4j * np.pi / sensor.wavelength * distance)
    stamp = messages.to_stamp(0)
    with BagWriter(path) as bag:
        bag.add_topic("/sensor_info", "sal_height_msgs/msg/SensorInfo")
        bag.add_topic("/slc", "sal_height_msgs/msg/ComplexImage")
        if info:
            bag.write("/sensor_info", serialize(messages.sensor_to_message(sensor, stamp)), 0, 0)
        for dwell in range(dwells):
            frame, provenance = ChannelFrame(dwell=dwell), Provenance(config_hash=sensor.config_hash)
            image = Slc(slc, GRID, aperture, np.zeros(3), np.zeros(3))
            for message in messages.slc_to_messages(image, frame, provenance):
                for name, value in changes.items():
                    setattr(message, name, value)
                bag.write("/slc", serialize(message), dwell + 1, dwell + 1)
    return path


def measured(out: Path) -> list[dict[str, Any]]:
    return json.loads((out / "irf.json").read_text())


def check_point(entry: dict[str, Any], place: tuple[float, float], azimuth_axis: int = 1) -> None:
    """Compare with what is known of a point."""
    assert (entry["row"], entry["col"]) == pytest.approx(place, abs=1 / 128)
    kinds = ["range", "azimuth"] if azimuth_axis == 1 else ["azimuth", "range"]
    for kind, cell in zip(kinds, CELLS, strict=True):
        assert entry[kind]["width_px"] == pytest.approx(cell * HALF_POWER, rel=0.003)
        assert entry[kind]["pslr_db"] == pytest.approx(-13.26, abs=0.05)
        assert entry[kind]["islr_db"] == pytest.approx(-10.2, abs=0.1)


def check_picture(path: Path, rows: int) -> None:
    """The picture has as many rows, and something to see in each panel."""
    picture = imread(path)[..., :3]
    assert picture.shape[0] == pytest.approx(220 * (2.0 * rows + 0.6), abs=2)
    for row in np.array_split(picture[50:-50], rows):
        for panel in np.array_split(row, 3, axis=1):
            assert panel.std() > 0.05


@pytest.mark.parametrize("azimuth_axis", [0, 1])
def test_array_of_one_image(azimuth_axis: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "point.npy", point_image(PLACES[0]))
    words = ["irf", str(tmp_path / "point.npy"), "--out", str(tmp_path / "out")]
    assert main([*words, *(["--azimuth-axis", "0"] if azimuth_axis == 0 else [])]) == 0
    (entry,) = measured(tmp_path / "out")
    check_point(entry, PLACES[0], azimuth_axis)
    assert entry["image"] == str(tmp_path / "point.npy")
    assert [entry[key] for key in ("topic", "dwell", "channel", "position_m")] == [None] * 4
    assert entry["range"]["width_m"] is None
    assert entry["peak_over_median_db"] > 50
    check_picture(tmp_path / "out" / "irf.png", 1)
    said = capsys.readouterr().out
    shown = next(line for line in said.splitlines() if "point.npy" in line).split()
    assert float(shown[1]) == pytest.approx(entry["row"], abs=6e-4)
    assert float(shown[3]) == pytest.approx(entry["range"]["width_px"], abs=6e-4)
    assert shown[4] == "-"
    assert "narrower than a pixel" not in said


@pytest.mark.usefixtures("blank_pictures")
def test_npz_with_one_complex_array_beside_others(tmp_path: Path) -> None:
    np.savez(tmp_path / "point.npz", image=point_image(PLACES[1]), spacing=np.array([0.05, 0.02]))
    assert main(["irf", str(tmp_path / "point.npz"), "--out", str(tmp_path / "out")]) == 0
    check_point(measured(tmp_path / "out")[0], PLACES[1])


def test_array_of_several_detectors(tmp_path: Path) -> None:
    np.save(tmp_path / "points.npy", np.array([point_image(place) for place in PLACES]))
    assert main(["irf", str(tmp_path / "points.npy"), "--out", str(tmp_path / "all")]) == 0
    entries = measured(tmp_path / "all")
    assert [entry["channel"] for entry in entries] == [0, 1, 2]
    for entry, place in zip(entries, PLACES, strict=True):
        check_point(entry, place)
    check_picture(tmp_path / "all" / "irf.png", 3)
    with blank_pictures():
        assert main(["irf", str(tmp_path / "points.npy"), "--channel", "1", "--out", str(tmp_path / "one")]) == 0
    assert measured(tmp_path / "one") == entries[1:2]


@pytest.mark.usefixtures("blank_pictures")
def test_bag_gives_positions_and_widths_in_metres(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    assert main(["irf", str(bag), "--out", str(tmp_path / "all")]) == 0
    entries = measured(tmp_path / "all")
    assert [(e["topic"], e["dwell"], e["channel"]) for e in entries] == [
        ("/slc", d, m) for d in (0, 1) for m in range(3)
    ]
    for entry, place in zip(entries, PLACES * 2, strict=True):
        check_point(entry, place)
        np.testing.assert_allclose(entry["position_m"], GRID.points(*place), atol=1e-3)
        assert entry["range"]["width_m"] == pytest.approx(CELLS[0] * HALF_POWER * GRID.row_spacing, rel=0.003)
        assert entry["azimuth"]["width_m"] == pytest.approx(CELLS[1] * HALF_POWER * GRID.col_spacing, rel=0.003)
    (file,) = bag.glob("*.mcap")
    words = ["irf", str(file), "--dwell", "1", "--channel", "2", "--out", str(tmp_path / "one")]
    assert main(words) == 0
    assert measured(tmp_path / "one") == [{**entries[5], "image": str(file)}]


@pytest.mark.usefixtures("blank_pictures")
def test_target_is_chosen_by_a_place_near_it(tmp_path: Path) -> None:
    np.save(tmp_path / "two.npy", point_image((20.0, 20.0)) + 2 * point_image((40.0, 50.0)))
    for words, place in (([], (40, 50)), (["--near", "22,18"], (20, 20))):
        out = tmp_path / f"out{len(words)}"
        assert main(["irf", str(tmp_path / "two.npy"), *words, "--out", str(out)]) == 0
        (entry,) = measured(out)
        assert (entry["row"], entry["col"]) == pytest.approx(place, abs=0.05)


@pytest.mark.usefixtures("blank_pictures")
def test_what_an_image_does_not_show_is_null(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "tiny.npy", point_image(PLACES[0])[26:31, 38:45])
    assert main(["irf", str(tmp_path / "tiny.npy"), "--out", str(tmp_path / "out")]) == 0
    (entry,) = measured(tmp_path / "out")
    assert [entry[kind][key] for kind in ("range", "azimuth") for key in ("pslr_db", "islr_db")] == [None] * 4
    assert (tmp_path / "out" / "irf.png").is_file()
    assert capsys.readouterr().out.count(" - ") >= 4


@pytest.mark.usefixtures("blank_pictures")
def test_coarse_sampling_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "coarse.npy", point_image((28.0, 40.0))[::2, ::3])
    assert main(["irf", str(tmp_path / "coarse.npy"), "--out", str(tmp_path / "out")]) == 0
    assert "1 of 1 responses are narrower than a pixel" in capsys.readouterr().out


def test_of_many_images_the_first_are_drawn_and_the_picture_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[Sequence[Any], str]] = []
    monkeypatch.setattr(irf_module, "MOST_DRAWN", 2)
    monkeypatch.setattr(irf_module, "draw_responses", lambda targets, title, _: drawn.append((targets, title)))
    np.save(tmp_path / "points.npy", np.array([point_image(place) for place in PLACES]))
    assert len(irf_module.irf([tmp_path / "points.npy"], tmp_path / "out")) == 3
    ((targets, title),) = drawn
    assert [target.response.row for target in targets] == pytest.approx([28.3, 31.0], abs=0.01)
    assert "the first 2 of 3 images" in title


def test_windows_are_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["irf", "--windows"]) == 0
    shown = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()}
    assert float(shown["rectangular"][0]) == pytest.approx(-13.26, abs=0.1)
    assert [float(shown["taylor"][i]) for i in (0, 2)] == pytest.approx([-35.2, 1.188], rel=0.003)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("blank_pictures")
def test_without_out_the_next_free_folder_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("point.npy", point_image(PLACES[0]))
    for name in ("irf", "irf_2"):
        assert main(["irf", "point.npy"]) == 0
        check_point(measured(tmp_path / "out" / name)[0], PLACES[0])


def save(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


POINT = point_image(PLACES[0])

USELESS = {
    "absent.npy": (lambda _: None, "No such file"),
    "real.npy": (lambda path: np.save(path, POINT.real), "0 complex arrays"),
    "line.npy": (lambda path: np.save(path, POINT[0]), "shape (80,)"),
    "four.npy": (lambda path: np.save(path, POINT[None, None]), "shape (1, 1, 60, 80)"),
    "empty.npy": (lambda path: np.save(path, POINT[:0]), "shape (0, 80)"),
    "zero.npy": (lambda path: np.save(path, 0 * POINT), "none that is finite and not 0"),
    "nan.npy": (lambda path: np.save(path, np.nan * POINT), "none that is finite and not 0"),
    "nothing.npy": (lambda path: path.touch(), "not a whole .npy file"),
    "text.npy": (lambda path: path.write_text("hello"), "not a whole .npy file"),
    "cut.npy": (lambda path: path.write_bytes(npy_bytes(path)[:500]), "not a whole .npy file"),
    "pickled.npy": (lambda path: np.save(path, np.array([None]), allow_pickle=True), "not a whole .npy file"),
    "two.npz": (
        lambda path: save(path, a=POINT, b=POINT, c=POINT.real),
        "2 complex arrays; it must have one (it contains: a of complex64 (60, 80), b of complex64 (60, 80))",
    ),
    "none.npz": (lambda path: save(path, c=POINT.real), "0 complex arrays"),
    "empty.npz": (save, "it contains: nothing"),
    "image.h5": (lambda path: path.write_bytes(b"HDF"), "not a whole .h5 file"),
    "image.png": (lambda path: path.write_bytes(b"PNG"), "is not an image"),
    "no_bag": (lambda path: path.mkdir(), "is not a bag"),
    "no_info": (lambda path: write_bag(path, info=False), "not its sensor_info"),
    "no_images": (lambda path: write_bag(path, dwells=0), "contains no images"),
    "other_sensor": (lambda path: write_bag(path, provenance=Provenance(config_hash="x")), "an image of sensor 'x'"),
    "wrong_size": (lambda path: write_bag(path, samples=[1.0, 2.0]), "dwell 0, channel 0: samples has 2 entries"),
}


def npy_bytes(path: Path) -> bytes:
    np.save(path, POINT)
    return path.read_bytes()


@pytest.mark.parametrize("name", USELESS)
def test_useless_image_is_refused_by_name(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make, said = USELESS[name]
    make(tmp_path / name)
    assert main(["irf", str(tmp_path / name), "--out", str(tmp_path / "out")]) == 2
    complaint = capsys.readouterr().err.splitlines()[-1]
    assert complaint.startswith("sal-height: ")
    assert said in complaint
    assert str(tmp_path / name) in complaint
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "either images to measure or --windows"),
        (["point.npy", "--windows"], "either images to measure or --windows"),
        (["point.npy", "--channel", "0"], "it has no dwell numbers and no channel numbers"),
        (["points.npy", "--channel", "3"], "it has no dwell numbers and channels 0 to 2"),
        (["point.npy", "--near", "300,300"], "within 8 pixels of row 300, column 300"),
        (["point.npy", "--out", "."], "not empty"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_sentence(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("point.npy", POINT)
    np.save("points.npy", np.array([POINT] * 3))
    assert main(["irf", *words]) == 2
    assert_one_sentence(capsys.readouterr().err.splitlines()[-1].removeprefix("sal-height: "), said)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["point.npy", "points.npy"]


@pytest.mark.parametrize("words", [["--near", "3"], ["--near", "-1,2"], ["--azimuth-axis", "2"], ["--dwell", "x"]])
def test_malformed_options_end_with_status_2(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["irf", "point.npy", *words]) == 2
    assert words[0] in capsys.readouterr().err


@pytest.mark.usefixtures("blank_pictures")
def test_a_bag_without_images_is_measured_by_those_of_its_phase_history(tmp_path: Path) -> None:
    assert main(["irf", str(REFERENCE), "--out", str(tmp_path / "out")]) == 0
    entries = json.loads((tmp_path / "out" / "irf.json").read_text())
    assert [(one["dwell"], one["channel"]) for one in entries] == [(n, channel) for n in (0, 1) for channel in range(8)]
