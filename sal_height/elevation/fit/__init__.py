"""Goodness of fit: tests of a dwell's data against what was assumed of the sensor.

`statistics` reads the pixels, once for all tests. `noise_level` compares the noise with its stated power,
`noise_pattern` finds noise that channels have in common, `channel_gains` compares every channel with what the others
predict, and `channel_noise` its noise with theirs.
"""
