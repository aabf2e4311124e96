"""Common parts of images and heights: position, provenance and doubts, as items of the engine and as messages."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from sal_height.engine.geometry_items import Aperture
from sal_height.engine.height_items import Heights
from sal_height.engine.image_items import ChannelImage, Images, Place
from sal_height.engine.losses import Doubt, FitTest
from sal_height.engine.provenance import Provenance, Same
from sal_height.errors import Rejected, UserError
from sal_height.geometry import Grid
from sal_height.messages.basics import numbers_of
from sal_height.messages.parameters import shared_parameter, value_of
from sal_height.messages.types import Doubt as DoubtMessage
from sal_height.messages.types import FitTest as FitTestMessage
from sal_height.messages.types import Provenance as ProvenanceMessage


@lru_cache(8)  # the images of a dwell share theirs
def _place_of(grid: tuple[float, ...], aperture: tuple[float, ...], covariance: bytes) -> Place:
    """Grid and aperture from their numbers."""
    origin, row, col = np.array(grid[:3]), np.array(grid[3:6]), np.array(grid[6:9])
    found = Grid(origin, row, col, grid[9], grid[10], int(grid[11]), int(grid[12]))
    position, orientation, velocity = np.array(aperture[:3]), aperture[3:7], np.array(aperture[7:10])
    matrix = np.frombuffer(covariance).reshape(6, 6) if covariance else np.zeros((6, 6))
    seen = Aperture(position, orientation, velocity, aperture[10], matrix, bool(aperture[11]))  # type: ignore[arg-type]
    return Place(found, seen)


def place_of(message: Any) -> Place:
    """Grid and aperture of an image; those of equal numbers are the same object.

    Raises:
        Rejected: the covariance of the pose has neither 36 entries nor none.
    """
    grid, aperture, pose = message.grid, message.aperture, message.aperture.pose
    if len(aperture.pose_covariance) not in {0, 36}:
        raise Rejected(
            "wrong size",
            f"aperture.pose_covariance has {len(aperture.pose_covariance)} entries; it must have 36, or none if it is "
            "not known.",
        )
    numbers = (
        *numbers_of(grid.origin),
        *numbers_of(grid.row_direction),
        *numbers_of(grid.col_direction),
        grid.row_spacing,
        grid.col_spacing,
        grid.rows,
        grid.cols,
    )
    seen = (
        *numbers_of(pose.position),
        pose.orientation.x,
        pose.orientation.y,
        pose.orientation.z,
        pose.orientation.w,
        *numbers_of(aperture.velocity),
        aperture.length,
        aperture.sliding,
    )
    return _place_of(numbers, seen, aperture.pose_covariance.tobytes())


@lru_cache(16)
def _provenance_of(shared: Same[Any]) -> Provenance:
    message = shared.one
    return Provenance(
        message.code_version,
        message.config_hash,
        message.calibration_id,
        dict(_parameters_of(message)),
        np.array(message.autofocus_phase, np.float32),
    )


def _parameters_of(message: Any) -> Iterator[tuple[str, Any]]:
    for one in message.parameters:
        try:
            value = value_of(one.value)
        except UserError as error:
            raise Rejected(
                "wrong provenance",
                f"Provenance.parameters has {one.name!r} of type {one.value.type}; 0 to 9 are allowed.",
            ) from error
        if value is not None:
            yield one.name, tuple(value) if isinstance(value, list) else value


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
