"""Single-look complex images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sal_height_msgs import msg as messages
from std_msgs.msg import Header

from sal_height.errors import Rejected
from sal_height.geometry import ApertureState, Grid
from sal_height.imaging import Slc
from sal_height.messages.basics import (
    MAP_FRAME,
    aperture_from_message,
    aperture_to_message,
    check_detector,
    check_geometry,
    complex_view,
    grid_from_message,
    grid_to_message,
    to_floats,
)
from sal_height.numeric import C64, F64
from sal_height.sensor import Sensor


def slc_to_messages(
    slc: Slc, saturated_shares: F64, frame: messages.DetectorFrame, provenance: messages.Provenance
) -> list[messages.ComplexImage]:
    """One ComplexImage per detector, with the stamp and dwell of `frame`; shares as of `saturation`."""
    return [
        messages.ComplexImage(
            header=Header(stamp=frame.header.stamp, frame_id=MAP_FRAME),
            dwell=frame.dwell,
            detector=detector,
            grid=grid_to_message(slc.grid),
            aperture=aperture_to_message(slc.aperture),
            noise_power=slc.noise_power[detector],
            saturated_share=float(saturated_shares[detector]),
            samples=to_floats(image),
            provenance=provenance,
        )
        for detector, image in enumerate(slc.images)
    ]


def check_slc(image: messages.ComplexImage, sensor: Sensor) -> None:
    """Make sure an image can be processed with `sensor`.

    Raises:
        Rejected: it cannot; the sentence names the field, the value and what is allowed.
    """
    where = f"ComplexImage of dwell {image.dwell}, detector {image.detector}"
    check_detector(image.detector, sensor, where)
    count = 2 * image.grid.rows * image.grid.cols
    if len(image.samples) != count or count == 0:
        raise Rejected(
            "wrong size",
            f"{where}: samples has {len(image.samples)} entries, {image.grid.rows} x {image.grid.cols} complex "
            f"pixels need {count}.",
        )
    if not np.all(np.isfinite([image.noise_power, image.saturated_share])):
        raise Rejected(
            "not finite", f"{where}: noise_power or saturated_share is NaN or infinite; both must be finite."
        )
    check_geometry(image.grid, image.aperture, where)


def slc_from_messages(images: Sequence[messages.ComplexImage]) -> tuple[C64, Grid, ApertureState, F64]:
    """Images (detectors, rows, cols), grid, aperture and noise powers of the checked images of all detectors.

    Raises:
        Rejected: the detectors disagree on grid or aperture.
    """
    first = images[0]
    for image in images[1:]:
        if image.grid != first.grid or image.aperture != first.aperture:
            raise Rejected(
                "detectors disagree",
                f"Dwell {first.dwell}: detector {image.detector} has another grid or aperture than detector "
                f"{first.detector}; all must share them.",
            )
    grid = grid_from_message(first.grid)
    slc = np.stack([complex_view(image.samples, grid.shape) for image in images])
    return slc, grid, aperture_from_message(first.aperture), np.array([image.noise_power for image in images])
