r"""The squares of a mesh, and their two diagonals.

Two triangles that share their hypotenuse make a square around its midpoint v: upright about a
centre vertex, rotated about an edge vertex::

    p-------b            b              p, q   the apexes of v
    |     / |          / | \            a, b   the ends of the edge that v bisects
    |   v   |         p  v  q           v      bisects both diagonals; its spacing is half the
    | /     |          \ | /                   side of an upright square, and half the diagonal
    a-------q            a                     of a rotated one

On its *own* diagonal a square has the triangles (a, b, p) and (b, a, q) of the hierarchy, on the
*other* one (p, q, b) and (q, p, a): the same two after a quarter turn. The other diagonal runs
along edges of the finest mesh too, so that errors at samples still bound the error everywhere.

A mesh of the wider family is a closed set K and a diagonal for each of its squares, the v outside K
with both apexes in K. Those within the tolerance have a least K. For let a triangle (a, b, p) of
the process not fit, and let K* be the vertices of any mesh within the tolerance that has p. Either
v is in K*, and so is q; or K* has the square on its other diagonal, and so has q as well. Where the
other diagonal does not fit, v must be in K*. So what the process adds is in every K*: q where the
other diagonal fits, v where it does not. Both depend on v alone, not on the order of the steps.
"""

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.lattice import (
    SQUARE,
    VERTEX,
    apexes,
    axis_direction_of,
    direction_of,
    hypotenuse_of,
    is_centre,
    is_inside,
    is_unit,
    midpoint,
    row_spans_of,
    runs_down_right,
    spacing_of,
)
from rtin._kernels.planes import triangle_error, triangle_fails, triangle_plane


@jit
def directions_of_square(row, col, spacing):
    """Directions of the first triangle on a square's own and on its other diagonal.

    The second triangle of each looks the other way: its direction is 3 minus that of the first.
    """
    if is_centre(row, col, spacing):
        return (2, 3) if runs_down_right(row, col, spacing) else (3, 2)
    return (1, 3) if row & spacing != 0 else (3, 1)


@jit
def triangle_of_square(row, col, spacing, direction):
    """Apex, legs' spacing and kind of the triangle whose hypotenuse has that vertex as midpoint."""
    if is_centre(row, col, spacing):
        row_step, col_step = direction_of(direction)
        return row - spacing * row_step, col - spacing * col_step, 2 * spacing, False
    row_step, col_step = axis_direction_of(direction)
    return row - spacing * row_step, col - spacing * col_step, spacing, True


@jit
def other_diagonal_fails(heights, max_error, tolerance, row, col):
    """Whether a square leaves the raster, or has a void, or its other diagonal does not fit."""
    spacing = spacing_of(row, col)
    n_rows, n_cols = heights.shape
    if not (spacing <= row < n_rows - spacing and spacing <= col < n_cols - spacing):
        return True
    p_row, p_col, q_row, q_col = apexes(row, col, spacing)
    between = (np.float64(heights[p_row, p_col]) + heights[q_row, q_col]) / 2
    allowed = max_error if tolerance is None else tolerance[row, col]
    if not abs(between - heights[row, col]) <= allowed:
        return True
    _, first = directions_of_square(row, col, spacing)
    for direction in (first, 3 - first):
        apex_row, apex_col, legs, along_axis = triangle_of_square(row, col, spacing, direction)
        if triangle_fails(
            heights, max_error, tolerance, apex_row, apex_col, legs, direction, along_axis
        ):
            return True
    return False


@jit
def other_diagonal_error(heights, row, col, limit):
    """Largest error on the other diagonal of a square; inf where it is more than a limit."""
    if other_diagonal_fails(heights, limit, None, row, col):
        return np.inf
    spacing = spacing_of(row, col)
    _, first = directions_of_square(row, col, spacing)
    largest = 0.0
    for direction in (first, 3 - first):
        apex_row, apex_col, legs, along_axis = triangle_of_square(row, col, spacing, direction)
        error = triangle_error(heights, apex_row, apex_col, legs, direction, along_axis)
        largest = max(largest, error)
    return largest


@jit
def remedy(heights, max_error, tolerance, swapped, row, col):
    """What to do about a triangle that fails, at the midpoint of its hypotenuse.

    The square there is swapped where that is allowed and helps; else the vertex must be kept.
    """
    if swapped is None:
        return VERTEX
    return VERTEX if other_diagonal_fails(heights, max_error, tolerance, row, col) else SQUARE


