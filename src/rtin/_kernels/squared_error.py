r"""Arithmetic of the least squares mesh: what each vertex saves, and which vertices are worth it.

A triangle is (apex, first end, second end); its halves are (midpoint, apex, first end) and
(midpoint, second end, apex)::

                 apex                          apex
                 /  \                          /|\
                /    \          is             / | \
               /      \        split         /  |  \
              /        \       into         /   |   \
         first -------- second         first - mid - second

*Gain* of a vertex: by how much the sum of squared errors falls when it is added to any mesh that
it can be added to. Two triangles share the edge that it bisects, and nothing else changes.
``kept`` holds a byte for each sample of the lattice, not 0 where the vertex is kept; ``gains`` a
number for each sample of the raster, NaN where a void is involved.
"""

import heapq

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.coarsening import keep_with_closure, triangles_gained, undo, with_room
from rtin._kernels.lattice import (
    VERTEX,
    apexes,
    height_at,
    is_inside,
    is_unit,
    midpoint,
    packed,
    spacing_of,
    unpacked,
)

_FAR = 2**31 - 1
_BEYOND_NEAREST = 4

# --- gains --------------------------------------------------------------------------------------


@jit
def products_of_hats(n_depths):
    """Sums of apex hat² and of apex hat × end hat over the halves of a triangle of each depth.

    A hat is 1 at its corner, 0 at the other two, and linear between. Samples inside count whole,
    those on an edge half, the corners by their angle: an eighth and a quarter. So a triangle's
    samples are those of its halves, and the sums of hats are exact sums of theirs.
    """
    apex_apex, apex_end = np.empty(n_depths + 1), np.empty(n_depths + 1)
    aa, ae, ee, ef = 0.25, 0.0, 0.125, 0.0
    for depth in range(n_depths, 0, -1):
        apex_apex[depth], apex_end[depth] = aa, ae
        aa, ae, ee, ef = 2.0 * ee, ef + ae, ee + ae + aa / 2, ae + aa / 2
    return apex_apex, apex_end


@jit
def set_half(corners, depth, half):
    """Write the corners of one half of the triangle at some depth to the next depth."""
    for axis in range(2):
        apex = corners[depth, axis, 0]
        first, second = corners[depth, axis, 1], corners[depth, axis, 2]
        corners[depth + 1, axis, 0] = (first + second) >> 1
        corners[depth + 1, axis, 1] = second if half else apex
        corners[depth + 1, axis, 2] = apex if half else first


@jit
def is_beyond(corners, n_rows, n_cols):
    """Whether no sample of the raster is in a triangle."""
    row, a_row, b_row = corners[0, 0], corners[0, 1], corners[0, 2]
    col, a_col, b_col = corners[1, 0], corners[1, 1], corners[1, 2]
    return min(row, a_row, b_row) >= n_rows or min(col, a_col, b_col) >= n_cols


@jit
def join_halves(surplus, halves, apex_apex, apex_end, whole):
    """Write a triangle's moments from those of its halves; return its share of the gain.

    Moments are sums of residual × hat for each of the three corners, where a residual is a sample
    less the surface. Without the midpoint, ``surplus`` above the line between the ends, residuals
    grow by surplus × the midpoint's hat. No squares of heights are ever subtracted.
    """
    before = halves[0, 0] + halves[1, 0]
    top = before + 2.0 * surplus * apex_apex
    growth = surplus * apex_end
    whole[0] = halves[0, 1] + halves[1, 2] + 2.0 * growth
    whole[1] = halves[0, 2] + growth + top / 2
    whole[2] = halves[1, 1] + growth + top / 2
    return surplus * (before + top)


