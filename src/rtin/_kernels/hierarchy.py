"""Arithmetic of the hierarchy for level of detail: the errors and extents of all vertices.

The proper vertices of a spacing ``1 << level`` come as two generations: its centre vertices, then
its edge vertices. The children of a vertex, of which it is an apex, are all of the next generation.
``layout`` says where the hierarchy keeps each: first entry, entries a row and rows of the centre
vertices of a level, then the same of its edge vertices. The edge vertices of spacing 1, half of
all, are not kept: a few samples tell all about them.

    own[i]      the largest error of the triangles whose hypotenuse i bisects; not of spacing 1
    wholes[i]   for each of these two, as bits, whether any and whether all its unit triangles are
                whole, which is to say that they have three heights
    bounds[i]   error, lowest and highest sample of i and all its descendants; the error is negative
                where a triangle of theirs has to be split to tell heights from voids
"""

import numpy as np

from rtin._kernels._jit import inlined, jit
from rtin._kernels.coarsening import is_valid
from rtin._kernels.lattice import (
    apexes,
    hypotenuse,
    is_centre,
    is_inside,
    midpoint,
    row_spans,
    runs_down_right,
    spacing_of,
)
from rtin._kernels.planes import largest_in_row, triangle_plane

CENTRE, EDGE = 0, 3  # columns of the layout
ANY, ALL = 1, 2
WHOLE = 5 * (ANY | ALL)  # both triangles
ERROR, LOW, HIGH = 0, 1, 2
SMALL = 16  # the spacing of triangles that are searched sample by sample
SHORT = 8  # rows of triangles for which vector speed does not pay
LEAST = 1e-45  # that float32 holds


# --- where the hierarchy keeps a vertex -----------------------------------------------------------


@jit
def level_of(spacing):
    """The exponent of a spacing."""
    level = 0
    while spacing >> (level + 1):
        level += 1
    return level


@inlined
def holds(layout, level, kind, row, col):
    """Whether a vertex of the lattice is in the hierarchy: not far outside the raster."""
    shift = level + 1 if kind == CENTRE else level
    return row >> shift < layout[level, kind + 2] and col >> (level + 1) < layout[level, kind + 1]


@inlined
def entry_of(layout, level, kind, row, col):
    """Where the hierarchy keeps a vertex."""
    shift = level + 1 if kind == CENTRE else level
    return layout[level, kind] + (row >> shift) * layout[level, kind + 1] + (col >> (level + 1))


@inlined
def vertex_at(level, kind, i, j):
    """Row and column of the vertex in row i and place j of its generation."""
    if kind == CENTRE:
        return (2 * i + 1) << level, (2 * j + 1) << level
    return i << level, (2 * j + 1 - (i & 1)) << level


# --- the errors of triangles ----------------------------------------------------------------------


@jit
def direction_towards(along_axis, row_step, col_step):
    """The direction of a triangle whose midpoint lies that way from its apex."""
    if not along_axis:
        return 2 * (row_step > 0) + (col_step > 0)
    if row_step != 0:
        return 3 * (row_step > 0)
    return 2 - (col_step > 0)


@inlined
def search(heights, plane_row, plane_col, plane, row, col, direction, largest):
    """The largest distance from a plane, of ``largest`` and those of a triangle's samples."""
    apex, row_slope, col_slope = plane
    first, last, left, left_step, right, right_step = row_spans(
        row, col, spacing_of(row, col), direction
    )
    is_short = last - first <= SHORT
    for sample_row in range(first, last + 1):
        distance = abs(sample_row - row)
        start, end = left + left_step * distance, right + right_step * distance + 1
        value = apex + row_slope * (sample_row - plane_row) + col_slope * (start - plane_col)
        if not is_short:
            largest = largest_in_row(heights, sample_row, start, end, value, col_slope, largest)
            continue
        for i in range(end - start):
            error = abs(heights[sample_row, start + i] - (value + col_slope * i))
            largest = error if error > largest else largest
    return largest


@inlined
def tilt(heights, plane_row, plane_col, plane, row, col):
    """The distance of one sample from a plane."""
    apex, row_slope, col_slope = plane
    value = apex + row_slope * (row - plane_row) + col_slope * (col - plane_col)
    return abs(value - heights[row, col])


