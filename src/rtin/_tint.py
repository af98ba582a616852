"""Colours for heights, shared by the formats that carry colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["hillshade", "linear", "tint"]

# Muted, as on a printed relief map: (part of the way up, red, green, blue), sRGB in 0..1.
_LAND = np.array(
    [
        [0.00, 0.45, 0.58, 0.42],
        [0.20, 0.60, 0.69, 0.47],
        [0.40, 0.82, 0.80, 0.58],
        [0.60, 0.76, 0.63, 0.45],
        [0.80, 0.62, 0.50, 0.41],
        [0.92, 0.78, 0.75, 0.72],
        [1.00, 0.97, 0.97, 0.97],
    ]
)
_SEA = np.array([[0.0, 0.13, 0.27, 0.45], [0.6, 0.33, 0.55, 0.72], [1.0, 0.70, 0.84, 0.90]])
# From the north-west, 45 degrees high, as maps are lit: towards the light in x, y and z.
_LIGHT = np.array([-0.5, 0.5, np.sqrt(0.5)])


def tint(heights: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """Return sRGB colours in 0..1, shape (n, 3), for heights between ``low`` and ``high``.

    Greens, browns and white from the lowest land to the highest; blues below zero where the range
    has both land and sea.
    """
    has_sea = low < 0.0 < high
    shore = 0.0 if has_sea else low
    colours = _ramp(_LAND, (heights - shore) / ((high - shore) or 1.0))
    if has_sea:
        wet = heights < 0.0
        colours[wet] = _ramp(_SEA, 1.0 - heights[wet] / low)
    return colours


def hillshade(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the brightness, 0 to 1, of surfaces lit from the north-west; level ground has 0.71."""
    return np.asarray(np.clip(normals @ _LIGHT, 0.0, 1.0))


def linear(colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sRGB ``colours`` in 0..1 as linear ones, as glTF wants vertex colours."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def _ramp(stops: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([np.interp(at, stops[:, 0], stops[:, i]) for i in (1, 2, 3)])
