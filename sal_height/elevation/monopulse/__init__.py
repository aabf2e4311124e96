"""Elevation from two beams: amplitude-comparison monopulse, and the sum-difference discriminator.

Read `estimators` first (estimates of gamma = Delta / Sigma from looks), then `discriminant` (gamma as a function of
elevation, and its invertible domain), `inverse_table` (from gamma to elevation by tables for all pairs of an array, as
the estimators do), `inversion` (the exact inversion for one pair, where tables err too much, and the linear one),
`pairs` (the strongest pair of an array) and `sum_difference` (a sensor with a hybrid, also by a measured
characteristic).
"""
