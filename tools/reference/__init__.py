"""Writes the reference pages of the documentation from the code: messages, topics, commands, presets, parameters.

Run it after a change to one of these: .venv/bin/python -m tools.reference
"""
