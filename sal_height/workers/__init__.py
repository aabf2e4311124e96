"""Worker processes: how they start and end, what they are sent, and a pool of them for the stages of a live graph.

Read `serving` first, the loop of a worker; `sending` is the other end: batches of jobs, and their results. Which batch
is next is decided by `pool` for the nodes of a live graph, and by `runs.chain.side_by_side` for bags. `keeper` starts
the workers. `transfer` says how objects and arrays get to workers and back, `arena` where arrays are that all share,
`processes` how a process goes on with the memory of another.
"""