@inlined
def side_of(row, col, apex_row, apex_col):
    """By how many bits what is said of the triangle with that apex is shifted."""
    p_row, p_col, _, _ = apexes(row, col, spacing_of(row, col))
    return 0 if p_row == apex_row and p_col == apex_col else 2


@jit
def part_bound(heights, layout, own, wholes, plane_row, plane_col, plane, row, col, direction):
    """No sample of a part of a triangle is farther from its plane; inf where nothing is known."""
    v_row, v_col = midpoint(row, col, spacing_of(row, col), direction)
    spacing = spacing_of(v_row, v_col)
    kind = CENTRE if is_centre(v_row, v_col, spacing) else EDGE
    entry = entry_of(layout, level_of(spacing), kind, v_row, v_col)
    if not wholes[entry] >> side_of(v_row, v_col, row, col) & ALL:
        return np.inf  # the own error leaves out triangles that have a void for a corner
    a_row, a_col, b_row, b_col = hypotenuse(row, col, spacing_of(row, col), direction)
    farthest = tilt(heights, plane_row, plane_col, plane, row, col)
    farthest = max(farthest, tilt(heights, plane_row, plane_col, plane, a_row, a_col))
    farthest = max(farthest, tilt(heights, plane_row, plane_col, plane, b_row, b_col))
    return farthest + own[entry]


@inlined
def triangle_error(heights, layout, own, wholes, row, col, direction):
    """Largest distance of a sample of a triangle with three heights from its plane."""
    spacing = spacing_of(row, col)
    plane = triangle_plane(heights, row, col, spacing, direction, is_centre(row, col, spacing))
    if spacing <= SMALL:
        return search(heights, row, col, plane, row, col, direction, 0.0)
    return search_parts(heights, layout, own, wholes, plane, row, col, direction)


@jit
def search_parts(heights, layout, own, wholes, plane, row, col, direction):
    """The same by branch and bound, the more promising half first.

    No sample of a part is farther away than the part's own error and the distance of its corners
    together.
    """
    largest = 0.0
    stack, bounds, n_stack = np.empty((64, 3), np.int64), np.empty(64, np.float64), 1
    stack[0, 0], stack[0, 1], stack[0, 2], bounds[0] = row, col, direction, np.inf
    while n_stack > 0:
        n_stack -= 1
        if bounds[n_stack] <= largest:
            continue
        t_row, t_col, t_direction = stack[n_stack, 0], stack[n_stack, 1], stack[n_stack, 2]
        t_spacing = spacing_of(t_row, t_col)
        if t_spacing <= SMALL:
            largest = search(heights, row, col, plane, t_row, t_col, t_direction, largest)
            continue
        v_row, v_col = midpoint(t_row, t_col, t_spacing, t_direction)
        a_row, a_col, b_row, b_col = hypotenuse(t_row, t_col, t_spacing, t_direction)
        along_axis = is_centre(v_row, v_col, spacing_of(v_row, v_col))
        for leg in range(2):
            end_row, end_col = (a_row, a_col) if leg == 0 else (b_row, b_col)
            to_row, to_col = (t_row + end_row) // 2 - v_row, (t_col + end_col) // 2 - v_col
            half = direction_towards(along_axis, to_row, to_col)
            stack[n_stack + leg, 0], stack[n_stack + leg, 1] = v_row, v_col
            stack[n_stack + leg, 2] = half
            bounds[n_stack + leg] = part_bound(
                heights, layout, own, wholes, row, col, plane, v_row, v_col, half
            )
        if bounds[n_stack] > bounds[n_stack + 1]:
            bounds[n_stack], bounds[n_stack + 1] = bounds[n_stack + 1], bounds[n_stack]
            stack[n_stack, 2], stack[n_stack + 1, 2] = stack[n_stack + 1, 2], stack[n_stack, 2]
        n_stack += 2
    return largest


