"""Stages that enter the heights of all dwells into one map, published now and then and written at the end.

relief_mapper averages all heights; ground_mapper estimates the ground from all surfaces of all dwells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

from sal_height.elevation import ESTIMATORS
from sal_height.engine.frames import PlacedOrigin
from sal_height.engine.height_items import Heights, heights_port
from sal_height.engine.provenance import Provenance
from sal_height.engine.results import Answer, DwellKey, FileProduct, Loss, Notice, Product, Remark, Result
from sal_height.engine.settings import MapFrameSettings, MapOriginSettings
from sal_height.engine.stage import Job, Port, Rehearsal, Reset, Stage, StageSettings
from sal_height.engine.tracker import PREFIX as TRACKED
from sal_height.engine.tracker import made_up_item
from sal_height.errors import UserError
from sal_height.geometry import UTM, ApertureState, Origin, Projection, find_system
from sal_height.relief import (
    CellMap,
    GroundMap,
    GroundSettings,
    HeightField,
    ProjectedAxes,
    Relief,
    ReliefMap,
    SharedError,
    fine_cell_size,
    fitting_cell_size,
    ground_spacings,
    stated_course,
)
from sal_height.settings import setting
from sal_height.topics import MAP_ORIGIN

ADJUSTED = "adjusted"
"""Prefix of adjusted heights."""

LOCAL = "local"
"""Name for the coordinates of a map that is not located on the earth."""


ORIGIN_PORT = Port(
    MAP_ORIGIN,
    PlacedOrigin,
    "position of the origin of the map frame on the earth, sensor_msgs/NavSatFix, latched",
    latched=True,
    optional=True,
)

PUBLISH, SAVE, CONCLUDE = "publish", "save", "conclude"
"""Inputs of jobs of the stage's own."""


class MapSettings(MapOriginSettings, MapFrameSettings, StageSettings):
    """Settings of every stage that makes a map."""

    estimator: str = setting(
        "ml",
        "estimator whose heights enter the map; they are received on topic <estimator>/height",
        choices=(*ESTIMATORS, TRACKED, ADJUSTED),
        read_only=True,
    )
    max_cells: int = setting(
        4_000_000,
        "greatest number of cells of the map; heights that would need more are left out",
        minimum=1,
        maximum=1_000_000_000,
        read_only=True,
    )
    period_s: float = setting(
        2.0, "shortest time between two maps published", unit="s", minimum=0.1, maximum=3600.0, read_only=True
    )
    varying_offset_m: float = setting(
        0.0,
        "standard deviation of the part of the height error common to all pixels of a dwell that changes in flight and "
        "averages out over dwells; 0: not stated, all of it is assumed to last",
        unit="m",
        minimum=0.0,
        maximum=1e4,
        read_only=True,
    )
    offset_correlation_s: float = setting(
        0.0,
        "time in which the correlation of that part falls to 1/e; 0: not stated",
        unit="s",
        minimum=0.0,
        maximum=1e6,
        read_only=True,
    )
    file: str = setting(
        "",
        "path of the GeoTIFF that the map is written to when the node ends; an existing file is replaced; empty: none",
        read_only=True,
        names_file=True,
    )
    crs: str = setting(
        UTM,
        "coordinate reference system of the map where its origin is known: utm is the zone of the origin, others are "
        f"named as PROJ does, such as EPSG:25832 or EPSG:32632+5773; {LOCAL} is arc distances from the origin",
        read_only=True,
    )


class ReliefMapSettings(MapSettings):
    """Settings of the map of averages."""

    cell_size_m: float = setting(
        0.0,
        "side of a cell of the map; 0: the smallest of 1, 2 or 5 times a power of ten that contains a pixel of "
        "the first "
        "height image",
        unit="m",
        minimum=0.0,
        maximum=1e5,
        read_only=True,
    )


class GroundMapSettings(MapSettings, GroundSettings):
    """Settings of the map of the ground."""

    cell_size_m: float = setting(
        0.0,
        "side of a cell; 0: the greatest of 1, 2 or 5 times a power of ten that is at most 3/4 of a pixel of the first "
        "height image on the ground",
        unit="m",
        minimum=0.0,
        maximum=1e5,
        read_only=True,
    )


@dataclass(frozen=True, eq=False)
class PlacedRelief:
    """A map as it stands.

    Attributes:
        key: key of the last dwell.
        frame_id: name of the frame of the map.
        layer: name of the layer.
        relief: map, in coordinates of the projection.
        projection: coordinate reference system; None: the coordinates are local.
        images: number of height images entered.
        estimator: name of the estimator that made them.
        provenance: provenance of the last height image, with the parameters of this stage.
    """

    key: DwellKey
    frame_id: str
    layer: str
    relief: Relief
    projection: Projection | None
    images: int
    estimator: str
    provenance: Provenance

    @property
    def crs(self) -> str:
        """Name of the coordinate reference system; empty: the coordinates are local."""
        return self.projection.name if self.projection else ""


