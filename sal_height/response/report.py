"""The point-spread function from the images of one receiver: by targets, by speckle, and whether both agree.

Each part is there or it is not, and then a sentence says why and what would be needed: nothing is made up (PSF paper,
sections 3 and 4). Axis 0 of images is range, axis 1 azimuth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from sal_height.errors import NotDetermined, UserError
from sal_height.numeric import C64, F64, Complex
from sal_height.response.linearity import Superposition, superposition
from sal_height.response.point_spread import PointSpread, estimate_point_spread
from sal_height.response.point_targets import CHIP, PointTarget, TargetSurvey, find_targets
from sal_height.response.speckle_spectra import SpeckleSpectra, estimate_speckle_spectra
from sal_height.response.speckle_tiles import REASONS, TILE, SpeckleTiles, find_pure_speckle
from sal_height.response.transfer_function import TransferFunction, estimate_transfer_function

Part = TypeVar("Part")

LONG_CHIPS = (256, 128, 64)
"""Rows of the chips that are compared with speckle, the first that hold a target: long ones cut less off."""


@dataclass(frozen=True)
class PsfReport:
    """The response to a point as images show it; None stands for what they do not show.

    Attributes:
        chip: rows and columns of the targets' chips.
        surveys: candidates and targets of each image.
        transfer: range and azimuth response, of the targets of all images.
        spread: the point-spread function they make.
        tiles: of the images side by side along azimuth, each cut to whole tiles.
        spectra: of the tiles of pure speckle.
        linearity: comparison of the responses to targets and to speckle, that of tiles away from bright points.
        linearity_rows: of the chips of the targets compared; 0: none were.
        undetermined: for each part that is None ("targets", "speckle", "pointing", "superposition"), one sentence: why,
            and what would be needed.
    """

    chip: tuple[int, int]
    surveys: tuple[TargetSurvey, ...]
    transfer: TransferFunction | None
    spread: PointSpread | None
    tiles: SpeckleTiles | None
    spectra: SpeckleSpectra | None
    linearity: Superposition | None
    linearity_rows: int
    undetermined: dict[str, str]

    @property
    def targets(self) -> tuple[PointTarget, ...]:
        """Of all images."""
        return tuple(target for survey in self.surveys for target in survey.targets)


@dataclass(frozen=True)
class ImagePointing:
    """Where the antenna points along the track of one image.

    Attributes:
        cols: middle columns of tiles of pure speckle, pixels from the first column.
        displacement: Doppler centroid there, cycles per pixel.
        sigma: its standard error, cycles per pixel.
    """

    cols: F64
    displacement: F64
    sigma: F64


def report_on(images: Sequence[Complex], chip: tuple[int, int] | None = None) -> PsfReport:
    """Measure the point-spread function on images of one receiver.

    Targets and speckle of all images are pooled: what the images share is their response.

    Args:
        images: complex pixels, each of as many rows, of one spacing; shapes (rows, cols).
        chip: rows and columns around a target; None: 64 x 64 (PSF paper), or what the smallest image has.

    Raises:
        UserError: there is no image, they are not complex matrices of as many rows, one has no phase, or the chip does
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
    surveys = tuple(find_targets(image, chip) for image in images)
    transfer = _part("targets", reasons, lambda: estimate_transfer_function(_pooled(surveys).require()))
    mosaic = side_by_side(images, tile[1])
    tiles = _part("speckle", reasons, lambda: find_pure_speckle(mosaic, tile))
    spectra = estimate_speckle_spectra(mosaic, tiles) if tiles else None
    if not (spectra and spectra.pointing):
        reasons["pointing"] = _why_no_pointing(spectra)
    linearity, length = None, 0
    if transfer and tiles:
        away = _away_from_candidates(images, surveys, tiles)
        compared = _part("superposition", reasons, lambda: _compared(images, mosaic, away, chip[1]))
        linearity, length = compared or (None, 0)
    else:
        missing = " and ".join(what for what in ("targets", "speckle") if what in reasons)
        reasons["superposition"] = (
            "Whether the system is linear is told by targets and speckle together; needed is also the response "
            f"of {missing}."
        )
    spread = estimate_point_spread(transfer) if transfer else None
    return PsfReport(chip, surveys, transfer, spread, tiles, spectra, linearity, length, reasons)


