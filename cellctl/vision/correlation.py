"""How much less neighbouring pixels tell than independent ones. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def inflation(scores: Array, pixels: NDArray[np.intp], shape: tuple[int, ...], *, reach: int = 6) -> Array:
    """Factor (k,) on the variances of estimates whose points have influences `scores` (N, k): at least 1.

    `pixels` (N,) are flat indices into the organised cloud of `shape`; a cloud that is not organised gives ones.
    Sum of the influences' products over pixel lags up to `reach`, tapered (Newey, West, Econometrica 55 (1987) 703).
    """
    total = np.sum(scores**2, axis=0)
    if len(shape) != 2 or min(shape) < 2 or not np.all(total > 0):
        return np.ones(scores.shape[1])
    rows, columns = np.divmod(pixels, shape[1])
    row0, column0 = rows.min(), columns.min()
    width = int(columns.max() - column0) + 1 + 2 * reach
    table = np.full((int(rows.max() - row0) + 1 + reach, width), -1, dtype=np.int64)
    rows, columns = rows - row0, columns - column0 + reach
    table[rows, columns] = np.arange(len(pixels))
    double = np.zeros(scores.shape[1])
    for down in range(reach + 1):
        for right in range(-reach, reach + 1):
            distance = float(np.hypot(down, right))
            if (down == 0 and right <= 0) or distance > reach:
                continue
            other = table[rows + down, columns + right]
            paired = other >= 0
            taper = 1.0 - distance / (reach + 1.0)
            double += 2.0 * taper * np.sum(scores[paired] * scores[other[paired]], axis=0)
    return np.asarray(np.maximum(1.0 + double / total, 1.0))
