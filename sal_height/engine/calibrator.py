"""Stage psf_calibration: calibrates the sensor on the images (slc) of many dwells."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

from sal_height.calibration import CalibrationSettings, Calibrator
from sal_height.engine.calibrations import CALIBRATION_PORT, StatedCalibration
from sal_height.engine.compression import SLC_PORT
from sal_height.engine.dwells import SENSOR_PORT, SENSORS_KEPT, DwellStage, WholeDwell
from sal_height.engine.heights import images_of
from sal_height.engine.image_items import ChannelImage, Images, check_image, check_images
from sal_height.engine.kept import RecentValues
from sal_height.engine.provenance import Provenance
from sal_height.engine.results import Answer, FileProduct, Product, Remark, Result
from sal_height.engine.settings import ChannelSettings
from sal_height.engine.stage import Job, Port
from sal_height.errors import Rejected, UserError
from sal_height.geometry import sphere_point
from sal_height.numeric import F64
from sal_height.sensor import Sensor
from sal_height.settings import setting
from sal_height.topics import CALIBRATION, SLC

MOST_DWELLS = 1024
"""Greatest number of dwells for one calibration: 130 MB of pixels from 16 channels."""

SAVE, CONCLUDE = "save", "conclude"
"""Inputs of jobs of the stage's own."""


class PsfCalibrationSettings(ChannelSettings, CalibrationSettings):
    """Settings of the stage."""

    dwells: int = setting(
        64, "dwells that a calibration is made from; then the next calibration begins", minimum=1, maximum=MOST_DWELLS
    )
    dwell_step: int = setting(
        10,
        "use every n-th dwell only: receivers change slowly, and computing time is limited",
        minimum=1,
        maximum=1_000_000,
    )
    target: str = setting(
        "",
        "position of a reference target as E,N,H: arc distances east and north of the map's origin, and height, "
        "all in m; "
        "empty: no target",
        read_only=True,
    )
    file: str = setting(
        "",
        "path of the .npz file that each calibration is written to; an existing file is replaced; empty: none",
        names_file=True,
    )


class SensorCalibrator:
    """The calibration of a sensor that is being made.

    Attributes:
        calibrator: calibrator with the dwells so far; None: none was used since the last calibration.
        dwells: number of dwells so far, used or not.
        made: True if a calibration has been made.
        stamp_ns: stamp of the last dwell that was used, ns.
    """

    def __init__(self) -> None:
        """Start without dwells."""
        self.calibrator: Calibrator | None = None
        self.dwells = 0
        self.made = False
        self.stamp_ns = 0

    @property
    def used(self) -> int:
        """Number of dwells that have been used since the last calibration."""
        return self.calibrator.dwells if self.calibrator else 0


class PsfCalibration(DwellStage):
    """Estimates receivers and beams from the images of whatever is flown over, and publishes a calibration."""

    usual_name = "psf_calibration"
    about = "Estimates receivers and beams from the images of whatever is flown over, and publishes a calibration."
    settings = PsfCalibrationSettings
    dwell_port = SLC
    whole_kind = Images
    concludes = True
    commands: ClassVar = {SAVE: "make a calibration of the dwells so far"}

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self._target = _place(self._settings.target)
        # The heavy side.
        self._sensors_seen = RecentValues[SensorCalibrator](SENSORS_KEPT, SensorCalibrator)

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        """Images and their sensor."""
        return [SENSOR_PORT, SLC_PORT._replace(counted=True)]

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:  # noqa: ARG003
        """The calibration."""
        return [CALIBRATION_PORT]

    def check(self, message: ChannelImage, sensor: Sensor) -> None:
        """Check the size of an image, and that no calibration has been applied to it."""
        check_image(message, sensor)
        self._check_provenance(message.provenance, sensor, f"{message.key.number}, channel {message.channel}")

    def check_whole(self, item: Images, sensor: Sensor) -> None:
        """Check the size of images, and that no calibration has been applied to them."""
        check_images(item, sensor)
        self._check_provenance(item.provenance, sensor, f"{item.key.number}")

    def series_of(self, whole: WholeDwell) -> str | None:  # noqa: ARG002
        """A calibration is made of dwells in their order."""
        return self.name

    def command(self, name: str) -> Sequence[Any]:
        """Make a calibration of the dwells so far."""
        return self._collected(self.add_own_job, name, self.name)

    def conclude_work(self) -> None:
        """If no calibration was made yet, make one from the dwells so far."""
        self.add_own_job(CONCLUDE, self.name)

    def work_on(self, whole: WholeDwell, job: Job) -> Iterator[Result]:
        """Use the images of every n-th dwell; make a calibration when there are enough of them."""
        settings, sensor = job.settings, whole.sensor
        seen = self._sensors_seen.of(sensor.config_hash)
        self._sensors_seen.take_surplus()
        seen.dwells += 1
        if (seen.dwells - 1) % settings.dwell_step:
            return
        if seen.calibrator is None:
            seen.calibrator = Calibrator(sensor, self._target, settings)
        try:
            seen.calibrator.add(images_of(whole).slc)
        except Rejected as error:
            raise Rejected(error.reason, f"Dwell {whole.key.number}: {error}") from error
        seen.stamp_ns = whole.key.stamp_ns
        if seen.used >= settings.dwells:
            yield from _completed(seen, settings)

    def work_otherwise(self, job: Job) -> Iterator[Result]:
        """Make a calibration of the dwells so far of each sensor."""
        used = [one for one in self._sensors_seen.values() if one.used]
        for seen in used:
            if job.inputs == SAVE or not seen.made:
                yield from _completed(seen, job.settings)
        if job.inputs == SAVE:
            said = (job.settings.file or "published") if used else "no dwell was used yet"
            yield Answer(bool(used), said)

    def forget_work(self) -> Iterator[Result]:
        """Start a new calibration with the next dwell."""
        for seen in self._sensors_seen.values():
            seen.calibrator, seen.dwells = None, 0
        yield from ()

    def _check_provenance(self, provenance: Provenance, sensor: Sensor, dwell: str) -> None:
        applied = provenance.calibration_id
        if applied not in {"", sensor.calibration_id}:
            raise Rejected(
                "calibrated already",
                f"Dwell {dwell}: calibration {applied!r} was applied to the image; calibration needs images as the "
                "sensor delivers them (parameter calibration of sar_compression).",
            )


def _place(text: str) -> F64 | None:
    """Position of the reference target in the map, m; None: no target.

    Raises:
        UserError: the text is not three numbers.
    """
    if not text:
        return None
    try:
        east, north, height = (float(number) for number in text.split(","))
    except ValueError as error:
        raise UserError(
            f"Parameter target is {text!r}; it must be three numbers, E,N,H in m, as in 12.5,-3,1.2, or empty."
        ) from error
    return sphere_point(east, north, height)


def _completed(seen: SensorCalibrator, settings: PsfCalibrationSettings) -> Iterator[Result]:
    """The calibration of the dwells so far, and its file."""
    calibrator, seen.calibrator = seen.calibrator, None
    if calibrator is None:
        return
    calibration, undetermined = calibrator.calibration()
    seen.made = True
    yield from map(Remark, undetermined)
    yield Product(CALIBRATION, StatedCalibration(calibration, seen.stamp_ns, tuple(undetermined)))
    if settings.file:
        yield FileProduct(settings.file, calibration)
