"""The height stages: slc to heights, one for each of `elevation.ESTIMATORS`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from pydantic import create_model

from sal_height.calibration import Calibration
from sal_height.elevation import ESTIMATORS, ElevationEstimator, Validity
from sal_height.engine.calibrations import CALIBRATION_PORT, CALIBRATIONS_ARRIVED, Calibrations
from sal_height.engine.compression import SLC_PORT
from sal_height.engine.dwells import SENSOR_PORT, DwellStage, WholeDwell
from sal_height.engine.gathering import Dwell
from sal_height.engine.geometry_items import Aperture
from sal_height.engine.height_items import Heights, packed
from sal_height.engine.image_items import ChannelImage, Images, check_image, check_images
from sal_height.engine.provenance import LEFT_OUT
from sal_height.engine.results import DwellKey, Notice, Product, Result, loss_of
from sal_height.engine.settings import ChannelSettings, processing_of
from sal_height.engine.stage import FOREVER_NS, Job, Port
from sal_height.errors import Rejected
from sal_height.imaging import ImageSettings
from sal_height.pipeline import heights_of_dwells, live_channels
from sal_height.rehearsal import once, rehearse_heights
from sal_height.relief import HeightField
from sal_height.sensor import Sensor
from sal_height.topics import CALIBRATION, SLC

_SETTINGS = "_parameters"
_STAGE = "HeightStage_"
"""Ending of the names of the settings of estimators' stages."""

AT_ONCE, BYTES_AT_ONCE = 8, 16_000_000
"""Dwells that are estimated together, and bytes of their images, at most: more would save little."""


class ImageStage(DwellStage):
    """Works on the images of all channels of a dwell, with the calibration that they were made with."""

    settings = ChannelSettings
    dwell_port = SLC
    whole_kind = Images
    changeable = ("_calibrations",)

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self._calibrations = Calibrations()

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003 (those of other stages follow from settings)
        """Images, their sensor and the calibrations that they were made with."""
        return [SENSOR_PORT, SLC_PORT._replace(counted=True), CALIBRATION_PORT]

    def check(self, message: ChannelImage, sensor: Sensor) -> None:
        """Check the size of an image; single bad pixels are marked as such."""
        check_image(message, sensor)

    def check_whole(self, item: Images, sensor: Sensor) -> None:
        """Check the size of the images of all channels."""
        check_images(item, sensor)

    def supplies(self, key: DwellKey, messages: Any, sensor: Sensor) -> Calibration | None:
        """The calibration that the images were made with: it may have changed the beams."""
        provenance = messages.provenance if isinstance(messages, Images) else messages[0].provenance
        return self._calibrations.of(provenance, sensor, key.number)

    def is_hopeless(self, dwell: Dwell[ChannelImage], missing: Rejected) -> bool:  # noqa: ARG002
        """True if the calibration that a dwell waits for will not arrive."""
        return self._none_before.get(CALIBRATION, 0) == FOREVER_NS

    def receive_other(self, port: str, item: Any) -> None:  # noqa: ARG002 (it is the only one)
        """Accept a calibration, which dwells may wait for."""
        self._calibrations.add(item.calibration)
        self.count(CALIBRATIONS_ARRIVED)
        self.hand_over_complete()


def images_of(whole: WholeDwell) -> Images:
    """The images of a dwell.

    Raises:
        Rejected: those of its channels contradict each other.
    """
    return whole.messages if isinstance(whole.messages, Images) else Images.joined(whole.messages)


