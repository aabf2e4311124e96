"""Bags and live graphs in the Rerun viewer: what `sal-height view` does.

`drawings` says what can be drawn, and in which colours, and `painter` makes drawings of messages; neither knows the
viewer. `screen` hands drawings to the viewer and arranges its views; it alone imports Rerun, which is an optional
package, inside its functions. `show` reads the messages of a bag, `listener` those of a live graph. Read `show` first,
which joins them.
"""
