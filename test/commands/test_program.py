"""The command line as a whole: help at once, wrong use in one sentence, commands without ROS."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import assert_one_sentence, few

import sal_height.commands
from sal_height import __version__
from sal_height.commands import main
from sal_height.commands._options import node_parameters, output_folder
from sal_height.commands._program import program
from sal_height.errors import UserError
from sal_height.figures import paper_figures
from sal_height.figures.curve import Curve

FOLDER = Path(sal_height.commands.__file__).parent
MODULES = {path.stem.rstrip("_").replace("_", "-"): path for path in sorted(FOLDER.glob("[a-z]*.py"))}
COMMANDS = list(MODULES)
WITH_OUTPUT = [name for name, path in MODULES.items() if "OutputFolder" in path.read_text()]
BAG = ("info", "check", "recover", "cut", "merge", "upgrade", "diff")
PATHS = [
    [],
    *([name] for name in COMMANDS),
    ["montecarlo", "pair"],
    ["montecarlo", "array"],
    *(["bag", name] for name in BAG),
    *(["import", name] for name in ("arrays", "cphd", "crsd", "slc", "gotcha")),
]

SLOW_TO_IMPORT = ("numba", "scipy", "numpy", "rclpy", "matplotlib", "pydantic", "sal_height_msgs")
"""Together they take 0.5 s and more to import, which would delay every --help and --version."""

ROS = ("rclpy", "sal_height_msgs", "std_msgs", "sensor_msgs", "geometry_msgs", "nav_msgs", "mcap")

IN_TURN = """
import contextlib, io, json, sys
blocked, many_words = map(json.loads, sys.argv[1:])
sys.modules.update(dict.fromkeys(blocked))  # as modules that are not installed: neither imported nor found
from sal_height.commands import main
results = []
for words in many_words:
    with contextlib.redirect_stderr(io.StringIO()) as complaint, contextlib.redirect_stdout(io.StringIO()) as said:
        status = main(words)
    results.append([status, said.getvalue(), complaint.getvalue()])
print(json.dumps([results, sorted({name.partition(".")[0] for name, module in sys.modules.items() if module})]))
"""


def run_fresh(many_words: Sequence[Sequence[str]], blocked: Sequence[str] = ()) -> tuple[list[Any], set[str]]:
    """Run command lines one after the other in a new process that cannot import the `blocked` modules.

    Returns status, output and error output of each, and the top-level modules that were imported.
    """
    command = [sys.executable, "-c", IN_TURN, json.dumps(blocked), json.dumps(many_words)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)  # noqa: S603 (our code)
    assert result.returncode == 0, result.stderr
    results, modules = json.loads(result.stdout)
    return results, set(modules)


def test_every_module_is_a_command() -> None:
    listed = {name for name in program() if not name.startswith("-")}
    assert listed == set(COMMANDS)
    assert {"run", "replay", "import"} <= listed


def test_help_imports_nothing_that_is_slow() -> None:
    results, modules = run_fresh([["--version"], *([*path, "--help"] for path in PATHS)])
    assert [status for status, *_ in results] == [0] * len(results)
    assert not modules & set(SLOW_TO_IMPORT)


def test_the_module_is_the_program() -> None:
    command = [sys.executable, "-m", "sal_height", "--version"]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)  # noqa: S603 (our own code)
    assert result.stdout == f"sal_height {__version__}\n"


@pytest.mark.parametrize("also_errors", [False, True], ids=["stdout", "stdout and stderr"])
@pytest.mark.parametrize(
    "words", few(3, [["--help"], ["--version"], ["replay"], ["montecarlo", "pair", "--trials", "10"]]), ids=" ".join
)
def test_a_reader_that_closes_the_output_ends_a_command_quietly(words: list[str], also_errors: bool) -> None:
    """As `sal-height ... | head` does; `replay` without a bag complains on stderr and prints nothing."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as closed:
        command = [sys.executable, "-m", "sal_height", *words]
        errors = closed if also_errors else subprocess.PIPE
        result = subprocess.run(command, stdout=closed, stderr=errors, check=False, timeout=600)  # noqa: S603 (our code)
    if words == ["replay"] and not also_errors:
        assert result.returncode == 2
    else:
        said = [
            line for line in (result.stderr or b"").splitlines() if b"Compiling kernels for this processor" not in line
        ]
        assert (result.returncode, said) == (141, [])


