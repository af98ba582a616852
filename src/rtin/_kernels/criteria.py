"""Arithmetic of the criteria: Eq. (1) at every vertex, and a mesh's surface at every sample."""

import numpy as np

from rtin._kernels._jit import jit


@jit
def error_between(before, here, after):
    """Eq. (1): how far a height is from the middle of two others."""
    return abs((np.float64(before) + after) / 2 - here)


@jit
def errors_along_row(here, spacing, errors):
    """E(v) of the edge vertices whose longest edge lies in a row, level by level.

    The finest level is written at every column, which runs at vector speed; later levels and
    ``errors_across_row`` write over the columns that are theirs.
    """
    n_cols = here.size
    for col in range(1, n_cols - 1):
        errors[col] = error_between(here[col - 1], here[col], here[col + 1])
    errors[n_cols - 1] = np.inf
    step = 2
    while step < spacing:
        for col in range(step, n_cols - step, 2 * step):
            errors[col] = error_between(here[col - step], here[col], here[col + step])
        errors[(n_cols - 1) // step * step] = np.inf
        step *= 2


@jit
def errors_across_row(above, here, below, row, spacing, errors):
    """E(v) of a row's edge vertices with an upright longest edge, and of its centre vertices."""
    n_cols = here.size
    for col in range(0, n_cols, 2 * spacing):
        errors[col] = error_between(above[col], here[col], below[col])
    for col in range(spacing, n_cols - spacing, 2 * spacing):
        slant = spacing if (row ^ col) & (2 * spacing) == 0 else -spacing
        errors[col] = error_between(above[col - slant], here[col], below[col + slant])
    last = (n_cols - 1) // spacing
    if last & 1:
        errors[last * spacing] = np.inf


@jit
def errors_of_odd_row(above, here, below, row, errors):
    """E(v) of a row of the finest level: edge vertices in even columns, centre ones in odd columns.

    All three differences at every column: at vector speed, twice as quick as each at its own.
    """
    last = here.size - 1
    for col in range(1, last):
        upright = error_between(above[col], here[col], below[col])
        down_right = error_between(above[col - 1], here[col], below[col + 1])
        up_right = error_between(above[col + 1], here[col], below[col - 1])
        centre = down_right if (row ^ col) & 2 == 0 else up_right
        errors[col] = upright if col & 1 == 0 else centre
    errors[0] = error_between(above[0], here[0], below[0])
    errors[last] = np.inf if last & 1 else error_between(above[last], here[last], below[last])


@jit
def row_errors(heights, size, row, errors):
    """Write E(v) of one row: inf where v's longest edge leaves the raster, NaN beside a void."""
    spacing = row & -row if 0 < row < size else size
    reaches_down = spacing < size and row + spacing < heights.shape[0]
    if spacing == 1 and reaches_down:
        errors_of_odd_row(heights[row - 1], heights[row], heights[row + 1], row, errors)
        return
    if spacing > 1:
        errors_along_row(heights[row], spacing, errors)
    if reaches_down:
        errors_across_row(
            heights[row - spacing], heights[row], heights[row + spacing], row, spacing, errors
        )
    else:
        errors[::spacing] = np.inf


@jit
def fill_errors(heights, size, first_row, end_row, errors):
    """Write E(v) of some rows."""
    row_buffer = np.empty(heights.shape[1], np.float64)
    for row in range(first_row, end_row):
        row_errors(heights, size, row, row_buffer)
        for col in range(heights.shape[1]):
            errors[row, col] = row_buffer[col]


@jit
def columns_between(a_row, a_col, b_row, b_col, row, left, right):
    """Widen left and right to where the edge from a to b meets a row, if it does."""
    if row < min(a_row, b_row) or row > max(a_row, b_row):
        return left, right
    if a_row == b_row:
        return min(left, min(a_col, b_col)), max(right, max(a_col, b_col))
    col = a_col + (row - a_row) * (b_col - a_col) / (b_row - a_row)
    return min(left, col), max(right, col)


@jit
def rows_covered(places, triangles, triangle, n_rows):
    """First and last row of samples that a triangle may cover; first > last where there is none."""
    a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
    top = min(places[a, 0], places[b, 0], places[c, 0])
    bottom = max(places[a, 0], places[b, 0], places[c, 0])
    if not (bottom >= 0.0 and top <= n_rows - 1):
        return 1, 0
    return int(max(top, 0.0)), int(min(np.ceil(bottom), n_rows - 1))


@jit
def count_by_band(places, triangles, first, end, band_of_row, counts):
    """Write how many of some triangles reach into each band of rows."""
    for triangle in range(first, end):
        top, bottom = rows_covered(places, triangles, triangle, band_of_row.size)
        if top <= bottom:
            for band in range(band_of_row[top], band_of_row[bottom] + 1):
                counts[band] += 1


@jit
def fill_by_band(places, triangles, first, end, band_of_row, ends, members):
    """List some of the triangles that reach into each band of rows, from where it ends so far."""
    for triangle in range(first, end):
        top, bottom = rows_covered(places, triangles, triangle, band_of_row.size)
        if top <= bottom:
            for band in range(band_of_row[top], band_of_row[bottom] + 1):
                members[ends[band]] = triangle
                ends[band] += 1


@jit
def rise(places, z, a, b, c):
    """Height of the plane through three vertices per row and per column; NaN on a flat line."""
    a_row, a_col = places[a, 0] - places[c, 0], places[a, 1] - places[c, 1]
    b_row, b_col = places[b, 0] - places[c, 0], places[b, 1] - places[c, 1]
    determinant = a_row * b_col - b_row * a_col
    if determinant == 0.0:
        return np.nan, np.nan
    a_rise, b_rise = z[a] - z[c], z[b] - z[c]
    row_slope = (a_rise * b_col - b_rise * a_col) / determinant
    return row_slope, (b_rise * a_row - a_rise * b_row) / determinant


@jit
def first_and_end_row(places, a, b, c, first_row, end_row):
    """Rows from first_row to before end_row that have samples within 1e-9 cells of a triangle."""
    top = min(places[a, 0], places[b, 0], places[c, 0])
    bottom = max(places[a, 0], places[b, 0], places[c, 0])
    first = max(first_row, int(np.ceil(max(top, first_row) - 1e-9)))
    return first, min(end_row, int(np.floor(min(bottom, end_row) + 1e-9)) + 1)


@jit
def first_and_end_col(places, a, b, c, row, n_cols):
    """Columns of the samples in a row that are within 1e-9 cells of a triangle."""
    a_row, b_row, c_row = places[a, 0], places[b, 0], places[c, 0]
    a_col, b_col, c_col = places[a, 1], places[b, 1], places[c, 1]
    at = min(max(np.float64(row), min(a_row, b_row, c_row)), max(a_row, b_row, c_row))
    left, right = np.inf, -np.inf
    left, right = columns_between(a_row, a_col, b_row, b_col, at, left, right)
    left, right = columns_between(b_row, b_col, c_row, c_col, at, left, right)
    left, right = columns_between(c_row, c_col, a_row, a_col, at, left, right)
    first = int(np.ceil(min(max(left, 0.0), n_cols) - 1e-9))
    return max(0, first), min(n_cols, int(np.floor(min(right, n_cols) + 1e-9)) + 1)


@jit
def fill_surface(places, z, triangles, members, first_row, surface):
    """Write a mesh's height at each sample of some rows that it covers.

    ``places`` holds row and column of each vertex, ``members`` lists the triangles that reach into
    these rows. On a shared edge the last triangle writes, whose plane agrees there.
    """
    end_row, n_cols = first_row + surface.shape[0], surface.shape[1]
    for triangle in members:
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        row_slope, col_slope = rise(places, z, a, b, c)
        if np.isnan(row_slope):
            continue
        start, stop = first_and_end_row(places, a, b, c, first_row, end_row)
        for row in range(start, stop):
            value = z[c] + row_slope * (row - places[c, 0])
            left, right = first_and_end_col(places, a, b, c, row, n_cols)
            for col in range(left, right):
                surface[row - first_row, col] = value + col_slope * (col - places[c, 1])


@jit
def is_off(places, z, a, b, c, heights, tolerance):
    """Whether some sample under the triangle (a, b, c) is farther from it than is allowed there.

    ``tolerance`` is of the raster's shape, or has one row and column for all samples.
    """
    one = tolerance.size == 1
    row_slope, col_slope = rise(places, z, a, b, c)
    start, stop = first_and_end_row(places, a, b, c, 0, heights.shape[0])
    for row in range(start, stop):
        value = z[c] + row_slope * (row - places[c, 0])
        left, right = first_and_end_col(places, a, b, c, row, heights.shape[1])
        for col in range(left, right):
            allowed = tolerance[0, 0] if one else tolerance[row, col]
            if abs(value + col_slope * (col - places[c, 1]) - heights[row, col]) > allowed:
                return True
    return False


@jit
def find_off(places, z, triangles, first, end, heights, tolerance, wanted):
    """Of the wanted triangles from first to before end, keep those that are off, in place."""
    for triangle in range(first, end):
        if wanted[triangle]:
            a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
            wanted[triangle] = is_off(places, z, a, b, c, heights, tolerance)


@jit
def error_statistics(heights, first_row, surface):
    """Samples compared and uncovered, sums of |e| and e², largest |e| and its row and column.

    ``heights`` and ``surface`` hold the rows from ``first_row`` on.
    """
    compared, uncovered = 0, 0
    total, total_of_squares = 0.0, 0.0
    largest, worst_row, worst_col = -1.0, -1, -1
    for i in range(surface.shape[0]):
        for col in range(surface.shape[1]):
            height = heights[i, col]
            if np.isnan(height):
                continue
            error = abs(surface[i, col] - height)
            if np.isnan(error):
                uncovered += 1
                continue
            compared += 1
            total += error
            total_of_squares += error * error
            if error > largest:
                largest, worst_row, worst_col = error, first_row + i, col
    return compared, uncovered, total, total_of_squares, largest, worst_row, worst_col
