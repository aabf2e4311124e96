"""Greatest difference of a fast image former from backprojection."""

from __future__ import annotations

import numpy as np

from sal_height.errors import UserError

ALLOWED_ERROR = 1e-4
"""Greatest expected power of the difference to backprojection, over that of the image: -40 dB.

Noise and sidelobes of an image are stronger than that.
"""


def check_expected_error(former: str, error: float) -> None:
    """Refuse an image that would differ too much from backprojection's.

    Args:
        former: name of the former in the message.
        error: expected power of the difference over that of the image.

    Raises:
        UserError: it is greater than ALLOWED_ERROR.
    """
    if error > ALLOWED_ERROR:
        raise UserError(
            f"The former {former} would differ from backprojection by {10 * np.log10(error):.1f} dB here, because the "
            f"track is too uneven or the image too wide or not in the slant plane; at most "
            f"{10 * np.log10(ALLOWED_ERROR):.0f} dB are allowed, so use backprojection."
        )