@jit
def add_gains(heights, n_depths, root, gains, diagonal):
    """Add the gains in one of the root triangles: depth first, each after its halves.

    What the other root adds to as well, on the lattice's diagonal, goes to an array of its own.
    """
    n_rows, n_cols = heights.shape
    apex_apex, apex_end = products_of_hats(n_depths)
    corners = np.empty((n_depths + 1, 2, 3), np.int64)
    corners[1] = root
    moments = np.zeros((n_depths + 2, 2, 3))  # of the halves of the triangle at each depth
    n_done = np.ones(n_depths + 1, np.int64)
    n_done[1] = 0
    depth = 1
    while depth > 0:
        half = n_done[depth]
        if half == 0 and is_beyond(corners[depth], n_rows, n_cols):
            moments[depth - 1, n_done[depth - 1] - 1] = np.nan
            depth -= 1
        elif half < 2 and depth < n_depths:
            set_half(corners, depth, half)
            n_done[depth] += 1
            depth += 1
            n_done[depth] = 0
        else:
            a_row, b_row = corners[depth, 0, 1], corners[depth, 0, 2]
            a_col, b_col = corners[depth, 1, 1], corners[depth, 1, 2]
            row, col = (a_row + b_row) >> 1, (a_col + b_col) >> 1
            between = (height_at(heights, a_row, a_col) + height_at(heights, b_row, b_col)) / 2
            surplus = height_at(heights, row, col) - between
            if depth == n_depths:  # halves see a void at the apex, but the finest have no halves
                apex = height_at(heights, corners[depth, 0, 0], corners[depth, 1, 0])
                surplus += apex - apex
            whole = moments[depth - 1, n_done[depth - 1] - 1]
            gain = join_halves(surplus, moments[depth], apex_apex[depth], apex_end[depth], whole)
            if row == col:
                diagonal[row] = gain
            elif row < n_rows and col < n_cols:
                gains[row, col] += gain
            depth -= 1


@jit
def add_gains_along(line, gains):
    """Add the other half of what samples on the lattice's border count, along one side of it."""
    size = line.size - 1
    spacing = 1
    while spacing < size:
        for at in range(spacing, size, 2 * spacing):
            surplus = line[at] - (line[at - spacing] + line[at + spacing]) / 2
            total = surplus
            for away in range(1, spacing):
                hat = 1.0 - away / spacing
                for side in (-1, 1):
                    after = line[at] * hat + line[at + side * spacing] * (1.0 - hat)
                    residual = line[at + side * away] - after
                    total += hat * (2.0 * residual + surplus * hat)
            gains[at] += surplus * total / 2
        spacing *= 2


# --- the best closed set: a minimum cut ---------------------------------------------------------
# A vertex is worth its gain less the weight: a profit or a loss. Profits may flow from a vertex to
# its apexes, as much of them as wanted, and make up for losses there. When no more losses can be
# made up, the vertices with profits left over, and all that these could still flow to, are the
# smallest of the best closed sets: a maximum flow and the minimum cut beside it (Picard, "Maximal
# closure of a graph and applications to combinatorial problems", 1976). The *arc* 2 * i + slot
# leads from vertex i to one of its two apexes.


@jit
def is_inside_of(gains, row, col):
    """Whether the raster has that row and column."""
    return 0 <= row < gains.shape[0] and 0 <= col < gains.shape[1]


@jit
def candidates(gains, weight, kept, number):
    """Vertices not kept that gain more than the weight, and all their ancestors not kept.

    ``number`` is -1 everywhere, and gets the places of these in the list.
    """
    items, n_items = np.empty(1024, np.int64), 0
    for row in range(gains.shape[0]):
        for col in range(gains.shape[1]):
            if gains[row, col] > weight and kept[row, col] == 0:
                items, n_items = with_ancestors(kept, number, row, col, items, n_items)
    return items[:n_items]


