"""`sal-height import`: make a bag of what other programs and sensors have recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from sal_height.commands._options import BAGS, DONE, OutputFolder, command, output_folder
from sal_height.tables import counted

KINDS = Group("What is imported", sort_key=3)

EXAMPLES = """
  sal-height import arrays radar.yaml flight.npz --track track.csv
  sal-height import cphd spotlight.cphd
  sal-height import crsd spotlight.crsd
  sal-height import gotcha data_3dsar_pass1_az00*_HH.mat
"""

ARRAYS_EXAMPLES = """
  sal-height import arrays radar.yaml flight.npz
  sal-height import arrays radar.yaml flight.mat --track navigation.sbet
  sal-height import arrays radar.yaml flight.h5 --track flown --out mine
"""

CPHD_EXAMPLES = """
  sal-height import cphd spotlight.cphd --out out/spotlight
  sal-height import cphd polarimetric.cphd --channel VV
  sal-height replay out/spotlight
"""

CRSD_EXAMPLES = """
  sal-height import crsd spotlight.crsd --out out/spotlight
  sal-height import crsd polarimetric.crsd --channel VV
  sal-height replay out/spotlight
"""

GOTCHA_EXAMPLES = """
  sal-height import gotcha pass1/HH/data_3dsar_pass1_az00*_HH.mat \\
    --out out/gotcha
  sal-height replay out/gotcha
  sal-height import gotcha pass1/HH/*.mat --dwells 3 --out out/gotcha_dwells
"""

SLC_EXAMPLES = """
  sal-height import slc beams.yaml images/dwell_*.nitf --out out/images
  sal-height import slc radar.yaml channels.npz
  sal-height replay out/images --from slc
"""

app = command("import", BAGS, EXAMPLES)
app.help = "Make a bag, which sal-height replay processes, of what other programs and sensors have recorded."
arrays_app = command("arrays", KINDS, ARRAYS_EXAMPLES)
cphd_app = command("cphd", KINDS, CPHD_EXAMPLES)
crsd_app = command("crsd", KINDS, CRSD_EXAMPLES)
gotcha_app = command("gotcha", KINDS, GOTCHA_EXAMPLES)
slc_app = command("slc", KINDS, SLC_EXAMPLES)
for kind in (arrays_app, cphd_app, crsd_app, gotcha_app, slc_app):
    app.command(kind)


@arrays_app.default
def arrays(
    sensor: Annotated[Path, Parameter(name="SENSOR")],
    data: Annotated[Path, Parameter(name="DATA")],
    /,
    *,
    track: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    out: OutputFolder = None,
) -> int:
    """Make a bag of arrays of phase history and the description of their sensor.

    DATA holds the arrays samples, complex, of dwells, channels, pulses and samples
    (dwells and channels may be left out), pulse_times (s) and reference_range (m);
    and times, positions and maybe velocities and attitudes of the platform, unless
    --track has them. docs/import.md describes them, and SENSOR key by key.

    Args:
        sensor: YAML file of the sensor.
        data: File of arrays: .npz, .mat or .h5.
        track: Track of the platform: CSV with a line of names, SBET (.sbet, .out), or a bag with odometry or fixes.
        out: Folder of the new bag, new or empty. Default: out/DATA, or the next free of out/DATA_2, ….
    """
    from sal_height.imports import import_arrays

    folder = output_folder(out, data.stem)
    dwells = import_arrays(sensor, data, folder, track)
    print(f"{counted(dwells, 'dwell')} in {folder}; process them with: sal-height replay {folder}")
    return DONE


@cphd_app.default
def cphd(
    file: Annotated[Path, Parameter(name="FILE")],
    /,
    *,
    channel: Annotated[str, Parameter(metavar="ID", show_default=False)] = "",
    out: OutputFolder = None,
) -> int:
    """Convert a channel of compensated phase history data to a bag, which sal-height replay focuses.

    It reads files of CPHD 1.0 and 1.1 of one platform, over frequency (FX) or time
    of arrival (TOA), with any sign, number format and frequencies that change from
    pulse to pulse. The map's origin is the image area reference point.

    Args:
        file: The file.
        channel: Identifier of the channel. Default: the reference channel.
        out: Folder of the new bag, new or empty. Default: out/FILE, or the next free of out/FILE_2, ….
    """
    from sal_height.imports import import_cphd

    folder = output_folder(out, file.stem)
    pulses = import_cphd(file, folder, channel)
    print(f"{counted(pulses, 'pulse')} in {folder}; focus them with: sal-height replay {folder}")
    return DONE


@crsd_app.default
def crsd(
    file: Annotated[Path, Parameter(name="FILE")],
    /,
    *,
    channel: Annotated[str, Parameter(metavar="ID", show_default=False)] = "",
    out: OutputFolder = None,
) -> int:
    """Convert compensated radar signal data to a bag, which sal-height replay focuses.

    It reads files of CRSD 1.0 with pulses and their echoes (CRSDsar), of one
    platform that transmits a linear FM. Echoes are compressed in range. The map's
    origin is the image area reference point. Channels that are beams of one antenna
    are read together.

    Args:
        file: The file.
        channel: Identifier of the channel. Default: all that are beams of one antenna, else the reference channel.
        out: Folder of the new bag, new or empty. Default: out/FILE, or the next free of out/FILE_2, ….
    """
    from sal_height.imports import import_crsd

    folder = output_folder(out, file.stem)
    pulses = import_crsd(file, folder, channel)
    print(f"{counted(pulses, 'pulse')} in {folder}; focus them with: sal-height replay {folder}")
    return DONE


@gotcha_app.default
def gotcha(
    files: Annotated[tuple[Path, ...], Parameter(name="FILE", required=True)] = (),
    /,
    *,
    dwells: Annotated[int, Parameter(metavar="N")] = 1,
    out: OutputFolder = None,
) -> int:
    """Convert AFRL Gotcha phase history to a bag, which sal-height replay focuses.

    Args:
        files: Consecutive files data_3dsar_*.mat of one pass and polarisation.
        dwells: Number of dwells into which the pulses are split, for sal-height adjust; pulses left over are left out.
        out: Folder of the new bag, new or empty. Default: out/gotcha, or the next free of out/gotcha_2, ….
    """
    from sal_height.imports import import_gotcha

    folder = output_folder(out, "gotcha")
    pulses = import_gotcha(list(files), folder, dwells)
    print(f"{counted(pulses, 'pulse')} in {folder}; focus them with: sal-height replay {folder}")
    return DONE


@slc_app.default
def slc(
    sensor: Annotated[Path, Parameter(name="SENSOR")],
    files: Annotated[tuple[Path, ...], Parameter(name="FILE", required=True)] = (),
    /,
    *,
    out: OutputFolder = None,
) -> int:
    """Make a bag of focused single-look images of several channels; sal-height replay --from slc makes heights of it.

    Files are given dwell by dwell, and channel by channel in a dwell: SICD, which
    state grid and aperture themselves; or arrays, one channel or all of a dwell in
    each, of which SENSOR states these. docs/import.md describes SENSOR key by key.

    Args:
        sensor: YAML file of the sensor.
        files: SICD (.nitf), .npy, .npz, .mat, HDF5 (NISAR), or complex GeoTIFF.
        out: Folder of the new bag, new or empty. Default: out/SENSOR, or the next free of out/SENSOR_2, ….
    """
    from sal_height.imports import import_slc

    folder = output_folder(out, sensor.stem)
    dwells = import_slc(sensor, list(files), folder)
    print(f"{counted(dwells, 'dwell')} in {folder}; make heights of them with: sal-height replay {folder} --from slc")
    return DONE