@jit
def is_swapped(swapped, first_row, end_row, row, col):
    """Whether the square around a vertex is swapped, as far as these rows can tell."""
    if swapped is None:
        return False
    return first_row <= row < end_row and swapped[row, col] != 0


@jit
def is_on_other_diagonal(kept, swapped, row, col, spacing, direction):
    """Whether the mesh has the square of a triangle on its other diagonal."""
    if swapped is None:
        return False
    # A unit triangle's midpoint is its apex, which is kept.
    mid_row, mid_col = midpoint(row, col, spacing, direction)
    return kept[mid_row, mid_col] == 0 and swapped[mid_row, mid_col] != 0


# --- the smaller squared error ------------------------------------------------------------------


@jit
def squared_error(heights, row, col, spacing, direction, along_axis):
    """Sum of the squared errors of a triangle's samples, those of its hypotenuse by half."""
    apex, row_slope, col_slope = triangle_plane(heights, row, col, spacing, direction, along_axis)
    first, last, left, left_step, right, right_step = row_spans_of(
        row, col, spacing, direction, along_axis
    )
    total = 0.0
    for sample_row in range(first, last + 1):
        distance = abs(sample_row - row)
        start, end = left + left_step * distance, right + right_step * distance + 1
        value = apex + row_slope * (sample_row - row) + col_slope * (start - col)
        samples = heights[sample_row, start:end]
        for i in range(samples.size):
            total += (samples[i] - (value + col_slope * i)) ** 2
    a_row, a_col, b_row, b_col = hypotenuse_of(row, col, spacing, direction, along_axis)
    n_steps = max(abs(b_row - a_row), abs(b_col - a_col))
    row_step, col_step = (b_row - a_row) // n_steps, (b_col - a_col) // n_steps
    start_height = np.float64(heights[a_row, a_col])
    slope = (heights[b_row, b_col] - start_height) / n_steps
    for i in range(1, n_steps):
        sample = heights[a_row + row_step * i, a_col + col_step * i]
        total -= (sample - (start_height + slope * i)) ** 2 / 2
    return total


@jit
def square_squared_error(heights, row, col, spacing, first):
    """Sum of the squared errors of a square's samples, where its first triangle looks that way."""
    total = 0.0
    for direction in (first, 3 - first):
        apex_row, apex_col, legs, along_axis = triangle_of_square(row, col, spacing, direction)
        total += squared_error(heights, apex_row, apex_col, legs, direction, along_axis)
    return total


@jit
def other_diagonal_is_closer(heights, row, col):
    """Whether a square without voids has the smaller squared error on its other diagonal."""
    spacing = spacing_of(row, col)
    own, other = directions_of_square(row, col, spacing)
    before = square_squared_error(heights, row, col, spacing, own)
    return square_squared_error(heights, row, col, spacing, other) < before


@jit
def is_first_of_square(kept, row, col, mid_row, mid_col):
    """Whether a kept apex is the first one of a square of the mesh around that midpoint."""
    size = kept.shape[0] - 1
    if not is_inside(mid_row, mid_col, size) or kept[mid_row, mid_col] != 0:
        return False
    p_row, p_col, q_row, q_col = apexes(mid_row, mid_col, spacing_of(mid_row, mid_col))
    if p_row != row or p_col != col or not is_inside(q_row, q_col, size):
        return False
    return kept[q_row, q_col] != 0


@jit
def choose_diagonals(heights, max_error, tolerance, kept, words, swapped, first_row, end_row):
    """Swap the squares that are closer to their samples on the other diagonal, and fit there.

    Does those whose first apex lies in some rows; two bands never write to the same square.
    """
    n_cols = heights.shape[1]
    for row in range(first_row, end_row):
        for word in range((n_cols + 7) // 8):
            if words[row, word] == 0:
                continue
            for col in range(8 * word, min(8 * word + 8, n_cols)):
                spacing = spacing_of(row, col)
                if kept[row, col] == 0 or spacing == 0 or is_unit(row, col, spacing):
                    continue
                for direction in range(4):
                    mid_row, mid_col = midpoint(row, col, spacing, direction)
                    if (
                        is_first_of_square(kept, row, col, mid_row, mid_col)
                        and swapped[mid_row, mid_col] == 0
                        and not other_diagonal_fails(
                            heights, max_error, tolerance, mid_row, mid_col
                        )
                        and other_diagonal_is_closer(heights, mid_row, mid_col)
                    ):
                        swapped[mid_row, mid_col] = 1