@jit
def with_ancestors(kept, number, row, col, items, n_items):
    """Append a vertex and its ancestors, those that are neither kept nor listed."""
    if number[row, col] >= 0:
        return items, n_items
    size = kept.shape[0] - 1
    n_looked_at = n_items
    items = with_room(items, n_items + 1)
    items[n_items], number[row, col] = packed(row, col, VERTEX), n_items
    n_items += 1
    while n_looked_at < n_items:
        row, col, _ = unpacked(items[n_looked_at])
        n_looked_at += 1
        items = with_room(items, n_items + 2)
        p_row, p_col, q_row, q_col = apexes(row, col, spacing_of(row, col))
        for row, col in ((p_row, p_col), (q_row, q_col)):
            if is_inside(row, col, size) and kept[row, col] == 0 and number[row, col] < 0:
                items[n_items], number[row, col] = packed(row, col, VERTEX), n_items
                n_items += 1
    return items, n_items


@jit
def link(items, number):
    """The vertex at the end of each arc, and the four arcs that may end at each vertex; or -1.

    ``number`` is -1 but where it holds places in the list, and left at -1 everywhere.
    """
    for i in range(items.size):
        row, col, _ = unpacked(items[i])
        number[row, col] = i
    heads, incoming = np.full(2 * items.size, -1, np.int32), np.full((items.size, 4), -1, np.int32)
    n_incoming = np.zeros(items.size, np.int8)
    for i in range(items.size):
        row, col, _ = unpacked(items[i])
        p_row, p_col, q_row, q_col = apexes(row, col, spacing_of(row, col))
        if is_inside_of(number, p_row, p_col):
            heads[2 * i] = number[p_row, p_col]
        if is_inside_of(number, q_row, q_col):
            heads[2 * i + 1] = number[q_row, q_col]
        for arc in range(2 * i, 2 * i + 2):
            head = heads[arc]
            if head >= 0:
                incoming[head, n_incoming[head]] = arc
                n_incoming[head] += 1
    for item in items:
        row, col, _ = unpacked(item)
        number[row, col] = -1
    return heads, incoming


@jit
def measure_distances(heads, incoming, flow, balance, losses, distance, queue):
    """Write to how many arcs away a loss is, for the vertices near one; list these nearest first.

    Near means no more than a few arcs beyond the nearest profit: looking at all of the vertices
    took twice as long in the end, and no farther than the nearest profit as well. Returns the
    number of losses, which come first, and of vertices near one.
    """
    n_near, n_looked_at, farthest = 0, 0, _FAR
    for i in losses:
        if balance[i] < 0.0:
            queue[n_near], distance[i] = i, 0
            n_near += 1
    n_losses = n_near
    while n_looked_at < n_near and distance[queue[n_looked_at]] < farthest:
        i = queue[n_looked_at]
        n_looked_at += 1
        n_before = n_near
        for arc in incoming[i]:
            if arc >= 0 and distance[arc >> 1] == _FAR:
                queue[n_near], distance[arc >> 1] = arc >> 1, distance[i] + 1
                n_near += 1
        for arc in range(2 * i, 2 * i + 2):
            head = heads[arc]
            if head >= 0 and flow[arc] > 0.0 and distance[head] == _FAR:
                queue[n_near], distance[head] = head, distance[i] + 1
                n_near += 1
        for j in queue[n_before:n_near]:
            if farthest == _FAR and balance[j] > 0.0:
                farthest = distance[j] + _BEYOND_NEAREST
    return n_losses, n_near


@jit
def push_profit(heads, incoming, flow, balance, distance, i):
    """Let a vertex's profit flow to vertices one arc nearer to a loss, as much as they take."""
    nearer = distance[i] - 1
    for arc in range(2 * i, 2 * i + 2):
        head = heads[arc]
        if head >= 0 and distance[head] == nearer:
            taken = balance[i] if nearer > 0 else min(balance[i], max(-balance[head], 0.0))
            flow[arc] += taken
            balance[i] -= taken
            balance[head] += taken
    for arc in incoming[i]:
        if arc >= 0 and distance[arc >> 1] == nearer:
            taken = min(balance[i], flow[arc])
            if nearer == 0:
                taken = min(taken, max(-balance[arc >> 1], 0.0))
            flow[arc] -= taken
            balance[i] -= taken
            balance[arc >> 1] += taken


