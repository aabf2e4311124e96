"""A simulated flight: scene, platform and sensor become phase histories with known truth.

Read `preset` first (the YAML that describes a run), then `flight` (everything a run is made of), `scene`, `canopy`,
`scenes` (the ground and its vegetation), `gust` (motion of the platform), `spotlight` and `stripmap` (echoes of the
lit scatterers), `pulse_groups` and `echoes` (the sum of their echoes), `air`, `receiver_noise` and `impairments`
(changes of echoes) and `lit_surfaces` (true height images).
"""

from sal_height.simulation.flight import (
    SimulatedFlight,
    describe_beam_misfits,
    flight_of,
    samples_doppler,
    swings_little,
)
from sal_height.simulation.impairments import Impairments, RangeSawtooth, RangeTaper
from sal_height.simulation.lit_surfaces import truth_image
from sal_height.simulation.phase_errors import laser_structure
from sal_height.simulation.preset import (
    MountingSettings,
    OriginSettings,
    Preset,
    load_preset,
    parse_preset,
    preset_names,
)
from sal_height.simulation.scene import Scene, VisibleSurface
from sal_height.simulation.stripmap import mean_square_gain, simulate_block
from sal_height.simulation.uncertainty_settings import UncertaintySettings

__all__ = [
    "Impairments",
    "MountingSettings",
    "OriginSettings",
    "Preset",
    "RangeSawtooth",
    "RangeTaper",
    "Scene",
    "SimulatedFlight",
    "UncertaintySettings",
    "VisibleSurface",
    "describe_beam_misfits",
    "flight_of",
    "laser_structure",
    "load_preset",
    "mean_square_gain",
    "parse_preset",
    "preset_names",
    "samples_doppler",
    "simulate_block",
    "swings_little",
    "truth_image",
]
