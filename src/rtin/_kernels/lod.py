"""Arithmetic of level of detail: the walk down a hierarchy, the mesh of it, and budgets.

``heights``, ``layout`` and ``bounds`` are those of ``_kernels.hierarchy``.
"""

import numpy as np

from rtin._kernels._jit import inlined, jit
from rtin._kernels.coarsening import with_room
from rtin._kernels.hierarchy import CENTRE, EDGE, ERROR, HIGH, LOW, unit_bounds
from rtin._kernels.lattice import height_at, is_centre, is_inside, spacing_of

MIXED = 4  # beside a slot: a triangle is split there to tell heights from voids
BLOCK = 512  # vertices whose children are weighed together


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
    """The smallest weight such that above it, and above any larger, a budget is never exceeded.

    ``n_triangles`` are there without any vertex. Returns -1 where all fit. The smallest of all that
    fit it need not be: at voids a triangle may be split into fewer that are drawn.
    """
    keys = weights[4:].view(np.int64) >> 46  # a bucket for each 64th of an octave
    if keys.size == 0:
        return -1.0
    lowest = keys.min()
    gains, rises = np.zeros((2, keys.max() - lowest + 1), np.int64)
    for i in range(keys.size):
        gained = triangles_gained(z, around, slots, i + 4)
        gains[keys[i] - lowest] += gained
        rises[keys[i] - lowest] += max(gained, 0)
    for bucket in range(gains.size - 1, -1, -1):
        if n_triangles + rises[bucket] > budget:
            numbers = np.flatnonzero(keys == bucket + lowest) + 4
            weight = first_too_many(z, around, slots, weights, numbers, n_triangles, budget)
            if weight >= 0.0:
                return weight
        n_triangles += gains[bucket]
    return -1.0


@jit
def first_too_many(z, around, slots, weights, numbers, n_triangles, budget):
    """The largest weight of some vertices which, with all above, exceeds a budget; -1 if none."""
    numbers = numbers[np.argsort(-weights[numbers])]
    i = 0
    while i < numbers.size:
        weight = weights[numbers[i]]
        while i < numbers.size and weights[numbers[i]] == weight:
            n_triangles += triangles_gained(z, around, slots, numbers[i])
            i += 1
        if n_triangles > budget:
            return weight
    return -1.0
