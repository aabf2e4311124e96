"""Elevation from two beams: amplitude-comparison monopulse, and the sum-difference discriminator.

Read `estimators` first (estimates of gamma = Delta / Sigma from looks), then `discriminant` (gamma as a function of
elevation, and where it can be inverted), `inversion` and `slope_table` (from gamma to elevation, by the beams or by a
measured characteristic), `inverse_table` (the same as `inversion`, tabulated for all pairs of an array), `pairs` (the
strongest pair of an array) and `sum_difference` (a sensor with a hybrid).
"""