@inlined
def own_error(heights, layout, own, wholes, bits, row, col):
    """The largest error of the triangles whose hypotenuse a vertex bisects; rounded up.

    ``bits`` is what ``wholes`` says of the vertex.
    """
    spacing = spacing_of(row, col)
    p_row, p_col, q_row, q_col = apexes(row, col, spacing)
    largest = 0.0
    for side in range(2):
        a_row, a_col = (p_row, p_col) if side == 0 else (q_row, q_col)
        is_whole = bits >> (2 * side) & ALL
        if is_whole or has_three_heights(heights, row, col, a_row, a_col):
            direction = direction_towards(
                not is_centre(row, col, spacing), row - a_row, col - a_col
            )
            error = triangle_error(heights, layout, own, wholes, a_row, a_col, direction)
            largest = max(largest, error)
    return rounded_up(largest)


@jit
def rounded_up(value):
    """A float32 that is no less than a value of zero or more, and above it unless that is 0."""
    if value == 0.0:
        return np.float32(0.0)
    return np.nextafter(np.float32(max(value, LEAST)), np.float32(np.inf))


@jit
def rounded_down(value):
    """A float32 below a value."""
    return np.nextafter(np.float32(value), np.float32(-np.inf))


@inlined
def has_height(heights, row, col):
    """Whether there is a sample with a height at a place, which may be outside the lattice."""
    return row >= 0 and col >= 0 and is_valid(heights, row, col)


@inlined
def ends_of(row, col):
    """Both ends of the edge that a vertex bisects, as (row, col, row, col)."""
    spacing = spacing_of(row, col)
    p_row, p_col, q_row, q_col = apexes(row, col, spacing)
    if is_centre(row, col, spacing):
        return p_row, q_col, q_row, p_col
    row_step, col_step = col - p_col, row - p_row
    return row - row_step, col - col_step, row + row_step, col + col_step


@inlined
def has_three_heights(heights, row, col, apex_row, apex_col):
    """Whether the triangle with that apex, whose hypotenuse a vertex bisects, has three heights."""
    a_row, a_col, b_row, b_col = ends_of(row, col)
    return (
        has_height(heights, apex_row, apex_col)
        and has_height(heights, a_row, a_col)
        and has_height(heights, b_row, b_col)
    )


# --- wholes ---------------------------------------------------------------------------------------


@inlined
def unit_wholes(heights, row, col):
    """What ``wholes`` would say of an edge vertex of spacing 1."""
    p_row, p_col, q_row, q_col = apexes(row, col, 1)
    a_row, a_col, b_row, b_col = ends_of(row, col)
    if not has_height(heights, row, col):
        return 0
    bits = 0
    with_a, with_b = has_height(heights, a_row, a_col), has_height(heights, b_row, b_col)
    if has_height(heights, p_row, p_col):
        bits |= (with_a or with_b) * ANY | (with_a and with_b) * ALL
    if has_height(heights, q_row, q_col):
        bits |= ((with_a or with_b) * ANY | (with_a and with_b) * ALL) << 2
    return bits


@inlined
def joined_wholes(heights, layout, wholes, row, col):
    """What ``wholes`` is to say of a vertex, by what it says of its children."""
    spacing = spacing_of(row, col)
    level = level_of(spacing)
    from_centre = is_centre(row, col, spacing)
    size = 1 << len(layout)
    p_row, p_col, q_row, q_col = apexes(row, col, spacing)
    bits = 0
    for side in range(2):
        a_row, a_col = (p_row, p_col) if side == 0 else (q_row, q_col)
        if not is_inside(a_row, a_col, size):
            continue
        some, all_ = 0, ANY | ALL
        for direction in range(4):
            u_row, u_col = midpoint(row, col, spacing, direction)
            if (u_row - row) * (a_row - row) + (u_col - col) * (a_col - col) <= 0:
                continue
            of_child = 0
            if from_centre and spacing == 1:
                of_child = unit_wholes(heights, u_row, u_col)
            elif from_centre and holds(layout, level, EDGE, u_row, u_col):
                of_child = wholes[entry_of(layout, level, EDGE, u_row, u_col)]
            elif not from_centre and holds(layout, level - 1, CENTRE, u_row, u_col):
                of_child = wholes[entry_of(layout, level - 1, CENTRE, u_row, u_col)]
            of_child = of_child >> side_of(u_row, u_col, row, col)
            some |= of_child & ANY
            all_ &= of_child
        bits |= (some | all_ & ALL) << (2 * side)
    return bits


