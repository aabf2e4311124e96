"""Several scatterers per pixel, or one surface that is spread over elevation.

`several` and `extended` estimate them, `single` judges one scatterer, `order` gives the probability of each number of
scatterers, `models` weighs them, and `layover` chooses one for each pixel. `two_channels` states what two channels
cannot separate.
"""
