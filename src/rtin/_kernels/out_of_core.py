"""Arithmetic of rasters beyond memory: what a part of the samples says of a large triangle."""

from rtin._kernels._jit import jit
from rtin._kernels.lattice import row_spans_of
from rtin._kernels.planes import valid_in_row


@jit
def see_part(
    heights,
    first_row,
    first_col,
    row,
    col,
    spacing,
    direction,
    along_axis,
    apex,
    row_slope,
    col_slope,
    max_error,
):
    """Whether a triangle has, in a window, a valid sample; and one void or out of tolerance.

    ``heights`` is the window from ``first_row`` and ``first_col`` on, the triangle's apex is at
    ``row`` and ``col``, its height is ``apex``. Heights of the plane are rounded as
    ``planes.triangle_fails`` rounds them, which has all samples at hand.
    """
    end_row, end_col = first_row + heights.shape[0], first_col + heights.shape[1]
    first, last, left, left_step, right, right_step = row_spans_of(
        row, col, spacing, direction, along_axis
    )
    valid, faults = 0, 0
    for sample_row in range(max(first, first_row), min(last + 1, end_row)):
        distance = abs(sample_row - row)
        start, end = left + left_step * distance, right + right_step * distance + 1
        seen_from, seen_to = max(start, first_col), min(end, end_col)
        if seen_from >= seen_to:
            continue
        samples = heights[sample_row - first_row, seen_from - first_col : seen_to - first_col]
        if faults == 0:
            value = apex + row_slope * (sample_row - row) + col_slope * (start - col)
            before = seen_from - start
            for i in range(samples.size):
                faults += not abs(samples[i] - (value + col_slope * (before + i))) <= max_error
        if valid == 0:
            valid = valid_in_row(
                heights, sample_row - first_row, seen_from - first_col, seen_to - first_col
            )
        if valid > 0 and faults > 0:
            break
    return valid > 0, faults > 0
