"""Stage sar_compression: forms the images of all channels from the phase history and the odometry."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sal_height.calibration import Calibration
from sal_height.engine.air import (
    AIR_OF_TOPICS,
    AIR_PARAMETERS,
    AIR_PORTS,
    OTHER_CLOCK_S,
    USED_AIR,
    AirHistory,
    AirSettings,
    air_of_dwell,
    may_have_air,
    needed_air,
)
from sal_height.engine.calibrations import (
    CALIBRATION_PORT,
    CALIBRATION_REFUSED,
    CALIBRATIONS_ADOPTED,
    CALIBRATIONS_ARRIVED,
    CalibrationChoice,
    ChosenCalibrations,
    StatedCalibration,
)
from sal_height.engine.dwells import SENSOR_PORT, SENSORS_KEPT, DwellStage, WholeDwell
from sal_height.engine.frame_items import Frame, check_frame, history_of, samples_in_line, stacked_samples
from sal_height.engine.gathering import Dwell
from sal_height.engine.image_items import AIR_LEFT, AIR_REMOVED, Images, Source
from sal_height.engine.kept import Kept, RecentValues
from sal_height.engine.mountings import (
    NO_MOUNTING,
    TRANSFORM_PORT,
    Mountings,
    MountingSourceSettings,
    mounted,
    stated_mounting,
)
from sal_height.engine.provenance import of_compression
from sal_height.engine.results import DwellKey, Event, Notice, Product, Result
from sal_height.engine.settings import ChannelSettings, processing_of
from sal_height.engine.stage import FOREVER_NS, Decision, FileInput, Job, Port
from sal_height.engine.track import Arrival, OdometryHistory, OdometrySettings, Samples, longest_gap_s
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Mounting, PlatformState, Trajectory
from sal_height.imaging import MEASURED_AIR, UNKNOWN_AIR, VACUUM, ImageSettings, Slc
from sal_height.numeric import C64
from sal_height.pipeline import TESTED_BY, CalibrationTrial, Compressor
from sal_height.rehearsal import once, rehearse_heights, rehearsed_slc
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.settings import setting
from sal_height.topics import CALIBRATION, ODOMETRY, PHASE_HISTORY, SENSOR_INFO, SLC, TF_STATIC

SENSOR = (SENSOR_INFO, ODOMETRY, PHASE_HISTORY)
"""Topics of a sensor."""

ODOMETRY_PORT = Port(ODOMETRY, PlatformState, "state of the platform, nav_msgs/Odometry")

SLC_PORT = Port(SLC, Images, "complex image of one channel and dwell in each message", per_channel=True)

HEARD = "topic"
"""Value of the parameter calibration: apply the calibration that arrives on the topic calibration."""

ODOMETRY_GAP, NO_AIR = "odometry gap", "no air"
"""Reasons for which a dwell waits."""

NOT_TRUSTED = "autofocus found no phase error that it can trust; the image is focused with the odometry alone."


class CompressionSettings(MountingSourceSettings, AirSettings, OdometrySettings, ImageSettings, ChannelSettings):
    """Settings of the images, and the others that the stage needs."""

    calibration: str = setting(
        "",
        "path of a calibration file, which is applied to the images and published on topic calibration; 'topic': apply "
        "the last calibration received on topic calibration, unless the data contradict it; empty: none",
        read_only=True,
        names_file=True,
    )


class Supplies(NamedTuple):
    """Data that a dwell is compressed with, in addition to its frames.

    Attributes:
        states: odometry from the last sample before the first pulse to the first after the last pulse.
        choice: calibration of the sensor's receivers that is in use, and one on trial.
        mounting: mounting of the sensor on the platform.
        air: air data received, as values of the parameters that state measured air; None: none are used.
    """

    states: list[PlatformState]
    choice: CalibrationChoice
    mounting: Mounting
    air: Mapping[str, float] | None = None


class Compression(DwellStage):
    """Forms the images of all channels of a dwell, each with the same filter.

    A calibration is on trial until a dwell has tested it. Dwells are a series then, so that the first one decides for
    those after it, however many workers there are, and no image is published of a calibration that it contradicts.
    """

    usual_name = "sar_compression"
    about = "Forms the images of all channels of a dwell, each with the same filter."
    settings = CompressionSettings
    dwell_port = PHASE_HISTORY
    is_parallel = True
    niceness: ClassVar[int] = 4
    changeable: ClassVar = ("_received",)

    def __init__(self, *arguments: Any, **others: Any) -> None:
        super().__init__(*arguments, **others)
        self._odometry = OdometryHistory(self._settings.odometry_buffer_s)
        self._last_pulse_ns = 0
        self._awaited_ns = math.inf
        """Earliest stamp of odometry that a dwell waits for, as far as known; infinity: none does."""
        self._received = ChosenCalibrations()
        if self._of_file:
            self._received.receive(self._of_file)
        self._mountings = Mountings()
        self._air = AirHistory()
        self._awaits_air = False
        self._applied_from: dict[str, Sequence[DwellKey]] = {}
        """Dwells from which on calibrations are applied, by their identity; empty once they have arrived."""
        # The heavy side.
        self._strips = RecentValues[Compressor](2 * SENSORS_KEPT, Compressor)  # two where a calibration is on trial
        """Compressors of the blocks of each sensor in stripmap, by its config_hash and the calibration."""
        self._trials = Kept[tuple[int, CalibrationTrial]](SENSORS_KEPT)
        """Last trial of a calibration, and its number, by config_hash of the sensor."""
        self._spare: list[C64] = []
        """Samples of the last spotlight dwell, whose memory the next one uses: new pages take longer than the copy."""

    @classmethod
    def inputs(cls, settings: Any) -> Sequence[Port]:
        """Frames, their sensor, the odometry, and what the settings ask for."""
        frames = Port(
            PHASE_HISTORY, Frame, "samples of one channel and dwell in each message", per_channel=True, counted=True
        )
        ports = [SENSOR_PORT, ODOMETRY_PORT, frames, *AIR_PORTS]
        if settings.calibration == HEARD:
            ports.append(
                CALIBRATION_PORT._replace(about="calibration to apply, only if the parameter calibration is topic")
            )
        if settings.mounting_from_tf:
            ports.append(TRANSFORM_PORT)
        return ports

    @classmethod
    def described_inputs(cls) -> Sequence[Port]:
        """All ports that it accepts items on with some settings."""
        return cls.inputs(cls.settings(calibration=HEARD, mounting_from_tf=True))

    @classmethod
    def described_outputs(cls) -> Sequence[Port]:
        """All ports that it makes products for with some settings."""
        return cls.outputs(cls.settings(calibration="FILE"))

    @classmethod
    def outputs(cls, settings: Any) -> Sequence[Port]:
        """The images, and the calibration of a file."""
        of_file = settings.calibration not in {"", HEARD}
        about = "calibration of the file that the parameter calibration names"
        return [SLC_PORT, *([CALIBRATION_PORT._replace(about=about)] if of_file else [])]

    @classmethod
    def files(cls, settings: Any) -> Sequence[FileInput]:
        """The calibration."""
        source = settings.calibration
        return [FileInput(CALIBRATION, CALIBRATION, source)] if source not in {"", HEARD} else []

    def begin(self, stamp_ns: int) -> None:
        """Publish the calibration of the file."""
        if self._of_file:
            self.add(Product(CALIBRATION, StatedCalibration(self._of_file, stamp_ns)))

    @property
    def _of_file(self) -> Calibration | None:
        found: Calibration | None = self._files.get(CALIBRATION)
        return found

    def state_mounting(self, sensor: str, mounting: Mounting) -> None:
        """Use a mounting for a sensor (config_hash) instead of that of its description, as a flight did."""
        self._mountings.state(sensor, mounting)

    def state_calibrations(self, applied_from: Mapping[str, Sequence[DwellKey]]) -> None:
        """Apply calibrations (by identity) from these dwells on, as a flight did, and not once they arrive."""
        self._applied_from = dict(applied_from)

    @property
    def needed_ports(self) -> Sequence[str]:
        """The air, if it is to be read from messages."""
        if self._settings.air != AIR_OF_TOPICS:
            return ()
        sensors = map(self._sensors.get, self._sensors)
        return [port for sensor in sensors if sensor for port in needed_air(sensor.wavelength)]

    def check(self, message: Frame, sensor: Sensor) -> None:
        """Check size, samples and pulse times of a frame."""
        check_frame(message, sensor)
        self._last_pulse_ns = max(self._last_pulse_ns, message.end_ns)

    def supplies(self, key: DwellKey, messages: list[Frame], sensor: Sensor) -> Supplies:
        """Odometry from before the first pulse to after the last without gaps, and calibration and air to use.

        Raises:
            Rejected: the odometry does not cover the pulses yet, or has a gap; the sensor's frame, or the air, is not
                known yet.
            UserError: the sensor's frame is nowhere on a platform.
        """
        frame, settings = messages[0], self._settings
        delay_ns = settings.odometry_delay_ns
        states = self._odometry.around(key.stamp_ns + delay_ns, frame.end_ns + delay_ns)
        gap = longest_gap_s(states)
        if gap <= settings.max_odometry_gap_s:
            try:
                air = air_of_dwell(self._air, frame, sensor, states, settings)
            except Rejected:
                self._awaits_air = True
                raise
            if gap > settings.odometry_interval_s:
                self.count("odometry.bridged")
            return Supplies(states, self._choice_for(sensor), self._mountings.of(sensor, settings), air)
        self._awaited_ns = min(self._awaited_ns, frame.end_ns + delay_ns)
        found = f"there are {gap:g} s between two" if states else self._describe_odometry(key.stamp_ns)
        raise Rejected(
            ODOMETRY_GAP,
            f"Dwell {key.number}: {ODOMETRY} must reach from its first pulse to its last with a sample every "
            f"{settings.max_odometry_gap_s:g} s (max_odometry_gap_s); {found}.{self.describe_sources()}",
        )

    def is_hopeless(self, dwell: Dwell[Frame], missing: Rejected) -> bool:
        """True if odometry, air or a transform that a dwell waits for will not arrive."""
        settings, none_before = self._settings, self._none_before
        if missing.reason == ODOMETRY_GAP:
            start_ns = dwell.key.stamp_ns + settings.odometry_delay_ns
            end_ns = dwell.messages[0].end_ns + settings.odometry_delay_ns
            none_before_ns = none_before.get(ODOMETRY, start_ns)
            return not self._odometry.may_cover(start_ns, end_ns, none_before_ns, settings.max_odometry_gap_s)
        if missing.reason == NO_AIR:
            return not may_have_air(self._air, none_before, dwell.key, dwell.sensor, settings)
        if missing.reason == NO_MOUNTING:
            return none_before.get(TF_STATIC, 0) == FOREVER_NS
        return super().is_hopeless(dwell, missing)

    @property
    def awaits_odometry(self) -> bool:
        """True if a dwell waits for odometry; else a sample changes nothing until something else arrives."""
        return self._awaited_ns < math.inf

    def accept_odometry(self, samples: Samples, now_s: float) -> Sequence[Decision]:
        """Accept odometry samples together, which decides what `accept` would, one by one.

        Args:
            samples: samples in the order of their arrival, one or more.
            now_s: time of the host's clock, s.
        """
        if not self._odometry.extend(samples):
            return [decision for state in samples.states() for decision in self.accept(ODOMETRY, state, now_s)]
        self._now_s = now_s
        first_ns, last_ns = int(samples.stamps_ns[0]), int(samples.stamps_ns[-1])
        return self._collected(self._note_odometry, first_ns, last_ns, True)

    def series_of(self, whole: WholeDwell) -> str | None:
        """Blocks of a strip follow each other, and so do dwells that test a calibration."""
        if whole.sensor.mode == "stripmap":
            return self.own_series
        return f"{self.name} trial" if whole.supplies.choice.on_trial else None

    def follow(self, job: Job, results: Sequence[Result]) -> None:
        """Learn whether a calibration was adopted or refused."""
        super().follow(job, results)
        if isinstance(job.inputs, WholeDwell):
            self._received.follow(job.inputs.supplies.choice, results)

    def hand_over_complete(self) -> None:
        """Make jobs of complete dwells; odometry is no longer awaited for those that were dropped meanwhile."""
        if not self._is_applying:
            self._awaited_ns = math.inf  # dwells that still wait set it again
        super().hand_over_complete()

    @property
    def own_series(self) -> str:
        """Series of what changes the strip."""
        return f"{self.name} strip"

    def receive_other(self, port: str, item: Any) -> None:
        """Accept odometry, air, a calibration or a transform."""
        if port == ODOMETRY:
            self._receive_odometry(item)
        elif port in AIR_PARAMETERS:
            self._air.add(port, item)
            if self._awaits_air:
                self._awaits_air = False  # dwells that still wait set it again
                self.hand_over_complete()
        elif port == CALIBRATION:
            self._receive_calibration(item)
        else:
            try:
                self._mountings.add(item)
            except UserError as error:
                self.warn("transform", error)
            self.hand_over_complete()

    def forget(self) -> None:
        """Forget odometry, unfinished dwells, and the strip that dwells are blocks of."""
        self._odometry = OdometryHistory(self._settings.odometry_buffer_s)
        self._last_pulse_ns, self._awaited_ns = 0, math.inf
        super().forget()

    def forget_work(self) -> Iterator[Result]:
        """Start new strips."""
        self._strips.take_all()
        yield from ()

    def rehearse_for(self, sensor: Sensor, settings: Any) -> None:
        """Compress made-up dwells, and test a calibration on them."""
        once(
            (sensor.digest, processing_of(settings)),
            lambda: rehearsed_slc(sensor, settings, Compressor(), np.random.default_rng(0)),
        )
        if settings.calibration:
            tests = [(TESTED_BY, TESTED_BY.settings())]
            once(
                (sensor.digest, TESTED_BY), lambda: rehearse_heights(sensor, settings, tests, np.random.default_rng(0))
            )

    def work_on(self, whole: WholeDwell, job: Job) -> Iterator[Result]:
        """Compress a dwell, or the columns that a block completes of a strip."""
        number, prepared, choice = whole.key.number, self._prepared(whole, job.settings), whole.supplies.choice

        def form(calibration: Calibration | None) -> Slc | None:
            compressor = self._compressor_of(whole.sensor, calibration)
            return compressor.add(prepared.history, prepared.track, prepared.sensor, prepared.settings, calibration)

        if choice.on_trial:
            trial = self._trial_of(whole.sensor, choice, choice.on_trial)
            was_decided = trial.adopted is not None
            slc, calibration = trial.images(form, whole.sensor), trial.chosen
            if trial.refusal and not was_decided:
                yield Notice(CALIBRATION_REFUSED, f"Dwell {number}: {trial.refusal}")
            elif trial.adopted and not was_decided:
                yield Event(CALIBRATIONS_ADOPTED)
            if trial.adopted is not None and not was_decided:
                self._strips.remove(_strip_name(whole.sensor, trial.left_out))
        else:
            slc, calibration = form(choice.in_use), choice.in_use
        samples = prepared.history.samples
        if whole.sensor.mode != "stripmap" and samples.flags.owndata:  # a strip keeps its samples
            self._spare.append(samples)
        if slc is None:
            if shortfall := self._compressor_of(whole.sensor, calibration).shortfall:
                yield Notice("strip incomplete", f"Dwell {number}: {shortfall}", whole.key)
            return
        if slc.focus and not slc.focus.trusted:
            yield Notice("autofocus", f"Dwell {number}: {NOT_TRUSTED}", whole.key)
        yield from (Notice(doubt.name, f"Dwell {number}: {doubt.sentence}", whole.key) for doubt in slc.doubts)
        yield Product(SLC, self._product(whole, job, prepared, slc, calibration))

    def _compressor_of(self, sensor: Sensor, calibration: Calibration | None) -> Compressor:
        """Compressor of the blocks of a sensor so far; a new one for a spotlight dwell, which needs none before it."""
        if sensor.mode != "stripmap":
            return Compressor()
        compressor = self._strips.of(_strip_name(sensor, calibration))
        self._strips.take_surplus()
        return compressor

    def _trial_of(self, sensor: Sensor, choice: CalibrationChoice, on_trial: Calibration) -> CalibrationTrial:
        """The trial of a calibration, which goes on from dwell to dwell."""
        number, trial = self._trials.use(sensor.config_hash) or (0, None)
        if trial is None or number != choice.trial:
            before = trial.settled if trial and 0 < choice.first_open <= number else choice.in_use
            trial = CalibrationTrial(on_trial, before)
            self._trials.put(sensor.config_hash, (choice.trial, trial))
        return trial

    def _prepared(self, whole: WholeDwell, settings: CompressionSettings) -> _Prepared:
        """A dwell with the mounting of its sensor and the air that apply to it."""
        sensor, supplies = whole.sensor, whole.supplies
        stated: dict[str, Any] = dict(settings)
        if supplies.mounting != sensor.mounting:
            sensor = mounted(sensor, supplies.mounting)
            stated |= stated_mounting(supplies.mounting)
        track = Trajectory(supplies.states, motion=settings.motion, accuracy=settings.accuracy)
        used = settings
        if supplies.air is not None:
            used = settings.changed(air=MEASURED_AIR, **supplies.air)
            stated[USED_AIR] = supplies.air
        return _Prepared(self._history_of(whole), track, sensor, used, stated)

    def _product(
        self, whole: WholeDwell, job: Job, prepared: _Prepared, slc: Slc, calibration: Calibration | None
    ) -> Images:
        """The images as a product."""
        sensor = prepared.sensor
        applied = calibration.id if calibration else sensor.calibration_id
        provenance = of_compression(self.name, prepared.stated, slc, sensor.config_hash, applied)
        air_delay = {VACUUM: AIR_LEFT, UNKNOWN_AIR: ""}.get(prepared.settings.air, AIR_REMOVED)
        source = Source(whole.messages, sensor, whole.supplies.states, calibration, slc, job.settings)
        return Images.made_of(
            whole.key, job.settings.map_frame, slc, provenance, air_delay=air_delay, order=job.order, source=source
        )

    def _history_of(self, whole: WholeDwell) -> PhaseHistory:
        """The phase history of a dwell, without a copy of its samples or in memory that is spare, if there is any."""
        frames, spare = whole.messages, None
        if whole.sensor.mode != "stripmap" and (in_line := samples_in_line(frames)) is not None:
            return history_of(frames, in_line)
        with suppress(IndexError):
            spare = self._spare.pop()
        shape = len(frames), frames[0].pulse_count, frames[0].sample_count
        return history_of(
            frames, stacked_samples(frames, spare if spare is not None and spare.shape == shape else None)
        )

    def _choice_for(self, sensor: Sensor) -> CalibrationChoice:
        """The calibrations of a sensor: that of the file, or its own if one has arrived."""
        if self._of_file and self._of_file.config_hash != sensor.config_hash:
            return CalibrationChoice(self._of_file)  # the compression refuses the dwell
        return self._received.of(sensor)

    def _describe_odometry(self, start_ns: int) -> str:
        """Description of the odometry received, relative to a dwell that it does not cover."""
        if self._odometry.span_ns is None:
            return "no sample was received (is its QoS compatible?)"
        first, last = ((stamp_ns - start_ns) * 1e-9 for stamp_ns in self._odometry.span_ns)
        kept = f"samples are kept from {first:.6g} s to {last:.6g} s after its first pulse"
        return f"{kept}: frames and odometry have different clocks" if abs(first) > OTHER_CLOCK_S else kept

    def _receive_calibration(self, item: StatedCalibration) -> None:
        name = item.calibration.id
        if name in self._applied_from and not self._is_applying:
            for dwell in self._applied_from[name]:
                self.schedule(dwell, CALIBRATION, item)
            self._applied_from[name] = ()
        else:
            self._received.receive(item.calibration)
            self.count(CALIBRATIONS_ARRIVED)

    def _receive_odometry(self, state: PlatformState) -> None:
        arrival = self._odometry.add(state)
        if arrival is Arrival.SET_ASIDE:
            self.warn("odometry out of time", UserError(_out_of_time(state, self._odometry)))
        elif arrival is not Arrival.IN_ORDER:
            self.count(f"odometry.{arrival.value}")
        self._note_odometry(state.stamp_ns, state.stamp_ns, arrival is Arrival.IN_ORDER)

    def _note_odometry(self, first_ns: int, last_ns: int, in_order: bool) -> None:
        """Go on with dwells that wait for the odometry that has arrived, whose stamps are from first to last, ns."""
        if first_ns <= self._last_pulse_ns + self._settings.odometry_delay_ns:
            self.note_progress()  # what dwells still wait for is on its way
        if last_ns >= self._awaited_ns or not in_order:
            self.hand_over_complete()


class _Prepared(NamedTuple):
    """A dwell that is ready for the compression.

    Attributes:
        history: phase history of all channels.
        track: track of the platform.
        sensor: sensor with the mounting that applies.
        settings: settings of the images, with measured air if some is used.
        stated: values for the provenance.
    """

    history: PhaseHistory
    track: Trajectory
    sensor: Sensor
    settings: CompressionSettings
    stated: dict[str, Any]


def _strip_name(sensor: Sensor, calibration: Calibration | None) -> str:
    """Name of the compressor of a strip."""
    return f"{sensor.config_hash} {calibration.id if calibration else ''}"


def _out_of_time(state: PlatformState, history: OdometryHistory) -> str:
    _, last_ns = history.span_ns or (0, 0)
    return (
        f"A sample is stamped {(state.stamp_ns - last_ns) * 1e-9:.6g} s after the latest one; it is used only if the "
        "next sample continues it, as when the clock has started again."
    )
