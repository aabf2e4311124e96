"""imaging/formers."""