@inlined
def must_split(heights, bits, row, col):
    """Whether a triangle whose hypotenuse a vertex bisects is neither whole nor to be dropped."""
    p_row, p_col, q_row, q_col = apexes(row, col, spacing_of(row, col))
    for side in range(2):
        a_row, a_col = (p_row, p_col) if side == 0 else (q_row, q_col)
        of_side = bits >> (2 * side)
        if of_side & ALL:
            continue
        if of_side & ANY or has_three_heights(heights, row, col, a_row, a_col):
            return True
    return False


# --- the hierarchy --------------------------------------------------------------------------------


@jit
def touches(kind, spacing, row, col, patch):
    """Whether a triangle whose hypotenuse a vertex bisects may have a sample of a patch.

    The patch is given by its first and end row, and its first and end column.
    """
    down = max(patch[0] - row, row - patch[1] + 1, 0)
    across = max(patch[2] - col, col - patch[3] + 1, 0)
    return max(down, across) <= spacing if kind == CENTRE else down + across <= spacing


@jit
def renew_own(heights, layout, patch, level, kind, first, end, left, right, own, wholes):
    """Write own errors and wholes of some rows and places of a generation, if a patch matters."""
    size = 1 << len(layout)
    for i in range(first, end):
        for j in range(left, right):
            row, col = vertex_at(level, kind, i, j)
            if is_inside(row, col, size) and touches(kind, 1 << level, row, col, patch):
                entry = entry_of(layout, level, kind, row, col)
                if level == 0 and is_whole_cell(heights, row, col):
                    wholes[entry] = WHOLE
                    continue
                wholes[entry] = joined_wholes(heights, layout, wholes, row, col)
                if level > 0:
                    own[entry] = own_error(heights, layout, own, wholes, wholes[entry], row, col)


@inlined
def unit_bounds(heights, row, col):
    """What ``bounds`` would say of an edge vertex of spacing 1, not rounded."""
    if 0 < row < heights.shape[0] - 1 and 0 < col < heights.shape[1] - 1:
        height, up, down = heights[row, col], heights[row - 1, col], heights[row + 1, col]
        left, right = heights[row, col - 1], heights[row, col + 1]
        if height + up + down + left + right == height + up + down + left + right:
            a, b = (up, down) if row & 1 else (left, right)
            return abs((np.float64(a) + b) / 2 - height), np.float64(height), np.float64(height)
    return unit_bounds_at_voids(heights, row, col)


@jit
def unit_bounds_at_voids(heights, row, col):
    """The same where one of the samples around it may be a void."""
    height, error = np.nan, 0.0
    if has_height(heights, row, col):
        height = np.float64(heights[row, col])
        p_row, p_col, q_row, q_col = apexes(row, col, 1)
        if has_three_heights(heights, row, col, p_row, p_col) or has_three_heights(
            heights, row, col, q_row, q_col
        ):
            a_row, a_col, b_row, b_col = ends_of(row, col)
            between = (np.float64(heights[a_row, a_col]) + heights[b_row, b_col]) / 2
            error = abs(between - height)
    if must_split(heights, unit_wholes(heights, row, col), row, col):
        low, high = range_of_corners(heights, row, col)
        return -max(error, LEAST), low, high
    return error, height, height


@inlined
def bounds_of(heights, layout, bounds, level, kind, row, col):
    """Error, lowest and highest sample of a vertex and its descendants; NaN where there is none."""
    if kind == EDGE and level == 0:
        return unit_bounds(heights, row, col)
    entry = entry_of(layout, level, kind, row, col)
    return (
        np.float64(bounds[entry, ERROR]),
        np.float64(bounds[entry, LOW]),
        np.float64(bounds[entry, HIGH]),
    )


@inlined
def widen(low, high, other_low, other_high):
    """The range that holds both; of one that is NaN the other."""
    low = other_low if not low <= other_low else low
    high = other_high if not high >= other_high else high
    return low, high


