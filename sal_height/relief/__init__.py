"""From elevation to heights on the ground, tracked over pixels and gathered from many dwells.

Read `heights` first (elevation, range and Doppler to height, position and sigma) with `position_error` (covariance of
the position; error of height at a fixed position), and `slope` (slope of the ground, from neighbours), then `smoothing`
(Gauss-Markov smoothing along range and along-track, with the `settings`), `prior` (prior of the smoothing, from many
dwells), `tracked` (positions of the smoothed heights), `ground` (ground from all surfaces of all dwells, with `layers`,
also of rows estimated apart, `membrane` and `visibility`), `cell_map` (a map that grows with the ground seen), `map`
(mean of all dwells), `ground_map` (map of the ground), `projected` (map in UTM or the like) and `geotiff` (map as a
file).
"""

from sal_height.relief.cell_map import CellMap, GroundKind, Relief
from sal_height.relief.geotiff import check_geotiff, write_geotiff
from sal_height.relief.ground import GroundEstimate
from sal_height.relief.ground_map import GroundMap, fine_cell_size
from sal_height.relief.heights import HeightField, Surface, height_field
from sal_height.relief.labelled import LAYERS, labelled_heights, map_coordinates
from sal_height.relief.layers import joined_rows
from sal_height.relief.map import ReliefMap, fitting_cell_size
from sal_height.relief.offsets import SharedError, stated_course
from sal_height.relief.position_error import (
    circle_covariance,
    covariances_from_sigma,
    folded,
    height_variance,
    level_turn,
    measured_covariance,
    pitch_covariance,
    pose_covariance,
    position_jacobian,
    turn_jacobian,
    unfolded,
    variance_at_place,
    vertical,
)
from sal_height.relief.prior import PriorEstimate
from sal_height.relief.projected import ProjectedAxes
from sal_height.relief.settings import GroundSettings, TrackingSettings
from sal_height.relief.smoothing import (
    MeasuredHeights,
    ReliefPrior,
    TrackedRelief,
    filtered,
    smoothed,
    smoothed_columns,
    steady_sigmas,
)
from sal_height.relief.tracked import ground_spacings, track

__all__ = [
    "LAYERS",
    "CellMap",
    "GroundEstimate",
    "GroundKind",
    "GroundMap",
    "GroundSettings",
    "HeightField",
    "MeasuredHeights",
    "PriorEstimate",
    "ProjectedAxes",
    "Relief",
    "ReliefMap",
    "ReliefPrior",
    "SharedError",
    "Surface",
    "TrackedRelief",
    "TrackingSettings",
    "check_geotiff",
    "circle_covariance",
    "covariances_from_sigma",
    "filtered",
    "fine_cell_size",
    "fitting_cell_size",
    "folded",
    "ground_spacings",
    "height_field",
    "height_variance",
    "joined_rows",
    "labelled_heights",
    "level_turn",
    "map_coordinates",
    "measured_covariance",
    "pitch_covariance",
    "pose_covariance",
    "position_jacobian",
    "smoothed",
    "smoothed_columns",
    "stated_course",
    "steady_sigmas",
    "track",
    "turn_jacobian",
    "unfolded",
    "variance_at_place",
    "vertical",
    "write_geotiff",
]
