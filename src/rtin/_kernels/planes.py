"""Triangles of the lattice as planes: how far their samples are, and which triangles fit.

A triangle is an apex, a spacing, a direction, and whether its hypotenuse runs along an axis: the
triangles of the hierarchy have the spacing of their apex and ``is_centre`` of it.
"""

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.lattice import (
    hypotenuse,
    hypotenuse_of,
    is_centre,
    midpoint,
    row_spans,
    row_spans_of,
)


@jit
def triangle_plane(heights, row, col, spacing, direction, along_axis):
    """Plane through the corners of a triangle: height at the apex, slope per row, slope per column.

    The corners lie a power of two apart, so for float32 heights of one range nothing is rounded.
    """
    a_row, a_col, b_row, b_col = hypotenuse_of(row, col, spacing, direction, along_axis)
    apex = np.float64(heights[row, col])
    a = np.float64(heights[a_row, a_col])
    b = np.float64(heights[b_row, b_col])
    if not along_axis:
        if a_col == col:
            return apex, (a - apex) / (a_row - row), (b - apex) / (b_col - col)
        return apex, (b - apex) / (b_row - row), (a - apex) / (a_col - col)
    towards_apex = (a + b) / 2 - apex
    if a_row == b_row:
        return apex, towards_apex / (a_row - row), (a - b) / (a_col - b_col)
    return apex, (a - b) / (a_row - b_row), towards_apex / (a_col - col)


@jit
def midpoint_fails(heights, max_error, tolerance, row, col, spacing, direction):
    """Whether the midpoint of the hypotenuse is out of tolerance; False where a void is involved.

    Most triangles that must be split show it there, for a tenth of the cost of the whole test.
    """
    n_rows, n_cols = heights.shape
    a_row, a_col, b_row, b_col = hypotenuse(row, col, spacing, direction)
    if max(a_row, b_row) >= n_rows or max(a_col, b_col) >= n_cols:
        return False
    mid_row, mid_col = midpoint(row, col, spacing, direction)
    between = (np.float64(heights[a_row, a_col]) + heights[b_row, b_col]) / 2
    allowed = max_error if tolerance is None else tolerance[mid_row, mid_col]
    return abs(between - heights[mid_row, mid_col]) > allowed


@jit
def faults_in_row(heights, row, start, end, value, slope, max_error, tolerance):
    """Number of samples of a row that are void or further from value + slope * i than allowed."""
    samples = heights[row, start:end]
    limits = None if tolerance is None else tolerance[row, start:end]
    faults = 0
    for i in range(samples.size):
        allowed = max_error if limits is None else limits[i]
        faults += not abs(samples[i] - (value + slope * i)) <= allowed
    return faults


@jit
def valid_in_row(heights, row, start, end):
    """Number of samples of a row that are not void."""
    valid = 0
    for height in heights[row, start:end]:
        valid += height == height
    return valid


@jit
def triangle_fails(heights, max_error, tolerance, row, col, spacing, direction, along_axis):
    """Whether a triangle inside the raster has a sample that is void or out of tolerance."""
    apex, row_slope, col_slope = triangle_plane(heights, row, col, spacing, direction, along_axis)
    first, last, left, left_step, right, right_step = row_spans_of(
        row, col, spacing, direction, along_axis
    )
    for sample_row in range(first, last + 1):
        distance = abs(sample_row - row)
        start, end = left + left_step * distance, right + right_step * distance + 1
        value = apex + row_slope * (sample_row - row) + col_slope * (start - col)
        if faults_in_row(heights, sample_row, start, end, value, col_slope, max_error, tolerance):
            return True
    return False


@jit
def triangle_fails_or_is_mixed(heights, max_error, tolerance, row, col, spacing, direction):
    """Whether a triangle has a valid sample, and one that is void or out of tolerance.

    Samples below or to the right of the raster are void.
    """
    n_rows, n_cols = heights.shape
    first, last, left, left_step, right, right_step = row_spans(row, col, spacing, direction)
    apex, row_slope, col_slope = np.nan, np.nan, np.nan
    if last < n_rows and max(right, right + right_step * spacing) < n_cols:
        apex, row_slope, col_slope = triangle_plane(
            heights, row, col, spacing, direction, is_centre(row, col, spacing)
        )
    valid, faults = 0, 0
    for sample_row in range(first, last + 1):
        distance = abs(sample_row - row)
        start, end = left + left_step * distance, right + right_step * distance + 1
        if sample_row >= n_rows or end > n_cols:
            faults += 1
            end = min(end, n_cols)
        if valid == 0 and sample_row < n_rows:
            valid = valid_in_row(heights, sample_row, start, end)
        if faults == 0:
            value = apex + row_slope * (sample_row - row) + col_slope * (start - col)
            faults = faults_in_row(
                heights, sample_row, start, end, value, col_slope, max_error, tolerance
            )
        if valid > 0 and faults > 0:
            return True
    return False


@jit
def largest_in_row(heights, row, start, end, value, slope, largest):
    """The largest of ``largest`` and the distances of a row's samples from value + slope * i.

    Voids have no distance.
    """
    # Counting runs at vector speed, a running maximum does not: look only where it rises.
    if faults_in_row(heights, row, start, end, value, slope, largest, None):
        for i in range(end - start):
            distance = abs(heights[row, start + i] - (value + slope * i))
            if distance > largest:
                largest = distance
    return largest


@jit
def triangle_error(heights, row, col, spacing, direction, along_axis):
    """Largest distance of a sample of a triangle without voids from its plane."""
    apex, row_slope, col_slope = triangle_plane(heights, row, col, spacing, direction, along_axis)
    first, last, left, left_step, right, right_step = row_spans_of(
        row, col, spacing, direction, along_axis
    )
    largest = 0.0
    for sample_row in range(first, last + 1):
        distance = abs(sample_row - row)
        start, end = left + left_step * distance, right + right_step * distance + 1
        value = apex + row_slope * (sample_row - row) + col_slope * (start - col)
        largest = largest_in_row(heights, sample_row, start, end, value, col_slope, largest)
    return largest
