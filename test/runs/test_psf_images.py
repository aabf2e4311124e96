"""The command psf: what a tape was made with comes back from its file; what images do not tell is said, not made up."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence, make_aperture, make_sensor
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.image import imread

from sal_height import messages
from sal_height.bag.writer import BagWriter
from sal_height.commands import main
from sal_height.figures.psf_estimators import depth_and_pedestal
from sal_height.figures.synthetic_tape import AzimuthFault, RangeFault, Saturation, TapeTarget, make_tape
from sal_height.geometry.grid import Grid
from sal_height.imaging.focus import Slc
from sal_height.imaging.pixels import azimuth_resolution
from sal_height.messages import serialize
from sal_height.messages.types import ChannelFrame, Provenance
from sal_height.numeric.transforms import frequencies
from sal_height.numeric.windows import window
from sal_height.response.impulse import measure_brightest
from sal_height.response.report import PsfSettings, report_on
from sal_height.response.transfer_function import centred
from sal_height.runs.chain.recorded_images import bag_images
from sal_height.runs.responses import psf as psf_module
from sal_height.runs.responses.pictures import draw_psf

SIDE, TAPES, NOISE, SPUR = 768, 2, 0.2, 0.3
RANGE, SWINGING = RangeFault(), AzimuthFault(swing=0.03, swing_period=2 * SIDE)
PLACES = tuple((row, col) for row in (150, 600) for col in (150, 600))


def tape(
    seed: int, shape: tuple[int, int] = (SIDE, SIDE), places: Any = PLACES, over_db: float = 40.0, **how: Any
) -> Any:
    """A tape with targets up to a pixel from `places`."""
    rng = np.random.default_rng(seed)
    targets = tuple(TapeTarget(*(np.array(place) + rng.uniform(-1, 1, 2)), over_db) for place in places)
    return make_tape(shape, rng, targets, **{"range_fault": RANGE, "azimuth_fault": AzimuthFault(), **how})


def measured(out: Path) -> list[dict[str, Any]]:
    return json.loads((out / "psf.json").read_text())


def psf(path: Path, out: Path, *words: str) -> tuple[int, dict[str, Any]]:
    """Exit status and the only entry."""
    status = main(["psf", str(path), "--out", str(out), *words])
    (entry,) = measured(out)
    return status, entry


def psf_of(pixels: Any, folder: Path, *words: str) -> tuple[int, dict[str, Any]]:
    np.save(folder / "image.npy", pixels)
    return psf(folder / "image.npy", folder / "out", *words)


@pytest.fixture(autouse=True)
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What would be drawn: pictures take longer than all else, and `tapes` has two."""
    calls: list[Any] = []
    monkeypatch.setattr(psf_module, "draw_psf", lambda *words: calls.append(words))
    return calls


