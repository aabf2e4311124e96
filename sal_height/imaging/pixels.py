"""Pixel grids of SAR images, their noise power, the windows of their spectra, and the beams as strips contain them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sal_height.beams import Beams
from sal_height.errors import UserError
from sal_height.geometry import ApertureState, Grid, look_direction
from sal_height.numeric import F32, F64, main_lobe, noise_gain, window
from sal_height.sensor import Sensor, processed_angle

MAX_PIXELS = 2**24  # of an image: 128 MB per channel as complex64

TAPER_NODES = 1025  # of the tabulated azimuth window, which is interpolated linearly between them

ASPECTS = 8  # directions, of the Gauss-Legendre rule, in which beams are averaged over the processed angle


def azimuth_resolution(sensor: Sensor, aperture: ApertureState, slant_range: float) -> float:
    """Wavelength * range / (2 * synthetic aperture length), m: also the spacing of independent azimuth cells."""
    return sensor.wavelength * slant_range / (2 * aperture.length)


def slc_noise_power(sensor: Sensor, processing: Processing, pulses: int) -> F64:
    """E|n|^2 of an SLC pixel of each channel, shape (channels,): the mean of its samples' noise, raised by the windows.

    A pixel is made of `pulses` pulses and all frequencies.
    """
    return _noise_factor(processing, pulses, sensor.sample_count) * sensor.noise_covariance.diagonal().real


@lru_cache(maxsize=8)
def _noise_factor(processing: Processing, pulses: int, frequencies: int) -> float:
    """Noise power of a pixel that is made of this number of samples over that of a sample."""
    gain = noise_gain(processing.range_weights(frequencies)) * noise_gain(processing.azimuth_weights(pulses))
    return gain / (pulses * frequencies)


def slant_plane_size(
    sensor: Sensor, aperture: ApertureState, reference_range: float, range_broadening: float
) -> tuple[int, int]:
    """Rows and columns of a slant-plane image that covers the range window and one beamwidth along the flight."""
    cells = sensor.beams.track_beamwidth * reference_range / azimuth_resolution(sensor, aperture, reference_range)
    return max(1, int(sensor.sample_count / range_broadening)), max(1, int(cells + 1e-6))


def line_of_sight(sensor: Sensor, aperture: ApertureState) -> F64:
    """Unit vector (map) in the middle of all beams."""
    first, last = sensor.beams.span
    return aperture.rotation @ _abeam((first + last) / 2, sensor.look_side)


@lru_cache(maxsize=8)
def _abeam(elevation: float, look_side: int) -> F64:
    """Unit vector in body axes towards `elevation` (rad), abeam."""
    return look_direction(elevation, 0.0, look_side)


def aim_point(sensor: Sensor, aperture: ApertureState, reference_range: float) -> F64:
    """Point (m, map) in the middle of all beams at the reference range: the middle of the image."""
    return aperture.position + reference_range * line_of_sight(sensor, aperture)


def slant_plane_grid(
    sensor: Sensor, aperture: ApertureState, reference_range: float, rows: int, cols: int, range_broadening: float
) -> Grid:
    """Image in the plane of flight and line of sight around the aim point, pixels at the resolution.

    So spaced, looks are nearly independent: the powers of neighbouring range looks correlate by .11 (Taylor window).

    Rows grow along the line of sight, in range alone; columns across it, along-track, in Doppler alone. On a
    straight track every scatterer focuses in this plane at its own range and Doppler, whatever its elevation.

    Args:
        sensor: sensor with wavelength, bandwidth and beams.
        aperture: state of the platform.
        reference_range: slant range of the middle of the image, m.
        rows: number of pixels in range.
        cols: number of pixels in azimuth.
        range_broadening: broadening by the range window (`windows.broadening`).

    Raises:
        UserError: a line of sight along the flight, or too many pixels.
    """
    spacing = (sensor.range_resolution * range_broadening, azimuth_resolution(sensor, aperture, reference_range))
    return _slant_plane(sensor, aperture, reference_range, aperture.direction, spacing, (rows, cols))


def strip_grid(
    sensor: Sensor,
    aperture: ApertureState,
    reference_range: float,
    shape: tuple[int, int],
    spacing: tuple[float, float],
) -> Grid:
    """Stripmap image abeam of an aperture: as `slant_plane_grid`, but with columns along the body's forward axis.

    The antenna is fixed to the body and looks abeam of that axis, whichever way the wind drifts the platform. The
    spacing of rows and columns is in m.
    """
    return _slant_plane(sensor, aperture, reference_range, aperture.forward, spacing, shape)


def ground_plane_grid(
    sensor: Sensor, aperture: ApertureState, reference_range: float, rows: int, cols: int, spacing: float
) -> Grid:
    """Image in the horizontal plane through the aim point, square pixels of `spacing` m, rows pointing away.

    Raises:
        UserError: a line of sight straight down, or too many pixels.
    """
    centre = aim_point(sensor, aperture, reference_range)
    away = _unit((centre - aperture.position) * np.array([1.0, 1.0, 0.0]), "horizontal line of sight")
    along = np.cross([0.0, 0.0, 1.0], away)
    along *= np.sign(along @ aperture.direction) or 1.0
    return _centred_grid(centre, away, along, (spacing, spacing), (rows, cols))


def _slant_plane(
    sensor: Sensor,
    aperture: ApertureState,
    reference_range: float,
    along: F64,
    spacing: tuple[float, float],
    shape: tuple[int, int],
) -> Grid:
    centre = aim_point(sensor, aperture, reference_range)
    sight = (centre - aperture.position) / reference_range
    side = _unit(along - (along @ sight) * sight, "line of sight")
    return _centred_grid(centre, sight, side, spacing, shape)


def _centred_grid(
    centre: F64, row_direction: F64, col_direction: F64, spacing: tuple[float, float], shape: tuple[int, int]
) -> Grid:
    if shape[0] * shape[1] > MAX_PIXELS:
        raise UserError(f"An image of {shape[0]} x {shape[1]} pixels was asked for; at most {MAX_PIXELS} are allowed.")
    half = (np.array(shape) - 1) / 2 * spacing
    origin = centre - half[0] * row_direction - half[1] * col_direction
    return Grid(origin, row_direction, col_direction, *spacing, *shape)


def _unit(vector: F64, what: str) -> F64:
    length = np.linalg.norm(vector)
    if not length > 1e-9:
        raise UserError(f"The {what} has no component across the flight; the sensor must look sideways.")
    return vector / length


@dataclass(frozen=True)
class Processing:
    """Weights of a compression; the same for every detector.

    Attributes:
        range_window: window over the bandwidth, a name of `windows.WINDOWS`.
        azimuth_window: window over the pulses of the aperture.
        angle: processed angle in stripmap, rad: a target's aperture is half of it to each side of abeam; 0 in
            spotlight, where all pulses are the aperture of every target.
    """

    range_window: str = "taylor"
    azimuth_window: str = "rectangular"
    angle: float = 0.0

    def range_weights(self, count: int) -> F64:
        """Weights of `count` frequencies, of mean 1."""
        return window(self.range_window, count)

    def azimuth_weights(self, pulses: int) -> F64:
        """Weights of the pulses of a spotlight aperture, of mean 1."""
        return window(self.azimuth_window, pulses)

    def angle_weights(self, sine: F64, spacing: F64) -> F64:
        """Weights of pulses in stripmap, that of a pulse across the edge of the aperture by its fraction within.

        Args:
            sine: sine of the angle between abeam and the antenna, seen from a target.
            spacing: spacing of neighbouring pulses, in that sine.
        """
        share = np.clip((self.angle / 2 - np.abs(sine)) / spacing + 0.5, 0.0, 1.0)
        taper, position = self.taper(), np.clip((sine / self.angle + 0.5) * (TAPER_NODES - 1), 0, TAPER_NODES - 1)
        node = np.minimum(position.astype(np.int32), TAPER_NODES - 2)
        return np.asarray(share * (taper[node] + (position - node) * (taper[node + 1] - taper[node])))

    def reach(self, cell: tuple[float, float], spacing: tuple[float, float]) -> tuple[float, float]:
        """Distances in range and azimuth from the edge of a pixel to the first null of its response, m.

        Scatterers up to there contribute by the main lobe. Without a window that is half a cell, with the Taylor window
        a whole one: at 30 dB, or with many looks, a bright roof up to there shows its height in the pixel.

        Args:
            cell: unweighted resolution in range and azimuth, m.
            spacing: spacing of the pixels before looks are averaged, m.
        """
        down, across = main_lobe(self.range_window) * cell[0], main_lobe(self.azimuth_window) * cell[1]
        return down - spacing[0] / 2, across - spacing[1] / 2

    def taper(self) -> F32:
        """The azimuth window over the processed angle, at TAPER_NODES even sines from end to end."""
        return window(self.azimuth_window, TAPER_NODES).astype(np.float32)


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
