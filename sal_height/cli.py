"""The command line: sal-height run, replay, calibrate, irf, psf, figures, montecarlo, import-gotcha, salvage."""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import yaml

from sal_height import __version__
from sal_height.errors import UserError
from sal_height.figures.help_texts import ARRAY, DEFAULT_TRIALS, FIGURES, MONTE_CARLO, PAIR
from sal_height.runs.help_texts import CALIBRATE, IRF, PSF
from sal_height.simulation import Preset, load_preset, parse_preset, preset_names

if TYPE_CHECKING:
    from sal_height.beams import Beams
    from sal_height.figures.montecarlo import Experiment

Subcommands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"  # noqa: SLF001 (it has no other name)

OBJECTIVE_NAMES = {"normalised": "normalised", "numerator": "numerator", "seed": "numerator"}
"""Objectives of the maximum-likelihood estimator by their names on the command line."""

EXAMPLES = """examples:
  sal-height run                                    fly the lidar over a street
  sal-height run --preset xband_relief --dwells 8   fly the radar over the Jacksboro fault
  sal-height run --cnr-db 10 --looks 4x2 --out out/noisy
  sal-height replay out/sal_spotlight/bag           make the heights anew and compare
  sal-height replay out/sal_spotlight/bag --param ml_height.objective=numerator
  sal-height calibrate out/sal_spotlight/bag        receivers and beams, from whatever was flown over
  sal-height irf out/replay_gotcha/bag              width and sidelobes of the brightest target
  sal-height psf tape.npy                           point-spread function, from targets and from speckle
  sal-height figures                                the papers' figures beside theory
  sal-height montecarlo array --cnr-db 10 --theta 1.75 --looks 4
"""

