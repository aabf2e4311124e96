"""Coverage of the sigma of heights if the platform vibrates, laser and odometry err, and leaves move.

Odometry errs as it states. The truth of a leaf in the wind is where it is in the middle of the dwell, not where its
Doppler puts its echo; that of a double bounce is the foot of its wall, where it appears. Every dwell is flown,
compressed and turned into heights as the graph does it, with nothing set but what a preset sets. A dwell is published
or refused; every surface of every published pixel is compared with the nearest true surface.

    python -m benchmarks platform                             the cases as rows with targets, into bench.json
    python -m benchmarks.imperfect_platform                   the cases as lines of a table, for people
    python -m benchmarks.imperfect_platform 'velocity*' --autofocus never
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import partial
from typing import Annotated

import numpy as np
from cyclopts import App, Parameter
from scipy.constants import mile, speed_of_light

from benchmarks.honest import Summary
from benchmarks.honest_scenes import fields, level
from benchmarks.row import Row, load, medians, sized
from benchmarks.spread import in_processes
from sal_height.elevation import ESTIMATORS
from sal_height.errors import Rejected
from sal_height.imaging import ImageSettings, Processing, Slc
from sal_height.pipeline import Compressor, heights
from sal_height.runs.truth.comparison import SurfaceComparison, compare, joined_comparisons
from sal_height.runs.truth.surface_report import as_flown, true_surfaces
from sal_height.simulation import Preset, Scene, SimulatedFlight, flight_of, load_preset
from sal_height.simulation.impairments import Impairments, PointingJitter, Turbulence, VegetationWind
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.phase_errors import Vibration, VibrationBand, VibrationLine
from sal_height.simulation.scene import PointScatterer
from sal_height.simulation.scenes import load_scene

PRESET = "sal_spotlight"
FLIGHTS = sized(96, 1)
"""Of a case, a dwell of each: errors of odometry are drawn once in a flight."""

MANY = sized(4, 1)
"""Times as many flights of cases where the error that all pixels of a flight share is the greatest: of n flights, c1 is
off by sqrt(.68 x .32 / n)."""

FEW = sized(24, 1)
"""Flights of cases whose dwells take several times as long, with vegetation or many pixels."""

BLOCKS = 6
"""Of a short strip: 3.8 m, five apertures."""

COMBINATIONS = sized(1000, 2)
"""Of levels of everything, each of them a flight of one dwell."""

STRIP_COMBINATIONS = sized(200, 1)
"""The same, each of them a short strip."""

WINDS = {2: 0.12, 10: 0.25}
"""Rms velocity of leaves, m/s, by the speed of the wind, m/s: light air and wind of `vegetation_wind`."""

BOUNCES = (10.0, 20.0, 30.0)
"""Double bounce of a wall 1 m high over a cell, dB."""

POINTING = 2e-6
"""Standard deviation of the attitude about each axis, rad: 7 mm of height by roll."""


@dataclass(frozen=True)
class Case:
    """A platform that is not perfect, or ground that is not at rest.

    Attributes:
        name: name in the results.
        preset: its first estimator makes the heights, `ml` if it names none.
        flights: number of flights of one dwell each.
        scene: function from a seed to the scene of that flight; None: that of the preset.
    """

    name: str
    preset: Preset
    flights: int = FLIGHTS
    scene: Callable[[int], Scene] | None = None


def same(seed: int, scene: Scene) -> Scene:  # noqa: ARG001 (as scenes are made that differ from flight to flight)
    """A scene that all flights have."""
    return scene


def _flown_as(impairments: Impairments, cnr_db: float = 20.0) -> Preset:
    return replace(load_preset(PRESET), impairments=impairments, cnr_db=cnr_db)


def _case(
    name: str, velocity_mps: float = 0.005, attitude_rad: float = POINTING, cnr_db: float = 20.0, **others: object
) -> Case:
    odometry = OdometryErrors(velocity_mps=velocity_mps, attitude_rad=attitude_rad)
    preset = _flown_as(Impairments(odometry=odometry, **others), cnr_db)  # type: ignore[arg-type]
    return Case(name, preset, FLIGHTS if attitude_rad == POINTING else MANY * FLIGHTS)


def _cases() -> Iterator[Case]:
    yield Case("perfect", _flown_as(Impairments()))
    for millimetres in (0.2, 0.5, 1, 2, 5, 10, 15):
        yield _case(f"velocity {millimetres:g} mm/s", 1e-3 * millimetres)
    for attitude in (2e-5, 1e-4):
        yield _case(f"velocity 5 mm/s, attitude {attitude:g} rad", attitude_rad=attitude)
    lines = [(30e-6, 10), (10e-6, 50), (3e-6, 200), (1e-6, 500), (10e-6, 500), (1e-6, 2000), (30e-6, 2000)]
    for amplitude, frequency in lines:
        vibration = Vibration(lines=(VibrationLine(amplitude, frequency),))
        yield _case(f"vibration {1e6 * amplitude:g} um at {frequency:g} Hz", vibration=vibration)
    yield _case("vibration .01 g^2/Hz, 10 to 2000 Hz", vibration=Vibration(bands=(VibrationBand(0.01, 10.0, 2000.0),)))
    for linewidth in (100.0, 1e3, 1e4, 1e5):
        yield _case(f"linewidth {linewidth / 1e3:g} kHz", laser_linewidth_hz=linewidth)
    helicopter = Vibration(lines=(VibrationLine(30e-6, 20.0), VibrationLine(3e-6, 200.0)))
    for cnr_db in (20.0, 10.0, 3.0):
        name = f"all together, {cnr_db:g} dB"
        yield _case(name, 0.01, cnr_db=cnr_db, vibration=helicopter, laser_linewidth_hz=1e4)
    yield from _cars(helicopter)
    for degrees in (0, 30):
        name = f"fields of 5 dB that rise by {degrees} degrees along the flight"
        yield replace(_case(name), scene=partial(fields, angle=np.radians(degrees)))
    yield from _strips()
    yield from _leaves()
    yield from _walls()
    yield from (Case(name, load_preset(name), MANY * FLIGHTS) for name in ("sal_realistic", "xband_realistic"))


def _cars(vibration: Vibration) -> Iterator[Case]:
    """The street with a car of 30 dB over the ground, at rest and driving, under a helicopter that vibrates."""
    for name, radial in (("at rest", 0.0), ("at 8 mm/s", 8e-3), ("at 11 m/s", -11.37)):
        case = _case(f"bright car {name}", vibration=vibration)
        street = load_scene(case.preset.scene)
        car = PointScatterer(-0.3, 1.0, 1.0, 1e3, radial, 0.0)
        beside = partial(same, scene=replace(street, points=(car,)))
        yield replace(case, preset=replace(case.preset, dwells=1), scene=beside)


def _strips() -> Iterator[Case]:
    """Short strips of the stripmap lidar, of which each of the first blocks joins on to the one before."""
    strip = replace(load_preset("sal_stripmap"), dwells=BLOCKS)
    helicopter = Vibration(lines=(VibrationLine(30e-6, 20.0), VibrationLine(3e-6, 200.0)))
    yield Case("strip, perfect", strip, FEW)
    cases: dict[str, tuple[OdometryErrors, dict[str, object], float]] = {
        "velocity 1 mm/s": (OdometryErrors(velocity_mps=1e-3, attitude_rad=POINTING), {}, 20.0),
        "velocity 15 mm/s": (OdometryErrors(velocity_mps=0.015, attitude_rad=POINTING), {}, 20.0),
        "attitude 1e-4 rad": (OdometryErrors(velocity_mps=0.005, attitude_rad=1e-4), {}, 20.0),
        "vibration": (OdometryErrors(velocity_mps=0.005, attitude_rad=POINTING), {"vibration": helicopter}, 20.0),
        "linewidth 100 kHz": (
            OdometryErrors(velocity_mps=0.005, attitude_rad=POINTING),
            {"laser_linewidth_hz": 1e5},
            20.0,
        ),
        **{
            f"all together, {cnr:g} dB": (
                OdometryErrors(velocity_mps=0.01, attitude_rad=POINTING),
                {"vibration": helicopter, "laser_linewidth_hz": 1e4},
                cnr,
            )
            for cnr in (20.0, 10.0, 3.0)
        },
    }
    for name, (odometry, others, cnr) in cases.items():
        impairments = Impairments(odometry=odometry, **others)  # type: ignore[arg-type]
        flights = FEW if odometry.attitude_rad == POINTING else MANY * FEW
        yield Case(f"strip, {name}", replace(strip, impairments=impairments, cnr_db=cnr), flights)


def _leaves() -> Iterator[Case]:
    """Vegetation at rest and in the wind: short grass for the lidar, woods for a radar near by and one far off."""
    lidar = replace(load_preset(PRESET), scene_extent_m=0.05)
    grass = replace(level(), extent=lidar.scene_extent_m)
    far = replace(load_preset("xband_relief"), scene_extent_m=20.0)
    ground = replace(load_preset("woods"), estimators=("canopy_ground",))
    for wind in (0, *WINDS):
        yield Case(f"grass, lidar, wind {wind} m/s", _in_wind(lidar, wind), FEW, partial(same, scene=grass))
        yield Case(f"grassy street, lidar, wind {wind} m/s", _in_wind(lidar, wind), FEW)
        if wind:
            stated = {"ml_height": {"radial_velocity_sigma_mps": WINDS[wind]}}
            preset = replace(_in_wind(lidar, wind), processing=stated)
            yield Case(f"grassy street, lidar, wind {wind} m/s, stated", preset, FEW)
        yield Case(f"ground under woods, radar, wind {wind} m/s", _in_wind(ground, wind), FEW)
        yield Case(f"woods over relief, radar, wind {wind} m/s", _in_wind(far, wind), FEW)


def _in_wind(preset: Preset, wind: int) -> Preset:
    """The preset with its vegetation in a wind (m/s) of WINDS; 0: at rest."""
    if not wind:
        return preset
    still = still_share(wind, speed_of_light / preset.sensor.wavelength_m)
    return replace(preset, impairments=replace(preset.impairments, vegetation_wind=VegetationWind(WINDS[wind], still)))


def still_share(wind: float, frequency: float) -> float:
    """Share of the power of leaves that stays still in a wind (m/s) at a frequency (Hz), as `vegetation_wind` says."""
    ratio = 489.8 * (wind * 3600 / mile) ** -1.55 * (frequency / 1e9) ** -1.21
    return ratio / (1 + ratio)


def _walls() -> Iterator[Case]:
    """Double bounce at the feet of cars, steps and walls in the street, for a lidar and for a radar near by."""
    radar = replace(load_preset("woods"), scene="street", looks=(1, 4))
    for bounce in (None, *BOUNCES):
        strength = "no double bounce" if bounce is None else f"double bounce {bounce:g} dB"
        if bounce is not None:
            yield Case(f"street, lidar, {strength}", replace(load_preset(PRESET), double_bounce_db=bounce))
        yield Case(f"street, radar, {strength}", replace(radar, double_bounce_db=bounce))


CASES = tuple(_cases())


@dataclass(frozen=True)
class Flown:
    """How the dwells of a case were handled.

    Attributes:
        dwells: flown.
        refused: number of refused dwells by reason.
        comparison: comparison of those that were published; None: none was.
    """

    dwells: int
    refused: Counter[str]
    comparison: SurfaceComparison | None

    @property
    def summary(self) -> Summary | None:
        """Shares over all published surfaces."""
        return Summary.of(self.comparison) if self.comparison else None

    def as_line(self) -> str:
        """Dwells, refused ones, and the summary."""
        shares = self.summary.as_line() if self.summary else "nothing published"
        why = ", ".join(f"{reason} {count}" for reason, count in self.refused.items())
        bias = 1e3 * float(np.nanmedian(self.comparison.errors.nearest)) if self.comparison else np.nan
        return f"{self.dwells:4d} {sum(self.refused.values()):4d} {shares} {bias:7.1f}  {why}"


HEADING = "dwells refused pixels valid publ. c1 c2 o5 own-o5 missed ghosts order (%) median error (mm), why refused"


def flown(seed: int, preset: Preset, autofocus: str, scene: Callable[[int], Scene] | None = None) -> Flown:
    """Fly a preset with a seed, over its scene or another, and compare the heights of a dwell, or of a short strip."""
    flight, settings = flight_of(preset, seed), image_settings(preset, autofocus)
    flight = replace(flight, scene=scene(seed)) if scene else flight
    is_strip = flight.sensor.mode == "stripmap"
    numbers = range(preset.dwells) if is_strip else [seed % preset.dwells]
    compressor, refused, found = Compressor(), Counter[str](), []
    for dwell in numbers:
        try:
            slc = compressor.add(flight.phase_history(dwell), flight.track(dwell), flight.sensor, settings)
        except Rejected as refusal:
            refused[refusal.reason] += 1
            continue
        if slc:
            found.append(_compared(slc, flight, dwell, settings))
    return Flown(len(numbers), refused, joined_comparisons(found) if found else None)


def _compared(slc: Slc, flight: SimulatedFlight, dwell: int, settings: ImageSettings) -> SurfaceComparison:
    """Heights of an image beside the truth."""
    preset, sensor = flight.preset, flight.sensor
    name = next(iter(preset.estimators), "ml")
    estimator, parameters = ESTIMATORS[name], preset.processing.get(f"{name}_height", {})
    chosen = estimator.settings(**{"range_looks": preset.looks[0], "azimuth_looks": preset.looks[1], **parameters})
    field = heights(slc, sensor, estimator, chosen)
    seen, aperture = as_flown(field, slc.aperture, flight, dwell)
    processing = Processing(settings.range_window, settings.azimuth_window)
    looks = chosen.range_looks, chosen.azimuth_looks
    truth = true_surfaces(seen, aperture, processing, looks, flight, flight.surface(dwell))
    return compare(field, truth, sensor.beamwidth)


def all_flown(case: Case, autofocus: str = "auto") -> Flown:
    """All flights of a case."""
    fly = partial(flown, preset=case.preset, autofocus=autofocus, scene=case.scene)
    return together(list(in_processes(fly, range(case.flights))))


def combined(number: int, *names: str) -> Preset:
    """One of these presets, with errors of everything at levels that are drawn evenly in their logarithms."""
    rng = np.random.default_rng([20, number])

    def level(least: float, most: float) -> float:
        return float(np.exp(rng.uniform(np.log(least), np.log(most))))

    preset = load_preset(str(rng.choice(names)))
    lines = tuple(VibrationLine(level(1e-6, 30e-6), level(10, 2000)) for _ in range(rng.integers(0, 4)))
    # Stated uncertainty of the mounting and the clock; 0, as presets describe their sensors, where nothing is stated.
    exact = dict.fromkeys(("odometry_delay_sigma_s", "lever_arm_sigma_m", "boresight_sigma_rad"), 0.0)
    stated = ImageSettings(**{"air": "none", **exact, **preset.processing.get("sar_compression", {})})
    odometry = OdometryErrors(
        delay_s=stated.odometry_delay_sigma_s * rng.standard_normal(),
        undescribed_lever_arm_m=tuple((stated.lever_arm_sigma_m * rng.standard_normal(3)).tolist()),
        undescribed_boresight_rad=tuple((stated.boresight_sigma_rad * rng.standard_normal(3)).tolist()),
        position_m=level(0.005, 0.2),
        velocity_mps=level(2e-4, 0.03),
        attitude_rad=level(1e-6, 1e-4),
        correlation_s=level(10, 300),
    )
    impairments = replace(
        preset.impairments,
        odometry=odometry,
        vibration=Vibration(lines=lines),
        laser_linewidth_hz=level(10, 1e5),
        turbulence=Turbulence(ground_cn2=level(1e-16, 1e-13)),
        pointing_jitter=PointingJitter(rms_rad=level(1e-8, 5e-6), highest_hz=level(50, 2000)),
    )
    return replace(preset, impairments=impairments, cnr_db=float(rng.uniform(0, 25)))


def flown_combination(number: int) -> Flown:
    """Fly a combination for one of both lidars in spotlight once."""
    return flown(1000 + number, combined(number, PRESET, "sal_realistic"), "auto")


def flown_strip(number: int) -> Flown:
    """Fly a combination for a short strip once."""
    return flown(1000 + number, replace(combined(number, "sal_stripmap"), dwells=BLOCKS), "auto")


def together(parts: Sequence[Flown]) -> Flown:
    """Flights as one."""
    found = [part.comparison for part in parts if part.comparison]
    refused = sum((part.refused for part in parts), Counter[str]())
    dwells = sum(part.dwells for part in parts)
    return Flown(dwells, refused, joined_comparisons(found) if found else None)


def image_settings(preset: Preset, autofocus: str) -> ImageSettings:
    """Those of a preset."""
    given = preset.processing.get("sar_compression", {})
    return ImageSettings(
        air="none", rows=preset.image.rows, cols=preset.image.cols, **{"autofocus": autofocus, **given}
    )


def coverage() -> Iterator[Row]:
    """Rows of the group: of every case how far c1 is off, and o5, of what is published; and the time of autofocus."""
    for case in sized(CASES, CASES[:2] + CASES[-2:]):
        yield from shares(case.name, all_flown(case))
    for name, fly, count in (
        ("combinations", flown_combination, COMBINATIONS),
        ("strip, combinations", flown_strip, STRIP_COMBINATIONS),
    ):
        combinations = together(list(in_processes(fly, range(count))))
        yield from shares(name, combinations)
        refused = 100 * sum(combinations.refused.values()) / combinations.dwells
        yield Row(f"{name}: refused", refused, "%", "<= 5", f"{count} random levels of everything")
    for name in (PRESET, "sal_stripmap"):  # one after the other, in a process with one thread of BLAS, as nodes are
        yield from in_processes(autofocus_time, [name])


def shares(name: str, result: Flown) -> Iterator[Row]:
    """Distance of c1 from that of normal errors, and o5, of what was published."""
    summary, text = result.summary, f"{HEADING}\n    {result.as_line()}"
    off = abs(100 * summary.within_1 - 68.27) if summary else 0.0
    yield Row(f"{name}: c1 off 68.27 %", off, "points", "<= 5", text)
    yield Row(f"{name}: o5", 100 * summary.beyond_5 if summary else 0.0, "%", "<= 1", text)


def autofocus_time(name: str) -> Row:
    """Time of the dwells of a short flight with autofocus, less that without it, over the latter."""
    odometry = OdometryErrors(velocity_mps=0.005, attitude_rad=POINTING)
    preset = replace(load_preset(name), dwells=BLOCKS, impairments=Impairments(odometry=odometry))
    flight = flight_of(preset, 1)
    dwells = [(flight.phase_history(dwell), flight.track(dwell)) for dwell in range(BLOCKS)]

    def compress(autofocus: str) -> None:
        compressor, settings = Compressor(), image_settings(preset, autofocus)
        for history, track in dwells:
            compressor.add(history, track, flight.sensor, settings)

    without, focused = medians(lambda: compress("never"), lambda: compress("always"))
    return Row(
        f"{name}: autofocus over the compression",
        (focused - without) / without,
        "1",
        "<= 0.5",
        f"{BLOCKS} dwells: {1e3 * without:.1f} ms without, {1e3 * focused:.1f} ms with; {load()}",
    )


app = App(
    name="python -m benchmarks.imperfect_platform", help_format="plaintext", default_parameter=Parameter(negative=())
)


@app.default
def table(
    names: Annotated[tuple[str, ...], Parameter(name="CASE", show_default=False)] = (),
    /,
    *,
    autofocus: str = "auto",
) -> int:
    """Print a line for each case.

    Args:
        names: patterns of names of cases; `*` stands for any text. Default: all.
        autofocus: the setting of that name.
    """
    sys.stdout.write(HEADING + "\n")
    for case in CASES:
        if not names or any(fnmatchcase(case.name, name) for name in names):
            sys.stdout.write(f"{case.name:40s} {all_flown(case, autofocus).as_line()}\n")
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(app())
