"""Products of a whole bag or of several: adjustment, calibration, movers, tomograms, heights of several passes."""
