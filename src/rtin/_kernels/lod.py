"""Arithmetic of level of detail: a hierarchy of errors and extents, and the walk down it.

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
from rtin._kernels.coarsening import is_valid, with_room
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
ERROR, LOW, HIGH = 0, 1, 2
MIXED = 4  # beside a slot: a triangle is split there to tell heights from voids
SMALL = 16  # the spacing of triangles that are searched sample by sample
SHORT = 8  # rows of triangles for which vector speed does not pay
LEAST = 1e-45  # that float32 holds
BLOCK = 512  # vertices whose children are weighed together


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


@jit
def triangle_error(heights, layout, own, wholes, row, col, direction):
    """Largest distance of a sample of a triangle with three heights from its plane.

    By branch and bound, the more promising half first: no sample of a part is farther away than
    the part's own error and the distance of its corners together.
    """
    spacing = spacing_of(row, col)
    plane = triangle_plane(heights, row, col, spacing, direction, is_centre(row, col, spacing))
    if spacing <= SMALL:
        return search(heights, row, col, plane, row, col, direction, 0.0)
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
def own_error(heights, layout, own, wholes, row, col):
    """The largest error of the triangles whose hypotenuse a vertex bisects; rounded up."""
    spacing = spacing_of(row, col)
    p_row, p_col, q_row, q_col = apexes(row, col, spacing)
    largest = 0.0
    for side in range(2):
        a_row, a_col = (p_row, p_col) if side == 0 else (q_row, q_col)
        if has_three_heights(heights, row, col, a_row, a_col):
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
                    wholes[entry] = 5 * (ANY | ALL)
                    continue
                wholes[entry] = joined_wholes(heights, layout, wholes, row, col)
                if level > 0:
                    own[entry] = own_error(heights, layout, own, wholes, row, col)


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
                error = np.float64(own_error(heights, layout, own, wholes, row, col))
            splits = must_split(heights, wholes[entry], row, col)
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


# --- the walk -------------------------------------------------------------------------------------


@jit
def reach_of(level, kind):
    """Rows and columns from a vertex to the farthest sample of its descendants."""
    return (3 << level) - 2 if kind == CENTRE else (2 << level) - 2


@jit
def side_of_planes(planes, row, col, reach, low, high):
    """-1 where a box of samples lies outside one of the planes wholly, 1 inside all, 0 between."""
    middle, half, is_inside_all = (low + high) / 2, (high - low) / 2, True
    for i in range(planes.shape[0]):
        a, b, c = planes[i, 0], planes[i, 1], planes[i, 2]
        farthest = (abs(a) + abs(b)) * reach + abs(c) * half
        of_middle = a * row + b * col + c * middle + planes[i, 3]
        if of_middle + farthest < 0.0:
            return -1
        # By more than rounding: then boxes inside this one need not be looked at.
        is_inside_all &= of_middle > (1.0 + 1e-6) * farthest + 1e-9 * abs(planes[i, 3])
    return 1 if is_inside_all else 0


@jit
def as_seen(error, scale, down, across, up):
    """An error in pixels, at the distance of those three parts."""
    distance = np.sqrt(down * down + across * across + up * up)
    if distance > 0.0:
        return error * scale / distance
    return np.inf if error > 0.0 else 0.0


@jit
def step_of(kind, slot):
    """Row and column step to the child of that kind in a slot.

    Slots go round clockwise: from north to an edge vertex, from north-west to a centre vertex.
    """
    if kind == EDGE:
        return (slot == 2) - (slot == 0), (slot == 1) - (slot == 3)
    return 2 * (slot > 1) - 1, 2 * (slot == 1 or slot == 2) - 1


@inlined
def height_at(heights, row, col):
    """The height at a place of the lattice; NaN outside the raster."""
    if row < heights.shape[0] and col < heights.shape[1]:
        return np.float64(heights[row, col])
    return np.nan


@jit
def propose(layout, level, kind, first, end, places, around, slots, children, proposed):
    """List the children, of that level and kind, whose apexes are all there; return their number.

    Each comes from one apex, the ``number`` first to before end, in a slot of it; the ``other`` is
    its sibling across the edge that the child bisects. Both surround a corner of that edge, their
    own apex, in neighbouring slots::

            other o           the corner's children: other and number
                  | \
                  u   corner
                  | /
           number o
    """
    size = 1 << len(layout)
    row_shift, col_shift = level + 1 if kind == CENTRE else level, level + 1
    n_rows, width = layout[level, kind + 2], layout[level, kind + 1]
    turn = kind == CENTRE
    first_slot, n = 2 if kind == CENTRE else 1, 0
    for number in range(first, end):
        row, col = places[number, 0], places[number, 1]
        is_on_border = kind == EDGE and (row >> level == 1 or col >> level == 1)
        for turned in range(4 if is_on_border else 2):
            slot = (turned + first_slot) & 3
            row_step, col_step = step_of(kind, slot)
            u_row, u_col = row + (row_step << level), col + (col_step << level)
            if not is_inside(u_row, u_col, size):
                continue
            if u_row >> row_shift >= n_rows or u_col >> col_shift >= width:
                continue
            other = -1
            if is_inside(u_row + (row_step << level), u_col + (col_step << level), size):
                if turned >= 2:
                    continue  # the other one proposes it
                corner_slot = (slot + 1 - turn) & 3
                if (corner_slot ^ slots[number]) & 1 == 0:
                    corner = around[number, corner_slot]
                    other = children[corner, (corner_slot + 3) & 3]
                else:
                    corner = around[number, (slot - turn) & 3]
                    other = children[corner, (slot - turn + 1) & 3]
                if other < 0:
                    continue
            proposed[n, 0], proposed[n, 1], proposed[n, 2] = u_row, u_col, slot
            proposed[n, 3], proposed[n, 4] = number, other
            n += 1
    return n


@jit
def weigh(heights, layout, bounds, eye, level, kind, proposed, n_proposed, weights, weighed):
    """Write weight, lowest and highest sample of what is proposed; mark in its slot what is mixed.

    Nothing here depends on what is found, so that reads from far away overlap.
    """
    start, width = layout[level, kind], layout[level, kind + 1]
    row_shift, col_shift = level + 1 if kind == CENTRE else level, level + 1
    eye_row, eye_col, eye_z, scale = eye[0], eye[1], eye[2], eye[6]
    row_length, col_length = eye[3], eye[4]
    breadth = (2 << level) * eye[5] * (np.sqrt(2.0) if kind == CENTRE else 1.0)
    reach_of_samples = reach_of(level, kind) + 1e-6
    for i in range(n_proposed):
        row, col, other = proposed[i, 0], proposed[i, 1], proposed[i, 4]
        weight = weights[proposed[i, 3]]
        weight = min(weight, weights[other]) if other >= 0 else weight
        if kind == EDGE and level == 0:
            error, low, high = unit_bounds(heights, row, col)
        else:
            entry = start + (row >> row_shift) * width + (col >> col_shift)
            error = np.float64(bounds[entry, ERROR])
            low, high = np.float64(bounds[entry, LOW]), np.float64(bounds[entry, HIGH])
        is_mixed = error < 0.0
        if scale == 0.0:
            weight = min(weight, np.inf if is_mixed else error)
        else:
            # The outline is off as far as the corners of finest triangles are.
            reach = reach_of_samples + is_mixed
            down = max(abs(row - eye_row) - reach, 0.0) * row_length
            across = max(abs(col - eye_col) - reach, 0.0) * col_length
            up = max(low - eye_z, eye_z - high, 0.0)
            error = max(-error, breadth) if is_mixed else error
            weight = min(weight, as_seen(error, scale, down, across, up))
        proposed[i, 2] += MIXED * is_mixed
        weighed[i, 0], weighed[i, 1], weighed[i, 2] = weight, low, high


@jit
def accept(
    heights,
    planes,
    tolerance,
    level,
    kind,
    proposed,
    weighed,
    n_proposed,
    places,
    z,
    around,
    slots,
    weights,
    children,
    is_within,
    n,
):
    """Append what is proposed and weighs more than a tolerance."""
    turn, first = kind == CENTRE, n
    reach_of_samples = reach_of(level, kind) + 1e-6
    for i in range(n_proposed):
        weight = weighed[i, 0]
        if not weight > tolerance:
            continue
        row, col, number, other = proposed[i, 0], proposed[i, 1], proposed[i, 3], proposed[i, 4]
        is_mixed, slot = proposed[i, 2] >> 2, proposed[i, 2] & 3
        is_within[n] = is_within[number]
        if not is_within[n]:
            reach, low, high = reach_of_samples + is_mixed, weighed[i, 1], weighed[i, 2]
            side = side_of_planes(planes, row, col, reach, low, high)
            if side < 0:
                continue
            is_within[n] = side > 0
        places[n, 0], places[n, 1] = row, col
        around[n, slot] = other
        around[n, (slot + 1) & 3] = around[number, (slot + 1 - turn) & 3]
        around[n, (slot + 2) & 3] = number
        around[n, (slot + 3) & 3] = around[number, (slot - turn) & 3]
        slots[n], weights[n] = proposed[i, 2], weight
        children[n, 0] = children[n, 1] = children[n, 2] = children[n, 3] = -1
        children[number, slot] = n
        if other >= 0:
            children[other, (slot + 2) & 3] = n
        n += 1
    for number in range(first, n):  # apart from the rest, for reads from far away to overlap
        z[number] = height_at(heights, places[number, 0], places[number, 1])
    return n


@jit
def walk(heights, layout, bounds, eye, planes, tolerance, most):
    """Every vertex that weighs more than a tolerance, from the coarsest on; at most about ``most``.

    What a vertex weighs is how large the error without it and its descendants may be. ``eye`` holds
    row, column and height of the eye; what a row and a column are long, at least; what either is,
    at most; and the pixels of a height of 1 at a distance of 1, 0 where heights themselves count.
    What lies outside a plane weighs nothing.

    Of each vertex: its place and height; the numbers of the four corners around it, clockwise from
    north or north-west, -1 where that is outside; the slot of its second apex among them, which is
    its own slot around the first, and whether it is mixed; what it weighs. The first four are the
    lattice's corners.
    """
    size = 1 << len(layout)
    places, z = np.empty((1024, 2), np.int32), np.empty(1024, np.float64)
    around, slots = np.empty((1024, 4), np.int32), np.empty(1024, np.uint8)
    weights, children = np.empty(1024, np.float64), np.empty((1024, 4), np.int32)
    is_within = np.empty(1024, np.bool_)
    around[:4], slots[:4], weights[:4], children[:4] = -1, 0, np.inf, -1
    is_within[:4] = planes.shape[0] == 0
    for corner in range(4):
        places[corner, 0], places[corner, 1] = (corner >> 1) * size, (corner & 1) * size
        z[corner] = height_at(heights, places[corner, 0], places[corner, 1])
    # The roots' apexes are the corners in the north-east and the south-west.
    around[2, 0], around[2, 1], around[1, 2], around[1, 3] = 0, 3, 3, 0
    children[3, 3] = 2  # the sibling across the first centre vertex
    proposed, weighed = np.empty((4 * BLOCK, 5), np.int64), np.empty((4 * BLOCK, 3), np.float64)
    first, end, n = 1, 3, 4
    for generation in range(2 * len(layout)):
        level = len(layout) - 1 - generation // 2
        kind = EDGE if generation & 1 else CENTRE
        n_needed = n + 4 * (end - first)
        if n_needed > slots.size:
            larger = max(n_needed, 2 * slots.size)
            places, around = with_rows(places, n, larger), with_rows(around, n, larger)
            slots, weights = with_room(slots, larger), with_room(weights, larger)
            z, is_within = with_room(z, larger), with_room(is_within, larger)
            children = with_rows(children, n, larger)
        n_before = n
        for block in range(first, end, BLOCK):
            n_proposed = propose(
                layout,
                level,
                kind,
                block,
                min(block + BLOCK, end),
                places,
                around,
                slots,
                children,
                proposed,
            )
            weigh(heights, layout, bounds, eye, level, kind, proposed, n_proposed, weights, weighed)
            n = accept(
                heights,
                planes,
                tolerance,
                level,
                kind,
                proposed,
                weighed,
                n_proposed,
                places,
                z,
                around,
                slots,
                weights,
                children,
                is_within,
                n,
            )
        first, end = n_before, n
        if first == end or n > most:
            break
    return places[:n], z[:n], around[:n], slots[:n], weights[:n]


@jit
def with_rows(array, n_rows, n_wanted):
    """A longer copy of the first rows of an array."""
    longer = np.empty((n_wanted, array.shape[1]), array.dtype)
    longer[:n_rows] = array[:n_rows]
    return longer


# --- the mesh -------------------------------------------------------------------------------------


@jit
def taken_slots(around, slots, weights, tolerance):
    """For each vertex the slots, as bits, whose triangles are split."""
    taken = np.zeros(slots.size, np.uint8)
    for number in range(4, slots.size):
        if weights[number] > tolerance:
            slot = slots[number] & 3
            taken[around[number, (slot + 2) & 3]] |= 1 << slot
            if around[number, slot] >= 0:
                taken[around[number, slot]] |= 1 << ((slot + 2) & 3)
    return taken


@jit
def triangles_of(places, z, around, slots, weights, tolerance, flip):
    """The triangles of the vertices above a tolerance: hypotenuse first, apex last."""
    taken = taken_slots(around, slots, weights, tolerance)
    triangles, n = np.empty((2 * slots.size + 2, 3), np.int32), 0
    for number in range(1, slots.size):
        if (number >= 4 and not weights[number] > tolerance) or z[number] != z[number]:
            continue
        row, col = places[number, 0], places[number, 1]
        turn = 1 - is_centre(row, col, spacing_of(row, col))
        for slot in range(4):
            if taken[number] >> slot & 1:
                continue
            a, b = around[number, (slot + 1 - turn) & 3], around[number, (slot - turn) & 3]
            if a < 0 or b < 0 or z[a] + z[b] != z[a] + z[b]:
                continue
            triangles[n, 0] = b if flip else a
            triangles[n, 1] = a if flip else b
            triangles[n, 2] = number
            n += 1
    return triangles[:n]


@jit
def renumber(triangles, n_vertices):
    """Number the vertices that triangles have anew, in place; return their numbers so far."""
    number_of = np.full(n_vertices, -1, np.int32)
    for i in range(triangles.shape[0]):
        for corner in range(3):
            number_of[triangles[i, corner]] = 0
    before = np.flatnonzero(number_of == 0)
    for number in range(before.size):
        number_of[before[number]] = number
    for i in range(triangles.shape[0]):
        for corner in range(3):
            triangles[i, corner] = number_of[triangles[i, corner]]
    return before


@jit
def fill_vertices(transform, places, z, around, slots, numbers, vertices, coarser):
    """Write x, y and z of some vertices, and the height of the edge that each bisects.

    Its own height where it is mixed: the triangles before were not drawn, or over voids, so no
    promise was kept on that edge.
    """
    for i in range(numbers.size):
        number = numbers[i]
        row, col = places[number, 0], places[number, 1]
        vertices[i, 0] = transform[0] * col + transform[1] * row + transform[2]
        vertices[i, 1] = transform[3] * col + transform[4] * row + transform[5]
        vertices[i, 2] = coarser[i] = z[number]
        slot = slots[number]
        if number >= 4 and slot < MIXED:
            between = (z[around[number, (slot + 1) & 3]] + z[around[number, (slot + 3) & 3]]) / 2
            if between == between:
                coarser[i] = between


# --- budgets --------------------------------------------------------------------------------------


@inlined
def triangles_gained(z, around, slots, number):
    """How many triangles more there are with a vertex than without it."""
    gained, slot = 0, slots[number]
    # As numbers: NumPy's booleans can't be subtracted.
    with_self = int(not np.isnan(z[number]))
    with_a = int(not np.isnan(z[around[number, (slot + 1) & 3]]))
    with_b = int(not np.isnan(z[around[number, (slot + 3) & 3]]))
    for side in range(0, 4, 2):
        apex = around[number, (slot + side) & 3]
        if apex >= 0 and z[apex] == z[apex]:
            gained += with_self * (with_a + with_b) - with_a * with_b
    return gained


@jit
def tolerance_within(z, around, slots, weights, n_triangles, budget):
    """The smallest weight at which the vertices above it make no more triangles than a budget.

    ``n_triangles`` are there without any vertex. Returns -1 where all fit.
    """
    keys = weights[4:].view(np.int64) >> 46  # a bucket for each 64th of an octave
    if keys.size == 0:
        return -1.0
    lowest = keys.min()
    gains = np.zeros(keys.max() - lowest + 1, np.int64)
    for i in range(keys.size):
        gains[keys[i] - lowest] += triangles_gained(z, around, slots, i + 4)
    bucket = gains.size - 1
    while bucket >= 0 and n_triangles + gains[bucket] <= budget:
        n_triangles += gains[bucket]
        bucket -= 1
    if bucket < 0:
        return -1.0
    numbers = np.flatnonzero(keys == bucket + lowest) + 4
    numbers = numbers[np.argsort(-weights[numbers])]
    i = 0
    while i < numbers.size:
        weight, of_ties = weights[numbers[i]], 0
        while i < numbers.size and weights[numbers[i]] == weight:
            of_ties += triangles_gained(z, around, slots, numbers[i])
            i += 1
        if n_triangles + of_ties > budget:
            return weight
        n_triangles += of_ties
    return -1.0
