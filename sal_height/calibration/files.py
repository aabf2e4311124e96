"""Files of calibrations."""

from __future__ import annotations

import io
import zipfile
from dataclasses import fields
from pathlib import Path

import numpy as np

from sal_height.calibration.calibration import (
    Calibration,
)
from sal_height.errors import UserError
from sal_height.io import write_whole
from sal_height.numeric import F64


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration to an .npz file, whole or not at all.

    Raises:
        UserError: it cannot be written.
    """
    stream = io.BytesIO()
    np.savez(stream, **{one.name: getattr(calibration, one.name) for one in fields(calibration)})
    write_whole(path, stream.getvalue())


def load_calibration(path: Path) -> Calibration:
    """Read what `save_calibration` wrote.

    Raises:
        UserError: it cannot be read, or is no calibration.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            return Calibration(
                config_hash=str(stored["config_hash"]),
                response=np.asarray(stored["response"], dtype=np.complex128),
                response_sigma=_measured(stored["response_sigma"]),
                gain_sigma=_measured(stored["gain_sigma"]),
                phase_sigma=_measured(stored["phase_sigma"]),
                width_factor=float(stored["width_factor"]),
                width_sigma=float(_measured(stored["width_sigma"])),
                pupil=np.asarray(stored.get("pupil", np.zeros(0))),
                pupil_sigma=np.asarray(stored.get("pupil_sigma", np.zeros(0))),
                pupil_misfit=float(stored.get("pupil_misfit", np.nan)),
                pupil_p_value=float(stored.get("pupil_p_value", np.nan)),
                dwells=int(stored["dwells"]),
                id=str(stored["id"]) if "id" in stored else "",
            )
    except OSError as error:
        raise UserError(f"Calibration {path} cannot be read: {error.strerror or error}.") from error
    except UserError as error:
        raise UserError(f"File {path}: {error}") from error
    except (ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"File {path} is no calibration that psf_calibration wrote: {reason}.") from error


def _measured(sigma: F64) -> F64:
    """Return standard errors with NaN for 0, which meant "not measured" before version 1 of the messages."""
    return np.where(sigma > 0, sigma, np.nan).astype(np.float64)
