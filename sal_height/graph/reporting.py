"""Common parts of `run`, `replay` and `calibrate`: report.json, tables on the terminal, handling of an outcome."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from sal_height import __version__
from sal_height.bag import files
from sal_height.bag.compare import TopicComparison
from sal_height.elevation import Validity
from sal_height.engine.registry import STAGES, takes_heights
from sal_height.errors import UserError
from sal_height.graph.catalogue import HEIGHTS, NodeParameters
from sal_height.graph.plan import Outcome
from sal_height.io import or_null, write_text
from sal_height.nodes.accounts.account import Account
from sal_height.renamed import with_new_names
from sal_height.tables import ABSENT, aligned, number_text

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
    report["losses_as_flown"] = outcome.losses_as_flown
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


MOSTLY_KNOWN = 0.8
"""Fraction of the lit pixels with a height from which on errors may be compared with the bound.

Where more is refused, what is left is chosen by its errors, and may be below it.
"""

_COLUMNS = (
    ("valid %", "valid", ".1f", 100.0),
    ("bias m", "bias_m", "+.3g", 1.0),
    ("common sigma m", "common_sigma_m", ".3g", 1.0),
    ("s68 m", "s68_m", ".3g", 1.0),
    ("within 1 sigma %", "within_1_sigma", ".1f", 100.0),
    ("beyond 5 sigma %", "beyond_5_sigma", ".2f", 100.0),
)
"""Of the table of results: heading, key of the statistics, format and factor."""


def results_table(outcome: Outcome, accuracy: Mapping[str, Mapping[str, Any]]) -> str:
    """Height images, messages dropped and, where the truth is known, the errors of each estimator.

    Args:
        outcome: outcome of the run.
        accuracy: statistics of each estimator (`surface_statistics`) by prefix of its topics; empty: no truth is known.
    """
    columns = _COLUMNS if accuracy else ()
    rows = [["estimator", "images", "dropped", *(heading for heading, *_ in columns)]]
    for node, prefix in HEIGHTS.items():
        if node in outcome.stages:
            account, errors = outcome.stages[node], accuracy.get(prefix, {})
            counts = account.published_on.get(f"{prefix}/height", 0), sum(account.dropped.values())
            numbers = (number_text(errors.get(key), form, factor) for _, key, form, factor in columns)
            rows.append([prefix, *map(str, counts), *numbers])
    return aligned(rows)


def achieved(accuracy: Mapping[str, Mapping[str, Any]]) -> str:
    """Summary of the errors of the estimator with the least scatter, and its bound; empty without errors.

    The bound is that of the looks of a pixel: it does not apply to heights to which neighbours contribute.

    Args:
        accuracy: statistics of each estimator (`surface_statistics`) by prefix of its topics.
    """
    bounded = [prefix for node, prefix in HEIGHTS.items() if not takes_heights(STAGES[node])]
    # Without a lit pixel inside the array `valid` is unknown.
    judged = {prefix: accuracy[prefix] for prefix in bounded if accuracy.get(prefix, {}).get("valid")}
    known = {prefix: errors for prefix, errors in judged.items() if errors["s68_m"]}
    if not known:
        return ""
    best = min(known, key=lambda name: float(known[name]["s68_m"]))
    errors = known[best]
    common = "" if errors["common_sigma_m"] is None else f" (stated common sigma {_length(errors['common_sigma_m'])})"
    text = (
        f"Heights of {best}: mean error {_length(errors['bias_m'], '+')}{common}, scatter {_length(errors['s68_m'])}, "
        f"{100 * errors['beyond_5_sigma']:.2f} % beyond 5 sigma, in {100 * errors['valid']:.1f} % of the lit pixels."
    )
    alone = errors["kinds"]["OK"]["s68_m"]
    if errors["valid"] < MOSTLY_KNOWN or not errors["crb_m"] or not alone:
        return text
    bound = _length(errors["crb_m"])
    # Each dwell has a shared error of its own, which is part of the scatter of all dwells.
    shared = ", with shared errors that differ from dwell to dwell" if common else ""
    one = f"Pixels with one surface scatter by {_length(alone)}{shared}"
    return f"{text}\n{one}; the Cramér-Rao bound of their looks is {bound}."


def _length(metres: float, sign: str = "") -> str:
    """A length as people write it; `sign`: "+" for one that has a sign."""
    return f"{1000 * metres:{sign}.3g} mm" if abs(metres) < 0.9995 else f"{metres:{sign}.2f} m"


def comparison_table(compared: Mapping[str, TopicComparison]) -> str:
    """Comparison of topics with the golden ones, and a line on each field that is beyond its tolerance."""
    heading = ["topic", "verdict", "compared", "missing", "extra", "values", "different", "beyond tolerance"]
    rows = []
    for topic, result in compared.items():
        fields = result.fields.values()
        counts = [result.matched, result.missing, result.extra, sum(one.values for one in fields)]
        counts += [sum(one.different for one in fields), sum(one.outside for one in fields)]
        rows.append([topic, result.verdict, *map(str, counts)])
    changes = list(_changes(compared))
    named = 5
    if len(changes) > named:
        changes[named:] = [f"{len(changes) - named} more fields changed; the report lists them."]
    return "\n".join([aligned([heading, *rows]), *changes])


def _changes(compared: Mapping[str, TopicComparison]) -> Iterator[str]:
    """Lines on the fields with values beyond the tolerance, for all topics with the same worst value together."""
    said: dict[str, list[str]] = {}
    for topic, result in compared.items():
        for name, one in result.fields.items():
            if one.outside and one.worst:
                worst = one.worst
                where = f"dwell {worst.dwell}" + (f", value {worst.position}" if one.values > result.matched else "")
                made, golden = (_named(name, value) for value in (worst.made, worst.golden))
                said.setdefault(f"{name} is {made} instead of {golden} in {where}", []).append(topic)
    return (f"{what} ({', '.join(topics)})." for what, topics in said.items())


def _named(field: str, value: str) -> str:
    """A value as text; that of a validity by its name, such as OK."""
    known = field == "validity" and value in {str(one.value) for one in Validity}
    return Validity(int(value)).name if known else value


def campaign_table(rows: Sequence[Mapping[str, Any]], varied: Sequence[str]) -> str:
    """Results of each bag and setting of a campaign; sigma and error are those of all estimators, in m."""
    endings = ("median_sigma_m", "s68_m")
    numbers = [name for name in dict.fromkeys(key for row in rows for key in row) if name.endswith(endings)]
    heading = ["bag", *varied, "dwells", "dropped", "s", "against recorded", *numbers]
    lines = []
    for row in rows:
        done = [str(row.get("dwells", ABSENT)), str(row.get("dropped", ABSENT)), number_text(row.get("seconds"), ".3g")]
        verdict = "failed" if row["failure"] else row["against_recorded"] or ABSENT
        measured = [number_text(row.get(name), ".3g") for name in numbers]
        lines.append([row["bag"], *(str(row[name]) for name in varied), *done, verdict, *measured])
    return aligned([heading, *lines])


def images_table(images: Sequence[Mapping[str, Any]]) -> str:
    """The brightest target of each image of a single channel."""
    heading = ["dwell", "peak over median dB", "width of rows m", "width of columns m"]
    keys = ("peak_over_median_db", "row_width_3db_m", "col_width_3db_m")
    return aligned([heading, *([str(one["dwell"]), *(number_text(one[key], ".4g") for key in keys)] for one in images)])
