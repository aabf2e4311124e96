"""`sal-height irf`: measure the impulse response of a target."""

from __future__ import annotations

from sal_height.commands._options import (
    DONE,
    MEASURING,
    AzimuthAxis,
    Channel,
    Dwell,
    Flag,
    Images,
    Jobs,
    OutputFolder,
    PixelPosition,
    command,
    output_folder,
)
from sal_height.errors import UserError

EXAMPLES = """
  sal-height irf image.npy
  sal-height irf image.npy --near 120,45
  sal-height irf out/replay_gotcha/bag   images that a replay records
  sal-height irf --windows               what windows cost and gain

A replay records the images of a single channel by itself. To have those of
several channels:
  sal-height replay BAG --record slc --out out/images \\
    --param sar_compression.image_plane=ground \\
    --param sar_compression.ground_spacing_m=0.02 \\
    --param sar_compression.rows=300 --param sar_compression.cols=60
  sal-height irf out/images/bag --channel 4
"""

app = command("irf", MEASURING, EXAMPLES)


@app.default
def irf(
    images: Images = (),
    /,
    *,
    near: PixelPosition = None,
    dwell: Dwell = None,
    channel: Channel = None,
    azimuth_axis: AzimuthAxis = 1,
    jobs: Jobs = 1,
    windows: Flag = False,
    out: OutputFolder = None,
) -> int:
    """Measure the impulse response of the brightest target in each image.

    An image is one of
      .npy, .npz   the complex array in it: (rows, cols) or (channels, rows, cols)
      .mat, .h5    the same; of NISAR (RSLC) all polarisations, as channels
      .tif, .nitf  the complex bands of a GeoTIFF, as channels, or a SICD
      bag          folder or .mcap file: every ComplexImage in it (topic slc), or
                   the images of its phase history; with its sensor_info, which is
                   needed to remove the phase of range first; adds positions and
                   widths in m

    Along cuts through the target's peak, interpolated to 32 samples per pixel, the
    command measures
      width        at -3 dB
      PSLR         highest sidelobe over the peak
      ISLR         energy of the sidelobes, up to 10 widths from the peak, over
                   that of the main lobe
    and, in the whole image,
      peak         brightest pixel over the median
      entropy      of the energy distribution over the pixels
    A dash in the table and null in irf.json mean that an image does not show a
    quantity: it is too small, or the target is too near its edge. Pixels must be
    closer than the resolution; the default images, in the slant plane, are not in
    range, so focus in the ground plane for a measurement.

    The output folder holds irf.json and irf.png.

    Args:
        images: Files or bags.
        near: Measure the brightest target within 8 pixels of this position.
        windows: Print what the windows of this program cost and gain, instead of measuring images.
        out: Output folder, new or empty. Default: out/irf, or the next free of out/irf_2, ….
    """
    from sal_height.runs.responses.irf import irf as measure
    from sal_height.runs.responses.irf import response_table, window_table

    if windows == bool(images):
        raise UserError("Give either images to measure or --windows; sal-height irf --help explains both.")
    if windows:
        print(window_table())
        return DONE
    folder = output_folder(out, "irf")
    entries = measure(list(images), folder, near, dwell, channel, azimuth_axis, jobs)
    print(response_table(entries))
    print(f"see {folder}/irf.json and {folder}/irf.png")
    return DONE
