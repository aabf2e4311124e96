"""What `sal-height irf` and `calibrate` say about themselves."""

IRF = """An image is one of
  .npy, .npz   the complex array in it: (rows, cols) or (detectors, rows, cols)
  bag          folder or .mcap file: every ComplexImage in it (topic slc), with its sensor_info, by which the phase of
               range is removed first; adds positions and widths in m

Measured are, in the cuts through the target's peak (32 samples per pixel):
  width        at -3 dB
  PSLR         greatest sidelobe over the peak
  ISLR         energy of the sidelobes, up to 10 widths from the peak, over that of the main lobe
  peak         brightest pixel over the median of the image
  entropy      of the shares of energy of all pixels
A dash, null in irf.json, stands for what an image does not show: it is too small, or the target too near its edge.
The pixels must be closer than the resolution. Those of the default images, in the slant plane, are not in range: focus
in the ground plane for a measurement.

A replay records images of single detectors only. To have those of several, record while they are made:
  .venv/bin/recorder --ros-args -p directory:=my_slc -p topics:=[/slc,/sensor_info] &
  sal-height replay BAG --param sar_compression.image_plane=ground --param sar_compression.ground_spacing_m=0.02 \\
    --param sar_compression.rows=300 --param sar_compression.cols=60
  kill -INT %1
  sal-height irf my_slc --detector 4
"""

CALIBRATE = """Plays a bag through compression, without weights in range, and measures on the images of all its dwells
  receivers    how each channel's receiver shapes the band, beyond what sensor_info says: relative to the others by the
               cross-spectra between channels, on any scene; what they have in common, by point targets
  gains, width complex gains of the detectors and the width of their beams, by the scene; of two detectors the phase
               only, unless a reflector of known place (E,N,H in m) is in the images:
               --param psf_calibration.target=12.5,-3,1.2
A calibration belongs to the sensor_info it was measured with. It is applied where images are made:

  sal-height calibrate out/sal_spotlight/bag --out out/calibrated
  sal-height replay out/sal_spotlight/bag --param sar_compression.calibration=out/calibrated/calibration.npz

Images and heights then have its id in their provenance. In the air, node psf_calibration does the same and publishes on
topic calibration, which sar_compression takes with calibration:=topic.
"""
