"""Bags processed by the chain of stages without nodes.

`entry` decides where in the chain a bag starts, `replay_parameters` with `recorded_parameters` and `timeline` which
parameters the stages have, and `chain_runs` processes it, with `side_by_side` for several processes. `recorded_images`
gives the complex images.
"""
