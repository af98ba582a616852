"""Arithmetic of tiles: what a closed set's mesh achieves, and the slopes at its vertices."""

import math

from rtin._kernels._jit import jit
from rtin._kernels.coarsening import present_directions
from rtin._kernels.lattice import is_centre, is_unit, spacing_of
from rtin._kernels.planes import triangle_error


@jit
def largest_error(heights, is_complete, kept):
    """Largest vertical distance of a sample from the mesh of a closed set.

    Every sample of a triangle that has no void corner is valid.
    """
    n_rows, n_cols = heights.shape
    largest = 0.0
    for row in range(n_rows):
        for col in range(n_cols):
            if kept[row, col] == 0:
                continue
            spacing = spacing_of(row, col)
            if is_unit(row, col, spacing):
                continue
            along_axis = is_centre(row, col, spacing)
            directions = present_directions(heights, is_complete, kept, row, col, spacing)
            for direction in range(4):
                if directions >> direction & 1:
                    error = triangle_error(heights, row, col, spacing, direction, along_axis)
                    largest = max(largest, error)
    return largest


@jit
def slope(before, here, after):
    """Rise from one node to the next: half that over two, all of one where the other is void."""
    rise, fall = after - here, here - before
    if math.isnan(rise):
        return 0.0 if math.isnan(fall) else fall
    return rise if math.isnan(fall) else (rise + fall) / 2.0


@jit
def fill_slopes(ringed, rows, cols, slopes):
    """Write the rise to the east and to the north at nodes of a tile, given with a ring of one."""
    for i in range(len(rows)):
        row, col = rows[i] + 1, cols[i] + 1
        here = float(ringed[row, col])
        west, east = float(ringed[row, col - 1]), float(ringed[row, col + 1])
        south, north = float(ringed[row + 1, col]), float(ringed[row - 1, col])
        slopes[i, 0], slopes[i, 1] = slope(west, here, east), slope(south, here, north)
