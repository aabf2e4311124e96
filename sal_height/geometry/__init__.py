"""Axes, the earth, pixel grids, and the platform's track.

Read `frames` first (body and map axes, mounting and state of the sensor, elevation and squint), then `earth` (heights
above the sphere), `grid` (pixels of an image), `trajectory` (odometry to positions of the antenna at each pulse; range
and Doppler to a position on the ground), `motion` (uncertainty in its gaps, quaternions), `accuracy` (of odometry whose
covariances state none), `geodesy` (the origin of a map on the ellipsoid, axes of aviation), `projection` (a map in UTM
or the like), `elevation_model` (heights of the ground from files), `navigation` (positions, velocities and attitudes of
separate instruments) and `refraction` (delay and bending by the atmosphere). Angles are in rad, lengths in m, times in
s.
"""

from sal_height.geometry.accuracy import ASSUMED, EXACT, NOT_STATED, OdometryAccuracy, known_pose, known_velocity
from sal_height.geometry.earth import EARTH_RADIUS, above_place, height_of, sphere_coordinates, sphere_point
from sal_height.geometry.frames import (
    AT_BASE_LINK,
    ApertureState,
    Mounting,
    angles_of,
    antennas_of,
    aperture_at,
    look_direction,
    shift_along,
    squint_on_cone,
)
from sal_height.geometry.geodesy import (
    BODY_AXES,
    GEOID_SIGMA_M,
    LEVELS,
    MAP_AXES,
    ROS_AXES,
    UNKNOWN_LEVEL,
    Altitudes,
    Axes,
    Origin,
)
from sal_height.geometry.grid import Grid, pixels_at, ranges_of_phase, without_range_phase
from sal_height.geometry.motion import (
    ASSUMED_ACCELERATION,
    ASSUMED_TURNING,
    STEADY,
    Motion,
    quaternion_of,
    rotation_matrix,
)
from sal_height.geometry.navigation import REORDERED_NS, Navigation, Sample
from sal_height.geometry.projection import UTM, WGS_84, Projection, find_system
from sal_height.geometry.refraction import (
    PRESSURES_PA,
    RADIO_M,
    STANDARD_ATMOSPHERE,
    TEMPERATURES_K,
    TOP_M,
    AirPath,
    Atmosphere,
    describe_implausible_pressure,
    electron_delay,
    path_through_air,
    refractivities,
)
from sal_height.geometry.trajectory import (
    PlatformState,
    Trajectory,
    antenna_covariance,
    locate_at_elevation,
    locate_at_height,
)

__all__ = [
    "ASSUMED",
    "ASSUMED_ACCELERATION",
    "ASSUMED_TURNING",
    "AT_BASE_LINK",
    "BODY_AXES",
    "EARTH_RADIUS",
    "EXACT",
    "GEOID_SIGMA_M",
    "LEVELS",
    "MAP_AXES",
    "NOT_STATED",
    "PRESSURES_PA",
    "RADIO_M",
    "REORDERED_NS",
    "ROS_AXES",
    "STANDARD_ATMOSPHERE",
    "STEADY",
    "TEMPERATURES_K",
    "TOP_M",
    "UNKNOWN_LEVEL",
    "UTM",
    "WGS_84",
    "AirPath",
    "Altitudes",
    "ApertureState",
    "Atmosphere",
    "Axes",
    "Grid",
    "Motion",
    "Mounting",
    "Navigation",
    "OdometryAccuracy",
    "Origin",
    "PlatformState",
    "Projection",
    "Sample",
    "Trajectory",
    "above_place",
    "angles_of",
    "antenna_covariance",
    "antennas_of",
    "aperture_at",
    "describe_implausible_pressure",
    "electron_delay",
    "find_system",
    "height_of",
    "known_pose",
    "known_velocity",
    "locate_at_elevation",
    "locate_at_height",
    "look_direction",
    "path_through_air",
    "pixels_at",
    "quaternion_of",
    "ranges_of_phase",
    "refractivities",
    "rotation_matrix",
    "shift_along",
    "sphere_coordinates",
    "sphere_point",
    "squint_on_cone",
    "without_range_phase",
]