class Mapper(Stage):
    """Enters height images into one map, which is published now and then, and written at the end.

    Where the origin of the map frame is known, by settings or by port map_origin, the map is one in a projection
    (setting crs).
    """

    settings = MapSettings
    prefix: ClassVar[str]
    """Prefix of the topics."""
    layer: ClassVar[str]
    """Name of the layer of the map."""
    concludes = True
    commands: ClassVar = {SAVE: "write the map as it stands to its file"}
    niceness = 10  # a map is as good a second later

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        if self._settings.crs not in {LOCAL, UTM}:
            find_system(self._settings.crs)
        self.shared_error(self._settings)
        self._origin = self._settings.origin
        self._has_news = False
        self._publishing = False
        self._rehearsed = False
        self._due_s = math.inf
        # The heavy side.
        self._axes = _axes_about(self._origin, self._settings.crs)
        self._map: CellMap | None = None
        self._map_axes: ProjectedAxes | None = None
        self._images = 0
        self._last: Heights | None = None

    @staticmethod
    def shared_error(settings: Any) -> SharedError:
        """Stated course of the height error that all pixels of a dwell share."""
        return stated_course(settings.varying_offset_m, settings.offset_correlation_s)

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:
        """Heights of an estimator, and the origin of the map frame where the settings do not give it."""
        takes_origin = settings.origin is None and settings.crs != LOCAL
        return [heights_port(settings.estimator), *([ORIGIN_PORT] if takes_origin else [])]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        """The map."""
        about = "map of heights and of their standard deviations, latched"
        return [Port(f"{cls.prefix}/relief", PlacedRelief, about, latched=True)]

    @classmethod
    def written_files(cls, settings: Any) -> Sequence[tuple[type, str]]:
        """The file of the map."""
        return [(PlacedRelief, settings.file)] if settings.file else []

    def empty_map(self, field: HeightField, aperture: ApertureState, settings: Any) -> CellMap:
        """A map for heights such as the first ones, seen from `aperture`.

        Raises:
            Rejected: the heights do not suit a map.
        """
        raise NotImplementedError

    @property
    def is_ready(self) -> bool:
        """True if made-up heights have been entered: the first dwell takes no longer then."""
        return self._rehearsed

    def begin(self, stamp_ns: int) -> None:  # noqa: ARG002
        """Rehearse."""
        self.add_own_job(Rehearsal(), self.name)

    def receive(self, port: str, item: Any) -> None:
        """Make a job of the heights of a dwell, or of another origin."""
        if port != MAP_ORIGIN:
            self.apply_scheduled(item.key)
            self.add_job(item.key, item, size=item.size, series=self.name)
        elif item.origin != self._origin:
            try:
                _axes_about(item.origin, self._settings.crs)
            except UserError as error:
                self.warn("origin", error)
                return
            self._origin = item.origin
            self.add_own_job(item.origin, self.name)

    def tick(self, *, busy: bool) -> None:  # noqa: ARG002
        """Publish the map if it has changed and some time has passed."""
        if math.isinf(self._due_s):
            self._due_s = self._now_s + self._settings.period_s
        if self._has_news and not self._publishing and self._now_s >= self._due_s:
            self._has_news, self._publishing, self._due_s = False, True, self._now_s + self._settings.period_s
            self.add_own_job(PUBLISH, self.name)

    def follow(self, job: Job, results: Sequence[Result]) -> None:
        """Publish the map later if it has changed, and again once it has been published."""
        if isinstance(job.inputs, Heights):
            self._has_news = self._has_news or not any(isinstance(one, Loss) for one in results)
        elif isinstance(job.inputs, Rehearsal):
            self._rehearsed = True
        elif isinstance(job.inputs, Reset):
            self._has_news = False
        elif job.inputs == PUBLISH:
            self._publishing = False

    def forget(self) -> None:
        """Start an empty map."""
        self.add_own_job(Reset(), self.own_series)

    def command(self, name: str) -> Sequence[Any]:
        """Write the map as it stands."""
        return self._collected(self.add_own_job, name, self.name)

    def conclude(self) -> None:
        """Make the map final, publish it and write the file."""
        self.add_own_job(CONCLUDE, self.name)

    def work(self, job: Job) -> Iterator[Result]:
        """Enter heights, or do what was asked for."""
        if isinstance(job.inputs, Heights):
            yield from self._enter(job.inputs, job.settings)
        elif isinstance(job.inputs, Rehearsal):
            self._rehearse(job.settings)
        elif isinstance(job.inputs, Reset):
            self._map, self._last, self._images = None, None, 0
        elif job.inputs == PUBLISH:
            yield from self._published(job.settings)
        elif job.inputs == SAVE:
            yield from self._saved(job.settings)
        elif job.inputs == CONCLUDE:
            if self._map is not None:
                self._map.settle()
            yield from self._published(job.settings)
            yield from self._written(job.settings)
        else:
            yield from self._moved(job.inputs, job.settings)

    def _rehearse(self, settings: Any) -> None:
        """Enter made-up heights into a map of their own."""
        spare = type(self)(settings)
        with suppress(UserError):  # a map with these settings may have no room for them
            for inputs in (made_up_item(settings.map_frame), PUBLISH):
                list(spare.work(Job(None, inputs, settings)))

    def _enter(self, heights: Heights, settings: Any) -> Iterator[Result]:
        """Enter a height image into the map; one that is refused leaves the map unchanged."""
        heights.check_frame(settings.map_frame)
        field, aperture = heights.field, heights.aperture.state
        yield from heights.notices()
        axes = self._axes if self._map is None else self._map_axes
        if axes:
            field, aperture = axes.field(field, aperture)
        grown = self.empty_map(field, aperture, settings) if self._map is None else self._map
        agreed = grown.contradiction is None
        grown.add(field, aperture, heights.key.stamp_ns / 1e9)
        self._map, self._map_axes, self._last = grown, axes, heights
        self._images += 1
        if agreed and grown.contradiction:
            yield Notice("offsets of dwells", grown.contradiction, heights.key)

    def _moved(self, origin: Origin, settings: Any) -> Iterator[Result]:
        """Place the next map that starts."""
        self._axes = _axes_about(origin, settings.crs)
        if self._map is not None:
            yield Notice(
                "origin after the begin",
                "The origin of the map frame was received, or changed, after the map had started, which stays where "
                "it is until service ~/reset starts a new one; publish the origin latched and before the first dwell, "
                "or set origin_latitude_deg and origin_longitude_deg.",
            )

    def _placed(self, settings: Any) -> PlacedRelief | None:
        """The map as it stands; None: nothing was seen yet."""
        relief, last = self._map.relief() if self._map else None, self._last
        if relief is None or last is None:
            return None
        axes = self._map_axes
        return PlacedRelief(
            last.key,
            last.frame_id,
            self.layer,
            axes.relief(relief) if axes else relief,
            axes.projection if axes else None,
            self._images,
            last.estimator,
            last.provenance.derived(self.name, settings),
        )

    def _published(self, settings: Any) -> Iterator[Result]:
        if placed := self._placed(settings):
            yield Product(f"{self.prefix}/relief", placed)

    def _saved(self, settings: Any) -> Iterator[Result]:
        if not settings.file:
            yield Answer(success=False, sentence="parameter file is empty; it must be the path of a GeoTIFF")
            return
        written = list(self._written(settings))
        yield from written
        made = any(isinstance(one, FileProduct) for one in written)
        yield Answer(made, settings.file if made else "no height was seen")

    def _written(self, settings: Any) -> Iterator[Result]:
        """The file of the map, if one is wanted."""
        path = settings.file
        if not path:
            return
        placed = self._placed(settings)
        if placed is None:
            yield Remark(f"No height was seen: there is no map to write to {path}.")
            return
        is_local = placed.projection is None and settings.crs != LOCAL
        remark = (
            f"{path} has local coordinates; set origin_latitude_deg and origin_longitude_deg, or publish topic "
            f"{MAP_ORIGIN}, to locate it on the earth."
        )
        yield FileProduct(path, placed, remark if is_local else "")


