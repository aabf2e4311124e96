"""Compare height images value for value, as the check that a replay did what the recorded run had done."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from sal_height_msgs.msg import HeightImage

from sal_height.bag.reader import BagReader

HEIGHT_IMAGE = "sal_height_msgs/msg/HeightImage"

NUMBERS = {"order_probability": 5, "covariance": 6, "common_covariance": 6}
"""Fields with several numbers per pixel, and how many: for each order, and of the upper triangle of a covariance."""

# Height images by topic: a bag, or messages at hand.
Heights: TypeAlias = Path | Mapping[str, Iterable[HeightImage]]

# Topic, dwell, and how many images of that dwell came before on the topic (a simulator may have been restarted).
_Key: TypeAlias = tuple[str, int, int]


@dataclass(frozen=True)
class HeightComparison:
    """What one topic of a replay has in common with the recorded one.

    Attributes:
        matched: number of dwells with an image on both sides.
        missing: number of those with a recorded image only.
        extra: number of those with a replayed image only.
        grids_different: matched images whose grid or looks differ in any way.
        grid_change: how the first of these differs, in words.
        pixels: pixels of the matched images.
        pixels_different: those where any array differs (NaN equals NaN); all pixels of an image that has another number
            of rows or columns, or arrays of another length.
        greatest_height_difference: of the first surface, over the pixels that have a height on both sides, m; None:
            there are none.
    """

    matched: int = 0
    missing: int = 0
    extra: int = 0
    grids_different: int = 0
    grid_change: str = ""
    pixels: int = 0
    pixels_different: int = 0
    greatest_height_difference: float | None = None

    @property
    def equal(self) -> bool:
        """Whether there are images, and all of them are the same on both sides."""
        return self.matched > 0 and not (self.missing or self.extra or self.grids_different or self.pixels_different)


def compare_heights(recorded: Heights, replayed: Heights, tolerance_m: float = 0.0) -> dict[str, HeightComparison]:
    """Match images by topic and dwell and compare every decoded value; one result per topic of either side.

    Provenance and stamps are not compared, nor bytes: equal messages differ in their padding. All images are missing
    from a side that has none. UserError if a bag cannot be read.

    With a tolerance_m above 0 a pixel is taken for equal if its validity is the same and no height differs by more: its
    other values (sigma, position, CNR) follow from the height. Numbers of the grids may differ by as much.
    """
    total: dict[str, HeightComparison] = {}
    waiting: tuple[dict[_Key, HeightImage], dict[_Key, HeightImage]] = ({}, {})
    # Both sides advance together, so that only images without a counterpart yet are held in memory.
    for pair in itertools.zip_longest(_images(recorded), _images(replayed)):
        for side, entry in enumerate(pair):
            if entry is not None:
                key, image = entry
                waiting[side][key] = image
                if key in waiting[1 - side]:
                    result = _compare(waiting[0].pop(key), waiting[1].pop(key), tolerance_m)
                    total[key[0]] = _add(total.get(key[0]), result)
    for topic, _, _ in waiting[0]:
        total[topic] = _add(total.get(topic), HeightComparison(missing=1))
    for topic, _, _ in waiting[1]:
        total[topic] = _add(total.get(topic), HeightComparison(extra=1))
    return total


def _images(source: Heights) -> Iterator[tuple[_Key, HeightImage]]:
    seen: Counter[tuple[str, int]] = Counter()
    for topic, image in _read(source) if isinstance(source, Path) else _unfold(source):
        yield (topic, image.dwell, seen[topic, image.dwell]), image
        seen[topic, image.dwell] += 1


def _read(path: Path) -> Iterator[tuple[str, HeightImage]]:
    bag = BagReader(path)
    topics = [topic.name for topic in bag.topics.values() if topic.type_name == HEIGHT_IMAGE and topic.count]
    for message in bag.messages(topics) if topics else ():
        yield message.topic, bag.decode(HEIGHT_IMAGE, message.cdr)


def _unfold(images: Mapping[str, Iterable[HeightImage]]) -> Iterator[tuple[str, HeightImage]]:
    return ((topic, image) for topic, sequence in images.items() for image in sequence)


def _compare(recorded: HeightImage, replayed: HeightImage, tolerance_m: float) -> HeightComparison:
    ours, theirs = _arrays(recorded), _arrays(replayed)
    # A well-formed image has rows * cols entries in every array that it has; of others the longest array counts.
    sizes = {values.size for side in (ours, theirs) for values in side.values()}
    pixels = max(sizes, default=0)
    if len(sizes) != 1 or ours.keys() != theirs.keys() or _shape(recorded) != _shape(replayed):
        different, greatest = pixels, None
    else:
        heights = {name for name in ours if name.endswith(".height")}
        compared = {name for name in ours if not tolerance_m or name == "validity"} | heights
        allowed = {name: tolerance_m if name in heights else 0.0 for name in compared}
        differences = [_differs(ours[name], theirs[name], allowed[name]) for name in compared]
        different = int(np.count_nonzero(np.any(differences, axis=0)))
        first = "surfaces[0].height"
        greatest = _greatest_difference(ours[first], theirs[first]) if first in heights else None
    change = _grid_change(recorded, replayed, tolerance_m)
    return HeightComparison(
        matched=1,
        grids_different=int(bool(change)),
        grid_change=change,
        pixels=pixels,
        pixels_different=different,
        greatest_height_difference=greatest,
    )


def _grid_change(recorded: HeightImage, replayed: HeightImage, tolerance_m: float) -> str:
    """How the replayed grid differs from the recorded one, in words; empty if it does not."""
    changes = [
        f"{ours[0]} x {ours[1]} {what} instead of {theirs[0]} x {theirs[1]}"
        for what, ours, theirs in (
            ("pixels", _shape(replayed), _shape(recorded)),
            ("looks", _looks(replayed), _looks(recorded)),
        )
        if ours != theirs
    ]
    if not changes and np.any(np.abs(_numbers(recorded.grid) - _numbers(replayed.grid)) > tolerance_m):
        changes = ["pixels at other places"]
    return ", ".join(changes)


def _shape(image: HeightImage) -> tuple[int, int]:
    return image.grid.rows, image.grid.cols


def _looks(image: HeightImage) -> tuple[int, int]:
    return image.range_looks, image.azimuth_looks


def _arrays(image: HeightImage) -> dict[str, NDArray[np.generic]]:
    """Every array of the message that has a number per pixel, by name; only those that are not empty."""
    fields = {"validity": image.validity, "order_probability": image.order_probability}
    for number, surface in enumerate(image.surfaces):
        names = surface.get_fields_and_field_types()
        fields |= {f"surfaces[{number}].{name}": getattr(surface, name) for name in names}
    return {name: values for field, numbers in fields.items() for name, values in _layers(field, np.asarray(numbers))}


def _layers(field: str, numbers: NDArray[np.generic]) -> Iterator[tuple[str, NDArray[np.generic]]]:
    """The arrays with a number per pixel that a field has in turn; none if it is empty."""
    each = NUMBERS.get(field.rpartition(".")[2], 1)
    for index in range(each if numbers.size else 0):
        yield f"{field}[{index}]" if each > 1 else field, numbers[index::each]


def _numbers(value: Any) -> NDArray[np.float64]:
    """All numbers in a message, one after the other."""
    if not hasattr(value, "get_fields_and_field_types"):
        return np.array([value], dtype=np.float64)
    return np.concatenate([_numbers(getattr(value, name)) for name in value.get_fields_and_field_types()])


def _differs(ours: NDArray[Any], theirs: NDArray[Any], tolerance: float) -> NDArray[np.bool_]:
    both_nan = np.isnan(ours) & np.isnan(theirs)
    near = np.abs(ours.astype(np.float64) - theirs.astype(np.float64)) <= tolerance
    differs: NDArray[np.bool_] = ~((ours == theirs) | near | both_nan)
    return differs


def _greatest_difference(ours: NDArray[np.generic], theirs: NDArray[np.generic]) -> float | None:
    difference = np.abs(ours.astype(np.float64) - theirs.astype(np.float64))
    return float(np.nanmax(difference)) if np.any(np.isfinite(difference)) else None


def _add(one: HeightComparison | None, other: HeightComparison) -> HeightComparison:
    if one is None:
        return other
    known = [d for d in (one.greatest_height_difference, other.greatest_height_difference) if d is not None]
    return HeightComparison(
        matched=one.matched + other.matched,
        missing=one.missing + other.missing,
        extra=one.extra + other.extra,
        grids_different=one.grids_different + other.grids_different,
        grid_change=one.grid_change or other.grid_change,
        pixels=one.pixels + other.pixels,
        pixels_different=one.pixels_different + other.pixels_different,
        greatest_height_difference=max(known, default=None),
    )
