"""Arithmetic of tiles: what a closed set's mesh achieves."""

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
