"""What speaks against a dwell is in all that is made of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from flown_items import SMALL, flight_items, made, ml_stage, small_flight

from sal_height.engine.compression import Compression, CompressionSettings
from sal_height.engine.height_items import Heights
from sal_height.topics import ODOMETRY


def test_heights_have_the_doubts_about_their_images() -> None:
    flight, settings = small_flight(), CompressionSettings(**SMALL)
    absurd = {"velocity_covariance": np.full((3, 3), np.nan)}
    items = flight_items(flight, dwells=[0])
    items = [(port, replace(item, **absurd) if port == ODOMETRY else item) for port, item in items]
    ml = ml_stage()
    found = made([Compression(settings), ml], [settings, type(ml).settings()], items, "ml/height")
    heights: Heights = found[0]
    assert [doubt.name for doubt in heights.doubts] == ["odometry"]
    assert "twist is not finite" in heights.doubts[0].sentence
