"""Whole runs, and the measurement of images: what the commands of sal-height do.

`truth` simulates flights, which `graph.lockstep` carries out with nodes, and compares their heights with the truth;
`live` runs nodes with a sensor that does not wait. `chain` processes bags by calls; `replay` replays them, `campaign`
processes many, and `products` makes what a whole bag gives. `responses` measures images. Read `truth.simulate` first,
then `chain.chain_runs`.
"""