@pytest.fixture(scope="module")
def tapes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of the measurement of two tapes with all their faults, as those of two detectors."""
    folder = tmp_path_factory.mktemp("tapes")
    faults = {"azimuth_fault": SWINGING, "noise": NOISE, "nyquist_spur": SPUR}
    np.save(folder / "tapes.npy", np.array([tape(seed, **faults) for seed in range(1, TAPES + 1)]))
    assert main(["psf", str(folder / "tapes.npy"), "--out", str(folder / "out")]) == 0
    return folder / "out"


def arrays(out: Path, name: str = "psf") -> dict[str, np.ndarray]:
    with np.load(out / f"{name}.npz", allow_pickle=False) as stored:
        return dict(stored)


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def test_the_responses_of_targets_are_those_the_tapes_were_made_with(tapes: Path) -> None:
    """4 targets of 40 dB, rms over the band: 0.0107 and 0.0166 rad over 16 tapes; standard error of two 12 %."""
    pixels = np.fft.ifft(np.fft.ifftshift(RANGE.response(2048)))
    expected = centred(np.fft.fftshift(np.fft.fft(np.concatenate([pixels[:32], pixels[-32:]]))))
    greatest = np.abs(expected).max()
    band = np.abs(expected) > 0.1 * greatest
    found = np.array([arrays(tapes, f"psf_{number}")["R"] for number in range(TAPES)])
    assert rms(((np.abs(found) - np.abs(expected)) / greatest)[:, band]) < 0.015
    assert rms(np.angle(found * expected.conj())[:, band]) < 0.02
    error = np.array([arrays(tapes, f"psf_{number}")["R_sigma"] for number in range(TAPES)])
    assert rms(((found - expected) / error)[:, band]) == pytest.approx(1, abs=0.3)  # 54 bins: 10 %


def test_the_modulus_of_speckle_is_that_of_the_response(tapes: Path) -> None:
    """Over its greatest, rms over all frequencies: 0.020 to 0.0285 over 16 tapes."""
    power = np.abs(RANGE.response(64)) ** 2
    power = (power / power.mean() + NOISE**2) / (1 + NOISE**2)
    for number in range(TAPES):
        found = arrays(tapes, f"psf_{number}")
        modulus = np.sqrt(np.maximum(found["speckle_R2"], 0))
        assert rms(modulus - np.sqrt(power)) < 0.033 * np.sqrt(power.max())
        assert depth_and_pedestal(found["speckle_R2"], RANGE.teeth)[0] > 0.075  # of 0.1; 0.065 through Fejer's kernel


def test_the_sawtooth_is_named_by_its_echoes(tapes: Path) -> None:
    """With 4 targets of 40 dB they are, on 15 of 16 tapes with noise and no other fault."""
    for entry in measured(tapes):
        echoes = entry["range"]["anomalous_sidelobes"]
        assert sorted(one["position_px"] for one in echoes) == pytest.approx([-16, 16], abs=1)
        assert [one["level_db"] for one in echoes] == pytest.approx([-29.5, -29.5], abs=3)
        assert all(one["significance"] > 3.5 and one["position_m"] is None for one in echoes)
        assert entry["azimuth"]["anomalous_sidelobes"] == []


def test_a_linear_tape_keeps_superposition(tapes: Path) -> None:
    """At 1 % it fires on 3 of 210 linear tapes of 640 x 512 and 768 x 768."""
    for entry in measured(tapes):
        assert entry["superposition"]["p_value"] > 0.01
        assert entry["superposition"]["chip_rows"] == 256
        assert entry["superposition"]["remark"] is None
        assert entry["superposition"]["share"] == pytest.approx(0.5 / (1 + NOISE**2), abs=0.02)


def test_what_speckle_tells_beside(tapes: Path) -> None:
    for number, entry in enumerate(measured(tapes)):
        assert entry["speckle"]["nyquist_spur"] == pytest.approx(SPUR**2 / (1 + NOISE**2 + SPUR**2), abs=0.015)
        # The quietest frequencies of an estimate that errs are too quiet.
        assert 0.4 < entry["speckle"]["noise_floor"] / (NOISE**2 / (1 + NOISE**2)) < 1.2
        assert sum(entry["speckle"]["verdicts"].values()) == entry["speckle"]["tiles"] == (SIDE // 64) ** 2
        cols, found, sigma = (
            np.array([one[key] for one in entry["pointing"]])
            for key in ("azimuth_px", "displacement_cycles_per_px", "sigma")
        )
        # 12 columns of tiles; the mean over a tile is as good as its middle to 0.0004.
        assert len(cols) == SIDE // 64
        assert np.all(sigma < 0.005)
        assert rms((found - SWINGING.pointing(cols)) / sigma) == pytest.approx(1, abs=0.65)
        stored = arrays(tapes, f"psf_{number}")
        np.testing.assert_array_equal(stored["pointing"], found)
        assert not stored["pointing_image"].any()


def test_what_is_left_in_the_folder(tapes: Path) -> None:
    assert sorted(path.name for path in tapes.iterdir()) == sorted(
        ["psf.json", *(f"psf_{number}.{kind}" for number in range(TAPES) for kind in ("npz", "png"))]
    )
    for number, entry in enumerate(measured(tapes)):
        stored = arrays(tapes, f"psf_{number}")
        assert entry["channel"] == number
        assert (entry["verdicts"], entry["chip"]) == ({"accepted": 4}, [64, 64])
        for place in PLACES:
            assert sum(np.hypot(one["row"] - place[0], one["col"] - place[1]) < 1.5 for one in entry["targets"]) == 1
        assert [one["over_clutter_db"] for one in entry["targets"]] == pytest.approx([39.5] * 4, abs=0.7)
        assert stored["psf"].shape == (256, 256)
        assert stored["psf"][128, 128] == pytest.approx(1)
        np.testing.assert_array_equal(stored["range_frequency"], frequencies(64))
        np.testing.assert_allclose(stored["psf"][::4, 128], np.fft.fftshift(np.fft.ifft(np.fft.ifftshift(stored["R"]))))
        assert stored["A_without_clutter"].shape == stored["A_sigma"].shape == (64,)
        assert list(entry["undetermined"]) == ["metres"]
        assert imread(tapes / f"psf_{number}.png").shape[1] == 1585


SHOWN = {
    "targets and speckle": (lambda: tape(1, (320, 320), ((160, 64), (160, 250))), 12 - 2),
    "a target": (lambda: one()[:, 48:80], 1 + 4 + 1),
    "speckle": (lambda: tape(1, (128, 128), ()), 3),
    "nothing": (lambda: np.zeros((128, 128), np.complex64), 0),
}


@pytest.mark.parametrize("name", SHOWN)
def test_panels_of_what_is_determined_are_drawn(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 12 at most, none of them empty, and words for the rest."""
    saved: list[Figure] = []
    draw = Figure.draw

    def remember(figure: Figure, renderer: RendererBase) -> None:
        saved.append(figure)
        draw(figure, renderer)

    monkeypatch.setattr(Figure, "draw", remember)
    make, drawn = SHOWN[name]
    report = report_on([make()])
    draw_psf(report, "title", ["A reason."], tmp_path / "psf.png")
    panels = [axes for axes in saved[0].axes if axes.get_title()]
    assert len(panels) == drawn
    assert all(axes.has_data() for axes in panels)
    (words,) = (axes for axes in saved[0].axes if not axes.axison)
    assert "Not determined: A reason." in words.texts[0].get_text()
    assert ("p = " in words.texts[0].get_text()) == (report.linearity is not None)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_tape_that_was_saturated_does_not_keep_superposition(seed: int, tmp_path: Path) -> None:
    """Of 10 such tapes the greatest p is 9e-10."""
    status, entry = psf_of(tape(seed, noise=NOISE, saturation=Saturation(14.0)), tmp_path)
    assert status == 0
    assert entry["superposition"]["p_value"] < 1e-6


