"""Movers in images, which are passed to package `movers` as channels of independent noise, with their beams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sal_height.beams import Beams
from sal_height.calibration import Calibration
from sal_height.elevation import ESTIMATORS
from sal_height.errors import Rejected, UserError
from sal_height.imaging import Slc
from sal_height.movers import (
    DwellImage,
    Looked,
    MoverSettings,
    ShownDwell,
    StripImage,
    check_sensor,
    search_strip,
)
from sal_height.numeric import C128, one_blas_thread
from sal_height.pipeline.channels import channels_and_beams, live_channels
from sal_height.sensor import Sensor


@one_blas_thread()
def movers(slc: Slc, sensor: Sensor, settings: MoverSettings, calibration: Calibration | None = None) -> Looked:
    """Movers in an image of a strip, with position, height and radial velocity.

    What drives along the flight is smeared beyond one image: `movers.StripMovers` finds it in successive ones.

    Args:
        slc: images of all channels.
        sensor: sensor of the images.
        settings: settings of the search.
        calibration: calibration of the images; None: the beams are as the sensor describes them.

    Raises:
        Rejected: too few channels have a signal, too many samples are clipped, or the image has too few columns.
        UserError: the sensor is in spotlight (`dwell_with_movers`) or cannot detect movers (`movers.check_sensor`), or
            noise powers are not known.
    """
    if sensor.mode != "stripmap":
        raise UserError(
            f"Sensor {sensor.name} is of mode {sensor.mode}; one image shows movers in stripmap only, where the beam "
            "passes them. In spotlight the dwells before and after show them (pipeline.dwell_with_movers)."
        )
    images, beams = _images_for_movers(slc, sensor, settings, calibration)
    return search_strip(images, beams, slc, sensor, settings, (0, images.shape[-1]))[0]


@one_blas_thread()
def strip_with_movers(
    slc: Slc, sensor: Sensor, settings: MoverSettings, calibration: Calibration | None = None
) -> StripImage:
    """An image of a strip for `movers.StripMovers`, which finds movers with the images before and after.

    Args:
        slc: images of all channels.
        sensor: sensor of the images.
        settings: settings of the search.
        calibration: calibration as of `movers`.

    Raises:
        Rejected: as `movers`.
        UserError: as `movers`.
    """
    images, beams = _images_for_movers(slc, sensor, settings, calibration)
    return StripImage(images, slc, beams, sensor)


@one_blas_thread()
def dwell_with_movers(
    slc: Slc, seconds: float, sensor: Sensor, settings: MoverSettings, calibration: Calibration | None = None
) -> ShownDwell:
    """A spotlight dwell for `movers.DwellMovers`, which finds movers over consecutive dwells.

    Args:
        slc: images of all channels, of all Doppler frequencies.
        seconds: time of the dwell, s.
        sensor: sensor of the images.
        settings: settings of the search.
        calibration: calibration as of `movers`.

    Raises:
        Rejected: as `movers`; or the images do not have all Doppler frequencies.
        UserError: as `movers`.
    """
    images, beams = _images_for_movers(slc, sensor, settings, calibration)
    return ShownDwell(DwellImage.of(images, slc, seconds, sensor), slc, beams, sensor)


def _images_for_movers(
    slc: Slc, sensor: Sensor, settings: MoverSettings, calibration: Calibration | None
) -> tuple[C128, Beams]:
    """Images of channels of independent noise of one power, and their beams in one direction."""
    check_sensor(sensor)
    live = live_channels(slc.images, sensor)
    if (clipped := float(slc.saturated_share[live].max())) > settings.max_saturated_fraction:
        raise Rejected(
            "saturated",
            f"A channel has {clipped:.2g} of its samples clipped, which spoils elevations; "
            f"max_saturated_fraction allows {settings.max_saturated_fraction:g}.",
        )
    channels, beams = channels_and_beams(slc, sensor, ESTIMATORS["ml"], calibration, live)
    images = np.tensordot(channels.transform, slc.images[live], 1)
    # In one direction at a time, not averaged over those that an image is made from.
    return images, replace(beams, aspects=np.zeros(1), weights=np.ones(1))
