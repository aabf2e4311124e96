"""Experiments: the figures of the SAL paper made anew, and Monte Carlo runs of the estimators, both beside theory.

Angles here are in beamwidths (wavelength / aperture diameter), as in the paper: the beams are those of an instrument
whose beamwidth is 1 rad and whose array looks at 0.
"""
