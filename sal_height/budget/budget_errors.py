"""Effects of the errors of a preset on positions and heights, one by one, if nothing corrects them.

Each generator of entries is of one impairment, and gives nothing where the preset has none. Errors that are constant
are given by their size, random ones by their standard deviation. `budget_table` prints all entries of a budget.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby

import numpy as np
from scipy.special import jv

from sal_height.beams import Beams
from sal_height.elevation import information
from sal_height.geometry import ApertureState
from sal_height.imaging import (
    VACUUM,
    ImageSettings,
    NavigationPrior,
    image_beams,
    is_for_speckle,
    line_of_sight,
    stays_in_range_cell,
    with_known_errors,
)
from sal_height.numeric import F64
from sal_height.renamed import with_new_names
from sal_height.sensor import Sensor, spectrum_sensor
from sal_height.simulation import Preset, laser_structure, swings_little
from sal_height.tables import aligned, with_prefix
from sal_height.theory import AperturePhase, phase_of_line, phase_of_structure, sum_of_phases

GROUP = "errors of this preset"

QUARTIC_REST = np.sqrt((4 / 7) ** 2 / 5 + (8 / 35) ** 2 / 9)
"""Rms of x^4 over -1 < x < 1 about its mean and slope, by Legendre's polynomials: x^4 = 1/5 + 4/7 P2 + 8/35 P4."""


BASE_UNITS = {
    **{unit: (1.0, unit) for unit in ("m", "m/s", "m/s²", "s", "rad", "Hz", "W")},
    "ms": (1e-3, "s"),
    "µs": (1e-6, "s"),
    "µm": (1e-6, "m"),
    "µrad": (1e-6, "rad"),
    "kHz": (1e3, "Hz"),
    "MB": (1e6, "B"),
    "MB/s": (1e6, "B/s"),
}
"""Size of the units of entries in units without a prefix, of those that take prefixes."""


@dataclass(frozen=True)
class BudgetEntry:
    """A number of the budget.

    Attributes:
        group: heading.
        key: name in the JSON file, with its unit.
        title: name in words.
        value: number in `unit`.
        unit: unit as printed.
        remark: printed behind it; empty: none.
    """

    group: str
    key: str
    title: str
    value: float
    unit: str
    remark: str = ""


def budget_table(entries: Sequence[BudgetEntry]) -> str:
    """The numbers as lines of text, under their headings."""
    cells = []
    for one in entries:
        number, unit = _printed(one.value, one.unit)
        cells.append((f"  {one.title}", number, f"{unit.ljust(5)} {one.remark}".rstrip()))
    width = max(len(unit) for *_, unit in cells)
    rows = aligned([(title, number, unit.ljust(width)) for title, number, unit in cells]).splitlines()
    lines: list[str] = []
    for group, members in groupby(zip(entries, rows, strict=True), key=lambda pair: pair[0].group):
        lines += [group, *(row.rstrip() for _, row in members)]
    return "\n".join(lines)


def _printed(value: float, unit: str) -> tuple[str, str]:
    """A number with four significant digits, and its unit with the prefix that fits; dB and counts have none."""
    if unit not in BASE_UNITS:
        return f"{value:.4g}", unit
    size, base = BASE_UNITS[unit]
    return with_prefix(size * value, base)


@dataclass(frozen=True, eq=False)
class Situation:
    """Situation that the effect of an error depends on: a preset's sensor, abeam of level ground.

    Attributes:
        preset: preset of the flight.
        sensor: sensor of the preset.
        settings: settings of the compression, as the preset has them.
        aperture: state of the antenna in the middle of an aperture.
        seconds: time of an aperture.
        climb: height (m) that a radian of elevation moves a point by.
    """

    preset: Preset
    sensor: Sensor
    settings: ImageSettings
    aperture: ApertureState
    seconds: float
    climb: float

    @property
    def speed(self) -> float:
        """Of the flight, m/s."""
        return self.preset.flight.speed_mps

    @property
    def slant_range(self) -> float:
        """M."""
        return self.preset.flight.slant_range_m

    @property
    def sight(self) -> F64:
        """Unit vector in the middle of the beams, map axes."""
        return line_of_sight(self.sensor, self.aperture)


