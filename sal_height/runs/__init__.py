"""Whole runs of the graph, and the measurement of images: what the commands of sal-height do.

`simulate`, `replay` and `calibrate` each make a plan and have `conductor.perform` carry it out with the nodes that
`ensemble` starts, of those in `catalogue`; `live` and `attend` run them beside a sensor that does not wait, where
`supervisor` starts again what has ended and `watch` reads what they tell; `reporting` and `tables` say what came out.
`accuracy` compares heights with the truth: `comparison` pixel by pixel, `surface_report`, `ground_report` and `report`
in numbers, and the modules that end in `_picture` and `profile` in pictures. `gotcha` imports recorded data; `irf`,
`psf` and `images` measure images. Read `simulate.run` first, then `conductor`.
"""
