"""MCAP bags as rosbag2 makes them: write, read, salvage and compare them.

`writer` and `reader` are the two ends; `definitions` knows message types, `qos` the profiles and `files` what a bag
consists of. `salvage` recovers what is whole of a damaged bag, and `compare` compares the heights of two bags.
"""
