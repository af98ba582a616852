r"""The lattice of the RTIN hierarchy: spacings, triangles, their samples and corners.

Every triangle but the two roots came from a bisection at its apex, so (apex, direction) names it,
and the apex alone tells its size::

    edge vertex c, spacing s               centre vertex c, spacing s
    (one coordinate an odd multiple of s)  (both odd multiples of s)

          b                                     a-------b
        / | \                                    \     /
       m  |  m     four triangles, directions      \ m /     four triangles, directions
      /   |   \    (±1, ±1): legs s along the      \ /      (±1, 0) and (0, ±1): the
     a----c----a   axes, hypotenuse a diagonal       c        hypotenuse is a side of
      \   |   /    whose midpoint m lies s/2          ...      the cell around c, with
       m  |  m     away on both axes                          midpoint m at distance s
        \ | /
          b

The corners (0, size) and (size, 0) of the lattice act as edge vertices of spacing ``size``: their
one triangle inside the lattice is a root. ``packed`` stores a triangle as one integer: row and
column of its apex, and its direction; direction 4 means the vertex itself, 5 the square of the two
triangles whose hypotenuse it bisects.
"""

import numpy as np

from rtin._kernels._jit import inlined, jit

VERTEX, SQUARE = 4, 5


def pack(row, col, direction):
    """One integer for a triangle, or a vertex or square where the direction says so; arrays too."""
    return (row << 34) | (col << 3) | direction


packed = jit(pack)


@jit
def unpacked(item):
    """Row, column and direction of what ``packed`` stored."""
    return item >> 34, (item >> 3) & 0x7FFFFFFF, item & 7


def rows_of(items):
    """Rows of an array of packed triangles or vertices."""
    return items >> 34


@inlined
def height_at(heights, row, col):
    """The height of a sample of the lattice; NaN beyond the raster."""
    if row < heights.shape[0] and col < heights.shape[1]:
        return np.float64(heights[row, col])
    return np.nan


@jit
def spacing_of(row, col):
    """Distance between samples on the level whose proper vertex this is; 0 at the origin."""
    coordinates = row | col
    return coordinates & -coordinates


@jit
def is_centre(row, col, spacing):
    """Whether a proper vertex of that spacing is a centre vertex (else an edge vertex)."""
    return row & spacing != 0 and col & spacing != 0


@jit
def runs_down_right(row, col, spacing):
    """Whether the longest edge of a centre vertex goes from north-west to south-east."""
    return ((row - spacing) ^ (col - spacing)) & (2 * spacing) == 0


@jit
def apexes(row, col, spacing):
    """Both parents of a vertex as (row, col, row, col); some lie outside on the border."""
    if is_centre(row, col, spacing):
        if runs_down_right(row, col, spacing):
            return row - spacing, col + spacing, row + spacing, col - spacing
        return row - spacing, col - spacing, row + spacing, col + spacing
    if row & spacing != 0:
        return row, col - spacing, row, col + spacing
    return row - spacing, col, row + spacing, col


@jit
def direction_of(direction):
    """Row and column step of a diagonal direction 0 to 3."""
    return (direction & 2) - 1, 2 * (direction & 1) - 1


@jit
def axis_direction_of(direction):
    """Row and column step of an axis direction 0 to 3: a diagonal one turned by 45 degrees."""
    row_step, col_step = direction_of(direction)
    return (row_step + col_step) // 2, (col_step - row_step) // 2


@jit
def midpoint(row, col, spacing, direction):
    """Midpoint of the hypotenuse of the triangle with that apex and direction.

    A unit triangle has none; callers leave out edge vertices of spacing 1.
    """
    if is_centre(row, col, spacing):
        row_step, col_step = axis_direction_of(direction)
        return row + spacing * row_step, col + spacing * col_step
    row_step, col_step = direction_of(direction)
    return row + spacing // 2 * row_step, col + spacing // 2 * col_step


@jit
def hypotenuse(row, col, spacing, direction):
    """Both ends of the hypotenuse, as (row, col, row, col).

    With the apex they go round the triangle in the same sense for all triangles: (a, b, apex) is
    counter-clockwise where rows run south and columns run east.
    """
    return hypotenuse_of(row, col, spacing, direction, is_centre(row, col, spacing))


@jit
def hypotenuse_of(row, col, spacing, direction, along_axis):
    """The same for a triangle that need not be one of the hierarchy."""
    if along_axis:
        row_step, col_step = axis_direction_of(direction)
        mid_row, mid_col = row + spacing * row_step, col + spacing * col_step
        return (
            mid_row + spacing * col_step,
            mid_col - spacing * row_step,
            mid_row - spacing * col_step,
            mid_col + spacing * row_step,
        )
    row_step, col_step = direction_of(direction)
    if row_step == col_step:
        return row + spacing * row_step, col, row, col + spacing * col_step
    return row, col + spacing * col_step, row + spacing * row_step, col


@jit
def is_inside(row, col, size):
    """Whether the lattice of size + 1 samples a side has that row and column."""
    return 0 <= row <= size and 0 <= col <= size


@jit
def is_unit(row, col, spacing):
    """Whether the triangles with that apex are the finest ones, which are never split."""
    return spacing == 1 and not is_centre(row, col, spacing)


@jit
def row_spans(row, col, spacing, direction):
    """Samples of a triangle, row by row: (first row, last row, left, left step, right, right step).

    On the row i rows from the apex they are the columns left + i * left step to
    right + i * right step, both included.
    """
    return row_spans_of(row, col, spacing, direction, is_centre(row, col, spacing))


@jit
def row_spans_of(row, col, spacing, direction, along_axis):
    """The same for a triangle that need not be one of the hierarchy."""
    if along_axis:
        row_step, col_step = axis_direction_of(direction)
        if row_step != 0:
            first = min(row, row + spacing * row_step)
            return first, first + spacing, col, -1, col, 1
        if col_step > 0:
            return row - spacing, row + spacing, col, 1, col + spacing, 0
        return row - spacing, row + spacing, col - spacing, 0, col, -1
    row_step, col_step = direction_of(direction)
    first = min(row, row + spacing * row_step)
    if col_step > 0:
        return first, first + spacing, col, 0, col + spacing, -1
    return first, first + spacing, col - spacing, 1, col, 0