class HeightStage(ImageStage):
    """Estimates the heights of a dwell from the images of all channels.

    Heights of dwells that wait are estimated together, which is faster and gives the same values.
    """

    estimator: ClassVar[ElevationEstimator]
    is_parallel = True
    at_once = AT_ONCE

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        """The heights."""
        return [Port(f"{cls.estimator.name}/height", Heights, HEIGHTS_ABOUT)]

    def rehearse_for(self, sensor: Sensor, settings: Any) -> None:
        """Estimate the heights of made-up images."""
        estimators = [(self.estimator, settings)]
        once(
            (sensor.digest, self.estimator, processing_of(settings)),
            lambda: rehearse_heights(sensor, ImageSettings(), estimators, np.random.default_rng(0)),
        )

    def process(self, jobs: Sequence[Job]) -> Iterator[Sequence[Result]]:
        """Estimate the heights of several dwells together where sensor, calibration and settings are the same."""
        waiting = list(jobs)
        while waiting:
            group = _alike(waiting)
            del waiting[: len(group)]
            if len(group) == 1:
                yield self.processed(group[0], self.work)
            else:
                yield from self._estimate_together(group)

    def work_on(self, whole: WholeDwell, job: Job) -> Iterator[Result]:
        """Estimate the heights of a dwell."""
        images = images_of(whole)
        (field,) = heights_of_dwells([images.slc], whole.sensor, self.estimator, job.settings, whole.supplies)
        yield from self._products(images, field, whole.sensor, job.settings)

    def _estimate_together(self, jobs: Sequence[Job]) -> Iterator[Sequence[Result]]:
        """Estimate several dwells; where one cannot be processed, each by itself, so that only it is lost."""
        first: WholeDwell = jobs[0].inputs
        try:
            images = [images_of(job.inputs) for job in jobs]
            slcs = [one.slc for one in images]
            fields = heights_of_dwells(slcs, first.sensor, self.estimator, jobs[0].settings, first.supplies)
        except Exception:  # noqa: BLE001 (which of them is to blame shows when each is processed by itself)
            for job in jobs:
                yield self.processed(job, self.work)
            return
        for job, one, field in zip(jobs, images, fields, strict=True):
            try:
                results: Sequence[Result] = list(self._products(one, field, first.sensor, job.settings))
            except Exception as error:  # noqa: BLE001 (no input may end a host)
                results = [loss_of(error, job.dwell, job.messages)]
            yield results

    def _products(self, images: Images, field: HeightField, sensor: Sensor, settings: Any) -> Iterator[Result]:
        """The heights, and warnings on clipped samples, and on what contradicts the description or is missing in it."""
        slc, number = images.slc, images.key.number
        if np.any(field.validity == Validity.SATURATED):
            fraction, limit = slc.saturated_share.max(), settings.max_saturated_fraction
            yield Notice(
                "saturated",
                f"Dwell {number}: {fraction:.3g} of a channel's samples are clipped; heights need {limit:g} "
                "or less (max_saturated_fraction).",
                images.key,
            )
        silent = sorted(set(range(len(slc.images))) - set(live_channels(slc.images, sensor).tolist()))
        used = {**dict(settings), LEFT_OUT: silent} if silent else settings
        heights = Heights(
            key=images.key,
            frame_id=images.frame_id,
            estimator=self.estimator.name,
            aperture=Aperture.of(slc.aperture),
            looks=(settings.range_looks, settings.azimuth_looks),
            provenance=images.provenance.derived(self.name, used),
            order=images.order,
            doubts=(*images.doubts, *field.doubts),
            fit=(*images.fit, *field.fit),
            **packed(field),
        )
        yield from (Notice(one.name, f"Dwell {number}: {one.sentence}", images.key) for one in field.doubts)
        yield Product(f"{self.estimator.name}/height", heights)


HEIGHTS_ABOUT = "height, position, standard deviation and validity of every pixel"


def _alike(jobs: Sequence[Job]) -> Sequence[Job]:
    """The first jobs that can be processed together."""
    first = jobs[0].inputs
    if not isinstance(first, WholeDwell):
        return jobs[:1]
    count, size = 0, 0
    for job in jobs[:AT_ONCE]:
        whole = job.inputs
        alike = (
            isinstance(whole, WholeDwell)
            and whole.sensor == first.sensor
            and whole.supplies is first.supplies
            and job.settings == jobs[0].settings
        )
        size += job.size
        if not alike or (count and size > BYTES_AT_ONCE):
            break
        count += 1
    return jobs[: max(1, count)]


@lru_cache
def height_stage(name: str) -> type[HeightStage]:
    """The stage of an estimator of `elevation.ESTIMATORS`.

    Args:
        name: name of the estimator.
    """
    estimator = ESTIMATORS[name]
    about = f"Estimates heights from the images of all channels of a dwell; estimator: {estimator.title}."
    attributes = {
        "estimator": estimator,
        "usual_name": estimator.node,
        "settings": _settings_of(name),
        "about": about,
        "__doc__": about,
    }
    return type(f"{_STAGE}{name}", (HeightStage,), attributes)


def __getattr__(name: str) -> Any:
    """The stage of an estimator, and its settings, which other processes find by their names."""
    if (estimator_name := name.removeprefix(_STAGE)) in ESTIMATORS and estimator_name != name:
        return height_stage(estimator_name)
    estimator = ESTIMATORS.get(name.removesuffix(_SETTINGS))
    if not (estimator and name.endswith(_SETTINGS)):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _settings_of(estimator.name)


@lru_cache
def _settings_of(name: str) -> type[ChannelSettings]:
    base: Any = (ESTIMATORS[name].settings, ChannelSettings)
    found: type[ChannelSettings] = create_model(f"{name}{_SETTINGS}", __base__=base, __module__=__name__)
    return found