def image_settings(preset: Preset) -> ImageSettings:
    """Settings of the compression, as the preset has them, but in vacuum: the air has entries of its own.

    Raises:
        UserError: one is not allowed.
    """
    given = with_new_names(preset.processing.get("sar_compression", {}))
    known = {key: given[key] for key in ImageSettings.model_fields if key in given}
    return ImageSettings(**{**known, "air": VACUUM})


def error_entries(of: Situation) -> Iterator[BudgetEntry]:
    """All errors that the preset has."""
    return chain(
        _navigation(of),
        _autofocus(of),
        _odometry_delay(of),
        _lever_arm(of),
        _boresight(of),
        _vibration(of),
        _laser(of),
        _turbulence(of),
        _pointing_jitter(of),
        _antenna_swing(of),
        _quartic_phase(of),
        _vegetation(of),
        _converters(of),
        _gains(of),
        _beams(of),
        _receivers(of),
    )


def describe_autofocus(of: Situation) -> str:
    """Remark on whether the compression needs autofocus, by its own rule."""
    prior, allowed = _prior(of), of.settings.autofocus_from_beamwidths
    uncertain = of.settings.beams_are_uncertain(prior, of.sensor)
    known = (
        "from the stated errors of odometry and mounting, the along-track position of the beams is uncertain by "
        f"{_in_beamwidths(prior, of.sensor):.3g} beamwidths, {'more' if uncertain else 'not more'} than the "
        f"{allowed:g} of autofocus_from_beamwidths"
    )
    if of.settings.autofocus == "always":
        return f"Autofocus is made of all dwells, as autofocus is always; {known}."
    if not uncertain:
        return f"No autofocus is needed: {known}."
    if of.settings.autofocus == "never":
        return f"Autofocus is needed, but autofocus is never: {known}."
    if not _speckle_locates_beams(of):
        return (
            f"Autofocus would be needed: {known}; but the beams are so wide that speckle does not show their position, "
            "so that images are left as odometry focuses and places them."
        )
    return f"Autofocus is needed: {known}."


def _speckle_locates_beams(of: Situation) -> bool:
    """True if autofocus can measure the beams."""
    if of.sensor.mode == "stripmap":
        return stays_in_range_cell(of.sensor, of.slant_range)
    return is_for_speckle(of.sensor, of.speed * of.seconds / 2 * np.outer([-1, 1], of.aperture.direction))


def _prior(of: Situation) -> NavigationPrior:
    """Stated uncertainty of the beams from odometry and mounting."""
    errors = of.preset.impairments.odometry
    stated = np.diag([errors.position_m] * 3 + errors.turn_rad.tolist()) ** 2
    middle = of.aperture.position + of.slant_range * of.sight
    aperture = with_known_errors(replace(of.aperture, covariance=stated), middle, of.sensor, of.settings)
    return NavigationPrior.of(aperture, errors.velocity_mps**2 * np.eye(3), of.sight)


def _in_beamwidths(prior: NavigationPrior, sensor: Sensor) -> float:
    """Standard deviation of the along-track position of the beams."""
    return prior.spread / prior.flight_speed / sensor.beams.track_beamwidth


def _navigation(of: Situation) -> Iterator[BudgetEntry]:
    """An error of velocity moves the image by range over speed; one of attitude turns the beams."""
    errors = of.preset.impairments.odometry
    if not errors.is_wrong:
        return
    grade = f" ({errors.grade} grade)" if errors.grade else ""
    along = errors.velocity_mps * of.slant_range / of.speed
    level = of.slant_range * float(np.sin(of.preset.flight.look_angle_rad))
    yield _entry("navigation_position_m", f"navigation{grade}: position, rms", errors.position_m, "m")
    yield _entry("navigation_along_m", "navigation: along-track position error from velocity, rms", along, "m")
    yield _entry("navigation_height_m", "navigation: height by roll, rms", of.climb * errors.attitude_rad, "m")
    yield _entry(
        "navigation_beams_m", "navigation: beams along the flight by heading, rms", level * errors.heading_rad, "m"
    )


