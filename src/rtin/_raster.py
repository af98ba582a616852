"""What ``Grid`` and the readers of rasters share: rows in chunks, scaled heights, places."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

__all__ = [
    "NORTH_UP",
    "NO_TRIANGLE",
    "extent",
    "moved",
    "padded",
    "row_chunks",
    "scaled",
    "widened",
]

Span = tuple[int, int]
CHUNK_SAMPLES = 1 << 18
NORTH_UP = Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0)
NO_TRIANGLE = (
    "the grid has no triangle to keep: none of the finest ones has heights at all three corners"
)


def row_chunks(shape: tuple[int, ...]) -> Iterator[slice]:
    """Return slices of consecutive rows, a quarter of a million samples each, to save memory."""
    step = max(1, CHUNK_SAMPLES // max(1, shape[1]))
    return (slice(start, start + step) for start in range(0, shape[0], step))


def moved(transform: Affine, rows: float, cols: float) -> Affine:
    """Return the transform that puts its origin at this row and column of the given one."""
    # Affine's own product is * before version 3 and @ since.
    a, b, x, d, e, y = transform[:6]
    return Affine(a, b, x + a * cols + b * rows, d, e, y + d * cols + e * rows)


def widened(transform: Affine, step: float, col_step: float | None = None) -> Affine:
    """Return the transform of a row and a column in every ``step`` of the given one.

    Columns may have another step than rows.
    """
    a, b, x, d, e, y = transform[:6]
    across = step if col_step is None else col_step
    return Affine(a * across, b * step, x, d * across, e * step, y)


def extent(transform: Affine, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the least and the largest x and y of a lattice's nodes, shape (2, 2)."""
    a, b, x, d, e, y = transform[:6]
    corners = [(col, row) for col in (0, shape[1] - 1) for row in (0, shape[0] - 1)]
    places = np.array([(a * col + b * row + x, d * col + e * row + y) for col, row in corners])
    return np.array([places.min(axis=0), places.max(axis=0)])


def padded(
    read: Callable[[Span, Span], NDArray[Any]],
    inside: tuple[Span, Span],
    window: tuple[Span, Span],
    dtype: Any,  # noqa: ANN401
) -> NDArray[Any]:
    """Return what ``read`` gives for a window; NaN outside of the rows and columns ``inside``."""
    rows, cols = (
        (max(first, low), min(end, high))
        for (first, end), (low, high) in zip(window, inside, strict=True)
    )
    if (rows, cols) == window:
        return read(rows, cols)
    (top, bottom), (left, right) = window
    values = np.full((bottom - top, right - left), np.nan, dtype)
    if rows[0] < rows[1] and cols[0] < cols[1]:
        part = slice(rows[0] - top, rows[1] - top), slice(cols[0] - left, cols[1] - left)
        values[part] = read(rows, cols)
    return values


def scaled(
    values: NDArray[Any],
    scale: float,
    offset: float,
    *,
    out: NDArray[np.float32] | None = None,
) -> NDArray[Any]:
    """Return ``values * scale + offset``, computed in float64 and rounded to float32.

    Where that changes nothing, returns the values themselves.
    """
    if scale == 1.0 and offset == 0.0:
        return values
    heights = np.empty(values.shape, np.float32) if out is None else out
    with np.errstate(over="ignore", invalid="ignore"):
        for rows in row_chunks(values.shape):
            heights[rows] = values[rows].astype(np.float64) * scale + offset
    return heights
