"""Dwells in, heights out, without ROS, without files and without a clock.

A `Stage` accepts what arrives, decides what is complete, late or hopeless, and makes jobs; it processes jobs into
products. A host decides when and where jobs are processed: `Chain` at once or on worker processes, the node host
(`nodes.host`) on a worker thread. Read stage.py first, then dwells.py, compression.py and heights.py.
"""
