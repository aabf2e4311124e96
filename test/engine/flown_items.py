"""Items of simulated flights, as stages accept them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from sal_height.engine.chain import Chain
from sal_height.engine.compression import Compression, CompressionSettings
from sal_height.engine.frame_items import Frame, frames_of
from sal_height.engine.height_items import Heights
from sal_height.engine.heights import height_stage
from sal_height.engine.image_items import Images
from sal_height.engine.provenance import Same
from sal_height.engine.results import DwellKey, Loss, Product
from sal_height.engine.stage import Stage
from sal_height.engine.track import ACCURACY, Samples
from sal_height.geometry import PlatformState
from sal_height.sensor import PhaseHistory, Sensor
from sal_height.simulation import SimulatedFlight, flight_of, load_preset
from sal_height.simulation.receiver_noise import receiver_noise
from sal_height.topics import ODOMETRY, PHASE_HISTORY, SENSOR_INFO, SLC

START_NS = 1_700_000_000_123_456_789

Item = tuple[str, Any]
"""Name of a port, and what arrives on it."""

EXACT_ODOMETRY = dict.fromkeys(ACCURACY, 0.0)
"""Parameters that state what the covariances of the flights, zeros, leave open."""

SMALL = {"rows": 20, "cols": 8, "air": "none", **EXACT_ODOMETRY}
"""Images of the small preset that take little time, of a flight in vacuum with exact odometry."""


def count_of(item: Any) -> int:
    """Number of messages that an item is."""
    return item.count if isinstance(item, Images) else 1


@cache
def small_flight(dwells: int = 6, seed: int = 7) -> SimulatedFlight:
    """Dwells of the small preset."""
    return flight_of(replace(load_preset("small"), dwells=dwells), seed)


class NoiseStrip(SimulatedFlight):
    """Blocks of a strip that hold receiver noise, which costs no simulation of echoes."""

    def phase_history(self, dwell: int) -> PhaseHistory:
        samples = receiver_noise(self.sensor, self.sensor.pulse_count, np.random.default_rng((self.seed, dwell)))
        reference = np.full(self.sensor.pulse_count, self.preset.flight.slant_range_m)
        return PhaseHistory(self.dwell_start_ns(dwell), self.pulse_times, reference, samples)


STRIP = {"rows": 16, "cols": 128, "air": "none", **EXACT_ODOMETRY}
"""Images of `noise_strip`: the third block completes the first one."""


@cache
def noise_strip(blocks: int = 6, seed: int = 3, name: str = "") -> NoiseStrip:
    """Blocks of a strip; a name makes another sensor of it."""
    flown = flight_of(replace(load_preset("sal_stripmap"), dwells=blocks), seed)
    sensor = replace(flown.sensor, name=name, config_hash="") if name else flown.sensor
    return NoiseStrip(flown.preset, sensor, flown.scene, flown.dwells, flown.seed)


def at(state: PlatformState, later_ns: int) -> PlatformState:
    """A state with a later stamp."""
    return replace(state, stamp_ns=state.stamp_ns + later_ns)


def key_of(flight: SimulatedFlight, dwell: int, start_ns: int = START_NS) -> DwellKey:
    """Key of a dwell of a flight."""
    return DwellKey(flight.sensor.config_hash, dwell, start_ns + flight.dwell_start_ns(dwell))


def history_in(flight: SimulatedFlight, dwell: int) -> PhaseHistory:
    """The phase history of a dwell, which is simulated once."""
    return _history(Same(flight), dwell)


@cache
def _history(flight: Same[SimulatedFlight], dwell: int) -> PhaseHistory:
    return flight.one.phase_history(dwell)


def frames_in(flight: SimulatedFlight, dwell: int, start_ns: int = START_NS) -> Sequence[Frame]:
    """The frames of a dwell."""
    history = history_in(flight, dwell)
    return frames_of(history, flight.sensor, dwell, start_ns + history.stamp_ns)


def odometry_items(flight: SimulatedFlight, dwell: int, start_ns: int = START_NS) -> list[Item]:
    """The odometry of a dwell that was not yet in that of the one before."""
    return [(ODOMETRY, at(state, start_ns)) for state in flight.platform_states(dwell)]


def samples_of(states: Sequence[PlatformState]) -> Samples:
    """Odometry samples as arrays."""
    return Samples(
        np.array([one.stamp_ns for one in states]),
        np.array([[*one.position, *one.orientation, *one.velocity] for one in states]),
        np.array([one.covariance for one in states]),
        np.array([one.velocity_covariance for one in states]),
    )


def frame_items(flight: SimulatedFlight, dwell: int, start_ns: int = START_NS) -> list[Item]:
    """The frames of a dwell."""
    return [(PHASE_HISTORY, frame) for frame in frames_in(flight, dwell, start_ns)]


def flight_items(flight: SimulatedFlight, start_ns: int = START_NS, dwells: Iterable[int] | None = None) -> list[Item]:
    """All items of a flight in its order: of each dwell the odometry, then the frames."""
    items: list[Item] = [(SENSOR_INFO, flight.sensor)]
    for dwell in range(flight.dwells) if dwells is None else dwells:
        items += [*odometry_items(flight, dwell, start_ns), *frame_items(flight, dwell, start_ns)]
    return items


def made(stages: Sequence[Stage], settings: Sequence[Any], items: Iterable[Item], port: str) -> list[Any]:
    """The items on a port that joined stages make; nothing may be lost."""
    chain, found = Chain(stages, settings), []
    for results in (chain.start(), *(chain.feed(*item) for item in items), chain.finish()):
        for one in results:
            assert not isinstance(one.result, Loss), one.result
            if isinstance(one.result, Product) and one.result.port == port:
                found.append(one.result.item)
    return found


def images_in(flight: SimulatedFlight, **settings: Any) -> Sequence[Images]:
    """The images of all dwells of a flight, which are made once."""
    return _images(Same(flight), CompressionSettings(**settings))


@cache
def _images(flight: Same[SimulatedFlight], settings: CompressionSettings) -> Sequence[Images]:
    return made([Compression(settings)], [settings], flight_items(flight.one), SLC)


def heights_in(flight: SimulatedFlight, **settings: Any) -> Sequence[Heights]:
    """The heights of all dwells of a flight by maximum likelihood, which are made once."""
    return _heights(Same(flight), CompressionSettings(**settings))


@cache
def _heights(flight: Same[SimulatedFlight], settings: CompressionSettings) -> Sequence[Heights]:
    ml = height_stage("ml")
    items = [(SENSOR_INFO, flight.one.sensor), *((SLC, images) for images in _images(flight, settings))]
    return made([ml(ml.settings())], [ml.settings()], items, "ml/height")


def ml_stage(**settings: Any) -> Stage:
    """The stage of heights by maximum likelihood."""
    ml = height_stage("ml")
    return ml(ml.settings(**settings))


def image_items(flight: SimulatedFlight, *, whole: bool, **settings: Any) -> list[Item]:
    """The sensor and the images of a flight, one item for a dwell, or one for each channel."""
    items: list[Item] = [(SENSOR_INFO, flight.sensor)]
    for images in images_in(flight, **settings):
        items += [(SLC, one) for one in ([images] if whole else images.channels())]
    return items


def other_sensor(sensor: Sensor, name: str) -> Sensor:
    """The same sensor by another name, which is another identity."""
    return replace(sensor, name=name, config_hash="")
