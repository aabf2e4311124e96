"""Common parts of images and heights: position, provenance and doubts, as items of the engine and as messages."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from sal_height.engine.height_items import Heights
from sal_height.engine.image_items import ChannelImage, Images, Place
from sal_height.engine.losses import Doubt, FitTest
from sal_height.engine.provenance import Provenance, Same
from sal_height.messages.basics import aperture_of, grid_from_message
from sal_height.messages.codec import deserialize, serialize
from sal_height.messages.parameters import named_values, shared_parameter
from sal_height.messages.types import Aperture as ApertureMessage
from sal_height.messages.types import Doubt as DoubtMessage
from sal_height.messages.types import FitTest as FitTestMessage
from sal_height.messages.types import ImageGrid
from sal_height.messages.types import Provenance as ProvenanceMessage


@lru_cache(8)  # the images of a dwell share theirs
def _place_of(grid: bytes, aperture: bytes) -> Place:
    """Grid and aperture from their serialized messages."""
    return Place(grid_from_message(deserialize(grid, ImageGrid)), aperture_of(deserialize(aperture, ApertureMessage)))


def place_of(message: Any) -> Place:
    """Grid and aperture of an image; those of equal numbers are the same object.

    Raises:
        Rejected: the covariance of the pose has neither 36 entries nor none.
    """
    return _place_of(serialize(message.grid), serialize(message.aperture))


@lru_cache(16)
def _provenance_of(shared: Same[Any]) -> Provenance:
    message = shared.one
    return Provenance(
        message.code_version,
        message.config_hash,
        message.calibration_id,
        {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in named_values(message.parameters)
            if value is not None
        },
        np.array(message.autofocus_phase, np.float32),
    )


def provenance_of(message: Any) -> Provenance:
    """A provenance; that of the same message is the same object.

    Raises:
        Rejected: a value is of a type that ROS parameters do not have.
    """
    return _provenance_of(Same(message))


@lru_cache(16)
def _provenance_message(shared: Same[Provenance]) -> Any:
    one = shared.one
    return ProvenanceMessage(
        code_version=one.code_version,
        config_hash=one.config_hash,
        calibration_id=one.calibration_id,
        parameters=[shared_parameter(name, value) for name, value in one.parameters.items()],
        autofocus_phase=one.autofocus_phase,
    )


def provenance_to_message(provenance: Provenance) -> Any:
    """The message of a provenance; that of the same object is the same object."""
    return _provenance_message(Same(provenance))


def doubts_of(message: Any) -> dict[str, Any]:
    """Order, doubts and fit of a product, as attributes of its item."""
    return {
        "order": message.order,
        "doubts": tuple(
            Doubt(one.name, one.sentence, one.channel, one.size, one.unit, one.p_value) for one in message.doubts
        ),
        "fit": tuple(
            FitTest(one.name, one.channel, one.statistic, one.p_value, one.size, one.sigma, one.unit)
            for one in message.fit
        ),
    }


def doubt_fields(item: Images | ChannelImage | Heights) -> dict[str, Any]:
    """Order, doubts and fit of an item, as fields of its message."""
    return {
        "order": item.order,
        "doubts": [DoubtMessage(**one._asdict()) for one in item.doubts],
        "fit": [FitTestMessage(**one._asdict()) for one in item.fit],
    }
