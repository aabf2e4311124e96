"""Needs and performance of a sensor from its preset alone: power, resolution, swath, pulses, data and accuracy."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.constants import speed_of_light

from sal_height.budget.budget_errors import BudgetEntry, Situation, describe_autofocus, error_entries, image_settings
from sal_height.elevation import stochastic_crb
from sal_height.errors import UserError
from sal_height.geometry import RADIO_M, AirPath, ApertureState, locate_at_height, path_through_air
from sal_height.imaging import azimuth_resolution, image_beams
from sal_height.io import new_folder, write_text, writing
from sal_height.numeric import F64
from sal_height.picture import page
from sal_height.relief import position_jacobian, vertical
from sal_height.sensor import Sensor, aperture_length, lit_doppler, spectrum_sensor
from sal_height.simulation import Preset, describe_beam_misfits, mean_square_gain, samples_doppler
from sal_height.theory import Link, diffuse_backscatter, effective_area, noise_density

BUDGET, PICTURE = "budget.json", "budget.png"
"""Files in the output folder."""

ALBEDO, BACKSCATTER_DB = 0.3, -10.0
"""Assumptions on the ground: in light a diffuse surface, for radio waves a radar cross-section per area."""

DEFOCUSING_RAD = np.pi / 4
"""Phase at the ends of the aperture that widens a response noticeably."""

SENSITIVITY = "sensitivity to uncorrected errors"
"""Heading of what an error of a unit does, whether the preset has it or not."""

PLACES = 201
"""Over the swath, of the picture."""


@dataclass(frozen=True)
class Assumptions:
    """Assumptions on what a preset does not state.

    Attributes:
        power: mean power that is transmitted, W; None: the one for the CNR of the preset.
        backscatter: radar cross-section per area of ground, a ratio; None: the usual one (ALBEDO, BACKSCATTER_DB).
        loss: power ratio lost in transmitter, air and receiver together, 1 or more.
        noise_figure: noise figure of the receivers, 1 or more.
    """

    power: float | None = None
    backscatter: float | None = None
    loss: float = 1.0
    noise_figure: float = 1.0


class Budget:
    """A preset's sensor over level ground, abeam, in the middle of its beams.

    Attributes:
        preset: preset of the flight.
        sensor: sensor of the preset.
        assumed: assumptions on what the preset does not state.
        backscatter: radar cross-section per area of ground, as assumed or the usual one.
        link: power budget from transmitter to receiver.
        cnr: carrier-to-noise ratio of a look of a detector that looks straight at the ground.
        power: mean power that is transmitted, W.
    """

    def __init__(self, preset: Preset, assumed: Assumptions) -> None:
        """Derive the numbers of the sensor.

        Raises:
            UserError: beams that leave the quarter between nadir and horizon, or a parameter that is not allowed.
        """
        self.preset, self.sensor, self.assumed = preset, preset.make_sensor(), assumed
        is_radar = self.sensor.wavelength >= RADIO_M
        usual = 10 ** (BACKSCATTER_DB / 10) if is_radar else diffuse_backscatter(ALBEDO, preset.flight.look_angle_rad)
        self.backscatter = usual if assumed.backscatter is None else assumed.backscatter
        self._settings = image_settings(preset)
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
            cnr: clutter-to-noise ratio of a look.
            elevation: elevation of the target, rad; None: the middle of the beams.
        """
        beams = image_beams(self.sensor, "taylor")
        middle = float(np.mean(beams.span))
        looks = int(np.prod(self.preset.looks))
        return self._climb * stochastic_crb(beams, middle if elevation is None else elevation, 0.0, cnr, looks)

    def over_the_swath(self) -> tuple[F64, F64]:
        """Elevation from the middle of the beams (rad), and `height_deviation` there."""
        first, last = self.sensor.beams.span
        middle = (first + last) / 2
        elevation = np.linspace(first, last, PLACES)
        return elevation - middle, self.height_deviation(self.cnr, elevation)

    def entries(self) -> list[BudgetEntry]:
        """All numbers, in the order in which they are printed."""
        return [
            *self._place(),
            *self._resolution(),
            *self._pulses(),
            *self._data(),
            *self._accuracy(),
            *self._sensitivities(),
            *error_entries(self._situation),
            *self._air(),
        ]

    def refusals(self) -> list[str]:
        """Messages with which a run refuses the preset, each once."""
        found = list(describe_beam_misfits(self.preset, self.sensor))
        if self.preset.impairments.air and isinstance(self._path, str):
            found.append(self._path)
        return found

    def notes(self) -> list[str]:
        """Notes on what the numbers leave out."""
        found = [describe_autofocus(self._situation)]
        if isinstance(self._path, str):
            found.append(f"The table has nothing on air: {self._path[0].lower()}{self._path[1:]}")
        return found

    @cached_property
    def _situation(self) -> Situation:
        """Situation that the effects of the preset's errors depend on."""
        return Situation(self.preset, self.sensor, self._settings, self._aperture, self._aperture_time, self._climb)

    @cached_property
    def _climb(self) -> float:
        """Height (m) that a radian of elevation moves a point by."""
        aperture = self._aperture
        point = locate_at_height(0.0, self.preset.flight.slant_range_m, 0.0, aperture, self.sensor.look_side)
        return abs(float(vertical(point) @ position_jacobian(point, aperture)[:, 0]))

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

    def _place(self) -> Iterator[BudgetEntry]:
        flight, sensor = self.preset.flight, self.sensor
        look = flight.look_angle_rad
        ground = self._lit_across / np.cos(look)
        window = spectrum_sensor(sensor).range_window / np.sin(look)
        along = sensor.azimuth_beamwidth * flight.slant_range_m
        group = "place"
        yield BudgetEntry(group, "slant_range_m", "slant range", flight.slant_range_m, "m")
        yield BudgetEntry(group, "height_m", "height over the ground", flight.slant_range_m * np.cos(look), "m")
        yield BudgetEntry(group, "swath_m", "swath of all beams, on the ground", ground, "m")
        yield BudgetEntry(group, "window_m", "range window, on the ground", window, "m")
        across = sensor.beamwidth * flight.slant_range_m
        yield BudgetEntry(group, "beam_across_m", "width of a beam across the line of sight", across, "m")
        yield BudgetEntry(group, "beam_along_m", "width of a beam along the flight", along, "m")

    def _resolution(self) -> Iterator[BudgetEntry]:
        slant, ground, along = self._cells
        yield BudgetEntry("resolution", "range_cell_m", "slant range", slant, "m")
        yield BudgetEntry("resolution", "ground_cell_m", "range on the ground", ground, "m")
        yield BudgetEntry("resolution", "along_cell_m", "along the flight", along, "m")
        yield BudgetEntry("resolution", "aperture_ms", "time of an aperture", 1e3 * self._aperture_time, "ms")

    def _pulses(self) -> Iterator[BudgetEntry]:
        sensor, flight, group = self.sensor, self.preset.flight, "pulses"
        rate = sensor.pulse_repetition_frequency
        least = lit_doppler(sensor, flight.speed_mps)
        greatest = speed_of_light / 2 / (self._lit_across * np.tan(flight.look_angle_rad))
        lowest_title = "lowest PRF that samples the Doppler of the main lobes"
        highest_title = "highest PRF without range ambiguity in the swath"
        aliases = "" if samples_doppler(self.preset, sensor) else "too low"
        yield BudgetEntry(group, "prf_hz", "pulse repetition frequency (PRF)", rate, "Hz", aliases)
        yield BudgetEntry(group, "least_prf_hz", lowest_title, least, "Hz")
        yield BudgetEntry(group, "greatest_prf_hz", highest_title, greatest, "Hz")
        on_the_way = 2 * flight.slant_range_m * rate / speed_of_light
        yield BudgetEntry(group, "pulses_on_the_way", "pulses in flight", on_the_way, "")
        fastest = sensor.wavelength * rate / 4
        yield BudgetEntry(group, "radial_velocity_mps", "radial velocity without ambiguity, up to", fastest, "m/s")

    def _data(self) -> Iterator[BudgetEntry]:
        sensor, preset = self.sensor, self.preset
        while_received = sensor.dwell_bytes * sensor.pulse_repetition_frequency / sensor.pulse_count
        per_second = preset.flight.speed_mps / preset.dwell_spacing_m
        yield BudgetEntry("data", "dwell_mb", "of a dwell", sensor.dwell_bytes / 1e6, "MB")
        yield BudgetEntry("data", "dwells_per_s", "dwells", per_second, "1/s")
        yield BudgetEntry("data", "mean_mb_per_s", "average", sensor.dwell_bytes * per_second / 1e6, "MB/s")
        yield BudgetEntry("data", "burst_mb_per_s", "during a dwell", while_received / 1e6, "MB/s")

    def _accuracy(self) -> Iterator[BudgetEntry]:
        group = "power and accuracy"
        decibels = {
            "backscatter_db": ("backscatter of the ground (sigma0)", self.backscatter),
            "loss_db": ("losses", self.assumed.loss),
            "noise_figure_db": ("noise figure", self.assumed.noise_figure),
            "cnr_db": ("single-look CNR at beam centre", self.cnr),
        }
        for key, (title, ratio) in decibels.items():
            yield BudgetEntry(group, key, title, 10 * np.log10(ratio), "dB")
        yield BudgetEntry(group, "power_w", "mean power transmitted", self.power, "W")
        deviation = float(self.height_deviation(self.cnr))
        yield BudgetEntry(group, "height_sigma_m", "sigma of a height by noise, at least", deviation, "m")

    def _sensitivities(self) -> Iterator[BudgetEntry]:
        flight, sensor, group = self.preset.flight, self.sensor, SENSITIVITY
        time, wavelength = self._aperture_time, sensor.wavelength
        arm = flight.slant_range_m * np.sin(flight.look_angle_rad)
        shift = flight.slant_range_m / flight.speed_mps
        acceleration = DEFOCUSING_RAD * wavelength / (2 * np.pi) / (time / 2) ** 2
        echo_db = -20.0  # power of the paired echoes that a vibration makes on both sides of each target
        vibration = 2 * 10 ** (echo_db / 20) * wavelength / (4 * np.pi)
        yield BudgetEntry(group, "roll_m_per_urad", "height error per µrad of roll", 1e-6 * arm, "m")
        yield BudgetEntry(
            group, "range_m_per_m", "height error per metre of range", -np.cos(flight.look_angle_rad).item(), "m"
        )
        yield BudgetEntry(
            group, "velocity_m_per_mm_per_s", "azimuth shift per mm/s of line-of-sight velocity", 1e-3 * shift, "m"
        )
        yield BudgetEntry(
            group, "clock_m_per_ms", "along-track shift per ms of odometry clock", 1e-3 * flight.speed_mps, "m"
        )
        yield BudgetEntry(
            group, "acceleration_mps2", "line-of-sight acceleration that defocuses (pi/4)", acceleration, "m/s²"
        )
        yield BudgetEntry(group, "vibration_um", "vibration with echoes of -20 dB, amplitude", 1e6 * vibration, "µm")

    @cached_property
    def _ground_above_sea(self) -> float:
        """Height of the map's origin above sea level, m, as the preset says it.

        The height of an origin above the ellipsoid, which differs by up to 100 m, is used where nothing else is stated.
        """
        if self.preset.impairments.air:
            return self.preset.impairments.air.map_height_m
        origin = self.preset.origin
        return self._settings.map_height_m or (origin.height_m if origin else 0.0)

    @cached_property
    def _path(self) -> AirPath | str:
        """Effect of the air of the preset, or else of the standard atmosphere; or a message on why it is not known."""
        flight, ground, wavelength = self.preset.flight, self._ground_above_sea, self.sensor.wavelength
        above = flight.slant_range_m * np.cos(flight.look_angle_rad)
        try:
            if air := self.preset.impairments.air:
                return air.way(wavelength, flight.slant_range_m, flight.look_angle_rad, 0.0)
            return path_through_air(wavelength, ground + above, ground, flight.look_angle_rad)
        except UserError as error:
            return str(error)

    def _air(self) -> Iterator[BudgetEntry]:
        """Entries on the air; empty where its effect is not known."""
        flight, path = self.preset.flight, self._path
        if isinstance(path, str):
            return
        group = ("air of this preset" if self.preset.impairments.air else "standard atmosphere") + ", uncorrected"
        look = flight.look_angle_rad
        by_range, by_bend = -np.cos(look) * path.delay, flight.slant_range_m * np.sin(look) * path.bend
        yield BudgetEntry(group, "air_map_height_m", "ground above sea level", self._ground_above_sea, "m")
        yield BudgetEntry(group, "air_range_m", "slant range, too long by", path.delay, "m")
        yield BudgetEntry(group, "air_bend_urad", "elevation, too far from nadir by", 1e6 * path.bend, "µrad")
        yield BudgetEntry(group, "air_height_by_range_m", "height, by range", by_range, "m")
        yield BudgetEntry(group, "air_height_by_bend_m", "height, by elevation", by_bend, "m")


