"""Each number once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["distinct"]


def distinct(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return numbers of zero or more once each, ascending.

    By sorting: NumPy 2.3 and later hash in ``np.unique``, which takes three to five times as long.
    """
    ordered = np.sort(numbers)
    return ordered[np.diff(ordered, prepend=-1) > 0]
