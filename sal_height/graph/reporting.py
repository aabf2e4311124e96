"""Common parts of `run`, `replay` and `calibrate`: their report.json, and the handling of an outcome."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from sal_height import __version__
from sal_height.bag import files
from sal_height.errors import UserError
from sal_height.graph.catalogue import NodeParameters
from sal_height.graph.plan import Outcome
from sal_height.io import or_null, write_text
from sal_height.nodes.accounts.account import Account
from sal_height.renamed import with_new_names

PARAMETERS = files.PARAMETERS
"""Name of the nodes' parameters (JSON) in the custom data of a bag."""

PRESET, SEED = "preset", "seed"
"""Names of the preset (JSON) and the seed of a simulated flight in the custom data of a bag."""

RELIEF_MAP = "relief_map.tif"
"""Name of the relief map in an output folder."""


@contextmanager
def reporting(folder: Path, known: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A report that starts with what is `known`; left in `folder`/report.json even after a failure, which it names.

    Raises:
        UserError: the file cannot be written.
    """
    report = {"version": __version__, **known}

    def write() -> None:
        write_text(folder / "report.json", json.dumps(report, indent=2) + "\n")

    try:
        yield report
    except BaseException as error:
        report["failed"] = str(error) or type(error).__name__
        with suppress(UserError):  # the first failure is the one to report
            write()
        raise
    write()


def conclude(outcome: Outcome, values: NodeParameters, report: dict[str, Any]) -> None:
    """Put the outcome and the nodes' parameters into the report.

    Raises:
        UserError: the run has failed.
    """
    report["dwells"] = outcome.dwells
    report["interrupted"] = outcome.interrupted
    report["elapsed_s"] = outcome.elapsed_s
    report["stages"] = {name: _stage(account) for name, account in outcome.stages.items()}
    report["losses"] = outcome.losses
    report["parameters"] = values
    if outcome.failure:
        raise outcome.failure


def merged(base: NodeParameters, changes: NodeParameters) -> dict[str, dict[str, Any]]:
    """Node parameters of `base`, overridden by those of `changes`, by their new names."""
    return {
        name: {**with_new_names(base.get(name, {})), **with_new_names(changes.get(name, {}))}
        for name in {**base, **changes}
    }


def _stage(account: Account) -> dict[str, Any]:
    """Entry of the report on one node."""
    return {
        "in": account.received,
        "processed": account.processed,
        "out": account.published,
        "published": dict(account.published_on),
        "dropped": dict(account.dropped),
        "ignored": dict(account.ignored),
        "latency_p50_ms": or_null(account.latency_p50_ms),
        "latency_p95_ms": or_null(account.latency_p95_ms),
    }