@inlined
def is_whole_cell(heights, row, col):
    """Whether all nine samples around a centre vertex of spacing 1 have a height."""
    if row + 1 >= heights.shape[0] or col + 1 >= heights.shape[1]:
        return False
    total = 0.0
    for i in range(row - 1, row + 2):
        total += heights[i, col - 1] + heights[i, col] + heights[i, col + 1]
    return total == total


@inlined
def bounds_of_cell(heights, growth, row, col):
    """Error, lowest and highest sample of such a vertex and its children: the common case, fast."""
    nw, n, ne = as_three(heights, row - 1, col)
    w, centre, e = as_three(heights, row, col)
    sw, s, se = as_three(heights, row + 1, col)
    across = nw + se if runs_down_right(row, col, 1) else ne + sw
    of_edges = max(
        abs((nw + ne) / 2 - n),
        abs((sw + se) / 2 - s),
        abs((nw + sw) / 2 - w),
        abs((ne + se) / 2 - e),
    )
    low = min(nw, n, ne, w, centre, e, sw, s, se)
    high = max(nw, n, ne, w, centre, e, sw, s, se)
    return max(abs(across / 2 - centre), growth * of_edges), low, high


@inlined
def as_three(heights, row, col):
    """A sample and its neighbours to the left and right, as float64."""
    return (
        np.float64(heights[row, col - 1]),
        np.float64(heights[row, col]),
        np.float64(heights[row, col + 1]),
    )


@jit
def renew_bounds(
    heights, layout, growth, level, kind, first, end, left, right, own, wholes, bounds
):
    """Write the bounds of some rows and places of a generation, by those of the next one."""
    size = 1 << len(layout)
    child_level, child_kind = (level, EDGE) if kind == CENTRE else (level - 1, CENTRE)
    for i in range(first, end):
        for j in range(left, right):
            row, col = vertex_at(level, kind, i, j)
            if not is_inside(row, col, size):
                continue
            entry = entry_of(layout, level, kind, row, col)
            if level == 0 and is_whole_cell(heights, row, col):
                error, low, high = bounds_of_cell(heights, growth, row, col)
                bounds[entry, ERROR] = rounded_up(error)
                bounds[entry, LOW], bounds[entry, HIGH] = rounded_down(low), -rounded_down(-high)
                continue
            if level > 0:
                error = np.float64(own[entry])
            else:
                error = np.float64(own_error(heights, layout, own, wholes, wholes[entry], row, col))
            splits = must_split(heights, wholes[entry], row, col)
            low, high = np.nan, np.nan
            if level == 0 or wholes[entry] != WHOLE:  # else the children tell of all corners
                low, high = range_of_corners(heights, row, col)
            for direction in range(4):
                u_row, u_col = midpoint(row, col, 1 << level, direction)
                if not is_inside(u_row, u_col, size):
                    continue
                if not holds(layout, child_level, child_kind, u_row, u_col):
                    continue
                u_error, u_low, u_high = bounds_of(
                    heights, layout, bounds, child_level, child_kind, u_row, u_col
                )
                splits |= u_error < 0.0
                error = max(error, growth * abs(u_error))
                if u_low == u_low:
                    low, high = widen(low, high, u_low, u_high)
            rounded = rounded_up(error)
            bounds[entry, ERROR] = -max(rounded, np.float32(LEAST)) if splits else rounded
            bounds[entry, LOW], bounds[entry, HIGH] = rounded_down(low), -rounded_down(-high)


@inlined
def range_of_corners(heights, row, col):
    """Lowest and highest of a vertex and the corners around it; NaN where all are voids."""
    low, high = np.nan, np.nan
    p_row, p_col, q_row, q_col = apexes(row, col, spacing_of(row, col))
    a_row, a_col, b_row, b_col = ends_of(row, col)
    for r, c in ((row, col), (p_row, p_col), (q_row, q_col), (a_row, a_col), (b_row, b_col)):
        if has_height(heights, r, c):
            height = np.float64(heights[r, c])
            low, high = widen(low, high, height, height)
    return low, high
