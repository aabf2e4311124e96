"""Detection of movers without prior knowledge: position, height and velocity, and false alarms of what stands still.

python -m benchmarks movers
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.stats import chi2

from benchmarks.row import Row, load, sized
from benchmarks.spread import in_processes
from sal_height.errors import Rejected
from sal_height.geometry import Trajectory
from sal_height.imaging import ImageSettings, Slc
from sal_height.movers import Blind, DwellMovers, Looked, Mover, MoverSettings, StripMovers
from sal_height.pipeline import Compressor, dwell_with_movers, strip_with_movers
from sal_height.sensor import PhaseHistory
from sal_height.simulation import Preset, SimulatedFlight, flight_of, load_preset
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.scene import PointScatterer

FLIGHTS, STILL, UNSURE = sized(40, 1), sized(6, 1), sized(24, 1)
CARS, AT_REST = sized(80, 1), sized(60, 1)
RATE = 1e-2
WARM = sized(4, 0)
"""Flights whose time does not count: the first of each process compiles."""


EXACT = Impairments()
"""Of a navigation without errors."""

ERRORS = Impairments(odometry=OdometryErrors(velocity_mps=0.005, attitude_rad=2e-6))
"""Of a navigation that is not perfect: autofocus places the images."""


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight over one mover, or over none.

    Attributes:
        errors: errors of each that was found: along-track position and height, m, radial velocity but for its
            ambiguity and radial velocity by range migration, m/s, and over dwells and where images are unsure the
            along-track velocity, m/s, NaN if it is not estimated; shape (found, 4 or 5).
        over: the same over what is stated.
        candidates: pixels that were looked at.
        seconds: times of the search and of the compression of all images, s.
        speed: speed of the mover over the ground, m/s.
        blind: blind fractions of the first image.
    """

    errors: Sequence[np.ndarray]
    over: Sequence[np.ndarray]
    candidates: int
    seconds: tuple[float, float]
    speed: float = 0.0
    blind: tuple[Blind, ...] = ()


def images_of(flight: SimulatedFlight, histories: Sequence[PhaseHistory]) -> list[Slc]:
    """The images of a strip."""
    image = flight.preset.image
    compressor, states, images = Compressor(), [], []
    for dwell, history in enumerate(histories):
        states += flight.platform_states(dwell)
        settings = ImageSettings(air="none", rows=image.rows, cols=image.cols)
        track = Trajectory(states, accuracy=flight.odometry_accuracy)
        slc = compressor.add(history, track, flight.sensor, settings)
        images += [slc] if slc else []
    return images


def searched(images: Sequence[Slc], flight: SimulatedFlight, settings: MoverSettings) -> list[Looked]:
    """Results of the search in each image of a strip, with those before and after."""
    search, seen = StripMovers[None](settings), []
    for slc in images:
        seen += search.add(strip_with_movers(slc, flight.sensor, settings), None)
    seen += search.end()
    return [one for _, one in seen if one]


def car(seed: int, impairments: Impairments = EXACT) -> Flown:
    """A strip over a car of any course at up to 15 m/s, a point of 15 to 34 dB over a cell of the road.

    Its elevation is within those of the beams, and its image in the strip.
    """
    rng = np.random.default_rng([39, seed])
    speed, heading, power = rng.uniform(0.0, 15.0), rng.uniform(0, 2 * np.pi), 10 ** rng.uniform(1.5, 3.4)
    preset = replace(load_preset("sal_stripmap"), dwells=6, impairments=impairments)
    flight = flight_of(preset, seed)
    radial, along = speed * np.sin(heading) * np.sqrt(0.5), speed * np.cos(heading)
    period = flight.sensor.wavelength * flight.sensor.pulse_repetition_frequency / 2
    remainder = radial - period * round(radial / period)
    shift = preset.flight.slant_range_m * remainder / (preset.flight.speed_mps - along)
    height = rng.uniform(0.3, 1.6)
    # Seen from 45 degrees: within the image in range, (height - north) / sqrt(2), and within the beams in elevation.
    north = height - np.sqrt(2) * rng.uniform(max(-1.4, np.sqrt(2) * height - 1.3), 1.4)
    point = PointScatterer(rng.uniform(-0.3, 0.3) + shift, north, height, power, radial, along)
    flight = replace(flight, scene=replace(flight.scene, points=(point,)))
    images = images_of(flight, [flight.phase_history(dwell) for dwell in range(flight.dwells)])
    looked = searched(images, flight, MoverSettings())
    errors, over = [], []
    for one in (mover for each in looked for mover in each.movers):
        off = one.radial_velocity - radial
        velocities = [off - period * round(off / period), one.walk_velocity - radial, one.along_velocity - along]
        errors.append(np.array([one.position[0] - point.east, one.height - height, *velocities]))
        over.append(errors[-1] / sigmas_of(one))
    return Flown(errors, over, sum(one.candidates for one in looked), (0.0, 0.0), speed, looked[0].blind)