def test_images_of_one_detector_are_pooled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Errors of the response are less by the root of the number of targets; each image has its own pointing."""
    swings = (0.03, -0.03)
    paths = []
    for seed, swing in enumerate(swings):
        fault = AzimuthFault(swing=swing, swing_period=1e9)  # so slow that nothing moves within an image
        object.__setattr__(fault, "pointing", lambda cols, swing=swing: np.full(np.shape(cols), swing)[()])
        paths.append(tmp_path / f"{seed}.npy")
        np.save(paths[-1], tape(seed, (256, 300 + 40 * seed), ((128, 150),), azimuth_fault=fault))
    assert main(["psf", *map(str, paths), "--out", str(tmp_path / "both")]) == 0
    assert main(["psf", str(paths[0]), "--out", str(tmp_path / "one")]) == 0
    (both,), (one,) = measured(tmp_path / "both"), measured(tmp_path / "one")
    assert [target["image"] for target in both["targets"]] == [0, 1]
    assert [image["image"] for image in both["images"]] == [str(path) for path in paths]
    error = [rms(arrays(tmp_path / name)["R_sigma"]) for name in ("one", "both")]
    assert error[1] / error[0] == pytest.approx(np.sqrt(0.5), rel=0.25)
    assert both["speckle"]["tiles"] == 4 * (4 + 5)
    places = [(p["image"], p["azimuth_px"]) for p in both["pointing"]]
    assert set(places) <= {(image, 31.5 + 64 * col) for image in (0, 1) for col in range(4 + image)}
    for image, swing in enumerate(swings):
        found = [p["displacement_cycles_per_px"] for p in both["pointing"] if p["image"] == image]
        assert np.mean(found) == pytest.approx(swing, abs=0.01)
    assert "disagreement" in one["undetermined"]
    assert one["disagreement"]["range"] is None
    assert both["disagreement"]["range"] is not None
    shown = capsys.readouterr().out
    assert "2 images" in shown
    assert "2 accepted" in shown


GRID = Grid(np.array([3.0, -3500.0, 1.0]), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.05, 0.02, 128, 70)


def write_bag(path: Path, dwells: int = 2, stretched: float = 1.0, made: dict[str, Any] | None = None) -> Path:
    """A bag of tapes of three detectors with the phase of range; the columns of the last dwell are `stretched`.

    Args:
        path: of the bag.
        dwells: number of them.
        stretched: factor on the spacing of the last dwell's columns.
        made: parameters of the compression, as the provenance names them.
    """
    sensor, aperture = make_sensor(), make_aperture()
    with BagWriter(path) as bag:
        bag.add_topic("/sensor_info", "sal_height_msgs/msg/SensorInfo")
        bag.add_topic("/slc", "sal_height_msgs/msg/ComplexImage")
        bag.write("/sensor_info", serialize(messages.sensor_to_message(sensor, messages.to_stamp(0))), 0, 0)
        for dwell in range(dwells):
            spacing = GRID.col_spacing * (stretched if dwell == dwells - 1 else 1)
            grid = Grid(GRID.origin, GRID.row_direction, GRID.col_direction, GRID.row_spacing, spacing, *GRID.shape)
            distance = np.linalg.norm(grid.pixels() - aperture.position, axis=-1)
            wound = np.exp(4j * np.pi / sensor.wavelength * distance)
            slc = np.array([tape(3 * dwell + m, GRID.shape, ((64, 35),), noise=NOISE) for m in range(3)]) * wound
            frame, provenance = ChannelFrame(dwell=dwell), Provenance(config_hash=sensor.config_hash)
            provenance.parameters = messages.with_stage([], "sar_compression", made or {})
            image = Slc(slc.astype(np.complex64), grid, aperture, np.zeros(3), np.zeros(3))
            for message in messages.slc_to_messages(image, frame, provenance):
                bag.write("/slc", serialize(message), dwell + 1, dwell + 1)
    return path


def test_a_bag_gives_metres_and_places(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "bag")
    status, entry = psf(bag, tmp_path / "out", "--channel", "1")
    assert status == 0
    assert [(image["topic"], image["dwell"]) for image in entry["images"]] == [("/slc", 0), ("/slc", 1)]
    assert entry["channel"] == 1
    assert (entry["spacing_m"], entry["chip"]) == ({"range": 0.05, "azimuth": 0.02}, [64, 64])
    for axis, spacing in entry["spacing_m"].items():
        assert entry[axis]["width_m"] == pytest.approx(spacing * entry[axis]["width_px"])
    assert entry["range"]["width_px"] == pytest.approx(2.66, rel=0.05)
    assert [target["image"] for target in entry["targets"]] == [0, 1]
    for target in entry["targets"]:
        assert (target["row"], target["col"]) == pytest.approx((64, 35), abs=1.1)
        np.testing.assert_allclose(target["position_m"], GRID.points(target["row"], target["col"]), atol=1e-3)
    assert "metres" not in entry["undetermined"]
    assert f"{entry['range']['width_m']:.3f}" in capsys.readouterr().out
    _, alone = psf(bag, tmp_path / "alone", "--channel", "1", "--dwell", "1")
    assert [image["dwell"] for image in alone["images"]] == [1]


def test_a_bag_tells_how_noise_was_shaped(tmp_path: Path) -> None:
    """Neighbours at the resolution: white behind no window, and by .33 alike where a window's spacing is broadened."""
    stated = {"range_window": "rectangular", "azimuth_window": "taylor"}
    image = next(bag_images(write_bag(tmp_path / "bag", 1, made=stated)))
    sensor, aperture = make_sensor(), make_aperture()
    assert image.noise_shape is not None
    steps = (
        GRID.row_spacing / sensor.range_resolution,
        GRID.col_spacing / azimuth_resolution(sensor, aperture, float(np.linalg.norm(GRID.origin - aperture.position))),
    )
    weights = window("taylor", 4001)
    expected = [np.sinc(steps[0]), np.mean(weights**2 * np.cos(np.pi * np.linspace(-1, 1, 4001) * steps[1]))]
    expected[1] /= np.mean(weights**2)
    assert image.noise_shape.range[1] == pytest.approx(expected[0], abs=0.002)
    assert image.noise_shape.azimuth[1] == pytest.approx(expected[1], abs=0.002)
    assert next(bag_images(write_bag(tmp_path / "silent", 1))).noise_shape is None


