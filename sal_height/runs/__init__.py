"""Whole runs of the graph, and the measurement of images: what the commands of sal-height do.

`simulate` and `replay` make a plan, which `graph.lockstep` carries out with nodes; `live` and `attend` run nodes beside
a sensor that does not wait. `chain_runs` processes bags without nodes, for `by_calls`, `batch`, `adjust`, `calibrate`,
`movers` and `passes`, and `side_by_side` does so with several processes. `accuracy` compares heights with the truth:
`comparison` pixel by pixel, `surface_report`, `ground_report` and `report` in numbers, and the modules that end in
`_picture` and `profile` in pictures. `irf`, `psf` and `images` measure images. Read `simulate.run` first, then
`chain_runs`.
"""
