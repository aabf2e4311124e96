"""One scatterer per pixel, estimated from the whole array.

`estimate` has the result and the reasons for invalid pixels, `height_settings` the settings. `likelihood` with `search`
finds the elevation, and `bounds`, `beam_error` and `response_spread` the variance.
"""
