"""imaging/autofocus."""
