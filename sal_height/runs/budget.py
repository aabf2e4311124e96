"""What a sensor needs and gives, from its preset alone: power, resolution, swath, pulses, data and accuracy."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path

import numpy as np
from scipy.constants import speed_of_light

from sal_height.elevation import stochastic_crb
from sal_height.errors import UserError
from sal_height.geometry import RADIO_M, ApertureState, locate_at_height, path_through_air
from sal_height.imaging import azimuth_resolution, image_beams
from sal_height.io import new_folder, write_text
from sal_height.numeric import F64
from sal_height.relief import position_jacobian, vertical
from sal_height.runs.budget_picture import draw_budget
from sal_height.sensor import Sensor, aperture_length, lit_doppler, spectrum_sensor
from sal_height.simulation import Preset, mean_square_gain
from sal_height.tables import aligned
from sal_height.theory import Link, diffuse_backscatter, effective_area, noise_density

BUDGET, PICTURE = "budget.json", "budget.png"
"""Files in the output folder."""

ALBEDO, BACKSCATTER_DB = 0.3, -10.0
"""What is assumed of the ground: in light a diffuse surface, for radio waves a radar cross-section per area."""

DEFOCUSING_RAD = np.pi / 4
"""Phase at the ends of the aperture that widens a response noticeably."""

PAIRED_ECHO_DB = -20.0
"""Of the echoes that a vibration puts beside each target."""

PLACES = 201
"""Over the swath, of the picture."""


@dataclass(frozen=True)
class Assumptions:
    """What a preset does not say.

    Attributes:
        power: mean power that is transmitted, W; None: the one for the CNR of the preset.
        backscatter: radar cross-section per area of ground, a ratio; None: the usual one (ALBEDO, BACKSCATTER_DB).
        loss: of power in transmitter, air and receiver together, 1 or more.
        noise_figure: of the receivers, 1 or more.
    """

    power: float | None = None
    backscatter: float | None = None
    loss: float = 1.0
    noise_figure: float = 1.0


@dataclass(frozen=True)
class Entry:
    """A number of the budget.

    Attributes:
        group: heading.
        key: in the JSON file, with its unit.
        title: what it is, in words.
        value: in `unit`.
        unit: as printed.
    """

    group: str
    key: str
    title: str
    value: float
    unit: str


class Budget:
    """A preset's sensor over level ground, abeam, in the middle of its beams.

    Attributes:
        preset: as given.
        sensor: of the preset.
        assumed: what the preset does not say.
        backscatter: radar cross-section per area of ground, as assumed or the usual one.
        link: from transmitter to receiver.
        cnr: carrier-to-noise ratio of a look of a detector that looks straight at the ground.
        power: mean power that is transmitted, W.
    """

    def __init__(self, preset: Preset, assumed: Assumptions) -> None:
        """Take the sensor apart.

        Raises:
            UserError: beams that leave the quarter between nadir and horizon.
        """
        self.preset, self.sensor, self.assumed = preset, preset.make_sensor(), assumed
        usual = _usual_backscatter(self.sensor.wavelength, preset.flight.look_angle_rad)
        self.backscatter = usual if assumed.backscatter is None else assumed.backscatter
        self.link = self._link()
        if assumed.power is None:
            self.cnr = float(10 ** (preset.cnr_db / 10))
            self.power = self.cnr / self.link.cnr_per_watt
        else:
            self.power = assumed.power
            self.cnr = self.power * self.link.cnr_per_watt

    def height_deviation(self, cnr: F64 | float, elevation: F64 | float | None = None) -> F64:
        """Least standard deviation (m) of a height by noise, of a pixel with the looks of the preset.

        Args:
            cnr: of a look.
            elevation: of the target, rad; None: the middle of the beams.
        """
        beams = image_beams(self.sensor, "taylor")
        middle = float(np.mean(beams.span))
        aperture = self._aperture
        point = locate_at_height(0.0, self.preset.flight.slant_range_m, 0.0, aperture, self.sensor.look_side)
        climb = abs(float(vertical(point) @ position_jacobian(point, aperture)[:, 0]))
        looks = int(np.prod(self.preset.looks))
        return climb * stochastic_crb(beams, middle if elevation is None else elevation, 0.0, cnr, looks)

    def over_the_swath(self) -> tuple[F64, F64]:
        """Elevation from the middle of the beams (rad), and `height_deviation` there."""
        first, last = self.sensor.beams.span
        middle = (first + last) / 2
        elevation = np.linspace(first, last, PLACES)
        return elevation - middle, self.height_deviation(self.cnr, elevation)

    def entries(self) -> list[Entry]:
        """All numbers, in the order in which they are printed."""
        return [
            *self._place(),
            *self._resolution(),
            *self._pulses(),
            *self._data(),
            *self._accuracy(),
            *self._sensitivities(),
            *self._navigation(),
            *self._air(),
        ]

    @cached_property
    def _aperture(self) -> ApertureState:
        """State of the antenna, over level ground at height 0."""
        flight = self.preset.flight
        above = np.array([0.0, 0.0, flight.slant_range_m * np.cos(flight.look_angle_rad)])
        length = self._aperture_time * flight.speed_mps
        return ApertureState(above, np.array([flight.speed_mps, 0.0, 0.0]), np.eye(3), length, np.zeros((6, 6)))

    @property
    def _aperture_time(self) -> float:
        """Time of a synthetic aperture, s."""
        if self.sensor.mode == "stripmap":
            return aperture_length(self.sensor, self.preset.flight.slant_range_m) / self.preset.flight.speed_mps
        return self.sensor.pulse_count / self.sensor.pulse_repetition_frequency

    @cached_property
    def _cells(self) -> tuple[float, float, float]:
        """Resolution in slant range, in range on the ground, and along the flight, m."""
        slant = spectrum_sensor(self.sensor).range_resolution
        along = azimuth_resolution(self.sensor, self._aperture, self.preset.flight.slant_range_m)
        return slant, float(slant / np.sin(self.preset.flight.look_angle_rad)), along

    def _link(self) -> Link:
        """The link of a transmitter that lights up the beams of all detectors evenly, and nothing else."""
        sensor, (_, ground_cell, along_cell) = self.sensor, self._cells
        gain = mean_square_gain(sensor.beams) if sensor.mode == "stripmap" else 1.0
        return Link(
            slant_range=self.preset.flight.slant_range_m,
            lit_angle=_elevation_width(sensor) * sensor.azimuth_beamwidth,
            cell_area=ground_cell * along_cell,
            backscatter=self.backscatter,
            effective_area=effective_area(sensor.beams.patterns[0], sensor.elevation_diameter, sensor.azimuth_diameter),
            coherent_time=self._aperture_time * gain,
            noise=noise_density(sensor.wavelength, self.assumed.noise_figure),
            loss=self.assumed.loss,
        )

    @property
    def _lit_across(self) -> float:
        """Width that the beams light up across the line of sight, m."""
        return _elevation_width(self.sensor) * self.preset.flight.slant_range_m

    def _place(self) -> Iterator[Entry]:
        flight, sensor = self.preset.flight, self.sensor
        look = flight.look_angle_rad
        ground = self._lit_across / np.cos(look)
        window = spectrum_sensor(sensor).range_window / np.sin(look)
        beside = sensor.azimuth_beamwidth * flight.slant_range_m
        group = "place"
        yield Entry(group, "slant_range_m", "slant range", flight.slant_range_m, "m")
        yield Entry(group, "height_m", "height over the ground", flight.slant_range_m * np.cos(look), "m")
        yield Entry(group, "swath_m", "swath of all beams, on the ground", ground, "m")
        yield Entry(group, "window_m", "range window, on the ground", window, "m")
        across = sensor.beamwidth * flight.slant_range_m
        yield Entry(group, "beam_across_m", "width of a beam across the line of sight", across, "m")
        yield Entry(group, "beam_along_m", "width of a beam along the flight", beside, "m")

    def _resolution(self) -> Iterator[Entry]:
        slant, ground, along = self._cells
        yield Entry("resolution", "range_cell_m", "slant range", slant, "m")
        yield Entry("resolution", "ground_cell_m", "range on the ground", ground, "m")
        yield Entry("resolution", "along_cell_m", "along the flight", along, "m")
        yield Entry("resolution", "aperture_ms", "time of an aperture", 1e3 * self._aperture_time, "ms")

    def _pulses(self) -> Iterator[Entry]:
        sensor, flight, group = self.sensor, self.preset.flight, "pulses"
        rate = sensor.pulse_repetition_frequency
        least = lit_doppler(sensor, flight.speed_mps)
        swath = self._lit_across * np.tan(flight.look_angle_rad)
        yield Entry(group, "prf_hz", "pulse repetition frequency", rate, "Hz")
        yield Entry(group, "least_prf_hz", "least: Doppler that main lobes light up", least, "Hz")
        yield Entry(group, "greatest_prf_hz", "greatest: echoes of the swath apart", speed_of_light / 2 / swath, "Hz")
        on_the_way = 2 * flight.slant_range_m * rate / speed_of_light
        yield Entry(group, "pulses_on_the_way", "pulses on the way at once", on_the_way, "")
        fastest = sensor.wavelength * rate / 4
        yield Entry(group, "radial_velocity_mps", "radial velocity without ambiguity, up to", fastest, "m/s")

    def _data(self) -> Iterator[Entry]:
        sensor, preset = self.sensor, self.preset
        while_received = sensor.dwell_bytes * sensor.pulse_repetition_frequency / sensor.pulse_count
        per_second = preset.flight.speed_mps / preset.dwell_spacing_m
        yield Entry("data", "dwell_mb", "of a dwell", sensor.dwell_bytes / 1e6, "MB")
        yield Entry("data", "dwells_per_s", "dwells", per_second, "1/s")
        yield Entry("data", "mean_mb_per_s", "in the mean", sensor.dwell_bytes * per_second / 1e6, "MB/s")
        yield Entry("data", "burst_mb_per_s", "while pulses come", while_received / 1e6, "MB/s")

    def _accuracy(self) -> Iterator[Entry]:
        group = "power and accuracy"
        decibels = {
            "backscatter_db": ("backscatter of the ground (sigma0)", self.backscatter),
            "loss_db": ("losses", self.assumed.loss),
            "noise_figure_db": ("noise figure", self.assumed.noise_figure),
            "cnr_db": ("CNR of a look, straight ahead", self.cnr),
        }
        for key, (title, ratio) in decibels.items():
            yield Entry(group, key, title, 10 * np.log10(ratio), "dB")
        yield Entry(group, "power_w", "mean power transmitted", self.power, "W")
        deviation = float(self.height_deviation(self.cnr))
        yield Entry(group, "height_sigma_m", "sigma of a height by noise, at least", deviation, "m")

    def _sensitivities(self) -> Iterator[Entry]:
        flight, sensor, group = self.preset.flight, self.sensor, "errors that nobody tells the processor"
        time, wavelength = self._aperture_time, sensor.wavelength
        arm = flight.slant_range_m * np.sin(flight.look_angle_rad)
        shift = flight.slant_range_m / flight.speed_mps
        acceleration = DEFOCUSING_RAD * wavelength / (2 * np.pi) / (time / 2) ** 2
        vibration = 2 * 10 ** (PAIRED_ECHO_DB / 20) * wavelength / (4 * np.pi)
        yield Entry(group, "roll_m_per_urad", "roll: height, for a microradian", 1e-6 * arm, "m")
        yield Entry(
            group, "range_m_per_m", "range: height, for a metre too far", -np.cos(flight.look_angle_rad).item(), "m"
        )
        yield Entry(group, "velocity_m_per_mm_per_s", "velocity along the sight: place, for a mm/s", 1e-3 * shift, "m")
        yield Entry(group, "clock_m_per_ms", "clock of the odometry: place, for a ms", 1e-3 * flight.speed_mps, "m")
        yield Entry(
            group, "acceleration_mps2", "acceleration along the sight that defocuses (pi/4)", acceleration, "m/s²"
        )
        yield Entry(group, "vibration_um", "vibration with echoes of -20 dB, amplitude", 1e6 * vibration, "µm")

    def _navigation(self) -> Iterator[Entry]:
        """What the errors of the preset's navigation do, rms; nothing where it has none."""
        flight, errors = self.preset.flight, self.preset.impairments.odometry
        if not errors.is_wrong:
            return
        grade = f", {errors.grade} grade" if errors.grade else ""
        group = f"errors of the navigation, rms{grade}"
        arm = flight.slant_range_m * np.sin(flight.look_angle_rad)
        along = errors.velocity_mps * flight.slant_range_m / flight.speed_mps
        roll, heading = float(arm * errors.attitude_rad), float(arm * errors.heading_rad)
        yield Entry(group, "navigation_position_m", "position", errors.position_m, "m")
        yield Entry(group, "navigation_along_m", "velocity: place along the flight, without autofocus", along, "m")
        yield Entry(group, "navigation_height_m", "roll: height", roll, "m")
        yield Entry(group, "navigation_beams_m", "heading: beams along the flight", heading, "m")

    def _air(self) -> Iterator[Entry]:
        """What the standard atmosphere does; nothing where it is not known."""
        flight, group = self.preset.flight, "standard atmosphere, if nobody corrects it"
        look, ground = flight.look_angle_rad, self.preset.origin.height_m if self.preset.origin else 0.0
        above = flight.slant_range_m * np.cos(look)
        try:
            path = path_through_air(self.sensor.wavelength, ground + above, ground, look)
        except UserError:
            return
        by_range, by_bend = -np.cos(look) * path.delay, flight.slant_range_m * np.sin(look) * path.bend
        yield Entry(group, "air_range_m", "slant range, too long by", path.delay, "m")
        yield Entry(group, "air_bend_urad", "elevation, too far from nadir by", 1e6 * path.bend, "µrad")
        yield Entry(group, "air_height_by_range_m", "height, by range", by_range, "m")
        yield Entry(group, "air_height_by_bend_m", "height, by elevation", by_bend, "m")


