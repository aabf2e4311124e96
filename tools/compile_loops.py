"""Compile inner loops for this processor, so that nobody waits for them later, by processing made-up dwells.

Loops that these do not need are compiled when they are first called.
"""

from __future__ import annotations

import logging

import numpy as np

from sal_height.elevation import ESTIMATORS
from sal_height.imaging import ImageSettings
from sal_height.rehearsal import made_up_heights, rehearse_heights
from sal_height.relief import PriorEstimate, TrackingSettings, track
from sal_height.simulation import flight_of, load_preset

PRESETS = ("small", "sal_stripmap", "xband_sumdiff")
"""Sensors of different kinds: single images, strips, and two channels that are mixed."""


def main() -> None:
    """Simulate a dwell of each preset, and process a made-up one by all estimators that suit it."""
    logging.getLogger("sal_height").setLevel(logging.ERROR)  # what was started knows that it compiles
    rng = np.random.default_rng(0)
    for name in PRESETS:
        flight = flight_of(load_preset(name), 1)
        flight.phase_history(0)
        estimators = [
            (one, one.settings())
            for one in ESTIMATORS.values()
            if one.suits(flight.sensor) and one.name != "canopy_ground"  # it has no loops of its own, and takes longest
        ]
        rehearse_heights(flight.sensor, ImageSettings(air="none"), estimators, rng)
    track(*made_up_heights(rng), PriorEstimate(), TrackingSettings())


if __name__ == "__main__":
    main()
