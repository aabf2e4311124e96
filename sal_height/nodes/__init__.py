"""ROS 2 nodes: parameters → core call → publish. No signal processing in here.

`worker` is what all nodes have in common, `host` the one node of all stages; `accounts`, `transport`, `playing` and
`recording` have a docstring of their own.
"""
