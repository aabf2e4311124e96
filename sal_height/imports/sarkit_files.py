"""Common functions for files of the standards CPHD (NGA.STND.0068) and CRSD (NGA.STND.0080), read by sarkit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from sal_height.errors import UserError
from sal_height.extras import import_extra
from sal_height.geometry import Origin
from sal_height.numeric import C64, Bool


@contextmanager
def opened(path: Path, kind: str) -> Iterator[Any]:
    """The reader of sarkit for a file.

    Args:
        path: file to open.
        kind: kind of the file, "cphd" or "crsd".

    Raises:
        UserError: the package sarkit, which is an extra, is not installed, or the file is damaged.
    """
    reader = import_extra(f"sarkit.{kind}", f"Reading {path}").Reader
    try:
        with path.open("rb") as file, reader(file) as opened_file:
            yield opened_file
    except UserError:
        raise
    except Exception as error:  # lxml, numpy and sarkit each have their own for a damaged file
        said = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise UserError(f"File {path} is not a readable {kind.upper()} file: {said}.") from error


def first_word(path: Path) -> tuple[str, str]:
    """The kind and the version of a file, from its first line.

    Raises:
        UserError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            line = file.readline(64)
    except OSError as error:
        raise UserError(f"File {path} cannot be read: {error.strerror}.") from error
    kind, _, version = line.strip().decode("ascii", "replace").partition("/")
    return kind, version


def check_single(path: Path, tree: Any, element: str) -> None:
    """Check that a file describes one collection.

    Raises:
        UserError: the element that describes it is missing or repeated.
    """
    if (count := len(tree.findall(f"{{*}}{element}"))) != 1:
        raise UserError(f"File {path} describes {count} collections ({element}); files of one collection are read.")


def check_plain(path: Path, kind: str | None, compression: str | None) -> None:
    """Check that a collection is of one platform, and its samples without compression.

    Args:
        path: path of the file.
        kind: type of the collection in the file.
        compression: name of the compression in the file; None: without.

    Raises:
        UserError: they are not.
    """
    if kind != "MONOSTATIC":
        raise UserError(f"File {path} is of the type {kind}; collections of one platform (MONOSTATIC) are read.")
    if compression is not None:
        raise UserError(f"File {path} has compressed samples ({compression}); samples without compression are read.")


def chosen_channel(path: Path, there: Sequence[str], reference: str | None, wanted: str) -> str:
    """The identifier of the channel to read: the requested one, else the reference channel.

    Raises:
        UserError: no channel has that name.
    """
    chosen = wanted or reference or (there[0] if there else "")
    if chosen not in there:
        raise UserError(f"File {path} has no channel {chosen!r}; there are {', '.join(there) or 'none'}.")
    return chosen


def origin_of(path: Path, tree: Any) -> Origin:
    """The image area reference point, which the map's origin becomes.

    Raises:
        UserError: it is missing.
    """
    place = [tree.findtext(f"{{*}}SceneCoordinates/{{*}}IARP/{{*}}LLH/{{*}}{name}") for name in ("Lat", "Lon", "HAE")]
    try:
        latitude, longitude, height = (float(number) for number in place)
    except (TypeError, ValueError) as error:
        raise UserError(f"File {path} has no image area reference point (SceneCoordinates/IARP/LLH).") from error
    return Origin(math.radians(latitude), math.radians(longitude), height)


def time_ns(path: Path, tree: Any, *names: str) -> int:
    """A time in the metadata, ns since 1970.

    Args:
        path: path of the file.
        tree: metadata of the file.
        names: names of the elements from the root to the time.

    Raises:
        UserError: it is missing or no time.
    """
    text = tree.findtext("/".join(f"{{*}}{name}" for name in names)) or ""
    try:
        begin = datetime.fromisoformat(text)
    except ValueError as error:
        raise UserError(f"File {path} has {text!r} for {names[-1]}, which is no time.") from error
    return since_1970_ns(begin)


def since_1970_ns(time: datetime) -> int:
    """Nanoseconds from 1970 to a time, which is UTC if it names no zone."""
    since = (time if time.tzinfo else time.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000


def positive_number(path: Path, parent: Any, name: str) -> float:
    """A number greater than 0 in the metadata, read by `number_in`.

    Raises:
        UserError: it is missing, no number, not finite or not greater than 0.
    """
    number = number_in(path, parent, name)
    if number <= 0:
        raise UserError(f"File {path} has {number:g} for {name}; it must be greater than 0.")
    return number


def number_in(path: Path, parent: Any, name: str) -> float:
    """A number in the metadata.

    Args:
        path: path of the file.
        parent: parent of the element.
        name: name of the element.

    Raises:
        UserError: it is missing, no number or not finite.
    """
    text = parent.findtext(f"{{*}}{name}")
    try:
        number = float(text)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise UserError(f"File {path} has {text!r} for {name}; it must be a finite number.")
    return number


def check_parameters(path: Path, parameters: Any, needed: Sequence[str], block: str) -> None:
    """Check that the parameters of all pulses are there and finite.

    Args:
        path: path of the file.
        parameters: structured array with an entry for each pulse.
        needed: names of the parameters.
        block: short name of the array in the standard.

    Raises:
        UserError: a parameter is missing or not finite.
    """
    if missing := [name for name in needed if name not in parameters.dtype.names]:
        raise UserError(f"File {path} lacks {', '.join(missing)} among the parameters of its pulses ({block}).")
    for name in needed:
        values = parameters[name]
        parts = [values[part] for part in values.dtype.names] if values.dtype.names else [values]
        if not all(np.all(np.isfinite(part)) for part in parts):
            raise UserError(
                f"File {path} has values of {name} among the parameters of its pulses ({block}) that are not finite; "
                "all must be finite numbers."
            )


def has_signal(parameters: Any) -> Bool:
    """True for pulses that have a signal, shape (pulses,); all of them if the parameter SIGNAL is absent."""
    if "SIGNAL" not in parameters.dtype.names:
        return np.ones(len(parameters), np.bool_)
    return np.asarray(parameters["SIGNAL"] > 0)


def scaled_samples(path: Path, samples: Any, parameters: Any) -> C64:
    """Samples of pulses as complex64, times the amplitude factor of each pulse (AmpSF) if there is one.

    Args:
        path: path of the file.
        samples: samples from sarkit, big-endian, complex or pairs of whole numbers, shape (pulses, samples); complex
            ones are swapped in place.
        parameters: parameters of the pulses.

    Raises:
        UserError: samples are NaN or infinite, which those in little-endian order look like, too.
    """
    if samples.dtype.names:
        scaled = np.empty(samples.shape, np.complex64)
        scaled.real, scaled.imag = samples["real"], samples["imag"]
    elif samples.dtype == np.dtype(">c8"):
        scaled = samples.view(">u4").byteswap(inplace=True).view("<c8")
    else:
        scaled = samples.astype(np.complex64)
    if "AmpSF" in parameters.dtype.names and np.any(parameters["AmpSF"] != 1):
        scaled *= parameters["AmpSF"].astype(np.float32)[:, None]
    with np.errstate(over="ignore", invalid="ignore"):  # a finite sum of squares, which is quick, has finite samples
        finite = np.isfinite(np.vdot(scaled, scaled)) or np.all(np.isfinite(scaled))
    if not finite:
        raise UserError(
            f"File {path} has samples that are NaN or infinite; all must be finite, and stored in big-endian order."
        )
    return scaled
