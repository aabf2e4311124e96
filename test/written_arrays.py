"""Files of named arrays as other programs write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np


def write_mat73(path: Path, **arrays: Any) -> None:
    """As MATLAB writes version 7.3: HDF5 with axes in reverse, complex numbers as a compound of real and imag."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in arrays.items():
            flipped = np.asarray(values).T
            if np.iscomplexobj(flipped):
                kind = np.dtype([("real", "<f4"), ("imag", "<f4")])
                file[name] = np.ascontiguousarray(flipped)[..., None].view(kind)[..., 0]
            else:
                file[name] = np.atleast_2d(flipped)
    header = b"MATLAB 7.3 MAT-file, as by a test".ljust(124) + b"\x00\x02IM"
    with path.open("r+b") as raw:
        raw.write(header)


def write_hdf5(path: Path, **arrays: Any) -> None:
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
