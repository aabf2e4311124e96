"""The estimators of elevation by name.

`registry` lists them, and estimates several dwells at once; `maximum_likelihood` and `spectra` (Capon, MUSIC) each join
the steps of `array` and `layover`.
"""
