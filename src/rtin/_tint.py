"""Colours for heights, shared by the formats that carry colours."""

from __future__ import annotations

import numpy as np
from affine import Affine
from numpy.typing import NDArray

__all__ = ["encoded", "heat", "hillshade", "linear", "relief", "slopes", "tint"]

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
# From white by yellow and red to nearly black: darker all the way, so that it prints, too.
_HEAT = np.array(
    [
        [0.00, 0.97, 0.97, 0.95],
        [0.25, 0.99, 0.88, 0.55],
        [0.50, 0.96, 0.58, 0.27],
        [0.75, 0.76, 0.19, 0.24],
        [1.00, 0.25, 0.04, 0.28],
    ]
)
_ROUNDING = 1e-12  # of a height
# From the north-west, 45 degrees high, as maps are lit: towards the light in x, y and z.
_LIGHT = np.array([-0.5, 0.5, np.sqrt(0.5)])


def tint(heights: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """Return sRGB colours in 0..1, shape (n, 3), for heights between ``low`` and ``high``.

    Greens, browns and white from the lowest land to the highest; blues for zero, which most rasters
    give the sea, and below where the range begins there.
    """
    has_sea = low <= 0.0 < high
    shore = 0.0 if has_sea else low
    colours = _ramp(_LAND, (heights - shore) / ((high - shore) or 1.0))
    if has_sea:
        wet = heights <= 0.0
        colours[wet] = _ramp(_SEA, 1.0 - heights[wet] / (low or -1.0))
    return colours


def hillshade(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the brightness, 0 to 1, of surfaces lit from the north-west; level ground has 0.71."""
    return np.asarray(np.clip(normals @ _LIGHT, 0.0, 1.0))


def heat(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sRGB colours in 0..1, shape (n, 3): pale for 0, red and nearly black for 1."""
    return _ramp(_HEAT, shares)


def slopes(
    heights: NDArray[np.float64], transform: Affine
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the slopes along x and along y of heights on a lattice, NaN beside voids.

    ``transform`` maps (col, row) to (x, y). There must be 2 × 2 heights at least.
    """
    a, b, _, d, e, _ = tuple(transform)[:6]
    by_row, by_col = np.gradient(heights)
    # dz/dcol = a dz/dx + d dz/dy and dz/drow = b dz/dx + e dz/dy, solved for the slopes.
    determinant = a * e - b * d
    return (e * by_col - d * by_row) / determinant, (a * by_row - b * by_col) / determinant


def relief(
    heights: NDArray[np.float64], slope_x: NDArray[np.float64], slope_y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return pale RGBA colours, shape (n, 4): tinted by height, lit from the north-west.

    Slopes are scaled to a typical one of 0.4, whatever the units, but for a flat terrain; voids are
    transparent.
    """
    valid = np.isfinite(heights) & np.isfinite(slope_x) & np.isfinite(slope_y)
    colours = np.zeros((len(heights), 4))
    if not valid.any():
        return colours
    steepness = np.sqrt(np.mean(slope_x[valid] ** 2 + slope_y[valid] ** 2)) or np.inf
    low, high = heights[valid].min(), heights[valid].max()
    if high - low <= _ROUNDING * max(abs(low), abs(high)):
        steepness, high = np.inf, low
    slopes = 0.4 / steepness * np.column_stack([slope_x[valid], slope_y[valid]])
    normals = np.column_stack([-slopes, np.ones(len(slopes))])
    light = hillshade(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    tints = tint(heights[valid], low, high)
    shaded = (0.35 + 0.65 * tints) * (0.4 + 0.75 * light[:, np.newaxis])
    colours[valid] = np.column_stack([shaded.clip(0.0, 1.0), np.ones(len(shaded))])
    return colours


def linear(colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sRGB ``colours`` in 0..1 as linear ones, as glTF wants vertex colours."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def encoded(colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return linear ``colours`` in 0..1 as sRGB ones."""
    return np.where(colours <= 0.0031308, 12.92 * colours, 1.055 * colours ** (1.0 / 2.4) - 0.055)


def _ramp(stops: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([np.interp(at, stops[:, 0], stops[:, i]) for i in (1, 2, 3)])
