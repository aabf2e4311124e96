"""Campaigns: many bags, each with several settings if wanted, processed side by side on the workers of Dask."""

from __future__ import annotations

import itertools
import json
import logging
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from sal_height import __version__
from sal_height.bag.compare import compare_bags
from sal_height.bag.files import bag_files
from sal_height.bag.reader import BagReader
from sal_height.bag.tolerance import ROUNDING
from sal_height.bag.topics import HEIGHT_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.engine.height_items import Heights
from sal_height.engine.movers import MOVERS
from sal_height.engine.results import Product
from sal_height.errors import UserError
from sal_height.graph.catalogue import ADJUSTER, HEIGHTS, NodeParameters, check_parameters
from sal_height.graph.reporting import PARAMETERS, merged
from sal_height.io import bag_name, write_text, writing
from sal_height.messages.kinds import write_heights
from sal_height.numeric import available_processors
from sal_height.progress import Bar
from sal_height.runs.chain.chain_runs import BagRun, plan
from sal_height.runs.chain.replay_parameters import ReplayPlan
from sal_height.runs.replay.judge import verdict_of
from sal_height.runs.truth.report import read_accuracy, read_images, recorded_flight
from sal_height.workers.processes import ONE_THREAD

DONE = "done.json"
"""File in the folder of a part, or of a bag, with its result; it is written last."""


@dataclass(frozen=True)
class Case:
    """A bag and the parameters it is processed with.

    Attributes:
        bag: folder of the bag, or its file.
        folder: folder of its results.
        values: values of parameters that are varied, by "node.name".
        given: parameters of nodes that replace recorded ones, with those that are varied.
        estimators: names of those whose heights are made; none: as `chain_of` has it.
    """

    bag: Path
    folder: Path
    values: Mapping[str, Any]
    given: NodeParameters
    estimators: tuple[str, ...] = ()


def process_case(case: Case, jobs: int) -> dict[str, Any]:
    """Make the heights of a bag, track them and judge them, unless that is done; returns a row of the summary.

    Raises:
        UserError: the bag cannot be used, a parameter is not allowed, or the heights cannot be written.
    """

    def make(new: Path) -> dict[str, Any]:
        scheme = plan(case.bag, case.given, case.estimators)
        topics = [f"{HEIGHTS[node]}/height" for node in scheme.chain.stages if node in HEIGHTS]
        begun, images = time.monotonic(), 0
        run = BagRun(scheme, scheme.chain.stages, jobs=jobs)
        custom_data = {**scheme.reader.custom_data, PARAMETERS: json.dumps(scheme.values)}
        with BagWriter(new / "bag", custom_data) as bag:
            for topic in topics:
                bag.add_topic(f"/{topic}", HEIGHT_TYPE)
            for made in run.results():
                if isinstance(made.result, Product) and isinstance(item := made.result.item, Heights):
                    time_ns = run.time_of(item.key)
                    for cdr in write_heights(item):
                        bag.write(f"/{made.result.port}", cdr, time_ns, time_ns)
                    images += 1
        losses = run.losses
        row = {
            "bag": str(case.bag),
            **case.values,
            "failure": "",
            "dwells": len(scheme.frames),
            "dropped": losses.dropped.total(),
            "drops": json.dumps(losses.dropped),
            "warnings": json.dumps([*scheme.warnings, *losses.sentences.values()]),
            "images": images,
            "seconds": time.monotonic() - begun,
        }
        return row | _judged(scheme, new / "bag")

    return _once(case.folder, make)


def _judged(scheme: ReplayPlan, made: Path) -> dict[str, Any]:
    """Columns on the heights: fraction, sigma, and comparison with those in the bag and with the truth."""
    reader = scheme.reader
    recorded = [topic.name for topic in reader.topics.values() if topic.type_name == HEIGHT_TYPE and topic.count]
    compared = compare_bags(reader, BagReader(made), ROUNDING, recorded, by_stamp=True)
    columns: dict[str, Any] = {"against_recorded": verdict_of(compared) if compared else ""}
    for prefix, images in read_images(made).items():
        sigma = np.concatenate([image.surfaces[0].sigma for image in images if image.surfaces])
        known_sigma = np.isfinite(sigma)
        columns[f"{prefix}_with_height"] = float(np.mean(known_sigma)) if known_sigma.size else None
        columns[f"{prefix}_median_sigma_m"] = float(np.median(sigma[known_sigma])) if known_sigma.any() else None
    flight = recorded_flight(reader)
    if flight is None:
        return columns
    for prefix, numbers in read_accuracy(made, flight, scheme.chain.stages).statistics.items():
        for name in ACCURACY:
            columns[f"{prefix}_{name}"] = numbers.get(name)
    return columns


ACCURACY = ("valid", "bias_m", "common_sigma_m", "rms_m", "s68_m", "sigma_m", "within_1_sigma", "beyond_5_sigma")
"""Numbers of the accuracy, as report.json has them, that the summary has of each estimator."""


