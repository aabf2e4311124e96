"""`sal-height bag`: look at a bag, check, repair, cut, merge and upgrade it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from cyclopts import Group, Parameter
from cyclopts.validators import Number

from sal_height.commands._options import (
    BAGS,
    DONE,
    FAILED,
    Bag,
    DwellRange,
    Flag,
    OutputFolder,
    Tolerance,
    command,
    complain,
    output_folder,
    repeated,
)
from sal_height.io import bag_name
from sal_height.tables import counted

if TYPE_CHECKING:
    from sal_height.bag.described import DwellReport

PARTS = Group("What is done with a bag", sort_key=3)

EXAMPLES = """
  sal-height bag info out/small/bag     what it contains
  sal-height bag check out/small/bag    whether anything is wrong with it
  sal-height bag recover damaged/bag    what is whole of it, as a new bag
  sal-height bag diff golden/bag out/small/bag
  sal-height bag cut out/small/bag --dwells 1:1    a part, which can be replayed
  sal-height bag merge lidar navigation            bags of two recorders as one
"""

INFO_EXAMPLES = """
  sal-height bag info out/small/bag
  sal-height bag info out/small/bag --dwells     also which dwells lack channels
  sal-height bag info out/small/bag --json
"""

CHECK_EXAMPLES = """
  sal-height bag check out/small/bag
  sal-height bag check out/small/bag --json > findings.json
"""

RECOVER_EXAMPLES = """
  sal-height bag recover damaged/bag --out out/recovered
"""

DIFF_EXAMPLES = """
  sal-height bag diff golden/bag out/small/bag
  sal-height bag diff golden/bag out/small/bag --tolerance tolerances.yaml
  sal-height bag diff golden/bag out/small/bag --topic slc --topic ml/height
"""

CUT_EXAMPLES = """
  sal-height bag cut out/small/bag --dwells 1:1 --out out/second
  sal-height bag cut flight --from 60 --to 90.5        seconds from its start
  sal-height bag cut flight --from 1795404227.7        a time since 1970
"""

MERGE_EXAMPLES = """
  sal-height bag merge lidar navigation --out out/flight    of two recorders
  sal-height bag merge flight_0.mcap flight_1.mcap          files of a split
"""

UPGRADE_EXAMPLES = """
  sal-height bag upgrade bags/version_1 --out out/today