class ReliefMapper(Mapper):
    """Averages the heights of all dwells in the cells of one map."""

    usual_name = "relief_mapper"
    about = "Averages the heights of all dwells in the cells of one map."
    settings = ReliefMapSettings
    prefix = "map"
    layer = "mean"

    def empty_map(self, field: HeightField, aperture: ApertureState, settings: Any) -> ReliefMap:
        """A map whose cells contain a pixel of the first height image."""
        cell_size = settings.cell_size_m or fitting_cell_size(field.grid, aperture)
        return ReliefMap(cell_size, settings.max_cells, self.shared_error(settings))


class GroundMapper(Mapper):
    """Brings the estimate of the ground up to date with each dwell, and estimates all of it at once at the end."""

    usual_name = "ground_mapper"
    about = "Brings the estimate of the ground up to date with each dwell, and estimates all of it at once at the end."
    settings = GroundMapSettings
    prefix = "ground"
    layer = "ground"

    def empty_map(self, field: HeightField, aperture: ApertureState, settings: Any) -> GroundMap:  # noqa: ARG002
        """A map whose cells are finer than the pixels of the first height image."""
        cell_size = settings.cell_size_m or fine_cell_size(field.grid)
        spacing = max(ground_spacings(field.grid))
        return GroundMap(cell_size, spacing, settings.max_cells, settings, self.shared_error(settings))


def _axes_about(origin: Origin | None, crs: str) -> ProjectedAxes | None:
    """The axes of a map whose frame has that origin; None: it is local.

    Raises:
        UserError: the system that setting crs names does not suit the place.
    """
    if origin is None or crs == LOCAL:
        return None
    return ProjectedAxes.around(Projection.of(crs, origin))
