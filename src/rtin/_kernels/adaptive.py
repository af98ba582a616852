"""Refining and coarsening a mesh in place, at a cost that grows with what changes.

Triangles lie in *slots* without gaps; of the vertices' slots some are free. Corners, sides,
half-edges, twins and patterns are those of ``refinement`` and ``adjacency``.

Whole numbers of a triangle lie side by side in a row of ``cells``, those of a vertex in a row of
``nodes``: one cache line each, and few arrays to hand around, which takes Numba time for each.
"""

from typing import NamedTuple

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.adjacency import has_area, next_edge, next_side, previous_edge
from rtin._kernels.refinement import (
    ALL_SIDES,
    DEPTH,
    N_CHILDREN,
    child_of,
    gather,
    mark_and_propagate,
    owns,
    rotated,
    set_midpoint,
    side_to_bisect,
)

# Columns of ``cells``, after the three corners: the twins of the three sides; the triangle of the
# initial mesh that it lies in; how many bisections it is from that; and two of no meaning between
# calls, of which the marks are zero then.
TWINS, ROOT, LEVEL, MARKS, SCRATCH, N_CELL = 3, 6, 7, 8, 9, 10

# Columns of ``nodes``, after the two ends of the edge whose midpoint a vertex is (-1 if it is
# none): which call of refine has made it (0 if none, -1 in a free slot); a half-edge that leaves
# it; whether it waits to be looked at (zero between calls); and the stack of free slots.
STAMP, LEAVING, WAITS, FREE, N_NODE = 2, 3, 4, 5, 6

# Places in ``counts``; the last one is the number of the latest call of refine.
N_TRIANGLES, N_VERTEX_SLOTS, N_FREE, LATEST = 0, 1, 2, 3

# Kinds of an event, what becomes of two slots' values: [kind, slot, other slot].
COPY, MEAN, MIX = 0, 1, 2  # slot = other; slot = mean of both; both = mean of both

# Most triangles around a vertex that may be removed: three on each side after 4T-SS.
LARGEST_STAR = 6


class State(NamedTuple):
    """A mesh that changes. All arrays but ``counts`` are longer than what is in use."""

    counts: np.ndarray  # int64 (4,)
    vertices: np.ndarray  # float64 (n, 3)
    nodes: np.ndarray  # int32 (n, N_NODE)
    cells: np.ndarray  # int32 (m, N_CELL)
    marked: np.ndarray  # int32 (m,): of no meaning between calls


