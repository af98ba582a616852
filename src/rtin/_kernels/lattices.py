"""Heights at the nodes of one lattice, between the samples of another.

Places are rows and columns of samples, with fractions: an array of shape (n, m), or (n, 1) or
(1, m) where they are the same all along an axis. NaN is no place. Samples are NaN where void and
infinite where there is no raster.
"""

import math

import numpy as np

from rtin._kernels._jit import inlined, jit

FARTHEST = 1e9  # a place beyond has no row or column
TIE = 1e-6  # of a cell


@jit
def fill_between(controls, first_row, first_col, step, values):
    """Bilinear values of nodes from control nodes, one in every ``step`` rows and columns.

    controls[0, 0] belongs to the node (first_row, first_col), which are negative or 0, measured
    from the window's first node.
    """
    n_rows, n_cols = values.shape
    for i in range(n_rows):
        k, down = divmod(i - first_row, step)
        v = down / step
        for m in range(controls.shape[1] - 1):
            west = controls[k, m] + (controls[k + 1, m] - controls[k, m]) * v
            east = controls[k, m + 1] + (controls[k + 1, m + 1] - controls[k, m + 1]) * v
            start = first_col + m * step
            for j in range(max(start, 0), min(start + step, n_cols)):
                values[i, j] = west + (east - west) * ((j - start) / step)


@jit
def snap(places, margin):
    """Move places onto whole rows or columns that they are closer to than the margin."""
    for i in range(places.shape[0]):
        for j in range(places.shape[1]):
            nearest = np.rint(places[i, j])
            if abs(places[i, j] - nearest) < margin:
                places[i, j] = nearest


@jit
def extent(places, period):
    """The least span of whole rows or columns at or before the places, on a ring of ``period``.

    A period of 0 is no ring. The first is greater than the last where there is no place at all.
    """
    lowest, highest, origin = 1, 0, 0
    for i in range(places.shape[0]):
        for j in range(places.shape[1]):
            if not abs(places[i, j]) < FARTHEST:
                continue
            whole = math.floor(places[i, j])
            if lowest > highest:
                lowest = highest = origin = whole
            if period > 0:
                whole = origin + (whole - origin + period // 2) % period - period // 2
            lowest, highest = min(lowest, whole), max(highest, whole)
    return lowest, highest


@inlined
def sample(samples, row, col, period):
    """A sample, infinite outside the array."""
    if period > 0:
        col %= period
    if 0 <= row < samples.shape[0] and 0 <= col < samples.shape[1]:
        return np.float64(samples[row, col])
    return np.inf


@jit
def folded(u, first_missing, second_missing):
    """The weight of the second of two, where one of them may be outside all rasters.

    Up to half a cell beyond the outermost samples is still inside their cells.
    """
    if second_missing and u <= 0.5 + TIE:
        return 0.0
    if first_missing and u >= 0.5 - TIE:
        return 1.0
    return u


@jit
def height_at_edge(nw, ne, sw, se, u, v):
    """The height between four samples some of which do not count, are void or missing."""
    u = folded(
        u,
        (nw == np.inf or v == 1.0) and (sw == np.inf or v == 0.0),
        (ne == np.inf or v == 1.0) and (se == np.inf or v == 0.0),
    )
    v = folded(
        v,
        (nw == np.inf or u == 1.0) and (ne == np.inf or u == 0.0),
        (sw == np.inf or u == 1.0) and (se == np.inf or u == 0.0),
    )
    height, nearest, weight = 0.0, np.nan, -1.0
    is_whole = True
    for value, share in (
        (nw, (1.0 - u) * (1.0 - v)),
        (ne, u * (1.0 - v)),
        (sw, (1.0 - u) * v),
        (se, u * v),
    ):
        if share > 0.0:
            is_whole &= value != np.inf
            height += share * value
        if share > weight:
            nearest, weight = value, share
    if is_whole:
        return height
    # The inner corner of an L of rasters: three samples and none.
    return nearest if abs(nearest) < np.inf else np.nan


@jit
def fill_heights(samples, first_row, first_col, period, rows, cols, scale, rises, heights):
    """Write each node's height: bilinear between the samples, times the scale, plus its rise.

    samples[0, 0] is in row first_row and column first_col, on a ring of ``period`` columns. They
    are taken off whole rows and columns: off places they would round the weights, differently in
    every window.
    """
    n_rows, n_cols = samples.shape
    for i in range(heights.shape[0]):
        for j in range(heights.shape[1]):
            y = rows[min(i, rows.shape[0] - 1), min(j, rows.shape[1] - 1)]
            x = cols[min(i, cols.shape[0] - 1), min(j, cols.shape[1] - 1)]
            if not (abs(y) < FARTHEST and abs(x) < FARTHEST):
                heights[i, j] = np.nan
                continue
            whole_row, whole_col = math.floor(y), math.floor(x)
            v, u = y - whole_row, x - whole_col
            row, col = whole_row - first_row, whole_col - first_col
            if period > 0:
                col %= period
            height = np.inf
            if 0 <= row < n_rows - 1 and 0 <= col < n_cols - 1:
                height = (1.0 - v) * (
                    (1.0 - u) * samples[row, col] + u * samples[row, col + 1]
                ) + v * ((1.0 - u) * samples[row + 1, col] + u * samples[row + 1, col + 1])
            if not abs(height) < np.inf:
                height = height_at_edge(
                    sample(samples, row, col, period),
                    sample(samples, row, col + 1, period),
                    sample(samples, row + 1, col, period),
                    sample(samples, row + 1, col + 1, period),
                    u,
                    v,
                )
            rise = rises[min(i, rises.shape[0] - 1), min(j, rises.shape[1] - 1)]
            heights[i, j] = height * scale + rise