def _elevation_width(sensor: Sensor) -> float:
    """Angle that the beams of all detectors cover along the detector axis, rad."""
    first, last = sensor.elevation_boresights[0], sensor.elevation_boresights[-1]
    return last - first + sensor.beamwidth


def _usual_backscatter(wavelength: float, incidence: float) -> float:
    """Radar cross-section per area that is assumed of the ground, by wavelength (m) and angle of incidence (rad)."""
    return diffuse_backscatter(ALBEDO, incidence) if wavelength < RADIO_M else 10 ** (BACKSCATTER_DB / 10)


def budget(preset: Preset, assumed: Assumptions, out: Path) -> Sequence[Entry]:
    """Write budget.json and budget.png into the folder `out`, new or empty; returns the numbers.

    Raises:
        UserError: the sensor is impossible, or a file cannot be written.
    """
    found = Budget(preset, assumed)
    new_folder(out)
    entries = found.entries()
    content = {"preset": preset.name, **{entry.key: entry.value for entry in entries}}
    write_text(out / BUDGET, json.dumps(content, indent=2) + "\n")
    elevation, deviation = found.over_the_swath()
    powers = found.power * np.geomspace(1e-2, 1e2, PLACES)
    draw_budget(
        preset.name,
        (powers, found.height_deviation(powers * found.link.cnr_per_watt)),
        (elevation / found.sensor.beamwidth, deviation),
        (found.power, float(found.height_deviation(found.cnr))),
        out / PICTURE,
    )
    return entries


def _number(value: float) -> str:
    """A number with four digits that count, and without an exponent."""
    return np.format_float_positional(value, precision=4, unique=False, fractional=False, trim="-").rstrip(".")


def budget_table(entries: Sequence[Entry]) -> str:
    """The numbers as lines of text, under their headings."""
    rows = aligned([(f"  {one.title}", _number(one.value), one.unit.ljust(4)) for one in entries]).splitlines()
    lines: list[str] = []
    for group, members in groupby(zip(entries, rows, strict=True), key=lambda pair: pair[0].group):
        lines += [group, *(row.rstrip() for _, row in members)]
    return "\n".join(lines)
