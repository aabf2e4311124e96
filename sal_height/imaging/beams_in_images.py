"""Beams of the detectors as they appear in a focused stripmap image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sal_height.beams import Beams
from sal_height.imaging.weighting import Processing
from sal_height.sensor import Sensor, processed_angle

ASPECTS = 8  # directions, of the Gauss-Legendre rule, in which beams are averaged over the processed angle


def image_beams(sensor: Sensor, azimuth_window: str) -> Beams:
    """The beams in images: in spotlight those of the sensor, in stripmap their mean over a target's aspects.

    At its peak a target of a stripmap image has in every detector the mean of the pattern along its passage, weighted
    by the window (SAL paper, section 4). Where the pattern does not separate into one across and one along the flight,
    as that of a round aperture or with the detector axis turned, the ratios of detectors are not those of one
    direction.

    Scaled so that a detector looking straight at the target's elevation has the amplitude 1, as the CNRs of images
    refer to it. Beams that separate stay as they are.

    Speckled ground is not one target with these ratios: its detectors correlate as the mean of products of beams, which
    with the axis turned is not the product of means. About half of the error in elevation that averaging removes from
    points stays on ground.

    Args:
        sensor: sensor with the beams.
        azimuth_window: window over the processed angle, a name of `windows.WINDOWS`.

    Raises:
        UserError: there is no window of that name.
    """
    if sensor.mode == "spotlight":
        return sensor.beams
    processing = Processing(azimuth_window=azimuth_window, angle=processed_angle(sensor))
    nodes, weights = np.polynomial.legendre.leggauss(ASPECTS)
    aspects = processing.angle / 2 * nodes
    edge = np.full(ASPECTS, (1 - nodes[-1]) * processing.angle / 2)
    beams = sensor.beams.averaged(aspects, weights * processing.angle_weights(aspects, edge))
    along, across = aspects * math.sin(beams.rotation), aspects * math.cos(beams.rotation)
    passage = beams.patterns[0].amplitude(along / beams.beamwidth, across / beams.beamwidth_beside)
    return replace(beams, weights=beams.weights / float(np.abs(beams.weights @ passage)))
