"""`sal-height psf`: estimate the complex point-spread function of a system."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from sal_height.commands._options import (
    DONE,
    FAILED,
    MEASURING,
    AzimuthAxis,
    Channel,
    Dwell,
    Images,
    Jobs,
    OutputFolder,
    RangeByAzimuth,
    Settings,
    command,
    output_folder,
    settings_values,
)

EXAMPLES = """
  sal-height psf tape.npy             one image, range along the rows
  sal-height psf reflector.npy --azimuth-axis 0 --chip 48x64
  sal-height psf out/images/bag --channel 4   all dwells of a bag with images

Images of this program are weighted in range by default, with pixels as wide
as the weighted resolution, so that the edge of the band is folded into it.
Focus them without weights for this measurement:
  sal-height replay BAG --record slc --out out/images \\
    --param sar_compression.range_window=rectangular
  sal-height psf out/images/bag --channel 4
"""

app = command("psf", MEASURING, EXAMPLES, "no estimate could be made from point targets or speckle")


@app.default
def psf(
    images: Annotated[Images, Parameter(required=True)] = (),
    /,
    *,
    chip: RangeByAzimuth = None,
    dwell: Dwell = None,
    channel: Channel = None,
    azimuth_axis: AzimuthAxis = 1,
    noise_power: Annotated[float | None, Parameter(metavar="P", validator=Number(gte=0))] = None,
    settings: Settings = (),
    jobs: Jobs = 1,
    out: OutputFolder = None,
) -> int:
    """Estimate the complex point-spread function of each channel from all its images.

    All images of a channel, whatever their dwell and file, are measured together.
    They must come from one sensor and mode, have equally many range pixels, and
    be sampled critically or finer. An image is one of
      .npy, .npz   the complex array in it: (range, azimuth) or (channels, range,
                   azimuth)
      .mat, .h5    the same; of NISAR (RSLC) all polarisations, as channels
      .tif, .nitf  the complex bands of a GeoTIFF, as channels, or a SICD
      bag          folder or .mcap file: every ComplexImage in it (topic slc), or
                   the images of its phase history; with its sensor_info; adds m
                   to pixels

    There are two independent estimates, and each may fail:
      targets      chips around bright, isolated point targets give the complex
                   frequency responses R in range and A in azimuth, and so the
                   point-spread function: width at -3 dB, PSLR, ISLR, and
                   anomalous sidelobes, which rise above those nearer to the peak
                   and indicate a fault
      speckle      tiles of pure speckle give |R|^2 and |A|^2, the noise floor
                   (the quietest eighth of the frequencies), a spur at half a
                   cycle per range pixel, and the antenna pointing at each column
                   of tiles
      both         a test of superposition: the probability that a linear system
                   shows a difference between its responses to targets and to
                   speckle as large as this one, or larger. A small probability is
                   evidence against linearity. Receiver noise may have passed any
                   weights over range, but must be white along azimuth, unless a
                   bag states its weights. Speckle within 128 range pixels of
                   a bright point is excluded, because it contains the point's
                   echoes. Without a known noise power, tiles whose neighbours in
                   azimuth do not correlate are not used as speckle

    The output folder holds psf.json, psf.npz and psf.png; with several channels,
    psf_N.npz and psf_N.png are those of channel N. An entry of psf.json belongs
    to one channel. What cannot be estimated is null there, "undetermined" says
    why and what would be needed, and psf.npz lacks its arrays.

    psf.npz holds, along frequencies in cycles per pixel from -1/2 up
    (range_frequency, azimuth_frequency),
      R, A, R_sigma, A_sigma    responses to a point whose peak is 1 in pixel 0,
                                and their standard errors
      R_without_clutter, A_...  the same without what clutter explains
      speckle_R2, speckle_A2    power with mean 1, corrected for short tiles;
                                speckle_R2_sigma, speckle_A2_sigma
      psf                       complex, 4 samples per pixel, peak in the middle
      pointing, pointing_sigma  cycles per pixel, at column pointing_azimuth_px of
                                image pointing_image

    Settings, for option --set:
      point_over_clutter_db  20     lowest power of a point target over clutter
      point_isolation_db     20     what lies beside its cuts is so far below it
      point_sidelobes_db     9      its sidelobes are so far below it
      point_energy_ratio     1.25   largest energy over that of other targets
      points_per_image       25     bright pixels examined in an image
      speckle_significance   0.001  share of good tiles that each test rejects
      speckle_over_noise_db  3      lowest power of a tile over a known noise power

    Args:
        images: Files or bags.
        chip: Size of the chips around targets in pixels, range x azimuth. Default: 64x64, or less for small images.
        noise_power: Power of receiver noise in a pixel, unit of the pixels squared; 0: negligible. Default: a bag's.
        out: Output folder, new or empty. Default: out/psf, or the next free of out/psf_2, ….
    """
    from sal_height.response import PsfSettings
    from sal_height.runs.responses.psf import determined, psf_table
    from sal_height.runs.responses.psf import psf as measure

    folder, chosen = output_folder(out, "psf"), PsfSettings(**settings_values(settings))
    entries = measure(list(images), folder, chip, dwell, channel, azimuth_axis, chosen, noise_power, jobs)
    pictures = ", ".join(sorted(str(path) for path in folder.glob("psf*.png")))
    print(f"{psf_table(entries)}\nsee {folder}/psf.json and {pictures}")
    return DONE if determined(entries) else FAILED