def _once(folder: Path, make: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    """Have a folder made unless it is done, and return its result.

    The folder is made next to its final name, and moved there once it is whole.
    """
    if is_done(folder):
        return known(folder)
    new = folder.with_name(f"{folder.name}.unfinished")
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    begun = time.monotonic()
    try:
        result = make(new)
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise
    result.setdefault("seconds", time.monotonic() - begun)
    write_text(new / DONE, json.dumps(result, indent=2) + "\n")
    new.rename(folder)
    return result


def is_done(folder: Path) -> bool:
    """True if a folder has been made."""
    return (folder / DONE).is_file()


def known(folder: Path) -> dict[str, Any]:
    """Result in a folder that has been made."""
    found: dict[str, Any] = json.loads((folder / DONE).read_text(encoding="utf-8"))
    return found


CAMPAIGN, SUMMARY, PICTURE = "campaign.json", "summary.parquet", "comparison.png"
"""Files in the output folder: the request, a row for each bag and setting, and the settings compared."""

CONNECT_S = 10.0
"""Time for which a scheduler is searched for."""

EXTRA = "A campaign needs the package {}, which is not installed; run: pip install 'sal_height[batch]'."


@dataclass(frozen=True)
class Campaign:
    """Inputs and settings of a campaign.

    Attributes:
        bags: folders or files.
        given: parameters of nodes that replace recorded ones.
        varied: values that a parameter gets in turn, by "node.name"; each is combined with each of the others.
        estimators: names of those whose heights are made; empty: those whose heights a bag has, or the standard ones.
    """

    bags: Sequence[Path]
    given: NodeParameters = field(default_factory=dict)
    varied: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    estimators: tuple[str, ...] = ()

    def cases(self, out: Path) -> list[Case]:
        """The bags with all settings; folders have the names of the bags, and of the settings if there are several."""
        names = _unlike([bag_name(bag) for bag in self.bags])
        cases = []
        for bag, name in zip(self.bags, names, strict=True):
            for number, chosen in enumerate(itertools.product(*self.varied.values())):
                values = dict(zip(self.varied, chosen, strict=True))
                folder = out / name / f"setting_{number}" if self.varied else out / name
                cases.append(Case(bag, folder, values, merged(self.given, _nested(values)), self.estimators))
        return cases

    def as_json(self) -> dict[str, Any]:
        """Contents of the output folder, so that the same campaign can go on."""
        return {
            "version": __version__,
            "bags": [str(bag.resolve()) for bag in self.bags],
            "parameters": self.given,
            "varied": self.varied,
            "estimators": self.estimators,
        }


@dataclass(frozen=True)
class Workers:
    """Processes or hosts that do the work.

    Attributes:
        count: number of processes that are started on this machine; 0: one for each processor.
        scheduler: address of a Dask cluster that does the work instead, and sees the same files; empty: no cluster.
    """

    count: int = 0
    scheduler: str = ""


def run_campaign(campaign: Campaign, out: Path, workers: Workers) -> list[dict[str, Any]]:
    """Process bags, or continue after an interruption, and write the summary; returns its rows.

    A bag that cannot be processed has a row with its failure, and does not stop the others.

    Args:
        campaign: inputs and settings.
        out: folder that is new or empty, or contains the same campaign.
        workers: processes or hosts that do the work.

    Raises:
        UserError: a bag does not exist, an estimator or a parameter is not allowed, the folder contains something
            else, there is no cluster, or a package is not installed.
        KeyboardInterrupt: the user has interrupted; what is done stays.
    """
    if find_spec("pyarrow") is None:
        raise UserError(EXTRA.format("pyarrow"))
    _check_estimators(campaign.estimators)
    cases = campaign.cases(out)
    for case in cases:
        check_parameters(case.given)
        bag_files(case.bag)
    _enter(campaign, out)
    rows = {number: known(case.folder) for number, case in enumerate(cases) if is_done(case.folder)}
    remaining = {number: case for number, case in enumerate(cases) if number not in rows}
    with Bar(total=len(remaining), unit="bag", desc="batch", disable=not remaining) as progress:
        for number, (row, failure) in _processed(remaining, workers):
            case = cases[number]
            rows[number] = {"bag": str(case.bag), **case.values, "failure": failure} if failure else row
            progress.update()
    in_order = [rows[number] for number in range(len(cases))]
    _write_summary(in_order, out / SUMMARY)
    if campaign.varied:
        from sal_height.runs.campaign.campaign_picture import draw_settings  # noqa: PLC0415 (brings Matplotlib)

        with writing(out / PICTURE):
            draw_settings(in_order, list(campaign.varied), out / PICTURE)
    return in_order


def _processed(cases: Mapping[int, Case], workers: Workers) -> Iterator[tuple[int, tuple[Any, str]]]:
    """The number of each case, with its row, or None and the reason of its failure: one alone is processed here.

    Raises:
        UserError: Dask is not installed, or there is no cluster.
    """
    processes = workers.count or available_processors()
    if len(cases) == 1 and not workers.scheduler:
        ((number, case),) = cases.items()
        yield number, attempt(process_case, case, processes)
    elif cases:
        jobs = 1 if workers.scheduler else max(1, processes // len(cases))
        with _client(replace(workers, count=min(processes, len(cases)))) as client:
            from distributed import as_completed  # noqa: PLC0415 (an extra)

            numbers = {
                client.submit(attempt, process_case, case, jobs, pure=False): number for number, case in cases.items()
            }
            for future in as_completed(list(numbers)):
                lost = f"A worker ended while it worked on it: {future.exception()}"
                yield numbers[future], future.result() if future.status == "finished" else (None, lost)


def attempt(function: Callable[..., Any], *arguments: Any) -> tuple[Any, str]:
    """Call a function, and return its result and an empty text, or None and the reason of its failure."""
    try:
        return function(*arguments), ""
    except UserError as error:
        return None, str(error)
    except Exception as error:  # noqa: BLE001 (the other bags are to be processed)
        return None, f"Unexpected failure, please report it: {type(error).__name__}: {error}"


@contextmanager
def _client(workers: Workers) -> Iterator[Any]:
    """A client of a cluster, which is ended with it if it was started for it.

    Raises:
        UserError: Dask is not installed, or there is no cluster at the address.
    """
    try:
        import dask  # noqa: PLC0415 (an extra)
        from distributed import Client, LocalCluster  # noqa: PLC0415
    except ImportError as error:
        raise UserError(EXTRA.format("distributed")) from error
    for name in ("distributed", "tornado.application"):  # what matters of its cluster is in the results
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if workers.scheduler:
        try:
            client = Client(workers.scheduler, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            raise UserError(f"There is no Dask scheduler at {workers.scheduler!r}: {error}.") from error
        with client:
            yield client
        return
    with _deaf_to_interruption():
        dask.config.set({"distributed.worker.daemon": False})  # a worker may have jobs of its own
        cluster = LocalCluster(
            n_workers=workers.count or os.cpu_count(),
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
            env=ONE_THREAD,
        )
    with cluster, Client(cluster) as client:
        yield client


@contextmanager
def _deaf_to_interruption() -> Iterator[None]:
    """Start processes that ignore SIGINT, which a terminal sends to all, so that their parent ends them in order."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _check_estimators(names: Sequence[str]) -> None:
    """Refuse what needs the dwells of a bag in their order, while the parts of a campaign do not know each other."""
    if HEIGHTS[ADJUSTER] in names:
        raise UserError(
            "Adjusted heights need the dwells in their order; make them by `sal-height replay`, or by `sal-height "
            "adjust` and a batch of its bag."
        )
    if MOVERS in names:
        raise UserError("A batch makes heights only; make movers by `sal-height movers` or `sal-height replay`.")


def _enter(campaign: Campaign, out: Path) -> None:
    """Start in a folder, or go on in one that contains the same campaign.

    Raises:
        UserError: it contains something else.
    """
    wanted = json.loads(json.dumps(campaign.as_json()))
    file = out / CAMPAIGN
    if file.is_file():
        if json.loads(file.read_text(encoding="utf-8")) != wanted:
            raise UserError(f"Folder {out} contains another campaign; choose another one by --out, or remove it.")
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserError(f"Folder {out} is not empty and contains no campaign; choose another one by --out.")
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    write_text(file, json.dumps(wanted, indent=2) + "\n")


def _write_summary(rows: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Write rows as a Parquet file; columns that a row lacks are empty in it."""
    import pyarrow as pa  # noqa: PLC0415 (an extra)
    from pyarrow.parquet import write_table  # noqa: PLC0415

    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: _alike([row.get(name) for row in rows]) for name in names}
    with writing(file):
        write_table(pa.table(columns), file)


def _alike(values: list[Any]) -> list[Any]:
    """Values of a column, all of one type: numbers, truth values or texts."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} or len(kinds) < 2:
        return [float(value) if kinds == {int, float} and value is not None else value for value in values]
    return [None if value is None else str(value) for value in values]


def _nested(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Values by node and name of those by "node.name"."""
    nested: dict[str, dict[str, Any]] = {}
    for full, value in values.items():
        node, _, name = full.partition(".")
        nested.setdefault(node, {})[name] = value
    return nested


def _unlike(names: Sequence[str]) -> list[str]:
    """Names, of which equal ones have got numbers."""
    taken: list[str] = []
    for name in names:
        numbered = (name if number == 1 else f"{name}_{number}" for number in itertools.count(1))
        taken.append(next(one for one in numbered if one not in taken))
    return taken
