"""Goodness of fit: tests of a dwell's data against what was assumed of the sensor.

`noise_level` compares the noise with its stated power, and `channel_gains` every channel with what the others predict.
"""