def _elevation_width(sensor: Sensor) -> float:
    """Angle that the beams of all detectors cover along the detector axis, rad."""
    first, last = sensor.elevation_boresights[0], sensor.elevation_boresights[-1]
    return last - first + sensor.beamwidth


@dataclass(frozen=True)
class DrawnUp:
    """A budget as written: its numbers, what they leave out, and messages with which a run refuses the preset."""

    entries: list[BudgetEntry]
    notes: list[str]
    refusals: list[str]


def budget(preset: Preset, assumed: Assumptions, out: Path) -> DrawnUp:
    """Write budget.json and budget.png into the folder `out`, new or empty; returns what it says.

    Raises:
        UserError: the sensor is impossible, or a file cannot be written.
    """
    found = Budget(preset, assumed)
    drawn = DrawnUp(found.entries(), found.notes(), found.refusals())
    new_folder(out)
    numbers = {entry.key: entry.value for entry in drawn.entries}
    content = {"preset": preset.name, **numbers, "notes": drawn.notes, "refusals": drawn.refusals}
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
    return drawn


def draw_budget(
    name: str, by_power: tuple[F64, F64], by_place: tuple[F64, F64], point: tuple[float, float], path: Path
) -> None:
    """Write a PNG: sigma of a height by noise over the mean power, and over the swath.

    Args:
        name: name of the preset.
        by_power: mean power transmitted (W), and sigma (m) in the middle of the swath.
        by_place: elevation from the middle of the beams (beamwidths), and sigma (m).
        point: power (W) and sigma (m) of the budget.
        path: path of the picture.

    Raises:
        UserError: it cannot be written.
    """
    with writing(path), page(path, 2.6) as figure:
        power, swath = figure.subplots(1, 2)
        power.loglog(*by_power)
        power.plot(*point, "o", color="black", label=f"{point[0]:.3g} W: {point[1]:.2g} m")
        power.set(xlabel="mean power transmitted (W)", ylabel="sigma of a height by noise (m)")
        power.set_title(f"{name}: what a power gives, middle of the swath")
        power.legend(frameon=False)
        swath.plot(*by_place)
        swath.set(xlabel="elevation from the middle (beamwidths)", ylabel="sigma of a height by noise (m)")
        swath.set_title("over the swath, at that power")
        for axes in (power, swath):
            axes.grid(which="both")
        swath.set_ylim(bottom=0)
