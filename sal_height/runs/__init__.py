"""Whole runs of the graph, and the measurement of images: what the commands of sal-height do.

`simulate`, `replay` and `calibrate` each make a plan and have `conductor.perform` carry it out with the nodes that
`ensemble` starts; `reporting`, `report` and `tables` say what came out, `picture` and `profile` draw it. `gotcha`
imports recorded data; `irf`, `psf` and `images` measure images. Read `simulate.run` first, then `conductor`.
"""
