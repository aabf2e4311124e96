"""What the channels have observed in each pixel.

`looks` averages the channels over windows into sample covariances, `look_windows` decides how large these are,
`cell_response` how much of them belongs to neighbouring pixels, and `noise_floor` estimates the noise in them.
`dwell_columns` arranges several dwells side by side.
"""
