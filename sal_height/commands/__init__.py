"""The command line `sal-height`: one module per command, each with an `app` that this package finds by itself.

Read `_program` first (finding the commands, exit statuses, one message for every error), then `_options` (options
common to several commands), then any command. Command modules import NumPy, ROS and the core only when they run, so
that help appears at once.
"""

from sal_height.commands._program import main

__all__ = ["main"]
