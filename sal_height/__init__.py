"""Height images from airborne synthetic-aperture lidar and multi-beam radar: a core free of ROS, and ROS 2 nodes.

A session in Python, from a simulated phase history to heights:

    import sal_height

    flight, compressor = sal_height.flight_of(sal_height.load_preset("small"), seed=1), sal_height.Compressor()
    slc = compressor.add(flight.phase_history(0), flight.track(0), flight.sensor, sal_height.ImageSettings(cols=12))
    ml = sal_height.ESTIMATORS["ml"]
    field = sal_height.heights(slc, flight.sensor, ml, ml.settings(range_looks=2, azimuth_looks=2))
    field.plot()

and from a recorded bag: `sal_height.open_heights("out/small/bag")`. The names are imported on first use; the packages
have more, with a docstring that says what to read first.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "BagReader": "sal_height.bag.reader",
    "Calibration": "sal_height.calibration",
    "Compressor": "sal_height.pipeline",
    "ESTIMATORS": "sal_height.elevation",
    "HeightField": "sal_height.relief",
    "ImageSettings": "sal_height.imaging",
    "PhaseHistory": "sal_height.sensor",
    "ReliefMap": "sal_height.relief",
    "Sensor": "sal_height.sensor",
    "Slc": "sal_height.imaging",
    "UserError": "sal_height.errors",
    "Validity": "sal_height.elevation",
    "flight_of": "sal_height.simulation",
    "heights": "sal_height.pipeline",
    "load_preset": "sal_height.simulation",
    "open_heights": "sal_height.exports",
    "preset_names": "sal_height.simulation",
}
"""Module of each name; type checkers know the names by these modules."""

__all__ = ["__version__", *_HOMES]  # noqa: PLE0604 (texts)


def __getattr__(name: str) -> Any:
    """A name of this package, imported on first use."""
    if name not in _HOMES:
        raise AttributeError(f"Module {__name__} has no attribute {name!r}.")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
