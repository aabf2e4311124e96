"""`sal-height passes`: heights of bright points from bags of one pass each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sal_height import messages
from sal_height.bag.reader import BagReader
from sal_height.bag.topics import FIX_TYPE, HEIGHT_TYPE
from sal_height.bag.writer import BagWriter
from sal_height.elevation import ESTIMATORS, Validity
from sal_height.engine.frame_items import history_of
from sal_height.engine.image_items import Images, Source
from sal_height.engine.provenance import Provenance
from sal_height.engine.results import Loss, Product
from sal_height.errors import UserError, did_you_mean
from sal_height.geometry import Grid, Trajectory
from sal_height.graph.catalogue import NodeParameters
from sal_height.graph.reporting import reporting
from sal_height.imaging import apply_phase, line_of_sight
from sal_height.io import new_folder, writing
from sal_height.messages.products import provenance_to_message
from sal_height.messages.types import Header, HeightImage
from sal_height.numeric import F64
from sal_height.passes import (
    ESTIMATORS_OF_PASSES,
    OF_POINTS,
    Pass,
    PassHeights,
    PassSettings,
    PointHeights,
    ReferencePoint,
    heights_from_passes,
)
from sal_height.pipeline import corrected_spectrum
from sal_height.relief import HeightField, Surface
from sal_height.runs.chain.chain_runs import COMPRESSION, BagRun, plan
from sal_height.runs.products.passes_report import compared, draw_passes, summary_of, warnings_of
from sal_height.settings import Settings


def heights_of_bags(
    bags: Sequence[Path],
    out: Path,
    estimator: str = "ml",
    given: NodeParameters | None = None,
    wanted: Mapping[str, Any] | None = None,
    references: Sequence[ReferencePoint] = (),
    centre: tuple[float, float] | None = None,
    jobs: int = 1,
) -> tuple[dict[str, Any], list[str]]:
    """Make heights from bags; leaves report.json, passes.png and, if there are heights, a bag with them in `out`.

    Args:
        bags: folders or files, of one pass each or more.
        out: folder; must be new or empty.
        estimator: name of the elevation estimator.
        given: parameters of nodes that replace recorded ones.
        wanted: settings by name, of the passes and of the estimator.
        references: points of known position.
        centre: east and north of the middle of the scene, m; None: where the passes look, in the median.
        jobs: dwells of a bag that are compressed side by side.

    Returns:
        The numbers of the report, and warnings on data left out.

    Raises:
        UserError: a bag cannot be used, too few passes go together, or a setting is not allowed.
    """
    if estimator not in ESTIMATORS_OF_PASSES:
        hint = did_you_mean(estimator, ESTIMATORS_OF_PASSES)
        names = ", ".join(ESTIMATORS_OF_PASSES)
        raise UserError(f"Option --estimator is {estimator!r}{hint}; of passes allowed are {names}.")
    maker = ESTIMATORS[estimator]
    of_passes = {name: value for name, value in (wanted or {}).items() if name in PassSettings.model_fields}
    of_estimator = {name: value for name, value in (wanted or {}).items() if name not in of_passes}
    settings = PassSettings(**of_passes)
    # Capon's method is for points that have a weak neighbour: its sigma contains what that displaces them by.
    height_settings = maker.settings(**{**OF_POINTS, "layover": estimator != "capon", **of_estimator})
    looks = height_settings.range_looks, height_settings.azimuth_looks
    if looks != (1, 1):
        raise UserError(
            f"Settings range_looks and azimuth_looks are {looks[0]} and {looks[1]}; points are seen by single pixels: "
            "both must be 1."
        )
    folder = new_folder(out)
    known = {"bags": [bag.name for bag in bags], "estimator": estimator, "settings": settings.model_dump()}
    with reporting(folder, known) as report:
        gathered, warnings, first = _gathered(bags, given, jobs)
        passes, aims = [one for one, _ in gathered], [aim for _, aim in gathered]
        middle = np.median(aims, axis=0) if aims else np.zeros(3)
        middle = np.array([*(middle[:2] if centre is None else centre), settings.ground_m])
        report |= {"passes_given": len(passes), "centre_m": middle.tolist(), "warnings": warnings}
        result = heights_from_passes(passes, middle, maker, height_settings, settings, references)
        comparisons = [compared(one, result, settings) for one in references]
        warnings = [*warnings, *warnings_of(result, comparisons, settings)]
        summary = summary_of(result, comparisons, settings)
        report |= {**summary, "warnings": warnings}
        with writing(folder / "passes.png"):
            draw_passes(result, comparisons, folder / "passes.png")
        if len(result.found.points.height):
            _write_bag(folder / "bag", result, estimator, height_settings, first)
    return summary, warnings


def _gathered(
    bags: Sequence[Path], given: NodeParameters | None, jobs: int
) -> tuple[list[tuple[Pass, F64]], list[str], BagReader]:
    """The passes of all bags, each with the point that it aims at (m in map), warnings, and a reader of the first bag.

    Raises:
        UserError: a bag is named twice, or cannot be used.
    """
    passes: list[tuple[Pass, F64]] = []
    warnings: list[str] = []
    readers = []
    names = [bag.resolve() for bag in bags]
    for bag in bags:
        if names.count(bag.resolve()) > 1:
            raise UserError(f"Bag {bag} is named twice; name each bag once.")
    for bag in bags:
        scheme = plan(bag, given or {}, for_heights=False)
        readers.append(scheme.reader)
        run = BagRun(scheme, [COMPRESSION], jobs=jobs)
        passes += _passes_of(run, f"images of {bag.name}")
        warnings += [f"Bag {bag}: {sentence}" for sentence in (*scheme.warnings, *run.losses.sentences.values())]
    return passes, warnings, readers[0]


def _passes_of(run: BagRun, doing: str) -> list[tuple[Pass, F64]]:
    """The dwells of a bag as passes, each with the point that it aims at."""
    passes: list[tuple[Pass, F64]] = []
    for made in run.results(doing):
        images = made.result.item if isinstance(made.result, Product) else None
        if not isinstance(images, Images) or images.source is None:
            continue
        source, number = images.source, images.key.number
        if source.sensor.mode != "spotlight":
            sentence = f"Dwell {number} is one of a strip; passes must be spotlight."
            run.losses.add("passes", Loss(made.dwell, 0, "cannot be processed", sentence))
            continue
        several = len(run.scheme.frames) > 1
        name = run.scheme.reader.path.name
        passes.append(_pass_of(source, f"{name} dwell {number}" if several else name))
    return passes


def _pass_of(source: Source, name: str) -> tuple[Pass, F64]:
    """The phase history of a dwell with the phase that autofocus removed from it, and the point that it aims at, m."""
    settings, slc = source.settings, source.slc
    track = Trajectory(source.states, source.sensor.mounting, settings.motion)
    history, track, sensor, _ = corrected_spectrum(
        history_of(source.frames), track, source.sensor, settings, source.calibration
    )
    antenna = track.positions(history.stamp_ns, history.pulse_times)
    sight = line_of_sight(sensor, slc.aperture)
    if slc.focus and slc.focus.trusted:
        history = apply_phase(history, slc.focus.phase)
    seconds = history.pulse_times - (history.pulse_times[0] + history.pulse_times[-1]) / 2
    antenna = slc.placement.moved(antenna, seconds, sight)
    aim = slc.aperture.position + float(history.reference_range[len(antenna) // 2]) * sight
    return Pass(name, sensor, history, antenna), aim


def field_of(points: PointHeights, result: PassHeights) -> HeightField:
    """Points as a height image of one row, a pixel for each scatterer."""
    listed = {name: getattr(points, name)[None] for name in ("height", "cnr_db", "positions")}
    surface = Surface(
        sigma=points.total_sigma[None],
        spread=np.zeros((1, len(points.height))),
        own_covariance=points.own_covariance[None],
        common_covariance=points.common_covariance[None],
        **listed,
    )
    axes = result.array.axes
    grid = Grid(result.array.centre, axes[0], axes[1], 1.0, 1.0, 1, len(points.height))
    return HeightField(grid, np.full((1, len(points.height)), Validity.OK, np.uint8), (surface,))


def _write_bag(folder: Path, result: PassHeights, estimator: str, settings: Settings, first: BagReader) -> None:
    """Write the points as heights of a bag, on the topic of their estimator.

    Raises:
        UserError: it cannot be written.
    """
    array = result.array
    history = array.passes[0].history
    source = HeightImage(header=Header(stamp=messages.to_stamp(history.stamp_ns), frame_id=messages.MAP_FRAME))
    provenance = provenance_to_message(Provenance().derived("passes", settings))
    image = messages.height_to_message(
        field_of(result.found.points, result), array.reference, (1, 1), estimator, source, provenance
    )
    with BagWriter(folder) as bag:
        for topic in first.topics.values():
            if topic.type_name == FIX_TYPE and topic.count:
                bag.add_topic(topic.name, topic.type_name, topic.offered_qos)
                for recorded in first.messages([topic.name]):
                    bag.write(topic.name, recorded.cdr, history.stamp_ns, history.stamp_ns)
        bag.add_topic(f"/{estimator}/height", HEIGHT_TYPE)
        bag.write(f"/{estimator}/height", messages.serialize(image), history.stamp_ns, history.stamp_ns)
