"""`sal-height export`: write the heights or complex images of a bag in formats that other programs read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import DONE, PROCESSING, Bag, Place, command
from sal_height.errors import UserError
from sal_height.tables import counted

EXAMPLES = """
  sal-height export out/sal_spotlight/bag --las street.laz
  sal-height export out/xband_relief/bag --cog map.tif --netcdf heights.nc
  sal-height export out/village/bag --film village.gif
  sal-height export flight --zarr heights.zarr --origin 48.1,11.3,560
  sal-height export out/images_too/bag --sicd images --origin 48.1,11.3,560
"""

app = command("export", PROCESSING, EXAMPLES)

File = Annotated[Path | None, Parameter(metavar="FILE")]


@app.default
def export(
    bag: Bag,
    /,
    *,
    las: File = None,
    cog: File = None,
    netcdf: File = None,
    zarr: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    film: File = None,
    sicd: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    topic: Annotated[str, Parameter(metavar="NAME", show_default=False)] = "",
    origin: Place = None,
    crs: Annotated[str, Parameter(metavar="NAME")] = "utm",
    cell_size: Annotated[float, Parameter(metavar="M", validator=Number(gte=0), show_default=False)] = 0.0,
) -> int:
    """Write the heights of a bag as a point cloud, a map or arrays, or its complex images as SICD.

    Coordinates are easting, northing and height above the ellipsoid where the
    origin of the map is known, by topic map_origin, the recorded parameters or
    --origin; else those of the map frame.

    Args:
        las: Point cloud, .las or .laz: a return for every surface, with sigma, CNR, probability, dwell and GPS time.
        cog: Map of all dwells as a Cloud-Optimized GeoTIFF, each cell the mean weighted by inverse variance.
        netcdf: Arrays of all dwells as netCDF 4, by the CF conventions.
        zarr: The same arrays as Zarr, in a new folder.
        film: Point cloud that grows dwell by dwell, beside the truth of a simulated flight, .gif of 10 s at most.
        sicd: Complex images, recorded with --record slc: a SICD file for each dwell and channel, in a new folder.
        topic: Of the heights. Default: /ml/height, or the first that the bag has.
        origin: Origin of the map on WGS 84: latitude and longitude in degrees, height in m. Default: as the bag says.
        crs: Coordinate reference system: utm, a code such as EPSG:25832, or local.
        cell_size: Side of a cell of the map, m. Default: as the pixels are.
    """
    if not (las or cog or netcdf or zarr or film or sicd):
        raise UserError(
            "Say what to write: --las FILE, --cog FILE, --netcdf FILE, --zarr DIR, --film FILE or --sicd DIR."
        )

    from sal_height.configuration import validated
    from sal_height.exports import (
        RecordedHeights,
        write_film,
        write_las,
        write_map,
        write_netcdf,
        write_sicd,
        write_zarr,
    )
    from sal_height.simulation import OriginSettings

    place = validated(OriginSettings, origin, "--origin").place if origin else None
    if sicd:
        print(f"{counted(write_sicd(bag, sicd, place), 'image')} as SICD; see {sicd}")
    if not (las or cog or netcdf or zarr or film):
        return DONE
    heights = RecordedHeights.of_bag(bag, topic, place, crs)
    system = heights.projection.name if heights.projection else "coordinates of the map frame"
    if las:
        print(f"{counted(write_las(heights, las), 'point')} of {heights.topic} in {system}; see {las}")
    if cog:
        rows, cols = write_map(heights, cog, cell_size)
        print(f"map of {rows} x {cols} cells in {system}; see {cog}")
    if netcdf:
        print(f"{counted(write_netcdf(heights, netcdf), 'dwell')} of {heights.topic} in {system}; see {netcdf}")
    if zarr:
        print(f"{counted(write_zarr(heights, zarr), 'dwell')} of {heights.topic} in {system}; see {zarr}")
    if film:
        print(f"{counted(write_film(heights, film), 'frame')} of {heights.topic}; see {film}")
    return DONE
