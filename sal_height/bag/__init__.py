"""MCAP bags as rosbag2 makes them: write, read, check, cut, upgrade, recover and compare them.

`writer` and `reader` are the two ends; `qos` has the profiles, `files` the parts of a bag and their indexes, and
`described` its sensors and dwells. `info` and `check` report on a bag, `salvage` recovers the whole messages of a
damaged one, `copies` cuts and upgrades them, and `compare` compares the heights of two.
"""