def at_rest(seed: int, velocity_mps: float) -> Flown:
    """A strip over bright points and pairs of points at rest, with an error of the odometry's velocity (rms)."""
    rng = np.random.default_rng([49, seed])
    points = []
    for _ in range(4):
        east, north, height = rng.uniform(-1.2, 0.8), rng.uniform(-1.2, 1.2), rng.uniform(0.1, 1.2)
        power = 10 ** rng.uniform(1.5, 3.8)
        points.append(PointScatterer(east, north, height, power))
        nearer = rng.uniform(0.02, 0.11)
        beside, other = east + rng.uniform(-0.03, 0.03), power * 10 ** rng.uniform(-0.5, 0.5)
        points += [PointScatterer(beside, north - nearer, height - nearer, other)] if rng.random() < 0.5 else []
    errors = Impairments(odometry=OdometryErrors(velocity_mps=velocity_mps, attitude_rad=2e-6 if velocity_mps else 0.0))
    flight = flight_of(replace(load_preset("sal_stripmap"), dwells=6, impairments=errors), 1000 + seed)
    flight = replace(flight, scene=replace(flight.scene, points=tuple(points)))
    images = images_of(flight, [flight.phase_history(dwell) for dwell in range(flight.dwells)])
    looked = searched(images, flight, MoverSettings())
    found = [np.zeros(5) for one in looked for _ in one.movers]
    return Flown(found, found, sum(one.candidates for one in looked), (0.0, 0.0))


def rows_of_cars() -> Iterator[Row]:
    """Rows of cars of any course in strips, of what is blind, and of what stands still by wrong odometry."""
    for name, impairments in {"cars": EXACT, "cars, odometry of 5 mm/s": ERRORS}.items():
        moving = list(in_processes(partial(car, impairments=impairments), range(CARS)))
        text = f"{CARS} flights over the street, each with a car of any course at up to 15 m/s, 15 to 34 dB"
        near = [[bool(np.all(np.abs(error[:2]) < 0.3)) for error in one.errors] for one in moving]
        found = np.array([any(each) for each in near])
        yield Row(f"{name}: found", float(np.mean(found)), "1", ">= 0.8", text)
        fast = np.array([one.speed > 6.0 for one in moving])
        share = float(np.mean(found[fast])) if fast.any() else np.nan
        yield Row(f"{name}: found of those faster than 6 m/s", share, "1", ">= 0.95", f"{fast.sum()} of {text}")
        wrong = sum(not good for each in near for good in each)
        candidates = sum(one.candidates for one in moving)
        yield Row(f"{name}: movers elsewhere per car", wrong / CARS, "1", "<= 0.05", f"of {candidates} candidates")
        for blind in moving[0].blind:
            of_velocities = f"{name}: blind fraction of radial velocities at {blind.cnr_db:g} dB"
            about = "by the lag alone; migration and smear show most of them"
            yield Row(of_velocities, blind.fraction, "1", "<= 0.25", about)
        yield from rows_of_sigmas(name, text, moving)
    for velocity in (0.0, 0.005, 0.02):
        still = list(in_processes(partial(at_rest, velocity_mps=velocity), range(AT_REST)))
        candidates, alarms = sum(one.candidates for one in still), sum(len(one.errors) for one in still)
        limit = float(chi2.ppf(0.95, 2 * alarms + 2)) / 2  # of the mean of a Poisson number
        text = f"{alarms} movers among {candidates} candidates of {AT_REST} flights over bright points at rest"
        name = f"odometry of {1e3 * velocity:g} mm/s: upper limit (95 %) of the false alarms over their stated rate"
        yield Row(name, limit / max(1, candidates) / MoverSettings().false_alarm_rate, "1", "<= 1", text)


