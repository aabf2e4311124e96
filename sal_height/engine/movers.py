"""Stage mover_detection: detects what moves in strips or over spotlight dwells.

Movers are published a few dwells later: of a spotlight dwell once all overlapping dwells have arrived, of an image of a
strip once those have that may show it, too; the last ones once no other dwell has arrived for timeout_s, or at the end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from sal_height.engine.dwells import SENSORS_KEPT, WholeDwell
from sal_height.engine.heights import ImageStage, images_of
from sal_height.engine.image_items import ChannelImage, Images
from sal_height.engine.kept import RecentValues
from sal_height.engine.results import DwellKey, Event, Loss, Notice, Product, Result
from sal_height.engine.settings import ChannelSettings
from sal_height.engine.stage import Job, Port, Reset
from sal_height.errors import Rejected, UserError
from sal_height.movers import ALONE, DwellMovers, Looked, MoverSettings, StripMovers, check_sensor
from sal_height.pipeline import dwell_with_movers, strip_with_movers
from sal_height.sensor import Sensor

MOVERS = "movers"
"""Port of the movers of each dwell, and the name by which runs are asked for them."""

NO_OVERLAP = "no overlap"
"""Kind of the notice that a dwell by itself shows no movers."""

CANDIDATES = "mover candidates"
"""Event of a pixel that was tested for motion."""

UNPUBLISHED = "unpublished"
"""Input of the job that publishes the last dwells."""


class MoverDetectionSettings(ChannelSettings, MoverSettings):
    """Settings of the stage."""


@dataclass(frozen=True, eq=False)
class ImageMovers:
    """Movers of a dwell.

    Attributes:
        key: key of the dwell, or of the block that completed the image of a strip.
        frame_id: name of the frame of the map.
        images: images that were searched.
        looked: movers that were found, and number of pixels that were searched.
    """

    key: DwellKey
    frame_id: str
    images: Images
    looked: Looked


class MoverDetection(ImageStage):
    """Finds what moves in images, with position, height and radial velocity; a cloud of points for each dwell."""

    usual_name = "mover_detection"
    about = "Finds what moves in images, with position, height and radial velocity; a cloud of points for each dwell."
    settings = MoverDetectionSettings
    concludes = True

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self._unpublished = 0
        # The heavy side.
        self._search = MoverSettings()
        self._dwells, self._strips = _movers_of_sensors(self._search)

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        """The movers."""
        return [Port(MOVERS, ImageMovers, "what moves in each dwell, sensor_msgs/PointCloud2 in map")]

    def check(self, message: ChannelImage, sensor: Sensor) -> None:
        """Check the size of an image, and whether its sensor can detect movers."""
        super().check(message, sensor)
        _check_sensor(sensor)

    def check_whole(self, item: Images, sensor: Sensor) -> None:
        """Check the size of images, and whether their sensor can detect movers."""
        super().check_whole(item, sensor)
        _check_sensor(sensor)

    def series_of(self, whole: WholeDwell) -> str | None:  # noqa: ARG002
        """Dwells are compared with those before."""
        return self.name

    def tick(self, *, busy: bool) -> None:
        """Let time pass as for all dwells, and publish the last ones once no other has arrived for timeout_s."""
        super().tick(busy=busy)
        idle = not self.announced and not busy and self._waiting.waited_s > self._settings.timeout_s
        if self._unpublished and idle:
            self._waiting.restart()
            self.add_own_job(UNPUBLISHED, self.name)

    @property
    def unpublished(self) -> int:
        """Dwells that wait for later ones."""
        return self._unpublished

    def follow(self, job: Job, results: Sequence[Result]) -> None:
        """Count the dwells that wait for later ones."""
        super().follow(job, results)
        if isinstance(job.inputs, WholeDwell):
            self._unpublished += not any(isinstance(one, Loss) for one in results)
            self._unpublished -= sum(_concludes_dwell(one) for one in results)
        elif isinstance(job.inputs, Reset) or job.inputs == UNPUBLISHED:
            self._unpublished = 0

    def conclude_work(self) -> None:
        """Publish what was found in the last dwells."""
        self.add_own_job(UNPUBLISHED, self.name)

    def work_on(self, whole: WholeDwell, job: Job) -> Iterator[Result]:
        """Find what moves in a dwell, or in those that are complete now."""
        yield from self._follow_settings(job.settings)
        images, sensor, calibration = images_of(whole), whole.sensor, whole.supplies
        if sensor.mode == "stripmap":
            strip = strip_with_movers(images.slc, sensor, self._search, calibration)
            yield from self._products(self._strips.of(whole.key.sensor).add(strip, images))
            yield from self._ended(self._strips.take_surplus())
            return
        seconds = 1e-9 * whole.key.stamp_ns
        dwell = dwell_with_movers(images.slc, seconds, sensor, self._search, calibration)
        yield from self._products(self._dwells.of(whole.key.sensor).add(dwell, images))
        yield from self._ended(self._dwells.take_surplus())

    def work_otherwise(self, job: Job) -> Iterator[Result]:  # noqa: ARG002 (it is the only one)
        """Publish what was found in the last dwells."""
        yield from self._ended(self._take_all())

    def forget_work(self) -> Iterator[Result]:
        """Start again with the next dwell, without what has not been published, which is counted."""
        for _ in range(sum(one.unpublished for one in self._take_all())):
            yield Notice("reset", "The node was reset before the movers of a dwell were published.")

    def _follow_settings(self, wanted: Any) -> Iterator[Result]:
        """Start again if settings have changed."""
        settings = MoverSettings(**{name: getattr(wanted, name) for name in MoverSettings.model_fields})
        if settings != self._search:
            yield from self._ended(self._take_all())
            self._search = settings
            self._dwells, self._strips = _movers_of_sensors(settings)

    def _take_all(self) -> list[DwellMovers[Images] | StripMovers[Images]]:
        """The movers of all sensors, which start again."""
        return [*self._dwells.take_all(), *self._strips.take_all()]

    def _ended(self, sensors: Sequence[DwellMovers[Images] | StripMovers[Images]]) -> Iterator[Result]:
        """Yield the movers found in the last dwells of sensors."""
        for dwells in sensors:
            yield from self._products(dwells.end())

    def _products(self, found: Sequence[tuple[Images, Looked | None]]) -> Iterator[Result]:
        """Yield the movers found in dwells."""
        for images, looked in found:
            if looked is None:
                yield Notice(NO_OVERLAP, ALONE.format(images.key.number), images.key)
            else:
                yield Product(MOVERS, ImageMovers(images.key, images.frame_id, images, looked))
                yield Event(CANDIDATES, times=looked.candidates)


def _movers_of_sensors(
    search: MoverSettings,
) -> tuple[RecentValues[DwellMovers[Images]], RecentValues[StripMovers[Images]]]:
    """The movers over the dwells and in the strips of each sensor, by config_hash."""
    return (
        RecentValues[DwellMovers[Images]](SENSORS_KEPT, partial(DwellMovers[Images], search)),
        RecentValues[StripMovers[Images]](SENSORS_KEPT, partial(StripMovers[Images], search)),
    )


def _concludes_dwell(result: Result) -> bool:
    """True if a result ends the processing of a dwell."""
    return isinstance(result, Product) or (isinstance(result, Notice) and result.kind == NO_OVERLAP)


def _check_sensor(sensor: Sensor) -> None:
    """Check whether a sensor can detect movers.

    Raises:
        Rejected: it cannot.
    """
    try:
        check_sensor(sensor)
    except UserError as error:
        raise Rejected("movers", str(error)) from error
