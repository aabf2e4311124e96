"""Arrays in files of other programs: NumPy, MATLAB, HDF5, GeoTIFF and SICD.

Packages for formats other than NumPy's own are imported when needed; those that are extras are named with the command
that installs them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.errors import UserError

HDF5 = (".h5", ".hdf5")
TIFF = (".tif", ".tiff")
NITF = (".nitf", ".ntf", ".sicd")
MATLAB = ".mat"

NAMED = (".npz", MATLAB, *HDF5)
"""Suffixes of files of arrays with names."""

IMAGES = (".npy", *NAMED, *TIFF, *NITF)
"""Suffixes of files that may contain complex images."""

COMPLEX_PARTS = ({"real", "imag"}, {"r", "i"})
"""Names of the parts of complex numbers in HDF5: of MATLAB, and of h5py and NISAR."""


def named_arrays(path: Path) -> dict[str, Any]:
    """The arrays of a .npz, .mat or HDF5 file by name; of HDF5, those outside of groups.

    Raises:
        UserError: it is another kind of file, or cannot be read.
    """
    if path.suffix.lower() not in NAMED:
        raise UserError(f"File {path} has the suffix {path.suffix!r}; arrays are read from {_listed(NAMED)}.")
    return dict(_read(path, _datasets_at_the_top))


def complex_images(path: Path) -> dict[str, Any]:
    """The complex arrays of a file of images by name; those that are not complex are left out.

    Of HDF5 these are the datasets of two or three dimensions in all groups, of GeoTIFF the bands.

    Raises:
        UserError: it is another kind of file, cannot be read, or has no complex array.
    """
    if path.suffix.lower() not in IMAGES:
        raise UserError(f"File {path} is not an image; images are read from {_listed(IMAGES)} and bags.")
    arrays = dict(_read(path, _complex_datasets))
    found = {name: array for name, array in arrays.items() if np.iscomplexobj(array)}
    if not found:
        there = ", ".join(f"{name or 'an array'} of {np.asarray(a).dtype}" for name, a in arrays.items()) or "nothing"
        raise UserError(f"File {path} has 0 complex arrays; it must have one (it contains: {there}).")
    return found


def _listed(suffixes: tuple[str, ...]) -> str:
    *others, last = suffixes
    return f"{', '.join(others)} and {last}"


def _read(path: Path, of_hdf5: Callable[[Any], Iterator[tuple[str, Any]]]) -> Iterator[tuple[str, Any]]:
    """Arrays of a file and their names.

    Raises:
        UserError: it cannot be read.
    """
    suffix = path.suffix.lower()
    reader: Callable[[Path], Iterator[tuple[str, Any]]]
    if suffix in {".npy", ".npz"}:
        reader = _numpy
    elif suffix == MATLAB:
        reader = _matlab
    elif suffix in TIFF:
        reader = _tiff
    elif suffix in NITF:
        reader = _sicd
    else:
        reader = lambda file: _hdf5(file, of_hdf5)  # noqa: E731
    try:
        yield from reader(path)
    except UserError:
        raise
    except ImportError as error:
        raise UserError(
            f"Reading {path} needs {error.name}; install it with: pip install 'sal_height[formats]'."
        ) from error
    except Exception as error:  # each library has its own for a damaged file
        if isinstance(error, OSError) and error.strerror:
            raise UserError(f"File {path} cannot be read: {error.strerror}.") from error
        said = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise UserError(f"File {path} is not a whole {suffix} file: {said}.") from error


def _numpy(path: Path) -> Iterator[tuple[str, Any]]:
    with path.open("rb") as stream:
        loaded = np.load(stream, allow_pickle=False)
        if isinstance(loaded, np.lib.npyio.NpzFile):
            yield from loaded.items()
        else:
            yield "", loaded


def _matlab(path: Path) -> Iterator[tuple[str, Any]]:
    from scipy.io import loadmat  # noqa: PLC0415 (0.1 s)

    try:
        yield from ((name, value) for name, value in loadmat(path).items() if not name.startswith("__"))
    except NotImplementedError:  # version 7.3 is HDF5, with axes in the order of Fortran
        yield from ((name, value.T) for name, value in _hdf5(path, _datasets_at_the_top))


def _hdf5(path: Path, chosen: Callable[[Any], Iterator[tuple[str, Any]]]) -> Iterator[tuple[str, Any]]:
    import h5py  # noqa: PLC0415 (an extra)

    with h5py.File(path) as file:
        for name, entry in chosen(file):
            yield name, _as_complex(entry[()])


def _datasets_at_the_top(file: Any) -> Iterator[tuple[str, Any]]:
    yield from ((name, entry) for name, entry in file.items() if hasattr(entry, "dtype"))


def _complex_datasets(file: Any) -> Iterator[tuple[str, Any]]:
    """Datasets of two or three dimensions and complex numbers, in any group."""
    found: list[tuple[str, Any]] = []

    def look(name: str, entry: Any) -> None:
        if getattr(entry, "ndim", 0) in {2, 3} and (entry.dtype.kind == "c" or _is_compound(entry.dtype)):
            found.append((name, entry))

    file.visititems(look)
    yield from found


def _is_compound(kind: Any) -> bool:
    return kind.names is not None and set(kind.names) in COMPLEX_PARTS


def _as_complex(values: Any) -> Any:
    """Complex numbers of a compound of their parts, of any precision; others as they are."""
    kind = getattr(values, "dtype", None)
    if kind is None or not _is_compound(kind):
        return values
    real, imaginary = kind.names
    made = np.empty(values.shape, np.complex128 if kind[real].itemsize > 4 else np.complex64)
    made.real, made.imag = values[real], values[imaginary]
    return made


def _tiff(path: Path) -> Iterator[tuple[str, Any]]:
    import rasterio  # noqa: PLC0415 (an extra)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)  # images need not be
        file = rasterio.open(path)
    with file:
        for band in range(1, file.count + 1):
            yield f"band {band}", file.read(band)


def _sicd(path: Path) -> Iterator[tuple[str, Any]]:
    from sarkit import sicd  # noqa: PLC0415 (an extra)

    reader_of: Any = sicd.NitfReader  # which has no types
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # metadata that are not needed here may be wrong
        reader = reader_of(file)
        pixels = reader.read_image()
        kind = reader.metadata.xmltree.findtext("{*}ImageData/{*}PixelType")
    if kind == "AMP8I_PHS8I":
        raise UserError(f"File {path} has pixels of the type {kind}; RE32F_IM32F and RE16I_IM16I are read.")
    yield "", _as_complex(pixels)
