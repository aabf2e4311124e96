"""A simulated flight: level past the middle of the scene, one dwell after the other, in one pass or to and fro."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from sal_height.errors import UserError
from sal_height.geometry import (
    AirPath,
    ApertureState,
    OdometryAccuracy,
    Origin,
    PlatformState,
    Trajectory,
    aperture_at,
    height_of,
    look_direction,
    sphere_coordinates,
    sphere_point,
)
from sal_height.numeric import F64, Complex, ShortRepr
from sal_height.sensor import (
    PhaseHistory,
    Sensor,
    aperture_length,
    echo_sensor,
    from_spectrum,
    lit_angle,
    lit_doppler,
    spectrum_sensor,
)
from sal_height.simulation.air import INTERVAL_NS, ProbedAir
from sal_height.simulation.gust import GustMotion, gust_motion
from sal_height.simulation.harmonics import Harmonics
from sal_height.simulation.impairments import MOST_SWING_BEAMWIDTHS, pointing_rotation, through_receivers
from sal_height.simulation.odometry_errors import PoseErrors
from sal_height.simulation.phase_errors import laser_phase
from sal_height.simulation.preset import Preset
from sal_height.simulation.receiver_noise import blanked, received
from sal_height.simulation.scene import SAMPLES_PER_CELL, PointScatterer, Scene, VisibleSurface, joined, visible_surface
from sal_height.simulation.scenes import load_scene
from sal_height.simulation.spotlight import cell_power, draw_amplitudes, simulate_dwell
from sal_height.simulation.stripmap import mean_square_gain, simulate_block

GROUND, GUST, ODOMETRY, VIBRATION, AIR, JITTER = range(6)  # keys of random streams that do not belong to a dwell
LASER, LEAVES = 6, 7  # keys of streams of a dwell, or of a tile: laser phase, and velocities of vegetation


@dataclass(frozen=True)
class SimulatedFlight(ShortRepr):
    """Everything a simulated run is made of; each dwell follows from it alone.

    Positions, velocities and attitudes are those of the sensor: of the antenna, and of the axes of its stabilised
    mount. Odometry is that of base_link, from which the antenna is a lever arm away (`Sensor.mounting`). In spotlight
    the beams follow the scene: during a dwell every scatterer keeps the direction in which the sensor sees it in
    the middle of the dwell. In stripmap they are fixed to the sensor's axes, and dwells are blocks of one sequence of
    pulses.

    Attributes:
        preset: preset with sensor, flight and CNR.
        sensor: sensor of the preset, as it is described; the preset's impairments are applied in addition.
        scene: the ground.
        dwells: number of dwells; those of a pass are centred on the scene.
        seed: seed of all random numbers.
    """

    preset: Preset
    sensor: Sensor
    scene: Scene
    dwells: int
    seed: int

    def position(self, seconds: npt.ArrayLike) -> F64:
        """Antenna position (m, map) at times (s) after the start of the first dwell, shape (..., 3)."""
        flight = self.preset.flight
        aim = sphere_point(0.0, 0.0, self.scene.reference_height)
        abeam = aim - flight.slant_range_m * look_direction(flight.look_angle_rad, 0.0, self.sensor.look_side)
        seconds = np.asarray(seconds, dtype=np.float64)
        start_s = self._pass_of(seconds) * flight.passes.interval_s
        along = flight.speed_mps * (seconds - start_s) - self._pass_length / 2
        straight = abeam + along[..., None] * np.array([1.0, 0.0, 0.0])
        middle_of_pass = start_s + self._pass_length / flight.speed_mps / 2
        eastwards = straight + self._gust.displacement(seconds) - self._gust.displacement(middle_of_pass)
        return eastwards * self._heading(seconds)

    def velocity(self, seconds: npt.ArrayLike) -> F64:
        """Antenna velocity (m/s, map) at times (s) after the start of the first dwell, shape (..., 3)."""
        eastwards = np.array([self.preset.flight.speed_mps, 0.0, 0.0]) + self._gust.velocity(seconds)
        return eastwards * self._heading(seconds)

    def attitude(self, seconds: npt.ArrayLike) -> Rotation:
        """Rotation from the axes of the antenna's mount to those of map at times (s) after the start."""
        backwards = np.asarray(self._heading(seconds)[..., 0] < 0)
        about = Rotation.from_rotvec(np.pi * backwards[..., None] * np.array([0.0, 0.0, 1.0]))
        return about * self._gust.rotation(seconds) if backwards.any() else self._gust.rotation(seconds)

    @property
    def _dwells_per_pass(self) -> int:
        return self.preset.flight.passes.dwells_each(self.dwells)

    @property
    def _pass_length(self) -> float:
        """Way from the first pulse of a pass to the last one, m."""
        spacings = (self._dwells_per_pass - 1) * self.preset.dwell_spacing_m
        return spacings + 2 * self.preset.flight.speed_mps * self._middle_of_dwell

    def _pass_of(self, seconds: npt.ArrayLike) -> F64:
        """Number of the pass whose middle is nearest to times (s), from 0."""
        passes = self.preset.flight.passes
        middle = self._pass_length / self.preset.flight.speed_mps / 2
        nearest = np.round((np.asarray(seconds, dtype=np.float64) - middle) / passes.interval_s)
        return np.asarray(np.clip(nearest, 0, passes.count - 1))

    def _heading(self, seconds: npt.ArrayLike) -> F64:
        """Signs of the axes of map, (..., 3), that turn a pass eastwards to its heading about the middle of the scene.

        The passes are flown alternately eastwards and westwards.
        """
        sign = 1.0 - 2.0 * (self._pass_of(seconds) % 2)
        return np.stack([sign, sign, np.ones_like(sign)], axis=-1)

    @cached_property
    def _gust(self) -> GustMotion:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(GUST,)))
        return gust_motion(self.preset.flight.gust_mps, self.preset.flight.speed_mps, rng)

    @cached_property
    def _errors(self) -> PoseErrors:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(ODOMETRY,)))
        return self.preset.impairments.odometry.drawn(rng)

    @cached_property
    def _vibration(self) -> Harmonics:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(VIBRATION,)))
        return self.preset.impairments.vibration.drawn(rng)

    @cached_property
    def _jitter(self) -> Harmonics:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(JITTER,)))
        return self.preset.impairments.pointing_jitter.drawn(rng)

    def pointing(self, seconds: F64) -> tuple[F64, F64]:
        """Angles (rad) by which the beams point ahead and farther off nadir at times (s) after the start."""
        jitter = self._jitter.velocity(seconds)
        return self.preset.impairments.antenna_swing.pointing(seconds) + jitter[..., 0], jitter[..., 1]

    @cached_property
    def _air(self) -> Harmonics | None:
        """Phases by turbulence; None: no turbulence."""
        if not (turbulence := self.preset.impairments.turbulence):
            return None
        flight = self.preset.flight
        height = flight.slant_range_m * math.cos(flight.look_angle_rad)
        structure = turbulence.structure(self.sensor.wavelength, flight.slant_range_m, height)
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(AIR,)))
        return turbulence.drawn(structure, flight.speed_mps, rng)

    def pulse_phase(self, dwell: int) -> F64:
        """Phase (rad) of the echoes of each pulse of a dwell by vibration, laser and air, shape (pulses,).

        That of a laser whose phase drifts within pulses is left out: see `sample_phase`.
        """
        times = self.dwell_start_ns(dwell) * 1e-9 + self.pulse_times
        farther = self._vibration.displacement(times)[:, 0]
        walk = 0.0 if self.preset.impairments.laser_within_pulse else self._laser_phase(dwell, self.pulse_times)
        air = self._air.displacement(times)[:, 0] if self._air else 0.0
        return np.asarray(walk + air - 4 * np.pi / self.sensor.wavelength * farther)

    def sample_phase(self, dwell: int) -> F64:
        """Phase (rad) of the raw samples of a dwell by a laser that drifts within pulses, shape (pulses, samples)."""
        numbers = np.arange(self.sensor.sample_count) - (self.sensor.sample_count - 1) / 2
        return self._laser_phase(dwell, self.pulse_times[:, None] + numbers / self.sensor.sampling_rate)

    def _laser_phase(self, dwell: int, seconds: F64) -> F64:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(LASER, dwell)))
        return laser_phase(self.preset.impairments.laser_linewidth_hz, seconds, self.preset.flight.slant_range_m, rng)

    @cached_property
    def spectrum(self) -> Sensor:
        """The sensor after range compression: whose range window and resolution the images have."""
        return spectrum_sensor(self.sensor)

    @cached_property
    def built(self) -> Sensor:
        """The sensor with the beams that it really has."""
        return self.preset.impairments.built(self.sensor)

    @property
    def pulse_times(self) -> F64:
        """Times of the pulses after the start of their dwell, s."""
        return np.arange(self.sensor.pulse_count) / self.sensor.pulse_repetition_frequency

    @property
    def _middle_of_dwell(self) -> float:
        return float(self.pulse_times[-1]) / 2

    def dwell_start_ns(self, dwell: int) -> int:
        """Start of a dwell after the start of the first, ns."""
        return self._start_ns(*self._place_of(dwell))

    def _place_of(self, dwell: int) -> tuple[int, int]:
        """The pass of a dwell, and its number in that; dwells before the first and after the last continue theirs."""
        number = min(max(0, dwell // self._dwells_per_pass), self.preset.flight.passes.count - 1)
        return number, dwell - number * self._dwells_per_pass

    def _start_ns(self, number: int, dwell: int) -> int:
        """Start of a dwell of a pass after the start of the first, ns."""
        seconds = dwell * self.preset.dwell_spacing_m / self.preset.flight.speed_mps
        return round((number * self.preset.flight.passes.interval_s + seconds) * 1e9)

    def dwell_end_ns(self, dwell: int) -> int:
        """Last pulse of a dwell after the start of the first dwell, ns."""
        return self.dwell_start_ns(dwell) + round(float(self.pulse_times[-1]) * 1e9)

    def platform_states(self, dwell: int) -> list[PlatformState]:
        """Odometry samples that a dwell adds, at the preset's rate, up to two past its end; stamps after the start.

        If they are stamped too late or too early, those of the dwell's own times are among them.
        """
        period_ns = round(1e9 / self.preset.flight.odometry_rate_hz)
        early_ns, late_ns = self._odometry_off_ns
        before, last = ((self.dwell_end_ns(number) + late_ns) // period_ns + 2 for number in (dwell - 1, dwell))
        starts_pass = dwell % self._dwells_per_pass == 0
        first = (self.dwell_start_ns(dwell) + early_ns) // period_ns - 2 if starts_pass else before + 1
        return [self._state(number * period_ns) for number in range(first, last + 1)]

    def track(self, dwell: int) -> Trajectory:
        """Odometry of a dwell: from the last sample before its first pulse to the first after its last."""
        period_ns = round(1e9 / self.preset.flight.odometry_rate_hz)
        early_ns, late_ns = self._odometry_off_ns
        start_ns, end_ns = self.dwell_start_ns(dwell) + early_ns, self.dwell_end_ns(dwell) + late_ns
        numbers = range(start_ns // period_ns, -(-end_ns // period_ns) + 1)
        return Trajectory([self._state(number * period_ns) for number in numbers], accuracy=self.odometry_accuracy)

    @property
    def odometry_accuracy(self) -> OdometryAccuracy:
        """Accuracy of the odometry, whose covariances are zeros where it is exact."""
        errors = self.preset.impairments.odometry
        return OdometryAccuracy(errors.position_m, errors.velocity_mps, errors.attitude_rad, errors.heading_rad)

    @property
    def _odometry_off_ns(self) -> tuple[int, int]:
        """Least (not positive) and greatest offset of an odometry stamp from the time that it describes, ns."""
        delay_ns = self.preset.impairments.odometry.delay_ns
        return min(0, delay_ns), max(0, delay_ns)

    def _state(self, stamp_ns: int) -> PlatformState:
        """Odometry of base_link, to which the sensor is fixed by its mounting, with its errors."""
        errors = self.preset.impairments.odometry
        seconds, mounting = (stamp_ns - errors.delay_ns) * 1e-9, errors.built(self.sensor.mounting)
        attitude = self.attitude(seconds)
        position, velocity = self.position(seconds), self.velocity(seconds)
        if not mounting.is_identity:
            step = 1e-3  # s, of the central difference that gives the arm's velocity: gusts last seconds
            turned = self.attitude(seconds + step * np.array([-1, 0, 1])) * mounting.axes.inv()
            before, arm, after = turned.apply(mounting.lever_arm)
            position, velocity = position - arm, velocity - (after - before) / (2 * step)
            attitude *= mounting.axes.inv()
        true = PlatformState(stamp_ns, position, attitude.as_quat(), velocity, np.zeros((6, 6)))
        return self._errors.added_to(true, seconds)

    def aperture(self, dwell: int) -> ApertureState:
        """State in the middle of a dwell; in stripmap of the aperture that slides with the ground abeam of it."""
        return self._aperture_of(self.dwell_start_ns(dwell))

    def _aperture_of(self, start_ns: int) -> ApertureState:
        """The same of a dwell that starts then."""
        middle = start_ns * 1e-9 + self._middle_of_dwell
        velocity = self.velocity(middle)
        sliding = self.sensor.mode == "stripmap"
        spotlight = float(np.linalg.norm(velocity)) * self.sensor.pulse_count / self.sensor.pulse_repetition_frequency
        return ApertureState(
            position=self.position(middle),
            velocity=velocity,
            rotation=self.attitude(middle).as_matrix(),
            length=aperture_length(self.sensor, self.preset.flight.slant_range_m) if sliding else spotlight,
            covariance=np.zeros((6, 6)),
            sliding=sliding,
        )

    def surface(self, dwell: int) -> VisibleSurface:
        """Return the surface that the dwell illuminates, in the range window, at positions in the middle of the dwell.

        In spotlight that is the `lit_angle` along the flight to each side of the beams, for any swing. In stripmap
        it is the ground abeam of the block, and `lit_angle` and half a beamwidth before and behind it, each scatterer
        as it is seen from abeam.

        Raises:
            UserError: there is no terrain.
        """
        if self.sensor.mode == "stripmap":
            start_ns = self.dwell_start_ns(dwell)
            seconds = {tile: (start_ns - self._start_ns(*tile)) * 1e-9 for tile in self._tiles(dwell)}
            return joined([self._ground(tile)[0].after(since) for tile, since in seconds.items()])
        aperture, reach = self.aperture(dwell), self._swept_angle * self.preset.flight.slant_range_m
        seen = self._visible(aperture, (aperture.position[0] - reach, aperture.position[0] + reach))
        return self._in_wind(seen, aperture, (LEAVES, dwell))

    @property
    def _swept_angle(self) -> float:
        """Angle along the flight, to each side, that main lobes light up in any position of their swing, rad."""
        return lit_angle(self.built.beams) + self.preset.impairments.greatest_swing

    def _tiles(self, dwell: int) -> list[tuple[int, int]]:
        """The tiles of ground that a stripmap block lights up, each by its pass and its number there.

        Tile n is the ground abeam of block n of the pass without gusts.
        """
        turn_beamwidths = 0.5  # additional ground around that lit by a stripmap block, for small turns of the body
        angle = self._swept_angle + turn_beamwidths * self.sensor.beams.track_beamwidth
        neighbours = math.ceil(angle * self.preset.flight.slant_range_m / self.preset.dwell_spacing_m)
        aperture, (number, _) = self.aperture(dwell), self._place_of(dwell)
        forward = aperture.position[0] * np.sign(aperture.direction[0])
        abeam = math.floor(forward / self.preset.dwell_spacing_m + self._dwells_per_pass / 2)
        return [(number, tile) for tile in range(abeam - neighbours, abeam + neighbours + 1)]

    @cached_property
    def _ground(self) -> Callable[[tuple[int, int]], tuple[VisibleSurface, Complex]]:
        """Surface and amplitudes of a tile, the same for all blocks of a pass; those of one block are kept."""
        return lru_cache(len(self._tiles(0)))(self._make_ground)

    def _make_ground(self, tile: tuple[int, int]) -> tuple[VisibleSurface, Complex]:
        number, place = tile
        aperture = self._aperture_of(self._start_ns(*tile))
        ends = (place - self._dwells_per_pass / 2 + np.arange(2)) * self.preset.dwell_spacing_m
        west, east = sorted((ends * np.sign(aperture.direction[0])).tolist())
        ground = self._visible(aperture, (west, east), strips_per_cell=1)
        key = (abs(place), int(place < 0), *([number] if number else []))
        ground = self._in_wind(ground, aperture, (LEAVES, *key))
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(GROUND, *key)))
        flight, sensor = self.preset.flight, self.spectrum
        pulses = aperture_length(sensor, flight.slant_range_m) * sensor.pulse_repetition_frequency / flight.speed_mps
        power = cell_power(self._cnr, sensor, pulses, mean_square_gain(sensor.beams))
        return ground, draw_amplitudes(ground, power, rng)

    def _in_wind(self, surface: VisibleSurface, aperture: ApertureState, key: tuple[int, ...]) -> VisibleSurface:
        """The surface, with velocities of its vegetation: scatterers above the terrain that are no targets."""
        if not (wind := self.preset.impairments.vegetation_wind):
            return surface
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))
        east, north, _ = sphere_coordinates(surface.positions)
        # Vegetation is more than 1 mm above the terrain.
        above = (surface.heights > self.scene.heights(east, north) + 1e-3) & ~surface.deterministic
        sight = surface.positions - aperture_at(surface.positions, aperture).position
        sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
        speed = np.where(above, wind.drawn(len(above), rng), 0.0)
        return replace(surface, velocity=surface.velocity + speed[:, None] * sight)

    def probed_air(self, dwell: int) -> list[ProbedAir]:
        """Measurements of a probe on the platform, each second, starting with one before the first dwell.

        They are published with a dwell for the next one, which has them in any order of arrival. Stamps count
        from the start. None: no air.
        """
        if not (air := self.preset.impairments.air):
            return []
        first, end = (self.dwell_start_ns(number) // INTERVAL_NS for number in (dwell, dwell + 1))
        stamps = [number * INTERVAL_NS for number in range(first if dwell else first - 1, end)]
        return [air.probed(stamp_ns, float(height_of(self.position(stamp_ns * 1e-9)))) for stamp_ns in stamps]

    @cached_property
    def _way(self) -> AirPath:
        """The effect of the air on echoes from the middle of the scene."""
        if not (air := self.preset.impairments.air):
            return AirPath(0.0, 0.0)
        flight = self.preset.flight
        return air.way(self.sensor.wavelength, flight.slant_range_m, flight.look_angle_rad, self.scene.reference_height)

    @property
    def _cnr(self) -> float:
        return float(10 ** (self.preset.cnr_db / 10))

    def _visible(
        self, aperture: ApertureState, east_extent: tuple[float, float], strips_per_cell: int = SAMPLES_PER_CELL
    ) -> VisibleSurface:
        """The surface that an aperture sees in the range window between two arc distances east (m)."""
        reach = self.preset.flight.slant_range_m - self._way.delay
        half_window = self.spectrum.range_window / 2
        azimuth_cell = self.sensor.wavelength * reach / (2 * aperture.length)
        return visible_surface(
            self.scene,
            aperture,
            self.sensor.look_side,
            (self.spectrum.range_resolution, azimuth_cell),
            east_extent,
            (reach - half_window, reach + half_window),
            strips_per_cell,
        )

    def phase_history(self, dwell: int) -> PhaseHistory:
        """Frames of all detectors in a dwell, in the sensor's waveform, stamped after the start of the first.

        They are reproducible for (seed, dwell).

        Raises:
            UserError: there is no terrain.
        """
        rng, impairments = np.random.default_rng([self.seed, dwell]), self.preset.impairments
        start_ns = self.dwell_start_ns(dwell)
        reference = np.full(self.sensor.pulse_count, self.preset.flight.slant_range_m)
        times, since = start_ns * 1e-9 + self.pulse_times, self.pulse_times - self._middle_of_dwell
        ahead, off_nadir = self.pointing(times)
        sensor, surface, antenna = echo_sensor(self.built), self.surface(dwell), self.position(times)
        within, off_nadir = reference - self._way.delay, off_nadir - self._way.bend
        if self.sensor.mode == "stripmap":
            amplitudes = np.concatenate([self._ground(tile)[1] for tile in self._tiles(dwell)])
            rotation = self.attitude(times).as_matrix() @ pointing_rotation(ahead, off_nadir, self.sensor)
            quartic = impairments.quartic_phase_rad
            echoes = simulate_block(sensor, surface, amplitudes, antenna, rotation, within, since, quartic)
        else:
            power = cell_power(self._cnr, self.spectrum, self.sensor.pulse_count)
            amplitudes = draw_amplitudes(surface, power, rng)
            echoes = simulate_dwell(sensor, surface, amplitudes, antenna, within, since, ahead, off_nadir)
            if impairments.quartic_phase_rad:
                echoes *= np.exp(1j * impairments.dwell_phase(len(times)))[:, None]
        if impairments.turns_pulses:
            echoes *= np.exp(1j * self.pulse_phase(dwell))[:, None]
        clean = through_receivers(echoes, self.sensor, impairments)
        raw = from_spectrum(clean, self.sensor)
        if impairments.laser_within_pulse:
            raw *= np.exp(1j * self.sample_phase(dwell)).astype(np.complex64)
        samples = received(raw, self.sensor, rng, impairments.adc_bits)
        samples = blanked(samples, self.sensor, self.preset.flight.slant_range_m)
        return PhaseHistory(start_ns, self.pulse_times, reference, samples)


def flight_of(preset: Preset, seed: int) -> SimulatedFlight:
    """Return the flight that a preset describes, over its scene and targets.

    Raises:
        UserError: the scene or a file of beams cannot be used, the pulses do not sample the Doppler of the beams, or
            the beams swing too far.
    """
    sensor = preset.make_sensor()
    for misfit in describe_beam_misfits(preset, sensor):
        raise UserError(misfit)
    scene = load_scene(preset.scene, preset.scene_extent_m)
    targets = tuple(
        PointScatterer(
            t.east_m, t.north_m, t.height_m, 10 ** (t.power_db / 10), t.radial_velocity_mps, t.along_velocity_mps
        )
        for t in preset.targets
    )
    bounce = 0.0 if preset.double_bounce_db is None else 10 ** (preset.double_bounce_db / 10)
    scene = replace(scene, points=scene.points + targets, origin=_origin_of(preset, scene), double_bounce=float(bounce))
    return SimulatedFlight(preset, sensor, scene, preset.dwells, seed)


def _origin_of(preset: Preset, scene: Scene) -> Origin | None:
    """The map's origin on the earth, by the scene or else the preset; None: unspecified.

    Raises:
        UserError: both state it.
    """
    if preset.origin is None:
        return scene.origin
    if scene.origin is not None:
        raise UserError(
            f"Preset {preset.name} has an origin, and scene {scene.name} has one of its own, in its coordinate "
            "reference system; remove the key origin."
        )
    return preset.origin.place


def samples_doppler(preset: Preset, sensor: Sensor) -> bool:
    """True if the pulses sample the Doppler of all ground that the main lobes illuminate."""
    return sensor.pulse_repetition_frequency >= lit_doppler(sensor, preset.flight.speed_mps) * (1 - 1e-6)


def swings_little(preset: Preset, sensor: Sensor) -> bool:
    """True if the beams stay within the band that a dwell may have."""
    return preset.impairments.greatest_swing <= MOST_SWING_BEAMWIDTHS * sensor.beams.track_beamwidth


def describe_beam_misfits(preset: Preset, sensor: Sensor) -> Iterator[str]:
    """Messages on pulses and beams with which a flight refuses a preset."""
    track_beamwidth, speed = sensor.beams.track_beamwidth, preset.flight.speed_mps
    if not samples_doppler(preset, sensor):
        length, doppler_band = sensor.wavelength / track_beamwidth, lit_doppler(sensor, speed)
        yield (
            f"Preset {preset.name}: sensor.pulse_repetition_frequency_hz is {sensor.pulse_repetition_frequency:g}; the "
            f"main lobe spans {doppler_band:g} Hz of Doppler, {doppler_band * length / speed:g} times the speed over "
            f"the length {length:g} m of the antenna along the flight, so it must be {doppler_band:g} or more."
        )
    if not swings_little(preset, sensor):
        yield (
            f"Preset {preset.name}: the beams swing by {preset.impairments.greatest_swing:g} rad, "
            "impairments.antenna_swing.amplitude_rad and four times pointing_jitter.rms_rad; that must be "
            f"{MOST_SWING_BEAMWIDTHS * track_beamwidth:g}, {MOST_SWING_BEAMWIDTHS:g} beamwidths, or less."
        )
