"""Settings of heights from several passes."""

from __future__ import annotations

from sal_height.numeric import WINDOWS
from sal_height.settings import Settings, setting


class PassSettings(Settings):
    """Volume of the search, tie of the passes, and choice of points."""

    side_m: float = setting(
        80.0, "side of the square of ground that is searched", unit="m", minimum=1.0, maximum=2000.0
    )
    lowest_m: float = setting(-2.0, "lowest height that is searched", unit="m", minimum=-1000.0, maximum=9000.0)
    highest_m: float = setting(5.0, "greatest height that is searched", unit="m", minimum=-1000.0, maximum=9000.0)
    ground_m: float = setting(
        0.0,
        "height of the level about which bright points tie the passes, and which without reference points is the "
        "median of theirs",
        unit="m",
        minimum=-1000.0,
        maximum=9000.0,
    )
    least_power_db: float = setting(
        10.0,
        "power of a point in the mean over passes, over that of the background",
        unit="dB",
        minimum=0.0,
        maximum=100.0,
    )
    tie_reach_m: float = setting(
        3.0, "heights from the ground up to which a point may tie the passes", unit="m", minimum=0.1, maximum=100.0
    )
    most_ties: int = setting(300, "bright points that tie the passes, at most", minimum=10, maximum=10000)
    position_sigma_m: float = setting(
        0.1,
        "standard deviation of the error of position of a pass along each axis",
        unit="m",
        minimum=0.0,
        maximum=100.0,
    )
    largest_shift_m: float = setting(
        1.0, "largest shift between images that is looked for", unit="m", minimum=0.0, maximum=10.0
    )
    least_coherence: float = setting(
        0.5,
        "fraction of the power of bright points that a pass must have in the phase of the others, over what is usual; "
        "or it is left out",
        minimum=0.0,
        maximum=1.0,
    )
    reference_sigma_m: float = setting(
        0.02, "standard deviation of the height of a reference point", unit="m", minimum=1e-4, maximum=10.0
    )
    reference_radius_m: float = setting(
        1.0,
        "greatest distance of a bright point from the expected position of a reference point",
        unit="m",
        minimum=0.01,
        maximum=100.0,
    )
    range_window: str = setting("taylor", "weighting over the bandwidth", choices=tuple(sorted(WINDOWS)))
    azimuth_window: str = setting("taylor", "weighting over the aperture", choices=tuple(sorted(WINDOWS)))
