"""Movers over successive images of a strip.

The image of what drives along the flight is smeared over metres, so that each image is searched with those before and
after it. A mover is published once those images have been searched that show its azimuth ambiguities.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from sal_height.beams import Beams
from sal_height.imaging import Slc
from sal_height.movers.detection import MoverSettings, search_strip
from sal_height.movers.mover import Looked, StripMover, without_ambiguities
from sal_height.numeric import C128, ShortRepr
from sal_height.sensor import Sensor


@dataclass(frozen=True, eq=False)
class StripImage(ShortRepr):
    """An image of a strip in which movers are searched.

    Attributes:
        images: images of channels of independent noise of one power, shape (channels, rows, cols).
        slc: image from which these were made.
        beams: beams of the channels, in one direction.
        sensor: sensor of the image.
    """

    images: C128
    slc: Slc
    beams: Beams
    sensor: Sensor

    def follows(self, earlier: StripImage) -> bool:
        """True if this image joins an earlier one: its first column is the next one."""
        grid, before = self.slc.grid, earlier.slc.grid
        off = float(np.linalg.norm(grid.origin - before.points(0.0, float(before.cols))))
        same = self.images.shape[:2] == earlier.images.shape[:2]
        placed = self.slc.placement.beams_error == earlier.slc.placement.beams_error
        alike = same and placed and self.sensor.config_hash == earlier.sensor.config_hash
        return alike and off < 0.5 * grid.col_spacing


@dataclass(frozen=True, eq=False)
class _SearchedImage:
    """Result of the search in an image, and its movers with their images."""

    looked: Looked
    movers: Sequence[StripMover]


Of = TypeVar("Of")


class StripMovers(Generic[Of]):
    """Movers in successive images of a strip, in the order of arrival."""

    def __init__(self, settings: MoverSettings) -> None:
        """Search for movers with these settings."""
        self._settings = settings
        self._begin()

    def _begin(self) -> None:
        self._images: list[StripImage] = []
        self._found: list[_SearchedImage] = []
        self._published = 0
        self._of: deque[Of] = deque()

    @property
    def unpublished(self) -> int:
        """Number of images that have not been published yet."""
        return len(self._of)

    def add(self, image: StripImage, of: Of) -> list[tuple[Of, Looked | None]]:
        """Accept an image.

        Args:
            image: image; one that does not join that before starts a new strip.
            of: object that is returned with its result.

        Returns:
            Results of the images that are done, in their order.
        """
        done = [] if not self._images or image.follows(self._images[-1]) else self.end()
        self._images.append(image)
        self._of.append(of)
        if len(self._images) > 1:
            self._found.append(self._search(len(self._images) - 2))
        while len(self._found) - self._published > self._reach:
            done.append(self._publish())
        while self._published > self._reach:
            del self._images[0], self._found[0]
            self._published -= 1
        return done

    def end(self) -> list[tuple[Of, Looked | None]]:
        """Results of the remaining images in their order, after which no more follow."""
        self._found += [self._search(number) for number in range(len(self._found), len(self._images))]
        done = [self._publish() for _ in range(self._published, len(self._images))]
        self._begin()
        return done

    @property
    def _reach(self) -> int:
        """Number of images over which the azimuth ambiguities of a mover lie, with its smear."""
        image = self._images[-1]
        grid, aperture = image.slc.grid, image.slc.aperture
        period = image.sensor.wavelength * image.sensor.pulse_repetition_frequency / 2
        far = float(np.linalg.norm(grid.middle - aperture.position)) * period
        return min(8, int(np.ceil(1.3 * far / (np.linalg.norm(aperture.velocity) * grid.cols * grid.col_spacing))))

    def _search(self, number: int) -> _SearchedImage:
        """Search for movers in an image, with those before and after it."""
        group = self._images[max(0, number - 1) : number + 2]
        first = group[0].slc.grid.cols if number else 0
        columns = first, first + self._images[number].slc.grid.cols
        cols = sum(one.slc.grid.cols for one in group)
        slc = replace(self._images[number].slc, grid=replace(group[0].slc.grid, cols=cols))
        images = np.concatenate([one.images for one in group], axis=-1)
        middle = self._images[number]
        looked, movers = search_strip(images, middle.beams, slc, middle.sensor, self._settings, columns)
        return _SearchedImage(looked, movers)

    def _publish(self) -> tuple[Of, Looked | None]:
        """Result of the next image, without movers that are traces of brighter ones in other images."""
        number = self._published
        found = self._found[number]
        others = [one for other, each in enumerate(self._found) if other != number for one in each.movers]
        kept = [one for one in found.movers if not any(one.is_trace_of(other) for other in others)]
        self._published += 1
        self._found[number] = replace(found, movers=kept)
        return self._of.popleft(), replace(found.looked, movers=without_ambiguities(one.mover for one in kept))
