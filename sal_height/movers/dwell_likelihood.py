"""Likelihood of what was seen in dwells one after the other, through a beam that goes on from each to the next.

Dwell n shows a target with the amplitude g_n of the beam in its direction, and a phase that nothing tells. With m_n the
amplitude that matches the target in that dwell, over a background of power 1, the logarithm of the likelihood over that
of the background alone is the sum over dwells of

    |m_n|^2 - (|m_n|^2 + q_n) / v_n + ln I_0(2 sqrt(q_n) |m_n| / v_n) - ln v_n,  v_n = 1 + MODEL_ERROR q_n

for a point, as bright in every dwell but for errors of the beam, and

    |m_n|^2 q_n / (1 + q_n) - ln(1 + q_n)

for speckle, which every dwell draws anew, of the power q_n = P g_n^2 (Kay, Fundamentals of Statistical Signal
Processing II, 1998, sections 7.6 and 5.3). The likelihood is the greatest over P and these two, so that a target that
fades by chance is not taken for one that has gone elsewhere. What is to be told as moving must be likelier as speckle:
bright speckle has among so many points one that fits it by chance.
"""

from __future__ import annotations

import numpy as np
from scipy.special import i0e

from sal_height.movers.search import MODEL_ERROR
from sal_height.numeric import F64

POWERS = 10 ** (np.arange(-6, 55, 3) / 10)
"""Powers of targets over the background."""


def told(matched: F64, gains: F64, powers: F64 = POWERS, points: bool = True) -> F64:
    """Logarithm of the likelihood of a target over that of the background, its greatest over powers and kinds.

    Args:
        matched: |m_n|, shape (..., dwells).
        gains: g_n, amplitude of the beam over the background's, broadcasts to that shape.
        powers: P, of which the best counts.
        points: whether it may be a point; else it is speckle.

    Returns:
        Shape (...); not less than 0, as there may be no target.
    """
    square, amplitude = matched**2, np.abs(matched)
    q = np.multiply.outer(powers, gains**2)
    speckle = np.maximum(np.sum(square * (q / (1 + q)) - np.log1p(q), axis=-1).max(axis=0), 0.0)
    if not points:
        return np.asarray(speckle)
    v = 1 + MODEL_ERROR * q
    # ln I_0(x) is x and the logarithm of i0e, which does not overflow.
    x = 2 * np.sqrt(q) * amplitude / v
    point = np.sum(square - (square + q) / v + x + np.log(i0e(x) / v), axis=-1)
    return np.maximum(point.max(axis=0), speckle)


def told_of_cloud(matched: F64, gains: F64, shares: F64) -> float:
    """The same of speckle that is spread over rows, the greatest over its spreads.

    Args:
        matched: shape (dwells, rows).
        gains: shape (dwells,).
        shares: of the power in each row, shape (spreads, rows) or (spreads, dwells, rows).
    """
    square = matched**2
    powers = np.broadcast_to(shares if shares.ndim == 3 else shares[:, None], (len(shares), *square.shape))
    q = np.multiply.outer(POWERS, powers * gains[:, None] ** 2)
    return max(0.0, float(np.max(np.sum(square * (q / (1 + q)) - np.log1p(q), axis=(-2, -1)))))