@jit
def make_up_for_losses(heads, incoming, balance):
    """Send profits to losses until no more can be done; return the flow along each arc.

    ``balance`` holds profits and losses, and is left with what remains of them. Each round sends
    profits the shortest way, the farthest first. What is stuck then has a longer way to go in the
    next round, so the rounds come to an end: a dozen or two on real terrain of any size.
    """
    flow = np.zeros(heads.size)
    losses, queue = np.arange(balance.size), np.empty(balance.size, np.int64)
    distance = np.full(balance.size, _FAR, np.int32)
    n_losses, n_pushed = balance.size, 1
    while n_pushed > 0:
        n_losses, n_near = measure_distances(
            heads, incoming, flow, balance, losses[:n_losses], distance, queue
        )
        losses[:n_losses] = queue[:n_losses]
        n_pushed = 0
        for i in queue[:n_near][::-1]:
            if balance[i] > 0.0:
                push_profit(heads, incoming, flow, balance, distance, i)
                n_pushed += 1
        for i in queue[:n_near]:
            distance[i] = _FAR
    return flow


@jit
def reached_by_profits(heads, incoming, flow, balance):
    """Whether each vertex has a profit left, or more could flow to it from one that has."""
    is_reached = balance > 0.0
    stack = np.empty(balance.size, np.int64)
    n_stack = 0
    for i in np.flatnonzero(is_reached):
        stack[n_stack] = i
        n_stack += 1
    while n_stack > 0:
        n_stack -= 1
        i = stack[n_stack]
        for arc in range(2 * i, 2 * i + 2):
            head = heads[arc]
            if head >= 0 and not is_reached[head]:
                is_reached[head], stack[n_stack] = True, head
                n_stack += 1
        for arc in incoming[i]:
            if arc >= 0 and flow[arc] > 0.0 and not is_reached[arc >> 1]:
                is_reached[arc >> 1], stack[n_stack] = True, arc >> 1
                n_stack += 1
    return is_reached


@jit
def best_closed_set(items, gains, weight, number):
    """Whether each vertex of a list is in the smallest closed set of the largest total worth.

    The list holds all ancestors of its vertices but those that are kept anyway.
    """
    heads, incoming = link(items, number)
    balance = gains_of(items, gains)
    for i in range(items.size):
        balance[i] -= weight
    flow = make_up_for_losses(heads, incoming, balance)
    return reached_by_profits(heads, incoming, flow, balance)


@jit
def gains_of(items, gains):
    """Gains of the vertices of a list."""
    found = np.empty(items.size)
    for i in range(items.size):
        row, col, _ = unpacked(items[i])
        found[i] = gains[row, col]
    return found


# --- budgets ------------------------------------------------------------------------------------


@jit
def triangles_gained_by(items, n_rows, n_cols):
    """How many triangles the vertices of a list add."""
    gained = 0
    for item in items:
        row, col, _ = unpacked(item)
        gained += triangles_gained(row, col, n_rows, n_cols)
    return gained


@jit
def keep_all(kept, items):
    """Keep the vertices of a list."""
    for item in items:
        row, col, _ = unpacked(item)
        kept[row, col] = 1


@jit
def append_neighbours(heads, incoming, part, n_part, is_listed, i):
    """Append the vertices at the other ends of a vertex's arcs, those not listed yet."""
    for arc in range(2 * i, 2 * i + 2):
        if heads[arc] >= 0 and not is_listed[heads[arc]]:
            part[n_part], is_listed[heads[arc]] = heads[arc], True
            n_part += 1
    for arc in incoming[i]:
        if arc >= 0 and not is_listed[arc >> 1]:
            part[n_part], is_listed[arc >> 1] = arc >> 1, True
            n_part += 1
    return n_part