def test_images_of_different_spacing_are_not_pooled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "bag", stretched=1.5)
    assert main(["psf", str(bag), "--channel", "0", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.splitlines()[-1].removeprefix("sal-height: ")
    assert_one_sentence(said, "0.02 to 0.03 m in azimuth")
    assert not (tmp_path / "out").exists()


def test_a_real_corner_reflector(shared_data: Callable[[str], Path], tmp_path: Path) -> None:
    """ALOS PALSAR, (azimuth, range): as `sal-height irf` measures it; no speckle is near."""
    h5py = pytest.importorskip("h5py")
    (path,) = shared_data("alos_palsar").glob("calib_RSLC*.h5")
    with h5py.File(path) as file:
        stored = file["science/LSAR/RSLC/swaths/frequencyA/HH"][()]
    image = (stored["r"].astype(np.float32) + 1j * stored["i"].astype(np.float32)).astype(np.complex64)
    status, entry = psf_of(image, tmp_path, "--azimuth-axis", "0")
    assert status == 0
    known = measure_brightest(image)
    (target,) = entry["targets"]
    assert (target["row"], target["col"]) == pytest.approx((known.row, known.col), abs=0.05)
    for axis, cut in (("azimuth", known.row_cut), ("range", known.col_cut)):
        assert entry[axis]["width_px"] == pytest.approx(cut.width, rel=0.01)
        assert entry[axis]["pslr_db"] == pytest.approx(cut.pslr_db, abs=0.3)
        assert entry[axis]["islr_db"] == pytest.approx(cut.islr_db, abs=0.3)
        assert entry[axis]["anomalous_sidelobes"] == []
    assert entry["chip"] == [50, 64]
    assert entry["speckle"] is None


def textured(image: np.ndarray) -> np.ndarray:
    """The image with clutter of patches, 9 times as bright as others, around its middle."""
    bright = np.kron(np.indices((len(image) // 8, image.shape[1] // 8)).sum(axis=0) % 2, np.ones((8, 8)))
    bright[len(image) // 2 - 3 : len(image) // 2 + 4, image.shape[1] // 2 - 3 : image.shape[1] // 2 + 4] = 1
    return (image * (1 + 2 * bright)).astype(np.complex64)


def clipped(image: np.ndarray, level: float) -> np.ndarray:
    return (np.clip(image.real, -level, level) + 1j * np.clip(image.imag, -level, level)).astype(np.complex64)


def with_hole(image: np.ndarray, value: float) -> np.ndarray:
    image[70:78, 70:78] = value
    return image


def one(seed: int = 5, place: tuple[int, int] = (64, 64), **how: Any) -> np.ndarray:
    """A small tape of one target."""
    return tape(seed, (128, 128), (place,), 45.0, **how)


POOR = {
    "no target": (
        lambda: tape(5, (128, 128), ()),
        0,
        {"targets": "No pixel stands out", "superposition": "targets is also needed."},
    ),
    "two targets that overlap": (
        lambda: tape(5, (192, 192), ((60, 46), (60, 74)), 45.0),
        0,
        {"targets": "2 not alone in the chip", "superposition": "the response of targets is also needed"},
    ),
    "target at the edge": (lambda: one(place=(20, 64)), 0, {"targets": "1 too near the edge of the image"}),
    "hole of NaN": (lambda: with_hole(one(), np.nan), 0, {"targets": "1 next to pixels that are not finite"}),
    "hole of 0": (lambda: with_hole(one(), 0), 0, {"targets": "1 next to pixels of 0"}),
    "clipped target": (lambda: clipped(one(), 40.0), 0, {"targets": "1 clipped"}),
    "clipped image": (lambda: clipped(one(), 0.5), 1, {"targets": "No pixel stands", "speckle": "4 clipped"}),
    "all 0": (
        lambda: 0 * one(),
        1,
        {"targets": "No pixel stands", "speckle": "4 zero", "pointing": "one tile of it is needed"},
    ),
    "all NaN": (lambda: np.nan * one(), 1, {"targets": "No pixel stands", "speckle": "4 not finite"}),
    "no speckle": (
        lambda: textured(one()),
        0,
        {"speckle": "None of the 4 tiles", "superposition": "of speckle is also"},
    ),
    "speckle beside targets only": (one, 0, {"superposition": "within 128 rows of a bright point"}),
    "even azimuth": (
        lambda: tape(5, (128, 128), (), azimuth_fault=None),
        1,
        {"speckle": "neighbours in azimuth do not correlate", "pointing": "one tile of it is needed"},
    ),
    "12 columns": (lambda: tape(5, (184, 12), (), noise=NOISE), 0, {"targets": "No pixel stands"}),
    "6 columns": (lambda: tape(5, (184, 6), ()), 1, {"speckle": "tiles need 8 pixels each way"}),
    "target in 12 columns": (
        lambda: tape(5, (184, 12), ((90, 6),), 45.0)[:, :12],
        0,
        {"azimuth": "A chip of 12 pixels in azimuth is too short for"},
    ),
}


@pytest.mark.parametrize("name", POOR)
def test_what_an_image_does_not_tell_is_null_with_a_reason(
    name: str, tmp_path: Path, drawn: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    make, status, reasons = POOR[name]
    found, entry = psf_of(make(), tmp_path)
    assert found == status
    for part, words in reasons.items():
        assert_one_sentence(entry["undetermined"][part], words)
    for sentence in entry["undetermined"].values():
        assert_one_sentence(sentence, "need")
    shown = capsys.readouterr().out
    assert all(f"not determined: {sentence}" in shown for sentence in entry["undetermined"].values())
    stored = arrays(tmp_path / "out")
    without_targets, without_speckle = ("targets" in entry["undetermined"], "speckle" in entry["undetermined"])
    assert without_targets == (entry["range"] is None) == ("R" not in stored) == ("psf" not in stored)
    assert without_speckle == (entry["speckle"] is None) == ("speckle_R2" not in stored)
    for part in ("pointing", "superposition"):
        assert (part in entry["undetermined"]) == (entry[part] is None)
    assert [words[2] for words in drawn] == [list(entry["undetermined"].values())]


def test_a_known_noise_power_tells_speckle_from_noise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without it, speckle that is white in azimuth could be noise behind a range window."""
    even = tape(5, (128, 128), (), azimuth_fault=None)
    status, entry = psf_of(even, tmp_path, "--noise-power", "0.01")
    assert status == 0
    assert entry["speckle"]["verdicts"] == {"pure": 4}
    assert entry["speckle"]["remark"] is None
    assert_one_sentence(entry["undetermined"]["pointing"], "too flat")
    assert psf(tmp_path / "image.npy", tmp_path / "dark", "--noise-power", "0.9")[0] == 1
    (tmp_path / "wide").mkdir()
    _, entry = psf_of(tape(5, (128, 128), ()), tmp_path / "wide")
    assert_one_sentence(entry["speckle"]["remark"].split(": ")[0] + ".", "noise is not known")
    assert entry["speckle"]["remark"] in capsys.readouterr().out


def test_settings_are_set_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert psf_of(one(), tmp_path)[1]["verdicts"] == {"accepted": 1}
    image = tmp_path / "image.npy"
    assert psf(image, tmp_path / "high", "--set", "point_over_clutter_db=50")[1]["verdicts"] == {}
    for words, said in (
        ("point_over_clutter_db=1", "point_over_clutter_db is 1; it must be a number from 10 to 100"),
        ("point_over=20", "no parameter 'point_over' (did you mean"),
        ("20", "must be of the form NAME=VALUE"),
    ):
        assert main(["psf", str(image), "--out", str(tmp_path / "none"), "--set", words]) == 2
        assert_one_sentence(capsys.readouterr().err.splitlines()[-1].removeprefix("sal-height: "), said)


def test_help_lists_every_setting_with_its_default(capsys: pytest.CaptureFixture[str]) -> None:
    main(["psf", "--help"])
    listed = dict(re.findall(r"^  ((?:points?|speckle)_\w+) +([\d.]+) ", capsys.readouterr().out, re.MULTILINE))
    assert {name: float(value) for name, value in listed.items()} == PsfSettings().model_dump()


def moving_band(image: np.ndarray, rate: float) -> np.ndarray:
    """The image of a spotlight whose azimuth phase is left in it: the Doppler centroid moves by `rate` per column."""
    cols = np.arange(image.shape[1]) - image.shape[1] / 2
    return (image * np.exp(1j * np.pi * rate * cols**2)).astype(np.complex64)


def in_the_middle(response: np.ndarray) -> np.ndarray:
    """Modulus over its mean, its centre of gravity turned to frequency 0: that of a band that goes round is free."""
    waves = np.fft.fft(np.abs(response) / np.mean(np.abs(response)))
    turn = np.angle(waves[1] * np.exp(1j * np.pi))
    return np.fft.ifft(waves * np.exp(-1j * turn * np.fft.fftfreq(len(waves), 1 / len(waves)))).real


@pytest.mark.parametrize("rate", [2e-4, 0.13])
def test_a_band_that_moves_with_the_column_is_followed(rate: float) -> None:
    """By 15 % of the sampling rate over the image (X band), or 100 times through it (optical).

    Four targets of 40 dB give |A| within 0.0166 +- 0.0006 of its greatest, rms of 8 tapes, whatever the rate. With one
    band for all columns it was 0.031 and 0.27, targets disagreed by 2.3 and 4.6, and at the higher rate no speckle was
    left.
    """
    fault = AzimuthFault()
    truth = in_the_middle(fault.response(64))
    found = [report_on([image]) for image in (tape(3), moving_band(tape(3), rate))]
    assert [len(one.targets) for one in found] == [4, 4]
    errors = [rms(in_the_middle(one.transfer.azimuth.response) - truth) / truth.max() for one in found]
    assert errors[1] == pytest.approx(errors[0], abs=0.01)
    assert found[1].transfer.azimuth.disagreement < 1.5
    assert found[1].tiles.pure.sum() >= 0.9 * found[0].tiles.pure.sum()
    powers = [in_the_middle(one.spectra.azimuth.unfolded(64)[0]) for one in found]
    assert rms(powers[1] - powers[0]) < 0.05
    pointing, sigma = found[1].pointing[0], found[0].pointing[0].sigma
    error = pointing.displacement - found[0].pointing[0].displacement - rate * (pointing.cols - SIDE / 2)
    error -= np.round(error)
    assert rms(error) < 4 * np.median(sigma)


def test_a_shorter_chip_is_taken_for_superposition_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two targets 100 rows apart share the long chips; there is speckle in other columns."""
    _, entry = psf_of(tape(5, (320, 320), ((130, 64), (225, 64))), tmp_path)
    assert entry["superposition"]["chip_rows"] == 128
    assert_one_sentence(entry["superposition"]["remark"], "128 rows")
    assert entry["superposition"]["remark"] in capsys.readouterr().out


@pytest.mark.parametrize(
    ("make", "words", "said"),
    [
        (lambda: np.abs(one()), [], "0 complex arrays"),
        (lambda: np.abs(one()).astype(np.complex64), [], "not amplitudes"),
        (one, ["--chip", "200x64"], "A chip of 200 x 64 pixels does not fit the image of 128 x 128"),
        (lambda: one()[:3], [], "each side must be 4 pixels or more"),
        (one, ["--channel", "0"], "image.npy has no image of the requested"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_sentence(
    make: Callable[[], np.ndarray],
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("image.npy", make())
    assert main(["psf", "image.npy", *words]) == 2
    assert_one_sentence(capsys.readouterr().err.splitlines()[-1].removeprefix("sal-height: "), said)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["image.npy"]


def test_images_of_different_heights_are_not_pooled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "a.npy", one())
    np.save(tmp_path / "b.npy", one()[:100])
    assert main(["psf", str(tmp_path / "a.npy"), str(tmp_path / "b.npy"), "--out", str(tmp_path / "out")]) == 2
    assert_one_sentence(capsys.readouterr().err.splitlines()[-1].removeprefix("sal-height: "), "as many rows")
