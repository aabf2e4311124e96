"""What `sal-height irf`, `calibrate` and `psf` say about themselves."""

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

PSF = """What images of a detector have in common is the response of the system to a point: all those given of one
detector are measured together, whatever their dwells and files. They must be of one sensor and mode, of as many range
pixels, and critically sampled or finer. An image is one of
  .npy, .npz   the complex array in it: (range, azimuth) or (detectors, range, azimuth)
  bag          folder or .mcap file: every ComplexImage in it (topic slc), with its sensor_info; adds m to pixels

Two ways lead to the response, and each may fail by itself:
  targets      chips around points that are bright, whole and alone tell the complex responses R along range and A
               along azimuth, and so the point-spread function: width at -3 dB, PSLR, ISLR, and anomalous sidelobes,
               which rise above those nearer to the peak and are a fault's
  speckle      tiles that hold nothing else tell |R|^2 and |A|^2, a noise floor (the quietest eighth of the
               frequencies), a spur at half a cycle per range pixel, and where the antenna points at each column of
               tiles
  both         superposition: the probability that a linear system shows as large a difference, or a larger one,
               between its responses to targets and to speckle. A small one speaks against linearity. Speckle
               within 128 range pixels of a bright point is left out: the point's echoes are in it
What cannot be determined is null in psf.json, its entry under "undetermined" says why and what would be needed, and
psf.npz lacks its arrays. One entry of psf.json is one detector; with several, N's files are psf_N.npz and psf_N.png.

In psf.npz, along frequencies in cycles per pixel from -1/2 up (range_frequency, azimuth_frequency):
  R, A, R_sigma, A_sigma      responses to a point whose peak is 1 in pixel 0; standard errors of the complex numbers
  R_without_clutter, A_...    less what clutter explains of them
  speckle_R2, speckle_A2      of mean 1, the effect of short tiles undone; speckle_R2_sigma, speckle_A2_sigma
  psf                         complex, 4 samples per pixel, peak in the middle
  pointing, pointing_sigma    cycles per pixel, at column pointing_azimuth_px of image pointing_image

examples:
  sal-height psf tape.npy                      one image, range along rows
  sal-height psf reflector.npy --azimuth-axis 0 --chip 48x64
  sal-height psf my_slc --detector 4           all dwells of a bag with images of detector 4

Images of this program are weighted along range by default, and their pixels as wide as the weighted resolution: what
lies at the edge of the band is folded into it. Focus them without weights for this measurement:
  .venv/bin/recorder --ros-args -p directory:=my_slc -p topics:=[/slc,/sensor_info] &
  sal-height replay BAG --param sar_compression.range_window=rectangular
  kill -INT %1
"""
