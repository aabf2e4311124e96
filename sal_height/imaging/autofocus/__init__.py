"""Autofocus: read `gradient` first, then `coherence` and `phase_linking`, and `strip_phase` for stripmap.

`phase_error` selects the part of a phase that may be removed, `placement` locates the image then.
"""
