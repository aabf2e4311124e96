"""Numerics without physics, in addition to NumPy and SciPy, and the compilation of kernels.

Read `arrays` (types of arrays), `jit` (compilation of kernels) and `threads` (work in several threads, BLAS in one)
first, then `windows` (spectral weights), `transforms` (of many rows; exp(j phase)), `error_statistics` (of errors and
their predicted standard deviations), `bilinear` (interpolation on nodes), `range_profiles` (interpolation of
band-limited profiles), `vectors` (of three numbers, within compiled loops), `pickled` (objects for other processes),
`short_repr` (objects with arrays as text) and `drawing` (a look at an array).
Nothing here knows of sensors or images.
"""

from sal_height.numeric._kernels import cosine_and_sine, cosine_and_sine_of_part, tap_weights
from sal_height.numeric.arrays import C64, C128, F32, F64, I32, I64, U8, Bool, Complex, Index, vertex
from sal_height.numeric.bilinear import between_nodes, bilinear, node_before
from sal_height.numeric.drawing import draw_array
from sal_height.numeric.error_statistics import (
    MEDIAN_ERROR,
    ErrorStatistics,
    error_statistics,
    fraction_of,
    half_width,
    mean_of,
    root_mean_square,
)
from sal_height.numeric.jit import compiled, compiled_with_nan, inlined, squared
from sal_height.numeric.pickled import arrays_of, by_fields, joined_bytes
from sal_height.numeric.range_profiles import (
    OVERSAMPLING,
    TAPS,
    dense_profiles,
    kernel_transform,
    spectra_of_profiles,
    tap_polynomials,
)
from sal_height.numeric.short_repr import ShortRepr
from sal_height.numeric.threads import WORKERS, available_processors, in_parallel, in_threads, one_blas_thread
from sal_height.numeric.transforms import (
    LARGEST,
    CentredSums,
    ChirpZ,
    blocks,
    chirp_z,
    fast_length,
    frequencies,
    outer_phasors,
    rows_at_once,
    unit_phasors,
)
from sal_height.numeric.vectors import Vector, cross, dot, total, vector
from sal_height.numeric.windows import WINDOWS, broadening, main_lobe, noise_gain, taylor, window

__all__ = [
    "C64",
    "C128",
    "F32",
    "F64",
    "I32",
    "I64",
    "LARGEST",
    "MEDIAN_ERROR",
    "OVERSAMPLING",
    "TAPS",
    "U8",
    "WINDOWS",
    "WORKERS",
    "Bool",
    "CentredSums",
    "ChirpZ",
    "Complex",
    "ErrorStatistics",
    "Index",
    "ShortRepr",
    "Vector",
    "arrays_of",
    "available_processors",
    "between_nodes",
    "bilinear",
    "blocks",
    "broadening",
    "by_fields",
    "chirp_z",
    "compiled",
    "compiled_with_nan",
    "cosine_and_sine",
    "cosine_and_sine_of_part",
    "cross",
    "dense_profiles",
    "dot",
    "draw_array",
    "error_statistics",
    "fast_length",
    "fraction_of",
    "frequencies",
    "half_width",
    "in_parallel",
    "in_threads",
    "inlined",
    "joined_bytes",
    "kernel_transform",
    "main_lobe",
    "mean_of",
    "node_before",
    "noise_gain",
    "one_blas_thread",
    "outer_phasors",
    "root_mean_square",
    "rows_at_once",
    "spectra_of_profiles",
    "squared",
    "tap_polynomials",
    "tap_weights",
    "taylor",
    "total",
    "unit_phasors",
    "vector",
    "vertex",
    "window",
]
