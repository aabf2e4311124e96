"""Autofocus: read `gradient` first, then `phase_linking`; `phase_error` says which part of a phase may be removed."""
