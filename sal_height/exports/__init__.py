"""Export for other programs: the heights of a bag as point clouds, maps and labelled arrays, and its complex images.

Read `heights` first (the height images of a bag, located on the earth, and their map), then `las` (points), `dataset`
(arrays with names and units, as netCDF and Zarr), `film` (dwell by dwell) and `sicd` (complex images).
"""

from sal_height.exports.dataset import open_heights, write_netcdf, write_zarr
from sal_height.exports.film import write_film
from sal_height.exports.heights import DwellHeights, RecordedHeights, write_map
from sal_height.exports.las import write_las
from sal_height.exports.sicd import write_sicd

__all__ = [
    "DwellHeights",
    "RecordedHeights",
    "open_heights",
    "write_film",
    "write_las",
    "write_map",
    "write_netcdf",
    "write_sicd",
    "write_zarr",
]