def _autofocus(of: Situation) -> Iterator[BudgetEntry]:
    """Uncertainty of the beams along the track, which decides on autofocus."""
    if (prior := _prior(of)).spread:
        title = "beams along the flight, as stated, in beamwidths"
        yield _entry("beams_uncertainty_beamwidths", title, _in_beamwidths(prior, of.sensor), "")


def _odometry_delay(of: Situation) -> Iterator[BudgetEntry]:
    """Stamps that are late by a time put everything as far along the flight as the platform moves in it."""
    if delay := of.preset.impairments.odometry.delay_s - of.settings.odometry_delay_s:
        name = "odometry stamped late"
        yield _entry("odometry_delay_ms", f"{name}, in addition to odometry_delay_s", 1e3 * delay, "ms")
        yield _entry("odometry_delay_along_m", f"{name}: along-track position error", of.speed * abs(delay), "m")


def _lever_arm(of: Situation) -> Iterator[BudgetEntry]:
    """All points are displaced as much as the antenna is; the arm is in axes of base_link, and the antenna level."""
    if any(described := of.preset.impairments.odometry.undescribed_lever_arm_m):
        arm, name = of.sensor.mounting.axes.inv().apply(described), "undescribed lever arm"
        yield _entry("lever_arm_m", name, float(np.linalg.norm(arm)), "m")
        yield _entry("lever_arm_along_m", f"{name}: along-track position error", abs(float(arm[0])), "m")
        yield _entry("lever_arm_height_m", f"{name}: height", abs(float(arm[2])), "m")


def _boresight(of: Situation) -> Iterator[BudgetEntry]:
    """A turn about the flight is one of elevation; one about the normal of flight and sight turns the beams ahead."""
    if any(turn := of.preset.impairments.odometry.undescribed_boresight_rad):
        ahead, name = float(np.cross(of.sight, of.aperture.direction) @ turn), "undescribed boresight"
        yield _entry("boresight_urad", name, 1e6 * float(np.linalg.norm(turn)), "µrad")
        yield _entry("boresight_height_m", f"{name}: height", of.climb * abs(turn[0]), "m")
        yield _entry("boresight_beams_m", f"{name}: beams along the flight", of.slant_range * abs(ahead), "m")


def _vibration(of: Situation) -> Iterator[BudgetEntry]:
    """Of lines of independent phase, each 4 pi / wavelength times its displacement."""
    lines, radians = of.preset.impairments.vibration.all_lines, 4 * np.pi / of.sensor.wavelength
    if not lines:
        return
    size = np.sqrt(sum(line.amplitude_m**2 for line in lines) / 2)
    yield _entry("vibration_rms_um", "vibration, rms", 1e6 * float(size), "µm")
    phases = (phase_of_line(radians * line.amplitude_m, 2 * np.pi * line.frequency_hz, of.seconds) for line in lines)
    yield from _of_phase(of, "vibration", sum_of_phases(phases))


def _laser(of: Situation) -> Iterator[BudgetEntry]:
    """Phase noise of the laser: an echo is mixed with the light sent when it arrives (`laser_structure`)."""
    if linewidth := of.preset.impairments.laser_linewidth_hz:
        yield _entry("laser_linewidth_khz", "laser linewidth", 1e-3 * linewidth, "kHz")
        structure = laser_structure(linewidth, of.slant_range)
        yield from _of_phase(of, "laser linewidth", phase_of_structure(structure, of.seconds))


