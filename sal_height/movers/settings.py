"""Settings of the search for movers."""

from __future__ import annotations

from sal_height.sensor import MAX_SHARE
from sal_height.settings import Settings, setting


class MoverSettings(Settings):
    """Candidates of the search, and the likelihood that a mover must have."""

    prominence_db: float = setting(
        10.0,
        "power of a pixel over the median of its row, in spotlight of what is around it, from which it is looked at",
        unit="dB",
        minimum=3.0,
        maximum=60.0,
    )
    false_alarm_rate: float = setting(
        1e-3,
        "greatest fraction of candidates at rest that may be taken for movers",
        minimum=1e-9,
        maximum=0.1,
    )
    fastest_mps: float = setting(
        20.0,
        "greatest radial velocity whose range migration is looked for, in spotlight along the flight, too; in "
        "stripmap no more than 6 rows while the beam passes; 0: none",
        unit="m/s",
        minimum=0.0,
        maximum=1000.0,
    )
    chip_pixels: int = setting(
        32,
        "pixels along the flight of a strip from which the spectrum of a bright pixel is taken",
        minimum=16,
        maximum=256,
    )
    max_saturated_fraction: float = setting(
        MAX_SHARE,
        "highest fraction of clipped samples in a channel; above it, an image is left out",
        minimum=0.0,
        maximum=1.0,
    )