"""

LOST = "parts of the bag could not be read, or messages are lost; all else is in the new bag"
"""Meaning of status 1 of a recovery."""

Seconds: TypeAlias = Annotated[Decimal | None, Parameter(metavar="S", validator=Number(gte=0))]

Json: TypeAlias = Annotated[Flag, Parameter(name="--json")]

app = command("bag", BAGS, EXAMPLES)
app.help = "Look at a bag, check and repair it, cut a part out of it, merge several, and bring one up to date."
info_app = command("info", PARTS, INFO_EXAMPLES)
check_app = command("check", PARTS, CHECK_EXAMPLES, "there are findings")
recover_app = command("recover", PARTS, RECOVER_EXAMPLES, LOST)
diff_app = command("diff", PARTS, DIFF_EXAMPLES, "messages are missing or extra, or differ by more than the tolerance")
cut_app = command("cut", PARTS, CUT_EXAMPLES)
merge_app = command("merge", PARTS, MERGE_EXAMPLES)
upgrade_app = command("upgrade", PARTS, UPGRADE_EXAMPLES)
for part in (info_app, check_app, recover_app, cut_app, merge_app, upgrade_app, diff_app):
    app.command(part)


@info_app.default
def info(bag: Bag, /, *, dwells: Flag = False, json_: Json = False) -> int:
    """Topics, types, counts, rates, gaps, size and duration of a bag, from its index.

    Rates and gaps are those of the times at which messages were received. The
    number of frames shows how many are missing at least from whole dwells; only
    the messages show which (--dwells), and reading them takes longer.

    Args:
        dwells: Read all frames, and name every dwell that lacks channels or has some twice.
        json_: Print JSON instead of a table.
    """
    from sal_height.bag.info import bag_info, info_text, info_values

    found = bag_info(bag)
    reports = _dwell_reports(bag) if dwells else []
    if json_:
        values = info_values(found)
        print(json.dumps({**values, "dwells": [asdict(one) for one in reports]} if dwells else values, indent=2))
    else:
        print("\n".join([info_text(found), *map(str, reports)]))
    return DONE


def _dwell_reports(bag: Path) -> list[DwellReport]:
    from sal_height.bag.described import dwell_report, sensors_in
    from sal_height.bag.reader import BagReader

    reader = BagReader(bag)
    return [dwell_report(reader, sensor) for sensor in sensors_in(reader.topics)]


@check_app.default
def check(bag: Bag, /, *, json_: Json = False) -> int:
    """Check that a bag keeps the contract of rosbag2, and has what the nodes need.

    Every finding is a message with its remedy. All data are read, to
    verify their checksums. It checks, among others, metadata.yaml, types, dwells
    that lack channels, odometry around each dwell, stamps, parameters, and losses
    that the recorder reports.

    Args:
        json_: Print JSON instead of text.
    """
    from sal_height.bag.check import check_bag

    with _reading(bag) as advance:
        findings = check_bag(bag, advance)
    if json_:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        print("\n".join(map(str, findings)) or f"Nothing is wrong with {bag}.")
    return FAILED if findings else DONE


@contextmanager
def _reading(bag: Path) -> Iterator[Callable[[int, int], None]]:
    """A progress bar of the bytes that are read."""
    from sal_height.progress import Bar

    with Bar(desc=bag.name, unit="B", unit_scale=True, delay=1, leave=False) as progress:

        def advance(done: int, total: int) -> None:
            progress.total = total
            progress.update(done)

        yield advance


@recover_app.default
def recover(bag: Bag, /, *, out: OutputFolder = None) -> int:
    """Recover the intact messages of a bag that is damaged or whose recording was cut off.

    A table says how many messages of each topic are in the new bag, and how many
    are known to be lost; below, which parts of which file could not be read.

    Args:
        out: Folder of the new bag, new or empty. Default: out/recover_BAG, or the next free of out/recover_BAG_2, ….
    """
    return recover_bag(bag, output_folder(out, f"recover_{bag_name(bag)}"))


def recover_bag(bag: Path, folder: Path) -> int:
    """Recover a bag into a folder, and tell what is recovered and lost."""
    from sal_height.bag.salvage import recover, recovery_table

    recovery = recover(bag, folder)
    print(f"{recovery_table(recovery)}\n{counted(recovery.count, 'message')} recovered in {folder}")
    complain([*map(str, recovery.gaps)])
    return DONE if recovery.is_whole else FAILED


@diff_app.default
def diff(
    golden: Annotated[Path, Parameter(name="GOLDEN", help="Bag that is right: its folder, or its .mcap file.")],
    other: Annotated[Path, Parameter(name="OTHER", help="Bag that is judged.")],
    /,
    *,
    topic: Annotated[tuple[str, ...], repeated("TOPIC")] = (),
    tolerance: Tolerance = None,
    out: OutputFolder = None,
) -> int:
    """Compare two bags, field by field: equal, within the tolerance, or changed.

    Messages are matched by dwell and channel, others by their number. A table
    counts values, and sentences name what changed most; diff.json has all of it.
    comparison.png shows the worst dwell of the heights.

    Args:
        topic: Compare this topic; may be repeated. Default: all but those that say how a run went, such as diagnostics.
        out: Output folder, new or empty. Default: out/diff_OTHER, or the next free of out/diff_OTHER_2, ….
    """
    from sal_height.bag.compare import CHANGED, compare_bags
    from sal_height.bag.reader import BagReader
    from sal_height.bag.tolerance import ROUNDING, read_tolerances
    from sal_height.graph.reporting import comparison_table
    from sal_height.io import new_folder, write_text
    from sal_height.runs.replay.judge import as_json, draw_worst_dwell, topics_to_compare, verdict_of

    tolerances = read_tolerances(tolerance) if tolerance else ROUNDING
    bags = BagReader(golden), BagReader(other)
    topics = topics_to_compare(*bags, topic)
    folder = new_folder(output_folder(out, f"diff_{bag_name(other)}"))
    compared = compare_bags(*bags, tolerances, topics)
    draw_worst_dwell(*bags, compared, folder)
    write_text(folder / "diff.json", json.dumps(as_json(*bags, compared, tolerances), indent=2) + "\n")
    print(f"{comparison_table(compared)}\n{verdict_of(compared)}; see {folder}")
    return FAILED if verdict_of(compared) == CHANGED else DONE


@cut_app.default
def cut(
    bag: Bag,
    /,
    *,
    from_: Annotated[Seconds, Parameter(name="--from")] = None,
    to: Seconds = None,
    dwells: DwellRange = None,
    out: OutputFolder = None,
) -> int:
    """Cut a range of time or of dwells out of a bag, as a bag that can be replayed by itself.

    Dwells are kept whole or not at all, with odometry from a second before to a
    second after. What was latched before (descriptions of sensors, calibrations,
    static transforms) and the parameters of nodes are kept as they were last.
    Times are those at which messages were received, in seconds from the start of
    the bag, or since 1970.

    Args:
        from_: Keep what was received from here on.
        to: Keep what was received up to here.
        dwells: Keep the dwells with these numbers.
        out: Folder of the new bag, new or empty. Default: out/cut_BAG, or the next free of out/cut_BAG_2, ….
    """
    folder = output_folder(out, f"cut_{bag_name(bag)}")

    from sal_height.bag.copies import Range, time_of
    from sal_height.bag.copies import cut as cut_out
    from sal_height.bag.reader import BagReader

    reader = BagReader(bag)
    begin_ns, end_ns = (None if time is None else time_of(reader, time) for time in (from_, to))
    done = cut_out(bag, folder, Range(begin_ns, end_ns, dwells))
    for topic, count in done.dwells.items():
        print(f"{counted(count, 'dwell')} of {topic}")
    print(f"{counted(done.counts.total(), 'message')} in {folder}")
    return DONE


@merge_app.default
def merge(
    bags: Annotated[tuple[Path, ...], Parameter(name="BAG", show_default=False)],
    /,
    *,
    out: OutputFolder = None,
) -> int:
    """Merge bags into one, in the order in which their messages were received.

    The bags are files of a split, or those of several recorders of one flight. A
    message that several of them have is kept once, and so is a latched one that
    they repeat. Bags with different types of a topic, or with different
    definitions of a type, are refused.

    Args:
        bags: Folders of the bags, or .mcap files.
        out: Folder of the new bag, new or empty. Default: out/merge_BAG of the first one, or the next free of
            out/merge_BAG_2, ….
    """
    folder = output_folder(out, f"merge_{bag_name(bags[0])}")

    from sal_height.bag.merge import merge as merge_bags

    merged = merge_bags(bags, folder)
    for topic, count in merged.duplicates.items():
        print(f"{counted(count, 'message')} of {topic} kept once, which several bags have")
    for topic, count in merged.latched.items():
        print(f"{counted(count, 'latched message')} of {topic} left out: repeated for late subscribers")
    for name in merged.custom_data:
        print(f"custom data {name!r} differ; those of the earliest bag are kept")
    print(f"{counted(sum(merged.counts.values()), 'message')} in {folder}")
    return DONE


@upgrade_app.default
def upgrade(bag: Bag, /, *, out: OutputFolder = None) -> int:
    """Write a bag that was recorded with an older version of our messages again, with those of today.

    Programs that know only today's messages can read it then; `sal-height` itself
    reads bags of all versions as they are.

    Args:
        out: Folder of the new bag, new or empty. Default: out/upgrade_BAG, or the next free of out/upgrade_BAG_2, ….
    """
    folder = output_folder(out, f"upgrade_{bag_name(bag)}")

    from sal_height.bag.copies import upgrade as write_anew

    made = write_anew(bag, folder)
    for topic, count in made.items():
        print(f"{counted(count, 'message')} of {topic} made again")
    print(f"see {folder}" if made else f"all messages are of today's version; {folder} is a copy")
    return DONE
