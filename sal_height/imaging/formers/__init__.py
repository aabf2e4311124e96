"""Image formers: `choice` lists them, `backprojection` is the reference, `specan` and `range_doppler` are fast."""