def flown(seed: int, kind: str, settings: MoverSettings, impairments: Impairments | None = None) -> Flown:
    """The street with a point of 24 to 34 dB over a cell of the road.

    Args:
        seed: seed of the flight.
        kind: slow (3.5 to 7 mm/s), fast (5 to 15 m/s, as likely with any remainder up to 6 mm/s), driving (3.5 to 7
            mm/s, and 2 to 4 m/s along the flight), or still.
        settings: settings of the search.
        impairments: None: the platform is perfect.
    """
    rng = np.random.default_rng([19, seed])
    remainder = 0.0 if kind == "still" else rng.choice([-1, 1]) * rng.uniform(3.5e-3, 7e-3)
    north, height, power = rng.uniform(-1.4, 1.4), rng.uniform(0.3, 1.6), 10 ** rng.uniform(2.4, 3.4)
    preset = replace(load_preset("sal_stripmap"), dwells=4, impairments=impairments or EXACT)
    known = 5 if kind == "driving" or impairments else 4
    flight = flight_of(preset, seed)
    radial, sensor = remainder, flight.sensor
    if kind == "fast":
        period = sensor.wavelength * sensor.pulse_repetition_frequency / 2
        remainder = rng.uniform(-6e-3, 6e-3)
        radial = remainder + period * round(rng.choice([-1, 1]) * rng.uniform(5, 15) / period)
    shift = remainder * preset.flight.slant_range_m / preset.flight.speed_mps
    along = rng.choice([-1, 1]) * rng.uniform(2.0, 4.0) if kind == "driving" else 0.0
    point = PointScatterer(shift, north, height, power, radial, along)
    flight = replace(flight, scene=replace(flight.scene, points=(point,)))
    histories = [flight.phase_history(dwell) for dwell in range(flight.dwells)]
    begun = time.process_time()
    images = images_of(flight, histories)
    focused = time.process_time()
    seen = searched(images, flight, settings)
    ended = time.process_time()
    found = [mover for one in seen for mover in one.movers]

    def error(mover: Mover) -> np.ndarray:
        velocities = [mover.radial_velocity - remainder, mover.walk_velocity - radial]
        velocities.append(mover.along_velocity - along)
        return np.array([mover.position[0] - shift, mover.height - height, *velocities])[:known]

    sigmas = [sigmas_of(one)[:known] for one in found]
    errors = [error(one) for one in found]
    over = [e / s for e, s in zip(errors, sigmas, strict=True)]
    return Flown(errors, over, sum(one.candidates for one in seen), (ended - focused, focused - begun))


def sigmas_of(one: Mover) -> np.ndarray:
    """Stated sigmas of the position along the flight, height, and velocities: by lag, by range migration, along it."""
    place = np.sqrt(one.covariance[0, 0])
    return np.array([place, one.sigma, one.velocity_sigma, one.walk_sigma, one.along_sigma])


