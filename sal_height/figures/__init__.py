"""Figures of the papers, recomputed, and Monte Carlo runs of the estimators, both checked against theory.

Read `curve` first (what a figure is made of and how a point is checked), then `catalogue` (all figures, and how they
are written), and `montecarlo` (one estimator at one operating point).

Angles here are in beamwidths (wavelength / antenna diameter), as in the papers: the beams are those of an instrument
whose beamwidth is 1 rad and whose array looks at 0.
"""

DEFAULT_TRIALS = 20_000
"""Monte Carlo trials per point by default."""
