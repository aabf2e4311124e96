"""MCAP bags as rosbag2 makes them: write, read, check, cut, upgrade, recover and compare them.

`writer` and `reader` are the two ends; `definitions` knows message types, `qos` the profiles and `files` the parts of
a bag; `index` reads the index of a file, `layout` finds its records without it. `info` and `check` report on a bag,
`salvage` recovers the whole messages of a damaged one, `cut` and `upgrade` make bags of bags, and `compare` compares
the heights of two. Bags in other storages are read by `other_storage`.
"""
