"""One scatterer per pixel, estimated from the whole array.

`estimate` has the result and the reasons for none, `settings` what a user may set. `likelihood` with `search` finds the
elevation, `spatial_prior` helps it by neighbours, and `bounds`, `beam_error` and `response_spread` give the variance.
"""