EXIT_STATUS = """exit status:
  0    done
  1    run: not one valid height came out;
       replay: heights differ from the recorded ones, are missing or extra, and no --param was given;
       psf: neither targets nor speckle told anything
  2    something given cannot be used, or the run failed; one sentence on stderr says what
  130  interrupted by SIGINT (Ctrl-C), SIGTERM or SIGHUP; what was done until then is on disk
"""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status, see EXIT_STATUS."""
    options = _parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # as nohup has it
        signal.signal(signal.SIGHUP, signal.default_int_handler)
    try:
        return int(options.command(options))
    except UserError as error:
        print(f"sal-height: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="sal-height",
        description="Height images from synthetic-aperture lidar and multi-beam radar, as a ROS 2 graph.",
        epilog=f"{EXAMPLES}\n{EXIT_STATUS}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    shown: dict[str, Any] = {"epilog": EXIT_STATUS, "formatter_class": argparse.RawDescriptionHelpFormatter}
    parser.add_argument("--version", action="version", version=f"sal_height {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser(
        "run", help="simulate a flight through the graph; leaves bag, report and picture", **shown
    )
    run.add_argument(
        "--preset",
        default="sal_spotlight",
        metavar="NAME|FILE",
        help=f"{', '.join(preset_names())}, or a YAML file (default: %(default)s)",
    )
    run.add_argument("--scene", metavar="NAME|PATH", help="street, jacksboro_fault, or a DEM as .tif or .npz")
    run.add_argument("--dwells", type=int, metavar="N", help="number of dwells (default: the preset's)")
    run.add_argument("--cnr-db", type=float, metavar="X", help="CNR of one detector looking straight at the ground, dB")
    run.add_argument("--looks", type=_looks, metavar="RxA", help="pixels averaged in range x azimuth, e.g. 2x2")
    run.add_argument("--seed", type=_seed, default=1, metavar="S", help="of all random numbers (default: %(default)s)")
    run.add_argument("--processes", action="store_true", help="each node in a process of its own")
    run.set_defaults(command=_run)

    replay = commands.add_parser(
        "replay", help="play a bag through the same nodes; compares with what was recorded", **shown
    )
    replay.add_argument("bag", type=Path, metavar="BAG", help="folder of the bag, or its .mcap file")
    replay.set_defaults(command=_replay)
    calibrate = commands.add_parser(
        "calibrate",
        help="measure a sensor's receivers and beams on what it has flown over; leaves calibration.npz",
        description=CALIBRATE,
        **shown,
    )
    calibrate.add_argument("bag", type=Path, metavar="BAG", help="folder of the bag, or its .mcap file")
    calibrate.set_defaults(command=_calibrate)
    for command, default in (
        (run, "out/PRESET"),
        (replay, "out/replay_BAG"),
        (calibrate, "out/calibrate_BAG"),
    ):
        _add_out(command, default)
        command.add_argument(
            "--param",
            action="append",
            default=[],
            type=_parameter,
            metavar="NODE.NAME=VALUE",
            help="set a node's parameter; may be repeated",
        )

    irf = commands.add_parser(
        "irf",
        help="measure a target's impulse response in images; leaves irf.json and irf.png",
        description=IRF,
        **shown,
    )
    _add_images(irf, "*")
    irf.add_argument(
        "--near", type=_pixel, metavar="ROW,COL", help="measure the brightest target within 8 pixels of it"
    )
    irf.add_argument("--windows", action="store_true", help="show what this program's windows cost and gain instead")
    _add_out(irf, "out/irf")
    irf.set_defaults(command=_irf)

    psf = commands.add_parser(
        "psf",
        help="measure the complex point-spread function on images; leaves psf.json, psf.npz and psf.png",
        description=PSF,
        **shown,
    )
    _add_images(psf, "+")
    psf.add_argument(
        "--chip",
        type=_looks,
        metavar="RxA",
        help="pixels around a target in range x azimuth (default: 64x64, or what the smallest image has)",
    )
    _add_out(psf, "out/psf")
    psf.set_defaults(command=_psf)

    _add_figures(commands)
    _add_montecarlo(commands)

    gotcha = commands.add_parser("import-gotcha", help="turn AFRL Gotcha phase history into a bag")
    gotcha.add_argument("files", type=Path, nargs="+", metavar="FILE", help="consecutive data_3dsar_*.mat files")
    gotcha.add_argument("--out", type=Path, required=True, metavar="BAG", help="folder of the new bag")
    gotcha.set_defaults(command=_import_gotcha)

    salvage = commands.add_parser("salvage", help="save what is whole in a bag whose recording was cut off")
    salvage.add_argument("bag", type=Path, metavar="BAG")
    salvage.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the new bag")
    salvage.set_defaults(command=_salvage)
    return parser


def _add_figures(commands: Subcommands) -> None:
    figures = commands.add_parser(
        "figures",
        help="make the papers' figures anew, beside theory",
        description=FIGURES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    figures.add_argument(
        "names", nargs="*", metavar="NAME", help="fig3 to fig6, fig8 to fig11, relief_*, or all (default)"
    )
    figures.add_argument(
        "--trials",
        type=int,
        default=DEFAULT_TRIALS,
        metavar="N",
        help="Monte Carlo trials at each point (default: %(default)s)",
    )
    figures.add_argument(
        "--seed", type=_seed, default=1, metavar="S", help="of all random numbers (default: %(default)s)"
    )
    _add_out(figures, "out/figures")
    figures.set_defaults(command=_figures)


def _add_montecarlo(commands: Subcommands) -> None:
    shown: dict[str, Any] = {"formatter_class": argparse.RawDescriptionHelpFormatter}
    parser = commands.add_parser(
        "montecarlo", help="statistics of an estimator at one operating point", description=MONTE_CARLO, **shown
    )
    kinds = parser.add_subparsers(required=True, metavar="pair|array")
    pair = kinds.add_parser("pair", help="discriminant of two detectors", epilog=PAIR, **shown)
    array = kinds.add_parser("array", help="elevation by all detectors", epilog=ARRAY, **shown)
    for command, cnr in (
        (pair, "the sum channel at the target"),
        (array, "one detector looking straight at the target"),
    ):
        command.add_argument(
            "--pattern",
            default="sinc",
            metavar="NAME|PATH",
            help="sinc, jinc, gaussian, or a CSV file of measured beams (default: %(default)s)",
        )
        command.add_argument("--pitch", type=float, default=0.5, help="of the detectors (default: %(default)s)")
        command.add_argument(
            "--size",
            type=_size,
            default=(0.0, 0.0),
            metavar="WxH",
            help="of a detector in elevation and azimuth, e.g. 0.6x1.2 (default: a point)",
        )
        command.add_argument(
            "--cnr-db", type=float, default=10.0, metavar="X", help=f"of {cnr} in one look, dB (default: %(default)s)"
        )
        command.add_argument("--looks", type=int, default=4, metavar="K", help="(default: %(default)s)")
        command.add_argument(
            "--target",
            default="gaussian",
            metavar="steady|gaussian",
            help="of constant brightness, or speckle (default: %(default)s)",
        )
        command.add_argument(
            "--theta",
            type=float,
            default=0.0,
            help="elevation above the middle of the detectors (default: %(default)s)",
        )
        command.add_argument(
            "--objective",
            choices=sorted(OBJECTIVE_NAMES),
            default="normalised",
            help="of maximum likelihood; the paper's is the numerator only, or seed (default: %(default)s)",
        )
        command.add_argument(
            "--domain",
            type=float,
            metavar="HALF",
            help="half width of the search of maximum likelihood (default: number of detectors x pitch / 2)",
        )
        command.add_argument("--trials", type=int, default=DEFAULT_TRIALS, metavar="N", help="(default: %(default)s)")
        command.add_argument("--seed", type=_seed, default=1, metavar="S", help="(default: %(default)s)")
        command.add_argument("--json", action="store_true", help="print JSON instead of a table")
    estimators = ("ratio", "tls", "noise_subtraction", "ml")
    pair.add_argument(
        "--estimator",
        choices=estimators,
        default="ratio",
        help="of the discriminant; ml searches the elevation first (default: %(default)s)",
    )
    array.add_argument(
        "--estimator",
        choices=estimators,
        default="ml",
        help="ml: all detectors; the others: the strongest pair's discriminant (default: %(default)s)",
    )
    pair.add_argument("--detectors", type=int, metavar="M", default=2, help="a pair has %(default)s")
    array.add_argument("--detectors", type=int, metavar="M", help="(default: 16, or as many as the file of beams has)")
    pair.set_defaults(command=_montecarlo, kind="pair")
    array.set_defaults(command=_montecarlo, kind="array")


def _add_images(command: argparse.ArgumentParser, count: str) -> None:
    command.add_argument("images", type=Path, nargs=count, metavar="IMAGE", help=".npy or .npz file, or bag")
    command.add_argument("--dwell", type=int, metavar="N", help="only images of this dwell")
    command.add_argument("--detector", type=int, metavar="N", help="only images of this detector")
    command.add_argument(
        "--azimuth-axis",
        type=int,
        choices=(0, 1),
        default=1,
        help="in .npy and .npz: 1 if columns follow each other along the flight, 0 if rows do (default: %(default)s)",
    )


def _add_out(command: argparse.ArgumentParser, default: str) -> None:
    command.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"output folder, new or empty (default: {default}, or the next free of …_2, …_3)",
    )


def _run(options: argparse.Namespace) -> int:
    from sal_height.io import free_folder
    from sal_height.runs.conductor import Execution
    from sal_height.runs.simulate import RELIEF_MAP, run

    preset = _changed(load_preset(options.preset), options)
    out = options.out or free_folder(Path("out") / preset.name)
    outcome = run(preset, options.seed, out, _collected(options.param), Execution(options.processes))
    pictured = (out / "height.png").is_file()
    files = [str(out / name) for name in ("height.png", RELIEF_MAP, "report.json") if (out / name).is_file()]
    interrupted = " (interrupted)" if outcome.interrupted else ""
    print(f"{outcome.dwells} dwells{interrupted}; see {', '.join(files)} and {out}/bag")
    if outcome.interrupted:
        return 130
    if not pictured:
        print(f"sal-height: Not one valid height came out; {out}/report.json says what was dropped.", file=sys.stderr)
        return 1
    return 0


def _replay(options: argparse.Namespace) -> int:
    from sal_height.io import free_folder
    from sal_height.runs.replay import replay

    out = options.out or free_folder(Path("out") / f"replay_{_bag_name(options.bag)}")
    outcome, compared = replay(options.bag, out, _collected(options.param))
    for topic, result in compared.items():
        verdict = "equal to the recorded ones, value for value" if result.equal else f"different: {result}"
        print(f"{topic}: {result.matched} height images, {verdict}")
    print(f"{'interrupted; ' if outcome.interrupted else ''}see {out}/report.json and {out}/bag")
    if outcome.interrupted:
        return 130
    return int(not options.param and not all(result.equal for result in compared.values()))


def _calibrate(options: argparse.Namespace) -> int:
    from sal_height.io import free_folder
    from sal_height.runs.calibrate import CALIBRATION, calibrate, calibration_table

    out = options.out or free_folder(Path("out") / f"calibrate_{_bag_name(options.bag)}")
    _, calibration = calibrate(options.bag, out, _collected(options.param))
    if calibration is None:
        print(f"interrupted; see {out}/report.json")
        return 130
    print(calibration_table(calibration))
    print(f"see {out}/calibration.png; apply it with --param sar_compression.calibration={out / CALIBRATION}")
    return 0


def _bag_name(bag: Path) -> str:
    """Name of the folder of a bag; of the one around it where it is called just "bag"."""
    path = bag.resolve()
    folder = path.parent if path.suffix == ".mcap" and not path.is_dir() else path
    return folder.parent.name if folder.name == "bag" else folder.name


def _irf(options: argparse.Namespace) -> int:
    from sal_height.io import free_folder
    from sal_height.runs.irf import irf, response_table, window_table

    if options.windows == bool(options.images):
        raise UserError("Nothing to do, or two things; name images to measure, or give --windows.")
    if options.windows:
        print(window_table())
        return 0
    out = options.out or free_folder(Path("out") / "irf")
    entries = irf(options.images, out, options.near, options.dwell, options.detector, options.azimuth_axis)
    print(response_table(entries))
    print(f"see {out}/irf.json and {out}/irf.png")
    return 0


def _psf(options: argparse.Namespace) -> int:
    from sal_height.io import free_folder
    from sal_height.runs.psf import determined, psf, psf_table

    out = options.out or free_folder(Path("out") / "psf")
    entries = psf(options.images, out, options.chip, options.dwell, options.detector, options.azimuth_axis)
    print(f"{psf_table(entries)}\nsee {out}/psf.json and {', '.join(sorted(str(p) for p in out.glob('psf*.png')))}")
    return 0 if determined(entries) else 1


def _figures(options: argparse.Namespace) -> int:
    from sal_height.figures.catalogue import FIGURES as KNOWN
    from sal_height.figures.catalogue import make_figures, summary
    from sal_height.io import free_folder

    names = [name for name in options.names if name != "all"]
    everything = not names or "all" in options.names
    out = options.out or free_folder(Path("out") / "figures")
    checks = make_figures([*names, *(KNOWN if everything else ())], out, options.trials, options.seed)
    print(f"{summary(checks)}; see {out}/checks.json")
    return 0


def _montecarlo(options: argparse.Namespace) -> int:
    from sal_height.figures.montecarlo import array_statistics, array_with, pair_statistics

    beams = array_with(options.pattern, options.pitch, options.detectors, options.size)
    measure = {"pair": pair_statistics, "array": array_statistics}[options.kind]
    objective = OBJECTIVE_NAMES[options.objective]
    statistics = measure(_experiment(options, beams), options.estimator, objective, options.domain)
    _print_statistics(statistics, options.json)
    return 0


def _experiment(options: argparse.Namespace, beams: Beams) -> Experiment:
    from sal_height.figures.montecarlo import Experiment

    return Experiment(beams, options.theta, options.cnr_db, options.looks, options.target, options.trials, options.seed)


def _print_statistics(statistics: dict[str, Any], as_json: bool) -> None:
    from sal_height.figures.montecarlo import statistics_table

    print(json.dumps(statistics, indent=2, allow_nan=False) if as_json else statistics_table(statistics))


def _import_gotcha(options: argparse.Namespace) -> int:
    from sal_height.runs.gotcha import import_gotcha

    pulses = import_gotcha(options.files, options.out)
    print(f"{pulses} pulses in {options.out}; focus them with: sal-height replay {options.out}")
    return 0


def _salvage(options: argparse.Namespace) -> int:
    from sal_height.bag.salvage import salvage

    print(f"{salvage(options.bag, options.out)} messages saved in {options.out}")
    return 0


def _changed(preset: Preset, options: argparse.Namespace) -> Preset:
    """The preset with the command line's values in it, validated again."""
    changes = {
        key: getattr(options, key)
        for key in ("scene", "dwells", "cnr_db", "looks")
        if getattr(options, key) is not None
    }
    return parse_preset(dataclasses.asdict(preset) | changes, f"{preset.name} with the options given")


def _collected(parameters: list[tuple[str, str, Any]]) -> dict[str, dict[str, Any]]:
    values: dict[str, dict[str, Any]] = {}
    for node, name, value in parameters:
        values.setdefault(node, {})[name] = value
    return values


def _parameter(text: str) -> tuple[str, str, Any]:
    match = re.fullmatch(r"(\w+)\.(\w+)=(.*)", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NODE.NAME=VALUE")
    try:
        value = yaml.safe_load(match[3])
    except (yaml.YAMLError, ValueError):
        value = match[3]  # a text, which is refused where none is allowed
    return match[1], match[2], value


def _looks(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form RxA with numbers of 1 or more, e.g. 2x2")
    return int(match[1]), int(match[2])


def _size(text: str) -> tuple[float, float]:
    match = re.fullmatch(r"(\d*\.?\d+)x(\d*\.?\d+)", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form WxH with numbers, e.g. 0.6x1.2")
    return float(match[1]), float(match[2])


def _pixel(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+),(\d+)", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form ROW,COL with whole numbers, e.g. 120,45")
    return int(match[1]), int(match[2])


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) >= 2**31:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 to {2**31 - 1}")
    return int(text)


if __name__ == "__main__":
    raise SystemExit(main())