def _turbulence(of: Situation) -> Iterator[BudgetEntry]:
    """Phases of the structure function of `Turbulence`, which the platform passes at its speed."""
    if turbulence := of.preset.impairments.turbulence:
        above = of.slant_range * float(np.cos(of.preset.flight.look_angle_rad))
        level = turbulence.structure(of.sensor.wavelength, of.slant_range, above)
        yield _entry(
            "turbulence_ground_cn2", "turbulence: Cn2 at the ground, 1e-15 m^(-2/3)", 1e15 * turbulence.ground_cn2, ""
        )
        found = phase_of_structure(lambda lag: level * (of.speed * lag) ** (5 / 3), of.seconds)
        yield from _of_phase(of, "turbulence", found)


def _of_phase(of: Situation, name: str, found: AperturePhase) -> Iterator[BudgetEntry]:
    """A trend is a velocity along the line of sight, whose image lies elsewhere along the flight; the rest spreads."""
    key = name.split(maxsplit=1)[0]
    along = of.slant_range / of.speed * of.sensor.wavelength / (4 * np.pi) * found.trend
    yield _entry(f"{key}_along_m", f"{name}: along-track position error, rms", along, "m")
    yield _entry(f"{key}_phase_rad", f"{name}: phase without its trend, rms", found.rest, "rad")
    yield _entry(f"{key}_spread_percent", f"{name}: energy out of its pixel", 100 * found.spread_share, "%")


def _pointing_jitter(of: Situation) -> Iterator[BudgetEntry]:
    """The mean of a flat spectrum over an aperture: the mean of sinc^2 over the band, by frequency times its time."""
    jitter_nodes = 2001  # frequencies of the integral over the spectrum of a pointing jitter
    if rms := (jitter := of.preset.impairments.pointing_jitter).rms_rad:
        turns = np.linspace(0.0, jitter.highest_hz * of.seconds, jitter_nodes)
        if turns[-1] > jitter_nodes / 20:  # the integral of sinc^2 from 0 on is 1/2, up to 1/(20 turns)
            mean2 = 0.5 / turns[-1]
        else:
            mean2 = float(np.trapezoid(np.sinc(turns) ** 2, dx=1 / (jitter_nodes - 1)))
        angle, name = rms * float(np.sqrt(mean2)), "pointing jitter"
        yield _entry("jitter_urad", f"{name}, rms", 1e6 * rms, "µrad", _swing_remark(of))
        yield _entry("jitter_height_m", f"{name}: height in an aperture, rms", of.climb * angle, "m")
        yield _entry("jitter_beams_m", f"{name}: beams along the flight, rms", of.slant_range * angle, "m")


def _antenna_swing(of: Situation) -> Iterator[BudgetEntry]:
    """The beams look ahead and back."""
    if amplitude := of.preset.impairments.antenna_swing.amplitude_rad:
        yield _entry("swing_urad", "antenna swing, amplitude", 1e6 * amplitude, "µrad", _swing_remark(of))
        yield _entry("swing_beams_m", "antenna swing: beams along the flight, up to", of.slant_range * amplitude, "m")


def _swing_remark(of: Situation) -> str:
    return "" if swings_little(of.preset, of.sensor) else "too much"


def _quartic_phase(of: Situation) -> Iterator[BudgetEntry]:
    """It has no trend, and spreads energy."""
    if edge := of.preset.impairments.quartic_phase_rad:
        share = AperturePhase(0.0, abs(edge) * float(QUARTIC_REST)).spread_share
        yield _entry("quartic_rad", "quartic phase, at the edge of the aperture", edge, "rad")
        yield _entry("quartic_spread_percent", "quartic phase: energy out of its pixel", 100 * share, "%")


def _vegetation(of: Situation) -> Iterator[BudgetEntry]:
    """Displacement by motion along the sight: range over speed times the velocity."""
    if wind := of.preset.impairments.vegetation_wind:
        along = of.slant_range / of.speed * wind.rms_velocity_mps
        yield _entry("vegetation_mps", "wind in vegetation: velocity, rms", wind.rms_velocity_mps, "m/s")
        yield _entry("vegetation_along_m", "wind in vegetation: along-track position error, rms", along, "m")