@jit
def twin_of(cells, half_edge):
    """The half-edge behind this one, -1 on the boundary."""
    return cells[half_edge // 3, TWINS + half_edge % 3]


@jit
def start_of(cells, half_edge):
    """The vertex that a half-edge leaves."""
    return cells[half_edge // 3, half_edge % 3]


@jit
def join(cells, one, other):
    """Make two half-edges each other's twins; -1 is the boundary."""
    if one >= 0:
        cells[one // 3, TWINS + one % 3] = other
    if other >= 0:
        cells[other // 3, TWINS + other % 3] = one


@jit
def write_triangle(nodes, cells, slot, a, b, c):
    """Put the corners of a triangle into a slot."""
    cells[slot, 0], cells[slot, 1], cells[slot, 2] = a, b, c
    nodes[a, LEAVING], nodes[b, LEAVING], nodes[c, LEAVING] = 3 * slot, 3 * slot + 1, 3 * slot + 2


@jit
def log(events, n_events, kind, slot, other):
    """Write an event down; how many there are then."""
    events[n_events, 0], events[n_events, 1], events[n_events, 2] = kind, slot, other
    return n_events + 1


@jit
def set_up(triangles, twins, state):
    """Fill the rows of a mesh that is not refined yet."""
    cells, nodes = state.cells, state.nodes
    for vertex in range(nodes.shape[0]):
        nodes[vertex, 0] = nodes[vertex, 1] = nodes[vertex, LEAVING] = -1
        nodes[vertex, STAMP] = nodes[vertex, WAITS] = 0
    for slot in range(triangles.shape[0]):
        a, b, c = triangles[slot, 0], triangles[slot, 1], triangles[slot, 2]
        write_triangle(nodes, cells, slot, a, b, c)
        for side in range(3):
            cells[slot, TWINS + side] = twins[3 * slot + side]
        cells[slot, ROOT] = slot
        cells[slot, LEVEL] = cells[slot, MARKS] = 0


# --- refining -----------------------------------------------------------------------------------


@jit
def mark_targets(state, targets, sides):
    """Mark and propagate; numbers of marked triangles, new vertices, and further triangles."""
    cells = state.cells
    twins, marks = cells[:, TWINS : TWINS + 3], cells[:, MARKS]
    n_marked = mark_and_propagate(targets, sides, twins, marks, state.marked)
    marked = state.marked[:n_marked]
    marked.sort()
    n_vertices, n_children = 0, 0
    for triangle in marked:
        mark = marks[triangle]
        n_children += N_CHILDREN[mark]
        for side in range(3):
            if mark >> side & 1 and owns(3 * triangle + side, twins[triangle, side]):
                n_vertices += 1
    return n_marked, n_vertices, n_children - n_marked


@jit
def has_room(state, n_new, n_added):
    """Whether so many more vertices and triangles fit into the slots."""
    counts = state.counts
    return (
        counts[N_VERTEX_SLOTS] + max(0, n_new - counts[N_FREE]) <= state.nodes.shape[0]
        and counts[N_TRIANGLES] + n_added <= state.cells.shape[0]
    )


@jit
def unmark(state, n_marked):
    """Take the marks away."""
    for triangle in state.marked[:n_marked]:
        state.cells[triangle, MARKS] = 0


@jit
def new_vertex(counts, vertices, nodes, a, b):
    """Put the midpoint of a and b into a free slot."""
    if counts[N_FREE] > 0:
        counts[N_FREE] -= 1
        vertex = nodes[counts[N_FREE], FREE]
    else:
        vertex = np.int32(counts[N_VERTEX_SLOTS])
        counts[N_VERTEX_SLOTS] += 1
    set_midpoint(vertices, vertex, a, b)
    nodes[vertex, 0], nodes[vertex, 1] = a, b
    nodes[vertex, STAMP], nodes[vertex, WAITS] = counts[LATEST], 0
    return vertex


@jit
def free_vertex(counts, nodes, vertex):
    """Give a vertex's slot back."""
    nodes[vertex, STAMP] = -1
    nodes[counts[N_FREE], FREE] = vertex
    counts[N_FREE] += 1


@jit
def number_midpoints(state, n_marked, corners, created):
    """Make the midpoints of marked sides, triangle by triangle.

    Fills ``corners``, of shape (n_marked, 6): each triangle's corners and midpoints.
    """
    cells, n_created = state.cells, 0
    for i in range(n_marked):
        triangle = state.marked[i]
        cells[triangle, SCRATCH] = i
        for side in range(3):
            corners[i, side] = corners[i, 3 + side] = cells[triangle, side]
            if cells[triangle, MARKS] >> side & 1 == 0:
                continue
            twin = cells[triangle, TWINS + side]
            if not owns(3 * triangle + side, twin):
                corners[i, 3 + side] = corners[cells[twin // 3, SCRATCH], 3 + twin % 3]
                continue
            a, b = cells[triangle, side], cells[triangle, next_side(side)]
            vertex = new_vertex(state.counts, state.vertices, state.nodes, a, b)
            created[n_created] = corners[i, 3 + side] = vertex
            n_created += 1


@jit
def first_too_small(state, n_marked, pattern, corners, work):
    """The first marked triangle too small to split, as ``fill_children`` sees it, or -1."""
    x, y, _ = work
    for i in range(n_marked):
        mark = state.cells[state.marked[i], MARKS]
        gather(state.vertices, corners[i], x, y)
        for child in range(N_CHILDREN[mark]):
            a, b, c = child_of(x, y, pattern, mark, child)
            if not has_area(x[a], y[a], x[b], y[b], x[c], y[c]):
                return state.marked[i]
    return -1


@jit
def join_children(cells, inner):
    """Join the half-edges between children; ``inner`` has the one from each label to each other."""
    for a in range(6):
        for b in range(a):
            if inner[a, b] >= 0 and inner[b, a] >= 0:
                join(cells, inner[a, b], inner[b, a])


@jit
def split_triangle(state, slot, pattern, corners, work, events, n_events):
    """Put the children of a triangle into its slot and new ones, and join them to each other.

    ``work`` has room for places of the corners, and for ``inner``, which it fills.
    """
    counts, nodes, cells = state.counts, state.nodes, state.cells
    x, y, inner = work
    gather(state.vertices, corners, x, y)
    mark, level, root = cells[slot, MARKS], cells[slot, LEVEL], cells[slot, ROOT]
    inner[:] = -1
    for child in range(N_CHILDREN[mark]):
        place = np.int64(slot)
        if child > 0:
            place = counts[N_TRIANGLES]
            counts[N_TRIANGLES] += 1
            n_events = log(events, n_events, COPY, place, slot)
        a, b, c = child_of(x, y, pattern, mark, child)
        write_triangle(nodes, cells, place, corners[a], corners[b], corners[c])
        cells[place, ROOT], cells[place, LEVEL] = root, level + DEPTH[mark, child]
        cells[place, MARKS] = ALL_SIDES  # to tell it from neighbours that are not split
        inner[a, b], inner[b, c], inner[c, a] = 3 * place, 3 * place + 1, 3 * place + 2
    join_children(cells, inner)
    return n_events


@jit
def fill_halves(mark, inner, halves):
    """Write the half-edges along each side, from its beginning and to its end: one if whole."""
    for side in range(3):
        end = next_side(side)
        if mark >> side & 1:
            halves[side, 0], halves[side, 1] = inner[side, 3 + side], inner[3 + side, end]
        else:
            halves[side, 0] = halves[side, 1] = inner[side, end]


@jit
def split_marked(state, n_marked, n_new, n_added, pattern):
    """Split the marked triangles: the first too small for that, else -1; new vertices; events.

    Where one is too small, nothing changes. There must be room in the slots.
    """
    counts, cells = state.counts, state.cells
    first_added = counts[N_TRIANGLES]
    corners = np.empty((n_marked, 6), np.uint32)
    created = np.empty(n_new, np.int32)
    events = np.empty((n_added, 3), np.int32)
    before = np.empty((n_marked, 4), np.int32)  # twins, and marks
    halves = np.empty((n_marked, 3, 2), np.int32)
    work = np.empty(6), np.empty(6), np.empty((6, 6), np.int64)
    counts[LATEST] += 1  # from here on nothing can fail for want of memory
    number_midpoints(state, n_marked, corners, created)
    too_small = first_too_small(state, n_marked, pattern, corners, work)
    if too_small >= 0:
        for vertex in created[::-1]:
            free_vertex(counts, state.nodes, vertex)
        unmark(state, n_marked)
        return too_small, created, events
    n_events = 0
    for i in range(n_marked):
        slot = state.marked[i]
        mark = before[i, 3] = cells[slot, MARKS]
        for side in range(3):
            before[i, side] = cells[slot, TWINS + side]
        n_events = split_triangle(state, slot, pattern, corners[i], work, events, n_events)
        fill_halves(mark, work[2], halves[i])
    join_neighbours(cells, before, halves)
    unmark(state, n_marked)
    for slot in range(first_added, counts[N_TRIANGLES]):
        cells[slot, MARKS] = 0
    return -1, created, events


@jit
def join_neighbours(cells, before, halves):
    """Join the sides of triangles that were split to what lay behind them."""
    for i in range(before.shape[0]):
        for side in range(3):
            twin, begin, end = before[i, side], halves[i, side, 0], halves[i, side, 1]
            if twin < 0:
                join(cells, begin, -1)
                join(cells, end, -1)
            elif cells[twin // 3, MARKS]:
                other = cells[twin // 3, SCRATCH]
                cells[begin // 3, TWINS + begin % 3] = halves[other, twin % 3, 1]
                cells[end // 3, TWINS + end % 3] = halves[other, twin % 3, 0]
            else:
                join(cells, begin, twin)


# --- coarsening ---------------------------------------------------------------------------------

# Marks of triangles. MERGED: or written anew by undoing a swap; scratch has the midpoint's stamp.
TARGET, MERGED = 1, 2


@jit
def is_end_of(nodes, vertex, end):
    """Whether a vertex is the midpoint of an edge with this end."""
    return nodes[vertex, 0] == end or nodes[vertex, 1] == end


@jit
def other_end(nodes, vertex, end):
    """The other end of the edge whose midpoint a vertex is."""
    return nodes[vertex, 1] if nodes[vertex, 0] == end else nodes[vertex, 0]


@jit
def walk_star(cells, start, star, ring):
    """Half-edges that leave a vertex, counter-clockwise, and the vertices around it.

    Returns how many triangles there are (0 if more than a removable vertex can have) and whether
    they close around it; if not, the ring has one vertex more than there are triangles.
    """
    for _ in range(LARGEST_STAR):  # to the right, as far as the boundary
        twin = twin_of(cells, start)
        if twin < 0:
            break
        start = next_edge(twin)
    half_edge, size = start, 0
    while size < LARGEST_STAR:
        star[size] = half_edge
        ring[size] = start_of(cells, next_edge(half_edge))
        size += 1
        before = previous_edge(half_edge)
        half_edge = twin_of(cells, before)
        if half_edge == start:
            return size, True
        if half_edge < 0:
            ring[size] = start_of(cells, before)
            return (size, False) if twin_of(cells, start) < 0 else (0, False)
    return 0, False


@jit
def may_merge(cells, star, size, stamp):
    """Whether all triangles of a star are targets, or merged in this call for such a midpoint."""
    for i in range(size):
        slot = star[i] // 3
        mark = cells[slot, MARKS]
        if not (mark == TARGET or (mark == MERGED and cells[slot, SCRATCH] == stamp)):
            return False
    return True


@jit
def places_of_ends(nodes, vertex, ring, n_ring):
    """Where the ends of a vertex's edge are in the ring around it, ascending; the first -1: not."""
    one, two = -1, -1
    for place in range(n_ring):
        if is_end_of(nodes, vertex, ring[place]):
            one, two = two, place
    return one, two


@jit
def side_can_merge(nodes, cells, vertex, star, size, ring, n_ring, first, gap):
    """Whether the triangles on one side of a midpoint can be merged.

    ``first`` is the place of an end of its edge in the ring, the other end lies ``gap`` further on.
    Two triangles: their apex must not be the midpoint of an edge to ``vertex``. Three, after
    4T-SS: the two between must be the midpoints of the parent's other sides.
    """
    begin, one = ring[first], ring[(first + 1) % n_ring]
    if gap == 2:
        return not is_end_of(nodes, one, vertex)
    if gap != 3:
        return False
    two, end = ring[(first + 2) % n_ring], ring[(first + 3) % n_ring]
    middle = star[(first + 1) % size] // 3
    return (
        cells[middle, 2] != vertex
        and is_end_of(nodes, one, begin)
        and is_end_of(nodes, two, end)
        and other_end(nodes, one, begin) == other_end(nodes, two, end)
    )


@jit
def removable_star(nodes, cells, vertex, star, ring):
    """Size of the star of a vertex and the places of its edge's ends; 0 if it has to stay."""
    size, is_closed = walk_star(cells, nodes[vertex, LEAVING], star, ring)
    if size == 0 or not may_merge(cells, star, size, nodes[vertex, STAMP]):
        return 0, 0, 0
    n_ring = size if is_closed else size + 1
    one, two = places_of_ends(nodes, vertex, ring, n_ring)
    if one < 0 or not (is_closed or two - one == size):
        return 0, 0, 0
    gap = two - one
    if not side_can_merge(nodes, cells, vertex, star, size, ring, n_ring, one, gap):
        return 0, 0, 0
    if is_closed and not side_can_merge(
        nodes, cells, vertex, star, size, ring, n_ring, two, size - gap
    ):
        return 0, 0, 0
    return size, one, two


@jit
def write_leaf(vertices, nodes, cells, slot, a, b, c, is_child):
    """Write a triangle, a child with its side to bisect next first; the half-edge from a to b."""
    side = 0
    if is_child:
        x = vertices[a, 0], vertices[b, 0], vertices[c, 0]
        y = vertices[a, 1], vertices[b, 1], vertices[c, 1]
        side = side_to_bisect(x, y, 0, 1, 2)
    one, two, three = rotated(a, b, c, side)
    write_triangle(nodes, cells, slot, one, two, three)
    return 3 * slot + (3 - side) % 3


@jit
def undo_swap(state, middle, events, n_events):
    """Turn the edge p-q of 4T-SS into the edge c-m of 4T-LE; ``middle`` holds (p, q, m)."""
    vertices, nodes, cells = state.vertices, state.nodes, state.cells
    p, q, m = cells[middle, 0], cells[middle, 1], cells[middle, 2]
    to_p = cells[middle, TWINS]
    slot, p_to_c, c_to_q = to_p // 3, next_edge(to_p), previous_edge(to_p)
    c = start_of(cells, c_to_q)
    behind_pc, behind_cq = twin_of(cells, p_to_c), twin_of(cells, c_to_q)
    behind_qm, behind_mp = cells[middle, TWINS + 1], cells[middle, TWINS + 2]
    m_to_c = write_leaf(vertices, nodes, cells, slot, m, c, q, True)
    join(cells, next_edge(m_to_c), behind_cq)
    join(cells, previous_edge(m_to_c), behind_qm)
    c_to_m = write_leaf(vertices, nodes, cells, middle, c, m, p, True)
    join(cells, next_edge(c_to_m), behind_mp)
    join(cells, previous_edge(c_to_m), behind_pc)
    join(cells, m_to_c, c_to_m)
    for changed in (slot, middle):
        cells[changed, MARKS], cells[changed, SCRATCH] = MERGED, nodes[m, STAMP]
    return log(events, n_events, MIX, slot, middle)


@jit
def merge_side(state, vertex, right, left, events, n_events):
    """Merge two triangles at a midpoint; the half-edge along the whole edge.

    ``right`` leaves the midpoint along its edge, ``left`` towards the apex behind it. The parent
    takes the place of the left one, as its first child did.
    """
    vertices, nodes, cells = state.vertices, state.nodes, state.cells
    slot, freed = left // 3, right // 3
    to_apex, from_apex = next_edge(right), next_edge(left)
    begin, apex = start_of(cells, to_apex), start_of(cells, from_apex)
    end = start_of(cells, previous_edge(left))
    behind_one, behind_other = twin_of(cells, to_apex), twin_of(cells, from_apex)
    # Its apex came with the midpoint where the parent never was a triangle of the mesh.
    is_child = nodes[apex, STAMP] == nodes[vertex, STAMP]
    whole = write_leaf(vertices, nodes, cells, slot, end, begin, apex, is_child)
    join(cells, next_edge(whole), behind_one)
    join(cells, previous_edge(whole), behind_other)
    cells[slot, LEVEL] -= 1
    cells[slot, MARKS], cells[slot, SCRATCH] = MERGED, nodes[vertex, STAMP]
    cells[freed, MARKS], cells[freed, 0] = 0, -1
    return whole, log(events, n_events, MEAN, slot, freed)


@jit
def remove(state, vertex, star, ring, events, n_events):
    """Undo the bisection at a vertex, if the mesh stays conforming.

    Returns how many vertices lie around it then, 0 if it has to stay, and the number of events.
    """
    nodes, cells = state.nodes, state.cells
    size, one, two = removable_star(nodes, cells, vertex, star, ring)
    if size == 0:
        return 0, n_events
    is_closed = twin_of(cells, star[0]) >= 0
    if two - one == 3:
        n_events = undo_swap(state, star[one + 1] // 3, events, n_events)
    if is_closed and size - (two - one) == 3:
        n_events = undo_swap(state, star[(two + 1) % size] // 3, events, n_events)
    size, _ = walk_star(cells, nodes[vertex, LEAVING], star, ring)
    n_ring = size if is_closed else size + 1
    one, two = places_of_ends(nodes, vertex, ring, n_ring)
    first, n_events = merge_side(state, vertex, star[one], star[one + 1], events, n_events)
    second = -1
    if is_closed:
        left = star[(two + 1) % size]
        second, n_events = merge_side(state, vertex, star[two], left, events, n_events)
    join(cells, first, second)
    free_vertex(state.counts, nodes, vertex)
    return n_ring, n_events


@jit
def add_candidate(nodes, vertex, candidates, n_candidates):
    """Put a vertex that bisection has made on the stack, if it is not there yet."""
    if nodes[vertex, STAMP] > 0 and not nodes[vertex, WAITS]:
        nodes[vertex, WAITS] = 1
        candidates[n_candidates] = vertex
        n_candidates += 1
    return n_candidates


@jit
def coarsen_targets(state, targets):
    """Undo bisections among the targets, as far as one call of refine went.

    Returns removed vertices, events, and merged triangles. Each removal can make those around
    removable.
    """
    n_targets, nodes, cells = targets.size, state.nodes, state.cells
    candidates = np.empty(7 * n_targets, np.int32)
    removed = np.empty(n_targets, np.int32)
    events = np.empty((4 * n_targets, 3), np.int32)
    merged, freed = np.empty(n_targets, np.int32), np.empty(n_targets, np.int32)
    star, ring = np.empty(LARGEST_STAR, np.int64), np.empty(LARGEST_STAR + 1, np.int64)
    n_candidates, n_removed, n_events = 0, 0, 0
    for i in range(n_targets - 1, -1, -1):
        cells[targets[i], MARKS] = TARGET
        for corner in range(3):
            vertex = cells[targets[i], corner]
            n_candidates = add_candidate(nodes, vertex, candidates, n_candidates)
    while n_candidates > 0:
        n_candidates -= 1
        vertex = candidates[n_candidates]
        nodes[vertex, WAITS] = 0
        n_ring, n_events = remove(state, vertex, star, ring, events, n_events)
        if n_ring > 0:
            removed[n_removed] = vertex
            n_removed += 1
        for place in range(n_ring):
            n_candidates = add_candidate(nodes, ring[place], candidates, n_candidates)
    merged = merged[: take_merged(cells, targets, merged)]
    n_events = close_gaps(state, freed, events, n_events)
    for i in range(merged.size):
        if merged[i] >= state.counts[N_TRIANGLES]:
            merged[i] = cells[merged[i], SCRATCH]
    merged.sort()
    return removed[:n_removed], events[:n_events], merged


@jit
def take_merged(cells, targets, merged):
    """List the merged ones among the targets, and take all marks away; how many there are."""
    n_merged = 0
    for target in targets:
        if cells[target, MARKS] == MERGED:
            merged[n_merged] = target
            n_merged += 1
        cells[target, MARKS] = 0
    return n_merged


@jit
def close_gaps(state, freed, events, n_events):
    """Move the last triangles into slots that merging has freed; scratch says where they went.

    ``freed`` has room for their numbers. Returns the number of events.
    """
    counts, nodes, cells = state.counts, state.nodes, state.cells
    n_freed = 0
    for i in range(n_events):
        if events[i, 0] == MEAN:
            freed[n_freed] = events[i, 2]
            n_freed += 1
    freed = freed[:n_freed]
    freed.sort()
    mover, end = counts[N_TRIANGLES], counts[N_TRIANGLES] - n_freed
    for slot in freed:
        if slot >= end:
            break
        mover -= 1
        while cells[mover, 0] < 0:
            mover -= 1
        write_triangle(nodes, cells, slot, cells[mover, 0], cells[mover, 1], cells[mover, 2])
        for side in range(3):
            join(cells, 3 * np.int64(slot) + side, cells[mover, TWINS + side])
        cells[slot, ROOT], cells[slot, LEVEL] = cells[mover, ROOT], cells[mover, LEVEL]
        cells[slot, MARKS], cells[mover, SCRATCH] = 0, slot
        n_events = log(events, n_events, COPY, slot, mover)
    counts[N_TRIANGLES] = end
    return n_events


# --- carrying values ----------------------------------------------------------------------------

# Of old slots a new one has values from: four children, and after 4T-SS no more, some in halves.
MOST_SOURCES = 6


@jit
def trace(events, slots):
    """Where the values of changed slots come from: sources, shape (n, 6), weights, and how many.

    ``slots`` lists all slots that events name, ascending. Everything counts by its place there.
    """
    n = slots.size
    sources = np.zeros((n, MOST_SOURCES), np.int32)
    weights = np.zeros((n, MOST_SOURCES))
    counts = np.ones(n, np.int64)
    for i in range(n):
        sources[i, 0], weights[i, 0] = i, 1.0
    for event in events:
        slot, other = np.searchsorted(slots, event[1]), np.searchsorted(slots, event[2])
        if event[0] == COPY:
            weights[slot], counts[slot] = 0.0, 0
            add_sources(sources, weights, counts, slot, other, 1.0)
            continue
        weights[slot] *= 0.5
        add_sources(sources, weights, counts, slot, other, 0.5)
        if event[0] == MIX:
            weights[other], counts[other] = 0.0, 0
            add_sources(sources, weights, counts, other, slot, 1.0)
    return sources, weights, counts


@jit
def add_sources(sources, weights, counts, slot, other, share):
    """Add a share of the other slot's sources to those of a slot."""
    for i in range(counts[other]):
        source, place = sources[other, i], 0
        while place < counts[slot] and sources[slot, place] != source:
            place += 1
        if place == counts[slot]:
            sources[slot, place], weights[slot, place] = source, 0.0
            counts[slot] += 1
        weights[slot, place] += share * weights[other, i]
