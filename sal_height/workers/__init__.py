"""Worker processes: how they start and end, what they are sent, and a pool of them for the stages of a live graph.

Read `pool` first: the host of the nodes has it process jobs, which `serving` does in each worker. `transfer` says how
objects and arrays get to workers and back, `arena` where arrays are that all share, `processes` how a process goes on
with the memory of another.
"""