def over_dwells(seed: int, kind: str, settings: MoverSettings, flown_as: Preset | None = None) -> Flown:
    """Six spotlight dwells of the street with a point of 24 to 34 dB over a cell of the road.

    Args:
        seed: seed of the flight.
        kind: slow (5 to 15 mm/s), fast (1 to 15 m/s, and up to 15 m/s along the flight), crossing (5 to 15 mm/s, and 4
            to 15 m/s along the flight), or still.
        settings: settings of the search.
        flown_as: sal_spotlight, or with its sensor; None: that.
    """
    rng = np.random.default_rng([29, seed])
    slowly, quickly = rng.uniform(5e-3, 15e-3), rng.uniform(1.0, 15.0)
    radial = {"slow": slowly, "crossing": slowly, "fast": quickly, "still": 0.0}[kind] * rng.choice([-1, 1])
    east, north, height = rng.uniform(-0.6, 0.6), rng.uniform(-2.4, 2.4), rng.uniform(0.3, 1.6)
    preset = replace(flown_as or load_preset("sal_spotlight"), dwells=6)
    flight = flight_of(preset, seed)
    sensor = flight.sensor
    power = 10 ** rng.uniform(2.4, 3.4)
    along = {"fast": rng.uniform(0.0, 15.0), "crossing": rng.uniform(4.0, 15.0)}.get(kind, 0.0) * rng.choice([-1, 1])
    point = PointScatterer(east, north, height, power, float(radial), float(along))
    flight = replace(flight, scene=replace(flight.scene, points=(point,)))
    histories = [flight.phase_history(dwell) for dwell in range(flight.dwells)]
    given = preset.processing.get("sar_compression", {})
    wanted = ImageSettings(air="none", rows=preset.image.rows, cols=sensor.pulse_count, **given)
    begun = time.process_time()
    images: list[Slc | None] = []
    for dwell, one in enumerate(histories):
        try:
            images.append(Compressor().add(one, flight.track(dwell), sensor, wanted))
        except Rejected:  # the data do not tell where the beams are
            images.append(None)
    focused = time.process_time()
    search, seen = DwellMovers[None](settings), []
    for slc, history in zip(images, histories, strict=True):
        if slc is not None:
            seen += search.add(dwell_with_movers(slc, 1e-9 * history.stamp_ns, sensor, settings), None)
    seen += search.end()
    ended = time.process_time()
    looked = [one for _, one in seen if one]
    found = [mover for one in looked for mover in one.movers]

    def error(mover: Mover) -> np.ndarray:
        off = mover.radial_velocity - radial
        velocities = [off - mover.ambiguity * round(off / mover.ambiguity), mover.walk_velocity - radial]
        velocities.append(mover.along_velocity - along)
        return np.array([mover.position[0] - east, mover.height - height, *velocities])

    sigmas = [sigmas_of(one) for one in found]
    errors = [error(one) for one in found]
    over = [e / s for e, s in zip(errors, sigmas, strict=True)]
    return Flown(errors, over, sum(one.candidates for one in looked), (ended - focused, focused - begun))


def found_without_being_told() -> Iterator[Row]:
    """Rows of the group: of strips, and of spotlight dwells.

    Those that move over dwells are published at the rate of the settings, so that hardly any false alarm is among
    them; a hundred times as many pixels stand still as move.
    """
    often = MoverSettings(false_alarm_rate=RATE)
    kinds = {
        "slow": "3.5 to 7 mm/s",
        "fast": "5 to 15 m/s",
        "driving": "3.5 to 7 mm/s, and 2 to 4 m/s along the flight",
    }
    yield from rows_of_cars()
    yield from rows_with("", flown, often, kinds, "<= 12")
    kinds = {
        "slow": "5 to 15 mm/s",
        "fast": "1 to 15 m/s, and up to 15 m/s along the flight",
        "crossing": "5 to 15 mm/s, and 4 to 15 m/s along the flight",
    }
    yield from rows_with("dwells, ", over_dwells, MoverSettings(), kinds, "<= 10")
    realistic, placed = load_preset("sal_realistic"), replace(load_preset("sal_spotlight"), impairments=ERRORS)
    unsure = {
        "dwells of sal_realistic": partial(over_dwells, settings=MoverSettings(), flown_as=realistic),
        "dwells, odometry of 5 mm/s": partial(over_dwells, settings=MoverSettings(), flown_as=placed),
        "strips, odometry of 5 mm/s": partial(flown, settings=MoverSettings(), impairments=ERRORS),
    }
    for name, fly in unsure.items():
        moving = list(in_processes(partial(fly, kind="fast"), range(UNSURE)))
        yield from rows_of_sigmas(name, f"{UNSURE} flights over the street, each with a car, 24 to 34 dB", moving)


