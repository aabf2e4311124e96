"""Autofocus: read `gradient` first, then `coherence` and `phase_linking`, and `strip_phase` for stripmap.

`phase_error` says which part of a phase may be removed, `placement` where the image then lies.
"""
