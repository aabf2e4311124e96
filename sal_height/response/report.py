"""The point-spread function from the images of one receiver: by targets, by speckle, and a comparison of both.

Each part is determined, or a message states why it is not and what would be needed: nothing is assumed (PSF paper,
sections 3 and 4). Axis 0 of images is range, axis 1 azimuth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.ndimage import uniform_filter1d

from sal_height.errors import NotDetermined, UserError
from sal_height.numeric import C64, C128, F64, Complex, ShortRepr
from sal_height.response.linearity import KnownNoise, ShapedNoise, Superposition, superposition
from sal_height.response.point_spread import PointSpread, estimate_point_spread
from sal_height.response.point_targets import CHIP, PointTarget, PointTargetSettings, TargetSurvey, find_targets
from sal_height.response.speckle_spectra import Pointing, SpeckleSpectra, estimate_speckle_spectra
from sal_height.response.speckle_tiles import REASONS, TILE, SpeckleSettings, SpeckleTiles, find_pure_speckle
from sal_height.response.transfer_function import TransferFunction, estimate_transfer_function

Part = TypeVar("Part")

LONG_CHIPS = (256, 128, 64)
"""Rows of the chips that are compared with speckle, the first that contain a target: long ones truncate less."""

NOISE_UNKNOWN = (
    "The power of receiver noise is not known: tiles pass for speckle because neighbours in azimuth correlate, which "
    "those of noise do only where an azimuth filter is narrower than the sampling."
)
"""Remark on speckle that was found without knowing the noise."""


def steadied(images: Sequence[Complex]) -> tuple[list[Complex], list[F64]]:
    """Turn the pixels until all columns of all images have the Doppler centroid of their mean.

    Args:
        images: complex pixels, range along axis 0, shapes (rows, cols).

    Returns:
        The images, the same objects if the centroid does not move significantly; and for each image what was subtracted
        from the centroid between each column and the next, cycles per pixel, shape (cols - 1,).
    """
    measured = [_neighbours(image) for image in images]
    mean = sum((products.sum() for products, _ in measured), 0j)
    relative = [products * np.exp(-1j * np.angle(mean)) for products, _ in measured]
    # The centroid of a column moves if it differs from the mean by six standard errors.
    moved = [np.any(np.abs(one.imag) > 6.0 * error) for one, (_, error) in zip(relative, measured, strict=True)]
    if not any(moved):
        return list(images), [np.zeros(len(one)) for one in relative]
    turns = [np.angle(one) for one in relative]
    phasors = (np.exp(-1j * np.cumsum(np.append(0.0, turn))).astype(np.complex64) for turn in turns)
    turned = [image * phasor for image, phasor in zip(images, phasors, strict=True)]
    return turned, [turn / (2 * np.pi) for turn in turns]


def _neighbours(image: Complex) -> tuple[C128, float]:
    """Mean product of each column and the next, smoothed along the columns, and the standard error of its parts."""
    amplitude = np.abs(image)
    phasors = np.zeros(image.shape, dtype=np.complex64)
    np.divide(image, amplitude, out=phasors, where=np.isfinite(amplitude) & (amplitude > 0), casting="same_kind")
    products = np.einsum("rc,rc->c", phasors[:, 1:], phasors[:, :-1].conj()).astype(np.complex128)
    # A phase that is quadratic over the image would cancel in the mean: it is taken out first and put back.
    bend = np.angle(np.sum(products[1:] * products[:-1].conj()))
    straight = products * np.exp(-1j * bend * np.arange(len(products)))
    columns = 65  # about those of a tile of speckle
    smooth = uniform_filter1d(straight, columns, mode="constant")
    error = np.sqrt(np.mean(np.abs(straight - smooth) ** 2) / (2 * columns)) if len(products) else 0.0
    return smooth * np.exp(1j * bend * np.arange(len(products))), float(error)


class PsfSettings(PointTargetSettings, SpeckleSettings):
    """Criteria for pixels of an image that count as point targets, and for tiles that count as speckle."""


DEFAULTS = PsfSettings()


@dataclass(frozen=True, eq=False)
class PsfReport(ShortRepr):
    """The response to a point as measured in images; None: not determined.

    Attributes:
        chip: rows and columns of the targets' chips.
        surveys: candidates and targets of each image.
        transfer: range and azimuth response, of the targets of all images.
        spread: point-spread function of these responses.
        tiles: tiles of the images side by side along azimuth, each cut to whole tiles.
        spectra: spectra of the tiles of pure speckle.
        pointing: pointing of the antenna along each image; empty where unknown.
        linearity: comparison of the responses to targets and to speckle, that of tiles away from bright points.
        linearity_rows: rows of the chips of the targets compared; 0: not compared.
        undetermined: reason for each part that is None ("targets", "speckle", "pointing", "superposition"),
            and what would be needed.
    """

    chip: tuple[int, int]
    surveys: tuple[TargetSurvey, ...]
    transfer: TransferFunction | None
    spread: PointSpread | None
    tiles: SpeckleTiles | None
    spectra: SpeckleSpectra | None
    pointing: tuple[Pointing, ...]
    linearity: Superposition | None
    linearity_rows: int
    undetermined: dict[str, str]

    @property
    def targets(self) -> tuple[PointTarget, ...]:
        """Targets of all images."""
        return TargetSurvey.pooled(self.surveys).targets


def report_on(
    images: Sequence[Complex],
    chip: tuple[int, int] | None = None,
    settings: PsfSettings = DEFAULTS,
    noise_powers: Sequence[float] | None = None,
    noise_shape: ShapedNoise | None = None,
) -> PsfReport:
    """Measure the point-spread function on images of one receiver.

    Targets and speckle of all images are pooled, which have a common response. Where the Doppler centroid
    moves along the columns, the pixels are turned until it does not.

    Args:
        images: complex pixels, all with the same number of rows and one spacing; shapes (rows, cols).
        chip: rows and columns around a target; None: 64 x 64 (PSF paper), or what the smallest image has.
        settings: criteria for point targets, and for tiles of speckle.
        noise_powers: E|n|^2 of the receiver noise in a pixel of each image; None: unknown.
        noise_shape: covariance of the noise by the processor; None: unknown, but white along azimuth.

    Raises:
        UserError: there is no image, they are not complex matrices of equal rows, one has no phase, or the chip does
            not fit.
    """
    rows, cols = _common_shape(images)
    if any(image.real.any() and not image.imag.any() for image in images):
        raise UserError(
            "An image has no imaginary parts other than 0; a response takes complex pixels, not amplitudes."
        )
    chip = chip or (min(CHIP[0], rows), min(CHIP[1], cols))
    tile = min(TILE[0], rows), min(TILE[1], cols)
    reasons: dict[str, str] = {}
    steady, displacements = steadied(images)
    surveys = tuple(find_targets(image, chip, settings) for image in steady)
    transfer = _part("targets", reasons, lambda: estimate_transfer_function(TargetSurvey.pooled(surveys).require()))
    mosaic = _side_by_side(steady, tile[1], noise_powers)
    noise = None if noise_powers is None else float(any(noise_powers))
    tiles = _part("speckle", reasons, lambda: find_pure_speckle(mosaic, tile, settings, noise))
    spectra = estimate_speckle_spectra(mosaic, tiles) if tiles else None
    if not spectra:
        reasons["pointing"] = (
            "The pointing of the antenna shows in pure speckle only; at least one tile of it is needed."
        )
    elif not spectra.pointing:
        reasons["pointing"] = (
            "The response along azimuth is too flat, or the pure speckle too little, to show where the antenna points; "
            "neighbouring pixels that correlate are needed, or more speckle in a column of tiles."
        )
    linearity, length = None, 0
    if transfer and tiles:
        away = _away_from_candidates(steady, surveys, tiles)
        shape = noise_shape if noise else None
        compared = _part("superposition", reasons, lambda: _compared(steady, mosaic, away, chip[1], settings, shape))
        linearity, length = compared or (None, 0)
    else:
        missing = " and ".join(what for what in ("targets", "speckle") if what in reasons)
        reasons["superposition"] = (
            f"Only targets and speckle together show whether the system is linear; the response of {missing} is also "
            "needed."
        )
    spread = estimate_point_spread(transfer) if transfer else None
    pointing = _pointing_of_each(spectra, tile[1], displacements)
    return PsfReport(chip, surveys, transfer, spread, tiles, spectra, pointing, linearity, length, reasons)


def _common_shape(images: Sequence[Complex]) -> tuple[int, int]:
    """Rows of all images, and columns of the narrowest."""
    shapes = sorted({image.shape for image in images})
    if not shapes or any(len(shape) != 2 for shape in shapes) or len({shape[0] for shape in shapes}) > 1:
        raise UserError(
            f"Images of the shapes {', '.join(map(str, shapes)) or 'none'} cannot be measured together; at least one "
            "is needed, and all must have two axes and as many rows."
        )
    return shapes[0][0], shapes[0][1]


def _part(name: str, undetermined: dict[str, str], measure: Callable[[], Part]) -> Part | None:
    """The measured part, or None, with the reason recorded."""
    try:
        return measure()
    except NotDetermined as reason:
        undetermined[name] = str(reason)
        return None


def _side_by_side(images: Sequence[Complex], width: int, noise_powers: Sequence[float] | None) -> C64:
    """The images' whole tiles of `width` columns, side by side; pixels too great for single precision infinite.

    Images of a known noise power are divided by its root, so that all have the noise power 1.
    """
    scales = [float(power) ** -0.5 if power else 1.0 for power in noise_powers or np.ones(len(images))]
    with np.errstate(over="ignore", invalid="ignore"):
        whole = [
            image[:, : image.shape[1] // width * width] * scale for image, scale in zip(images, scales, strict=True)
        ]
        return np.concatenate(whole, axis=1).astype(np.complex64, copy=False)


def _pointing_of_each(spectra: SpeckleSpectra | None, width: int, displacements: Sequence[F64]) -> tuple[Pointing, ...]:
    """The pointing along each image, from that of the whole mosaic and what was subtracted from its centroids."""
    found = spectra.pointing if spectra else None
    if not found:
        return tuple(Pointing(*np.zeros((3, 0))) for _ in displacements)
    pointing, start = [], 0
    for displacement in displacements:
        end = start + (len(displacement) + 1) // width * width
        own = (found.cols >= start) & (found.cols < end)
        cols = found.cols[own] - start
        total = found.displacement[own] + displacement[cols.astype(int)]
        pointing.append(Pointing(cols, total - np.round(total), found.sigma[own]))
        start = end
    return tuple(pointing)


def _compared(
    images: Sequence[Complex],
    mosaic: C64,
    tiles: SpeckleTiles,
    cols: int,
    settings: PsfSettings,
    noise: ShapedNoise | None,
) -> tuple[Superposition, int]:
    """Comparison of the targets' range response with that of speckle, and the rows of the chips it was made with.

    Args:
        images: images as of `report_on`.
        mosaic: images side by side, of the noise power 1 if the noise's shape is known.
        tiles: tiles of the mosaic; those that a bright point touches are not pure.
        cols: columns of a chip.
        settings: criteria for pixels that count as point targets.
        noise: covariance of the noise by the processor; None: unknown.
    """
    least, rows = tiles.tile[0], images[0].shape[0]
    if not tiles.pure.any():
        raise NotDetermined(
            f"Every tile of pure speckle is within {LONG_CHIPS[0] // 2} rows of a bright point, whose echoes are not "
            "speckle; a comparison with targets needs one that is farther away."
        )
    for length in dict.fromkeys(min(rows, most) for most in LONG_CHIPS):
        targets = TargetSurvey.pooled([find_targets(image, (length, cols), settings) for image in images]).targets
        if targets and length >= least:
            transfer = estimate_transfer_function(targets)
            spectra = estimate_speckle_spectra(mosaic, tiles)
            known = KnownNoise(noise, float(np.mean(1 / tiles.intensity[tiles.pure]))) if noise else None
            return superposition(transfer.range.response, transfer.range.sigma, spectra, known), length
    raise NotDetermined(
        f"No target is alone in a chip of {least} x {cols} pixels, as long as a sub-image of speckle; one is needed to "
        "compare the two."
    )


def _away_from_candidates(
    images: Sequence[Complex], surveys: Sequence[TargetSurvey], tiles: SpeckleTiles
) -> SpeckleTiles:
    """The tiles, those not pure any more that the chip of a bright point would touch, as long as LONG_CHIPS go.

    What is left of a point in tiles around is too little for the tests of purity, but its echoes have deeper teeth than
    the response: with them the comparison of a linear system fails.
    """
    verdict, first = tiles.verdict.copy(), 0
    reach = LONG_CHIPS[0] // 2, CHIP[1] // 2
    for image, survey in zip(images, surveys, strict=True):
        across = image.shape[1] // tiles.tile[1]
        own = verdict[:, first : first + across]
        for one in survey.candidates:
            down, along = (
                slice(max(0, place - far) // side, (place + far) // side + 1)
                for place, far, side in zip((one.row, one.col), reach, tiles.tile, strict=True)
            )
            own[down, along][own[down, along] == 0] = REASONS.index("next to a bright point")
        first += across
    return replace(tiles, verdict=verdict)
