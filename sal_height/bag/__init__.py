"""MCAP bags as rosbag2 makes them: write, read, check, cut, upgrade, recover and compare them.

`writer` and `reader` are the two ends; `definitions` knows message types, `qos` the profiles and `files` what a bag
consists of; `index` reads what a file tells of itself, `layout` finds its records without. `info` and `check` look at a
bag, `salvage` recovers what is whole of a damaged one, `cut` and `upgrade` make bags of bags, and `compare` compares
the heights of two. Bags in other storages are read by `other_storage`.
"""
