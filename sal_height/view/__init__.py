"""Bags and live graphs in the Rerun viewer: what `sal-height view` does.

`drawings` says what can be drawn, and `painter` makes drawings of messages; neither knows the viewer. `screen` hands
drawings to the viewer and `layout` arranges its views; they alone import Rerun, which is an optional package, inside
their functions. Messages come from `recorded` (a bag) or from `listener` (the live graph). Read `show` first, which
joins them.
"""