def _converters(of: Situation) -> Iterator[BudgetEntry]:
    """Rounding to the step q adds noise of the power q^2 / 6 to a sample (`simulation.receiver_noise`)."""
    if bits := of.preset.impairments.adc_bits:
        step = 2 * of.sensor.full_scale / (2**bits - 1)
        rise = 1 + step**2 / 6 / min(of.sensor.noise_power)
        yield _entry("adc_bits", "converters", bits, "bits")
        yield _entry("adc_noise_db", "converters: noise higher by", 10 * float(np.log10(rise)), "dB")


def _gains(of: Situation) -> Iterator[BudgetEntry]:
    """A change c of the response a moves elevation by c a' / D, a' the slope perpendicular to a.

    With gains 1 + e of the receivers it is c = e a, and behind a channel matrix M in the antenna M^-1 e M a
    (`simulation.impairments.through_receivers`).
    """
    gains, phases = of.preset.impairments.undescribed_gains_db, of.preset.impairments.undescribed_phases_rad
    if any(gains):
        beams: Beams = image_beams(of.sensor, "taylor")
        middle = float(np.mean(beams.span))
        response, slope = beams.response(middle, 0.0), beams.slope(middle, 0.0)
        across = slope - response * (response.conj() @ slope) / np.sum(np.abs(response) ** 2)
        matrix = of.sensor.mixing if of.sensor.matrix_in_antenna else np.eye(len(gains))
        change = np.linalg.solve(matrix, (10 ** (np.array(gains) / 20) - 1) * (matrix @ response))
        angle = float(np.real(change @ across.conj())) / float(information(beams, middle, 0.0))
        yield _entry("gains_db", "undescribed gains, rms", float(np.sqrt(np.mean(np.square(gains)))), "dB")
        yield _entry("gains_height_m", "undescribed gains: height", of.climb * abs(angle), "m")
    if any(phases):
        yield _entry("phases_rad", "undescribed phases, rms", float(np.sqrt(np.mean(np.square(phases)))), "rad")


def _beams(of: Situation) -> Iterator[BudgetEntry]:
    """Sizes of errors of beams only: their effect on heights is estimated by a calibration."""
    impairments = of.preset.impairments
    if (factor := impairments.beam_width_factor) != 1:
        yield _entry("beam_width_factor", "beams wider than described, by the factor", factor, "")
    if any(waves := impairments.pupil_aberrations_waves.coefficients):
        yield _entry("pupil_waves", "aberrations of the pupil, rms", float(np.linalg.norm(waves)), "waves")


def _receivers(of: Situation) -> Iterator[BudgetEntry]:
    """Paired echoes of ripples over the band, and the sizes of the other errors."""
    impairments, cell = of.preset.impairments, spectrum_sensor(of.sensor).range_resolution
    if (ripple := impairments.chirp_ripple) and ripple.amplitude_rad:
        level = abs(jv(1, ripple.amplitude_rad) / jv(0, ripple.amplitude_rad))
        yield _entry("ripple_echo_db", "chirp ripple: paired echoes", 20 * float(np.log10(level)), "dB")
        yield _entry("ripple_echo_m", "chirp ripple: paired echoes, off in range by", ripple.cycles * cell, "m")
    if sawtooth := impairments.range_sawtooth:
        yield _entry(
            "sawtooth_echo_db", "range sawtooth: paired echoes", 20 * float(np.log10(sawtooth.depth / np.pi)), "dB"
        )
        yield _entry("sawtooth_echo_m", "range sawtooth: paired echoes, off in range by", sawtooth.teeth * cell, "m")
    if taper := impairments.range_taper:
        yield _entry("taper_band_share", "range taper: fraction of the band", taper.band_share, "")
    if spur := impairments.nyquist_spur_over_noise:
        yield _entry("spur_over_noise", "spur, over the noise of a sample", spur, "")


def _entry(key: str, title: str, value: float, unit: str, remark: str = "") -> BudgetEntry:
    return BudgetEntry(GROUP, key, title, value, unit, remark)
