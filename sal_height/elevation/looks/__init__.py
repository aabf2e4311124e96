"""The covariance of the channels in each pixel.

`looks` sums the channels over windows into sample covariances, `look_windows` defines the windows, `cell_response`
gives the fraction of the energy that neighbouring pixels contribute, and `noise_floor` the noise power of each pixel.
`dwell_columns` arranges several dwells side by side.
"""