@pytest.mark.parametrize("path", PATHS, ids=" ".join)
def test_help_has_examples_that_can_be_parsed_and_exit_statuses(
    path: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*path, "--help"]) == 0
    text = capsys.readouterr().out
    statuses = text[text.index("exit status:") :]
    assert "  0    done" in statuses
    assert "  2    " in statuses
    assert "  130  interrupted" in statuses
    assert "  141  the reader" in statuses
    examples = text[text.index("examples:") :].replace("\\\n", " ")
    lines = [
        re.split("  | > ", line.strip())[0].split()[1:] for line in examples.splitlines() if line.startswith("  sal-h")
    ]
    assert lines
    for line in lines:
        if line[0] != "COMMAND":
            program().parse_args(line, exit_on_error=False, print_error=False)


@pytest.mark.parametrize("path", PATHS, ids=" ".join)
def test_examples_and_exit_statuses_fit_a_terminal_of_80_columns(path: list[str]) -> None:
    app = program()
    for name in path:
        app = app[name]
    assert max(len(line) for line in str(app.help_epilogue).splitlines()) <= 80


@pytest.mark.parametrize(
    ("command", "failure"),
    [
        ("run", "no valid height"),
        ("--help", "a check failed"),
        ("replay", "heights differ"),
        ("psf", "no estimate"),
        ("figures", "from theory"),
    ],
)
def test_status_1_is_explained_where_it_can_occur(
    command: str, failure: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main([command, "--help"])
    text = capsys.readouterr().out
    status = text[text.index("\n  1    ") : text.index("\n  2    ")]
    assert failure in " ".join(status.split())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "--dwell", "2"], "Unknown option: --dwell"),
        (["run", "--looks", "2"], "of the form RxA"),
        (["run", "--looks", "0x2"], "1 or more"),
        (["run", "--seed", "-1"], "--seed"),
        (["run", "--seed", "4294967296"], "--seed"),
        (["run", "--dwells", "two"], "--dwells"),
        (["run", "--processes=maybe"], "--processes"),
        (["replay"], "BAG"),
        (["replay", "a", "b"], "more arguments than the command takes: 'b'"),
        (["irf", "a.npy", "--azimuth-axis", "2"], "--azimuth-axis"),
        (["psf", "a.npy", "--chip", "64"], "of the form RxA"),
        (["import", "gotcha"], "FILE"),
        (["fly"], 'Unknown command "fly"'),
    ],
)
def test_wrong_use_ends_with_status_2_and_names_the_help(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    printed = capsys.readouterr()
    assert not printed.out
    (line,) = printed.err.splitlines()
    assert line.startswith("sal-height: ")
    assert said in line
    command = {"fly": "", "import": "import gotcha "}.get(words[0], f"{words[0]} ")
    assert line.endswith(f"{command}--help.")


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["budget", "sal_spotligt"], "'sal_spotlight'"),
        (["run", "small"], "--preset small"),
        (["run", "--preset", "xband_releif"], "'xband_relief'"),
        (["run", "--scene", "wods"], "'woods'"),
        (["run", "--preset", "small", "--estimators", "capn"], "'capon'"),
        (["run", "--preset", "small", "--param", "ml_heigt.x=1"], "'ml_height'"),
        (["montecarlo", "array", "--estimator", "musik"], "'music'"),
        (["passes", str(FOLDER), "--estimator", "caopn"], "'capon'"),
        (["figures", "relief_ordr"], "'relief_order'"),
    ],
    ids=lambda value: value if isinstance(value, str) else value[0],
)
def test_a_wrong_name_is_answered_with_the_closest_one(
    words: list[str], hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"(did you mean {hint}?)" in line
    assert line.endswith(".")


def test_a_word_too_many_that_is_no_preset_has_no_hint(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "smalll"]) == 2
    assert main(["replay", "bag", "small"]) == 2
    assert "did you mean" not in capsys.readouterr().err


def test_completion_is_installed_and_offers_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "sal-height"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOME", str(tmp_path))
        assert main(["--install-completion", "--shell", "bash", "--output", str(script)]) == 0
    assert str(script) in capsys.readouterr().out
    typed = f"source {script}; COMP_WORDS=(sal-height rep); COMP_CWORD=1; _sal_height"
    completed = subprocess.run(  # noqa: S603 (our own text)
        ["bash", "-c", f'{typed}; echo "${{COMPREPLY[@]}}"'],  # noqa: S607 (that of the system)
        capture_output=True,
        text=True,
        check=True,
    )
    assert completed.stdout.split() == ["replay"]


