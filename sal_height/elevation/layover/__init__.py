"""Several scatterers per pixel, or one surface that is spread over elevation.

`several` and `extended` estimate them, `single` tests one scatterer, `order` gives the probability of each number of
scatterers, and `models` fits them and chooses one for each pixel. `two_channels` accounts for layover that two channels
cannot resolve.
"""