def side_by_side(images: Sequence[Complex], width: int) -> C64:
    """The images' whole tiles of `width` columns, beside each other; pixels too great for single precision infinite."""
    with np.errstate(over="ignore", invalid="ignore"):
        parts = [image[:, : image.shape[1] // width * width].astype(np.complex64, copy=False) for image in images]
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)


def pointing_of_images(report: PsfReport, images: Sequence[Complex]) -> list[ImagePointing]:
    """The pointing along each of the images the report is on; nothing in it where they hold no pure speckle."""
    pointing = report.spectra and report.spectra.pointing
    if not pointing or not report.tiles:
        return [ImagePointing(*np.zeros((3, 0))) for _ in images]
    width = report.tiles.tile[1]
    ends = np.cumsum([image.shape[1] // width * width for image in images])
    own = np.searchsorted(ends, pointing.cols, side="right")
    starts = np.concatenate([[0], ends])
    return [
        ImagePointing(pointing.cols[here] - starts[i], pointing.displacement[here], pointing.sigma[here])
        for i in range(len(images))
        for here in [own == i]
    ]


def _common_shape(images: Sequence[Complex]) -> tuple[int, int]:
    """Rows of all images, and columns of the narrowest."""
    shapes = sorted({image.shape for image in images})
    if not shapes or any(len(shape) != 2 for shape in shapes) or len({shape[0] for shape in shapes}) > 1:
        raise UserError(
            f"Images of the shapes {', '.join(map(str, shapes)) or 'none'} do not make one measurement; needed is one "
            "at least, and all must have two axes and as many rows."
        )
    return shapes[0][0], shapes[0][1]


def _part(name: str, undetermined: dict[str, str], measure: Callable[[], Part]) -> Part | None:
    """What is measured, or None, with the reason entered."""
    try:
        return measure()
    except NotDetermined as reason:
        undetermined[name] = str(reason)
        return None


def _pooled(surveys: Sequence[TargetSurvey]) -> TargetSurvey:
    return TargetSurvey(
        tuple(candidate for survey in surveys for candidate in survey.candidates),
        tuple(target for survey in surveys for target in survey.targets),
    )


def _why_no_pointing(spectra: SpeckleSpectra | None) -> str:
    if spectra is None:
        return "Where the antenna points is told by pure speckle, and none was found; needed is a tile of it."
    return (
        "The response along azimuth is too flat, or the pure speckle too little, to tell where the antenna points; "
        "needed are neighbouring pixels that correlate, or more speckle in a column of tiles."
    )


def _compared(images: Sequence[Complex], mosaic: C64, tiles: SpeckleTiles, cols: int) -> tuple[Superposition, int]:
    """Comparison of the targets' range response with that of speckle, and the rows of the chips it was made with."""
    least, rows = tiles.tile[0], images[0].shape[0]
    if not tiles.pure.any():
        raise NotDetermined(
            f"Every tile of pure speckle is within {LONG_CHIPS[0] // 2} rows of a bright point, whose echoes are no "
            "speckle; a comparison with targets needs one that is not."
        )
    for length in dict.fromkeys(min(rows, most) for most in LONG_CHIPS):
        targets = _pooled([find_targets(image, (length, cols)) for image in images]).targets
        if targets and length >= least:
            transfer = estimate_transfer_function(targets)
            spectra = estimate_speckle_spectra(mosaic, tiles)
            return superposition(transfer.range_response, transfer.range_sigma, spectra), length
    raise NotDetermined(
        f"No target is alone in a chip of {least} x {cols} pixels, as long as a sub-image of speckle; needed is one "
        "for a comparison of the two."
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
            own[down, along][own[down, along] == 0] = REASONS.index("beside a bright point")
        first += across
    return replace(tiles, verdict=verdict)
