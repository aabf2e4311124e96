"""Compile inner loops for this processor, so that nobody waits for them later, by processing made-up dwells.

Loops that these do not need are compiled when they are first called.
"""

from __future__ import annotations

import logging
from contextlib import suppress

import numpy as np

from sal_height.elevation import ESTIMATORS
from sal_height.errors import UserError
from sal_height.imaging import ImageSettings
from sal_height.pipeline import Compressor, heights
from sal_height.rehearsal import made_up_heights, rehearsed_slc, with_scatterers
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
        slc = rehearsed_slc(flight.sensor, ImageSettings(), Compressor(), rng)
        if slc is None:
            continue
        slc = with_scatterers(slc, flight.sensor, rng)
        for estimator in ESTIMATORS.values():
            if estimator.suits(flight.sensor):
                with suppress(UserError):  # noise may be nothing to an estimator, but its loops are compiled
                    heights(slc, flight.sensor, estimator, estimator.settings())
    track(*made_up_heights(rng), PriorEstimate(), TrackingSettings())


if __name__ == "__main__":
    main()
