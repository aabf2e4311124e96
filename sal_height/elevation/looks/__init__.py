"""The covariance of the channels in each pixel.

`looks` sums the channels over windows into sample covariances, of several dwells side by side, and gives the noise
power of each pixel; `look_windows` defines the windows, and `cell_response` gives the fraction of the energy that
neighbouring pixels contribute.
"""
