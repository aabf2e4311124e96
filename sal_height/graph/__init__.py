"""Graphs of nodes: which there are, what processes they run in, in lockstep or live, and what their accounts state.

`catalogue` has all nodes with their parameters, `plan` is what a run does, `ensemble` starts its nodes and `lockstep`
runs them step by step; `conductor` starts a live graph, `watch` reads its accounts, and `supervisor` starts again what
has ended. `reporting`, `tables` and `picture` are what reports, tables and pictures of all commands have in common.
"""
