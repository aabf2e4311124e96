"""Output folders and the files in them; a refusal by the file system becomes one message."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from sal_height.errors import UserError


def check_new_folder(path: Path) -> None:
    """Check, without making anything, that `path` can become an output folder: it is new or empty, and may be written.

    Raises:
        UserError: it is not empty, is a file, or cannot be made.
    """
    try:
        if path.is_dir() and any(path.iterdir()):
            raise UserError(f"Output folder {path} is not empty; name another with --out, or remove it.")
        existing = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    except OSError as error:
        raise UserError(f"Output folder {path} cannot be made: {error.strerror}.") from error
    if not existing.is_dir():
        raise UserError(f"Output folder {path} cannot be made: {existing} is a file.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise UserError(f"Output folder {path} cannot be made: permission to write in {existing} is denied.")


def new_folder(path: Path) -> Path:
    """Make the output folder.

    Raises:
        UserError: it exists and is not empty, or cannot be made.
    """
    check_new_folder(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"Output folder {path} cannot be made: {error.strerror}.") from error
    return path


def free_folder(base: Path) -> Path:
    """`base`, or else the first of base_2, base_3, … that does not exist or is empty.

    Raises:
        UserError: a folder cannot be read.
    """
    names = (base if number == 1 else base.with_name(f"{base.name}_{number}") for number in itertools.count(1))
    try:
        return next(path for path in names if not path.exists() or (path.is_dir() and not any(path.iterdir())))
    except OSError as error:
        raise UserError(f"Output folder {base} cannot be made: {error.strerror}; name another with --out.") from error


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Context in which a refusal of the disk becomes a UserError that names the file."""
    try:
        yield
    except OSError as error:
        raise UserError(f"File {path} cannot be written: {error.strerror or error}.") from error


def write_text(path: Path, text: str) -> None:
    """Write a small file.

    Raises:
        UserError: it cannot be written.
    """
    with writing(path):
        path.write_text(text, encoding="utf-8")


@contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """Path to write a file to, which gets its name when the block ends; an older file stays until then.

    The suffix is that of `path`, by which libraries choose a format.

    Raises:
        UserError: it cannot be written.
    """
    beside = path.with_name(f".{path.stem}.part{path.suffix}")
    with writing(path):
        try:
            yield beside
            beside.replace(path)
        except BaseException:
            with suppress(OSError):
                beside.unlink()
            raise


@contextmanager
def writing_whole(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, which appears under its name when the block ends; an older file stays until then.

    Raises:
        UserError: it cannot be written.
    """
    with unfinished(path) as beside, beside.open("w+b") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())


def write_whole(path: Path, content: bytes | memoryview) -> None:
    """Write a file that appears under its name when it is complete; an older file stays until then.

    Raises:
        UserError: it cannot be written.
    """
    with writing_whole(path) as file:
        file.write(content)


def or_null(value: float) -> float | None:
    """The number, or None (JSON's null) where it is not finite, because JSON has neither NaN nor infinity."""
    return value if math.isfinite(value) else None


def bag_name(bag: Path) -> str:
    """Name of results made from a bag: that of its folder, or of the folder around one that is called just "bag"."""
    path = bag.resolve()
    folder = path.parent if path.suffix == ".mcap" and not path.is_dir() else path
    return folder.parent.name if folder.name == "bag" else folder.name
