"""Passes over the street with errors of navigation and mounting, simulated once."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from benchmarks.passes import FlownPasses, observed
from sal_height.simulation import Preset, flight_of, load_preset
from sal_height.simulation.impairments import Impairments
from sal_height.simulation.odometry_errors import OdometryErrors
from sal_height.simulation.preset import Passes
from sal_height.simulation.scenes import SCENES, street

BORESIGHT = (1.5e-5, -2e-5, 1e-5)
ERRORS = OdometryErrors(
    position_m=0.1,
    velocity_mps=0.003,
    attitude_rad=3e-5,
    undescribed_lever_arm_m=(0.008, -0.006, 0.01),
    undescribed_boresight_rad=BORESIGHT,
)


EAST_M = 1.6
"""By which the street lies farther east, so that the dwells about the origin see where a car and the steps end."""

STREET = "street farther east"
SCENES[STREET] = lambda: replace(street(), east=street().east + EAST_M)


def preset_of(passes: int, per_pass: int, **impairments: object) -> Preset:
    """The street in passes to and fro."""
    preset = replace(load_preset("sal_spotlight"), scene=STREET)
    wrong = Impairments(**{"odometry": ERRORS, **impairments})  # type: ignore[arg-type]
    flight = replace(preset.flight, passes=Passes(passes, 100.0))
    return replace(preset, dwells=passes * per_pass, flight=flight, impairments=wrong)


def flown_as(preset: Preset, seed: int) -> FlownPasses:
    """All dwells of a preset."""
    return FlownPasses.of(flight_of(preset, seed), [observed(dwell, preset, seed) for dwell in range(preset.dwells)])


@cache
def flown(seed: int = 1) -> FlownPasses:
    """Five passes of three dwells."""
    return flown_as(preset_of(5, 3), seed)
