"""Figures of the papers, recomputed, and Monte Carlo runs of the estimators, both checked against theory.

Read `curve` first (the parts of a figure and the check of a point), then `paper_figures` (all figures, and their
files), and `montecarlo` (one estimator at one operating point).

Angles here are in beamwidths (wavelength / antenna diameter), as in the papers: the beams are those of an instrument
whose beamwidth is 1 rad and whose array looks at 0.
"""

DEFAULT_TRIALS = 20_000
"""Monte Carlo trials per point by default."""