@jit
def keep_parts(shape, kept, items, number, room):
    """Keep one after another the parts of a list that need nothing of each other, where they fit.

    Returns how many vertices and triangles may still be added then.
    """
    heads, incoming = link(items, number)
    room = room.copy()
    is_listed = np.zeros(items.size, np.bool_)
    part = np.empty(items.size, np.int64)
    for first in range(items.size):
        if is_listed[first]:
            continue
        part[0], is_listed[first] = first, True
        n_part, n_looked_at = 1, 0
        while n_looked_at < n_part:
            i = part[n_looked_at]
            n_part = append_neighbours(heads, incoming, part, n_part, is_listed, i)
            n_looked_at += 1
        vertices = items[part[:n_part]]
        n_triangles = triangles_gained_by(vertices, shape[0], shape[1])
        if n_part <= room[0] and n_triangles <= room[1]:
            keep_all(kept, vertices)
            room[0] -= n_part
            room[1] -= n_triangles
    return room


@jit
def gain_with_closure(gains, kept, item, stack, added):
    """Mean gain of a vertex and the ancestors that it needs; these, of which there are so many."""
    stack[0] = item
    added, n_added = keep_with_closure(kept, stack, 1, added, 0)
    undo(kept, added[:n_added])
    return gains_of(added[:n_added], gains).sum() / n_added, added, n_added


@jit
def push_if_it_fits(heap, gains, kept, item, room, stack, added):
    """Put a vertex on the heap, unless what it needs has no room; then it never will.

    What others keep of its ancestors takes up as much room as it takes from its need.
    """
    row, col, _ = unpacked(item)
    if triangles_gained(row, col, gains.shape[0], gains.shape[1]) > room[1]:
        return added
    mean, added, n_added = gain_with_closure(gains, kept, item, stack, added)
    n_triangles = triangles_gained_by(added[:n_added], gains.shape[0], gains.shape[1])
    if mean > 0.0 and n_added <= room[0] and n_triangles <= room[1]:
        heapq.heappush(heap, (-mean, item))
    return added


@jit
def push_children(heap, gains, kept, item, room, stack, added):
    """Put the midpoints of the triangles around a newly kept vertex on the heap."""
    row, col, _ = unpacked(item)
    spacing = spacing_of(row, col)
    if is_unit(row, col, spacing):
        return added
    for direction in range(4):
        mid_row, mid_col = midpoint(row, col, spacing, direction)
        if is_inside_of(gains, mid_row, mid_col) and kept[mid_row, mid_col] == 0:
            child = packed(mid_row, mid_col, VERTEX)
            added = push_if_it_fits(heap, gains, kept, child, room, stack, added)
    return added


@jit
def keep_greedily(gains, kept, items, room):
    """Keep vertices of a list, and what they need, the largest mean gain first, while they fit.

    Means change when others are kept. A vertex whose mean has fallen goes back to the heap when it
    is met; children of what is kept, whose means may have risen, go there again at once.
    ``room`` is how many vertices and triangles may be added; returns what is left of it.
    """
    room = room.copy()
    stack, added = np.empty(256, np.int64), np.empty(256, np.int64)
    heap = [(0.0, np.int64(0))]
    heap.pop()
    for item in items:
        added = push_if_it_fits(heap, gains, kept, item, room, stack, added)
    while len(heap) > 0 and room.min() > 0:
        promised, item = heapq.heappop(heap)
        row, col, _ = unpacked(item)
        if kept[row, col] != 0:
            continue
        mean, added, n_added = gain_with_closure(gains, kept, item, stack, added)
        n_triangles = triangles_gained_by(added[:n_added], gains.shape[0], gains.shape[1])
        if mean < -promised or n_added > room[0] or n_triangles > room[1]:
            added = push_if_it_fits(heap, gains, kept, item, room, stack, added)
            continue
        newly_kept = added[:n_added].copy()
        keep_all(kept, newly_kept)
        room[0] -= n_added
        room[1] -= n_triangles
        for parent in newly_kept:
            added = push_children(heap, gains, kept, parent, room, stack, added)
    return room
