"""The estimators of elevation by name.

`registry` lists them; `maximum_likelihood`, `capon` and `music` each join the steps of `array` and `layover`, and
`dwells` estimates several dwells at once.
"""