def rows_with(
    name: str,
    fly: Callable[..., Flown],
    settings: MoverSettings,
    speeds: dict[str, str],
    target: str,
) -> Iterator[Row]:
    """Rows of movers of each kind, of what stands still, and of the time.

    Args:
        name: start of the names of the rows.
        fly: a flight of a seed, a kind and settings.
        settings: settings of the search.
        speeds: text on the speeds of each kind.
        target: target of the time.
    """
    timed = np.zeros(2)
    for kind, speed in speeds.items():
        moving = list(in_processes(partial(fly, kind=kind, settings=settings), range(FLIGHTS)))
        text = f"{FLIGHTS} flights over the street, each with a point of {speed}, 24 to 34 dB"
        yield from rows_of(f"{name}{kind}", text, moving)
        timed += np.sum([one.seconds for one in moving[WARM:]], axis=0)
    bright = MoverSettings(false_alarm_rate=RATE, prominence_db=sized(5.0, 10.0))
    still = list(in_processes(partial(fly, kind="still", settings=bright), range(FLIGHTS, FLIGHTS + STILL)))
    candidates, alarms = sum(one.candidates for one in still), sum(len(one.errors) for one in still)
    share, text = alarms / max(1, candidates) / RATE, f"{candidates} bright pixels that stand still"
    yield Row(f"{name}false alarms over their stated rate", share, "1", "<= 1", text)
    ratio = timed[0] / timed[1]
    yield Row(f"{name}time of the search over that of the images", ratio, "1", target, f"processor time; {load()}")


def rows_of(kind: str, text: str, moving: Sequence[Flown]) -> Iterator[Row]:
    """Rows of movers of a kind."""
    errors = np.array([one for each in moving for one in each.errors] or np.zeros((0, 5)))
    # Along the flight not all get a velocity in a strip.
    rms = np.sqrt(np.nanmean(errors**2, axis=0)) if len(errors) else np.full(errors.shape[1], np.nan)
    share = sum(bool(len(one.errors)) for one in moving) / len(moving)
    yield Row(f"{kind} movers that were found", share, "1", ">= 0.8", text)
    yield Row(f"{kind}: error of the place along the flight", 1e3 * rms[0], "mm", "<= 50", f"{text}; rms")
    yield Row(f"{kind}: error of the radial velocity", 1e3 * rms[2], "mm/s", "<= 0.5", f"{text}, but periods; rms")
    yield Row(f"{kind}: error of the velocity by range migration", rms[3], "m/s", "<= 1", f"{text}; rms")
    median = float(np.median(np.abs(errors[:, 1]))) if len(errors) else np.nan
    yield Row(f"{kind}: error of the height", 1e3 * median, "mm", "<= 20", f"{text}; median")
    if errors.shape[1] > 4:
        yield Row(f"{kind}: error of the velocity along the flight", rms[4], "m/s", "<= 1", f"{text}; rms")
    yield from rows_of_sigmas(kind, text, moving)


def rows_of_sigmas(kind: str, text: str, moving: Sequence[Flown]) -> Iterator[Row]:
    """Rows of what is stated of movers of a kind: the fraction of published values beyond 5 of their sigmas."""
    over = np.abs(np.array([one for each in moving for one in each.over] or np.zeros((0, 5))))
    names = ("place", "height", "velocity", "velocity by range migration", "velocity along the flight")
    for name, each in zip(names[: over.shape[1]], over.T, strict=True):
        beyond = np.sum(each > 5) / max(1, np.sum(np.isfinite(each))) if len(over) else np.nan
        yield Row(f"{kind}: {name} beyond 5 sigma", float(beyond), "1", "<= 0.01", text)