@pytest.mark.parametrize("words", [[], ["montecarlo"], ["bag"]], ids=["nothing", "montecarlo", "bag"])
def test_a_missing_command_shows_the_help_and_ends_with_status_2(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert "Usage: sal-height" in capsys.readouterr().out


def test_parameters_of_nodes_are_read_as_yaml() -> None:
    found = node_parameters(["a.x=1", "a.y=[1, 2.5]", "b.z=text", "a.x=2", "b.w=[1,"])
    assert found == {"a": {"x": 2, "y": [1, 2.5]}, "b": {"z": "text", "w": "[1,"}}
    with pytest.raises(UserError, match=r"NODE\.NAME=VALUE"):
        node_parameters(["x"])


def test_the_output_folder_is_checked_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert output_folder(None, "irf") == Path("out/irf")
    assert not Path("out").exists()
    Path("file").touch()
    Path("used").mkdir()
    Path("used", "mine").touch()
    for given, said in (("used", "not empty"), ("file", "is a file"), ("file/inside", "is a file")):
        with pytest.raises(UserError, match=said):
            output_folder(Path(given), "irf")


@pytest.mark.parametrize("command", WITH_OUTPUT)
def test_no_command_begins_with_an_output_folder_in_use(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The input does not exist either, which would be reported if the folder were looked at later."""
    (tmp_path / "mine.txt").touch()
    words = {
        "run": ["--preset", "small"],
        "figures": ["fig3"],
        "live": ["--bag", "missing"],
        "bag": ["recover", "missing"],
        "import": ["gotcha", "missing.mat"],
    }.get(command, ["missing.npy"])
    assert main([command, *words, "--out", str(tmp_path)]) == 2
    assert "not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_arrays_are_measured_without_ros(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    image = rng.standard_normal((128, 128)) + 1j * rng.standard_normal((128, 128))
    image[64, 64] = 1000.0
    np.save(tmp_path / "image.npy", image)
    words = [[name, str(tmp_path / "image.npy"), "--out", str(tmp_path / name)] for name in ("irf", "psf")]
    results, _ = run_fresh(words, ROS)
    assert [status for status, *_ in results] == [0, 0], results
    assert (tmp_path / "irf" / "irf.json").is_file()
    assert (tmp_path / "psf" / "psf.json").is_file()


@pytest.mark.parametrize("missing", few(1, ["rclpy", "sal_height_msgs", "diagnostic_msgs"]))
def test_commands_that_need_ros_say_what_to_install(missing: str, tmp_path: Path) -> None:
    """All of it, whatever is found to be missing first."""
    words = [["record", "--out", str(tmp_path / "out")], ["live", "--out", str(tmp_path / "out"), "--preset", "small"]]
    results, _ = run_fresh(words, [missing])
    for (status, _, complaint), name in zip(results, ("record", "live"), strict=True):
        sentence = complaint.strip().removeprefix("sal-height: ")
        assert status == 2
        assert sentence.startswith(f"Command {name} needs ROS 2")
        assert f"module {missing} is not installed" in sentence
        assert "pip install '.[ros]' ./msg_defs" in sentence
        assert "pip install 'sal_height[ros]' and the wheel of sal_height_msgs" in sentence
    assert not list(tmp_path.iterdir())


def test_view_says_how_to_install_the_viewer(tmp_path: Path) -> None:
    words = ["view", str(Path(__file__).parents[2] / "bags" / "version_3"), "--save", str(tmp_path / "a.rrd")]
    ((status, said, complaint),), _ = run_fresh([words], ["rerun"])
    assert (status, said) == (2, "")
    assert_one_sentence(complaint.strip().removeprefix("sal-height: "), "module rerun", 'pip install "rerun-sdk')
    assert not list(tmp_path.iterdir())


def test_figures_end_with_status_1_if_a_check_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    right = paper_figures.FIGURES["fig3"]

    def shifted(trials: int, seed: int) -> Iterator[Curve]:
        return (replace(curve, value=curve.value + 2e-9) for curve in right.curves(trials, seed))

    monkeypatch.setitem(paper_figures.FIGURES, "fig3", replace(right, curves=shifted))
    assert main(["figures", "fig3", "--out", str(tmp_path / "wrong")]) == 1
    assert ", 0 off" not in capsys.readouterr().out
