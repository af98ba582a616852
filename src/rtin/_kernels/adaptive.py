"""Refining and coarsening a mesh in place, at a cost that grows with what changes.

Triangles lie in *slots* without gaps; of the vertices' slots some are free. Corners, sides,
half-edges, twins and patterns are those of ``refinement`` and ``adjacency``.
"""

from typing import NamedTuple

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.adjacency import next_edge, next_side, previous_edge
from rtin._kernels.refinement import (
    ALL_SIDES,
    DEPTH,
    N_CHILDREN,
    child_of,
    mark_and_propagate,
    rotated,
    set_midpoint,
    side_to_bisect,
    turn,
)

# Places in State.counts
N_TRIANGLES, N_VERTEX_SLOTS, N_FREE, STAMP = 0, 1, 2, 3

# Kinds of an event, what becomes of two slots' values: [kind, slot, other slot].
COPY, MEAN, MIX = 0, 1, 2  # slot = other; slot = mean of both; both = mean of both

# Most triangles around a vertex that may be removed: three on each side after 4T-SS.
LARGEST_STAR = 6


class State(NamedTuple):
    """A mesh that changes. The arrays are longer than what is in use; ``counts`` tells."""

    counts: np.ndarray  # int64 (4,): see the names above
    vertices: np.ndarray  # float64 (n, 3)
    ends: np.ndarray  # int32 (n, 2): of the edge whose midpoint a vertex is; -1 if it is none
    stamps: np.ndarray  # int32 (n,): which call of refine made it; 0 if none, -1 in a free slot
    leaving: np.ndarray  # int32 (n,): a half-edge that leaves it
    free: np.ndarray  # int32 (n,): a stack of free slots
    waits: np.ndarray  # bool (n,): false between calls
    triangles: np.ndarray  # int32 (m, 3)
    twins: np.ndarray  # int32 (3m,)
    roots: np.ndarray  # int32 (m,): the triangle of the initial mesh that it lies in
    levels: np.ndarray  # uint8 (m,): how many bisections it is from that
    marks: np.ndarray  # uint8 (m,): zero between calls
    scratch: np.ndarray  # int32 (m,): of no meaning between calls
    marked: np.ndarray  # int32 (m,): of no meaning between calls


@jit
def join(twins, one, other):
    """Make two half-edges each other's twins; -1 is the boundary."""
    if one >= 0:
        twins[one] = other
    if other >= 0:
        twins[other] = one


@jit
def gather(vertices, corners, x, y):
    """Put the places of vertices side by side."""
    for label in range(corners.size):
        x[label], y[label] = vertices[corners[label], 0], vertices[corners[label], 1]


# --- refining -----------------------------------------------------------------------------------


@jit
def mark_targets(state, targets, sides):
    """Mark and propagate; how many triangles are marked, and how many slots are wanted."""
    n_marked = mark_and_propagate(targets, sides, state.twins, state.marks, state.marked)
    marked = state.marked[:n_marked]
    marked.sort()
    n_vertices, n_children = 0, 0
    for triangle in marked:
        mark = state.marks[triangle]
        n_children += N_CHILDREN[mark]
        for side in range(3):
            twin = state.twins[3 * triangle + side]
            if mark >> side & 1 and (twin < 0 or twin > 3 * triangle + side):
                n_vertices += 1
    return n_marked, n_vertices, n_children - n_marked


@jit
def unmark(state, n_marked):
    """Take the marks away."""
    for triangle in state.marked[:n_marked]:
        state.marks[triangle] = 0


@jit
def new_vertex(state, a, b):
    """Put the midpoint of a and b into a free slot."""
    counts = state.counts
    if counts[N_FREE] > 0:
        counts[N_FREE] -= 1
        vertex = state.free[counts[N_FREE]]
    else:
        vertex = counts[N_VERTEX_SLOTS]
        counts[N_VERTEX_SLOTS] += 1
    set_midpoint(state.vertices, vertex, a, b)
    state.ends[vertex, 0], state.ends[vertex, 1] = a, b
    state.stamps[vertex] = counts[STAMP]
    return vertex


@jit
def free_vertex(state, vertex):
    """Give a vertex's slot back."""
    state.stamps[vertex] = -1
    state.free[state.counts[N_FREE]] = vertex
    state.counts[N_FREE] += 1


@jit
def number_midpoints(state, n_marked, corners, created):
    """Make the midpoints of marked sides, triangle by triangle.

    Fills ``corners``, of shape (n_marked, 6): each triangle's corners and midpoints.
    """
    n_created = 0
    for i in range(n_marked):
        triangle = state.marked[i]
        state.scratch[triangle] = i
        for side in range(3):
            corners[i, side] = corners[i, 3 + side] = state.triangles[triangle, side]
            if state.marks[triangle] >> side & 1 == 0:
                continue
            twin = state.twins[3 * triangle + side]
            if twin >= 0 and twin < 3 * triangle + side:
                corners[i, 3 + side] = corners[state.scratch[twin // 3], 3 + twin % 3]
                continue
            a, b = state.triangles[triangle, side], state.triangles[triangle, next_side(side)]
            created[n_created] = corners[i, 3 + side] = new_vertex(state, a, b)
            n_created += 1


@jit
def first_too_small(state, n_marked, pattern, corners):
    """The first marked triangle of which a child would have no area in float64, or -1."""
    x, y = np.empty(6), np.empty(6)
    for i in range(n_marked):
        mark = state.marks[state.marked[i]]
        gather(state.vertices, corners[i], x, y)
        for child in range(N_CHILDREN[mark]):
            a, b, c = child_of(x, y, pattern, mark, child)
            if not turn(x, y, a, b, c) > 0.0:
                return state.marked[i]
    return -1


@jit
def write_triangle(triangles, leaving, slot, a, b, c):
    """Put a triangle into a slot."""
    triangles[slot, 0], triangles[slot, 1], triangles[slot, 2] = a, b, c
    leaving[a], leaving[b], leaving[c] = 3 * slot, 3 * slot + 1, 3 * slot + 2


@jit
def split_triangle(state, slot, pattern, corners, halves, work, events, n_events):
    """Put the children of a triangle into its slot and new ones, and join them to each other.

    ``halves[side]`` becomes the half-edges along a side, from its beginning and to its end: the
    same one twice where the side is whole. ``work`` is room for places of the corners, and for the
    half-edge from each corner to each other.
    """
    triangles, leaving = state.triangles, state.leaving
    x, y, inner = work
    gather(state.vertices, corners, x, y)
    mark, level, root = state.marks[slot], state.levels[slot], state.roots[slot]
    inner[:] = -1
    for child in range(N_CHILDREN[mark]):
        place = slot
        if child > 0:
            place = state.counts[N_TRIANGLES]
            state.counts[N_TRIANGLES] += 1
            n_events = log(events, n_events, COPY, place, slot)
        a, b, c = child_of(x, y, pattern, mark, child)
        write_triangle(triangles, leaving, place, corners[a], corners[b], corners[c])
        state.roots[place] = root
        state.levels[place] = level + DEPTH[mark, child]
        state.marks[place] = 0
        inner[a, b], inner[b, c], inner[c, a] = 3 * place, 3 * place + 1, 3 * place + 2
    for a in range(6):
        for b in range(a):
            if inner[a, b] >= 0 and inner[b, a] >= 0:
                join(state.twins, inner[a, b], inner[b, a])
    for side in range(3):
        end = next_side(side)
        if mark >> side & 1:
            halves[side, 0], halves[side, 1] = inner[side, 3 + side], inner[3 + side, end]
        else:
            halves[side, 0] = halves[side, 1] = inner[side, end]
    return n_events


@jit
def split_marked(state, n_marked, n_new, n_added, pattern):
    """Split the marked triangles: the first too small for that, else -1; new vertices; events.

    Where one is too small, nothing changes. There must be room in the slots.
    """
    corners = np.empty((n_marked, 6), np.uint32)
    created = np.empty(n_new, np.int32)
    events = np.empty((n_added, 3), np.int32)
    state.counts[STAMP] += 1
    number_midpoints(state, n_marked, corners, created)
    too_small = first_too_small(state, n_marked, pattern, corners)
    if too_small >= 0:
        for vertex in created[::-1]:
            free_vertex(state, vertex)
        unmark(state, n_marked)
        return too_small, created, events
    behind = np.empty((n_marked, 3), np.int32)
    halves = np.empty((n_marked, 3, 2), np.int32)
    marks = np.empty(n_marked, np.uint8)
    for i in range(n_marked):
        marks[i] = state.marks[state.marked[i]]
        for side in range(3):
            behind[i, side] = state.twins[3 * state.marked[i] + side]
    work = np.empty(6), np.empty(6), np.empty((6, 6), np.int64)
    n_events = 0
    for i in range(n_marked):
        n_events = split_triangle(
            state, state.marked[i], pattern, corners[i], halves[i], work, events, n_events
        )
    join_neighbours(state, n_marked, marks, behind, halves)
    return -1, created, events


@jit
def join_neighbours(state, n_marked, marks, behind, halves):
    """Join the sides of triangles that were split to what lay behind them."""
    twins = state.twins
    for i in range(n_marked):
        state.marks[state.marked[i]] = ALL_SIDES  # to tell them from neighbours that were not split
    for i in range(n_marked):
        for side in range(3):
            twin, begin, end = behind[i, side], halves[i, side, 0], halves[i, side, 1]
            if twin < 0:
                twins[begin] = twins[end] = -1
            elif marks[i] >> side & 1 or state.marks[twin // 3]:
                other = state.scratch[twin // 3]
                twins[begin] = halves[other, twin % 3, 1]
                twins[end] = halves[other, twin % 3, 0]
            else:
                join(twins, begin, twin)
    unmark(state, n_marked)


@jit
def has_room(state, n_new, n_added):
    """Whether so many more vertices and triangles fit into the slots."""
    counts = state.counts
    return (
        counts[N_VERTEX_SLOTS] + max(0, n_new - counts[N_FREE]) <= state.stamps.size
        and counts[N_TRIANGLES] + n_added <= state.marks.size
    )


# --- coarsening ---------------------------------------------------------------------------------

TARGET, MERGED = 1, 2  # marks of triangles; of a merged one, scratch has the stamp of the midpoint


@jit
def is_end_of(ends, vertex, end):
    """Whether a vertex is the midpoint of an edge with this end."""
    return ends[vertex, 0] == end or ends[vertex, 1] == end


@jit
def other_end(ends, vertex, end):
    """The other end of the edge whose midpoint a vertex is."""
    return ends[vertex, 1] if ends[vertex, 0] == end else ends[vertex, 0]


@jit
def walk_star(state, vertex, star, ring):
    """Half-edges that leave a vertex, counter-clockwise, and the vertices around it.

    Returns how many triangles there are (0 if more than a removable vertex can have) and whether
    they close around it; if not, the ring has one vertex more than there are triangles.
    """
    twins, triangles = state.twins, state.triangles
    start = state.leaving[vertex]
    for _ in range(LARGEST_STAR):  # to the right, as far as the boundary
        twin = twins[start]
        if twin < 0:
            break
        start = next_edge(twin)
    half_edge, size = start, 0
    while size < LARGEST_STAR:
        star[size] = half_edge
        after = next_edge(half_edge)
        ring[size] = triangles[after // 3, after % 3]
        size += 1
        before = previous_edge(half_edge)
        half_edge = twins[before]
        if half_edge == start:
            return size, True
        if half_edge < 0:
            ring[size] = triangles[before // 3, before % 3]
            return (size, False) if twins[start] < 0 else (0, False)
    return 0, False


@jit
def find(ring, size, vertex):
    """Place of a vertex in a ring, -1 if it is not there."""
    for place in range(size):
        if ring[place] == vertex:
            return place
    return -1


@jit
def may_merge(state, star, size, stamp):
    """Whether all triangles of a star are targets, or merged in this call for such a midpoint."""
    for half_edge in star[:size]:
        triangle = half_edge // 3
        mark = state.marks[triangle]
        if not (mark == TARGET or (mark == MERGED and state.scratch[triangle] == stamp)):
            return False
    return True


@jit
def side_can_merge(state, vertex, star, ring, first, gap):
    """Whether the triangles on one side of a midpoint can be merged.

    ``first`` is the place of an end of its edge in the ring, the other end lies ``gap`` further on.
    Two triangles: their apex must not be the midpoint of an edge to ``vertex``. Three, after
    4T-SS: the two between must be the midpoints of the parent's other sides.
    """
    ends, n_ring = state.ends, ring.size
    begin, one = ring[first], ring[(first + 1) % n_ring]
    if gap == 2:
        return not is_end_of(ends, one, vertex)
    if gap != 3:
        return False
    two, end = ring[(first + 2) % n_ring], ring[(first + 3) % n_ring]
    middle = star[(first + 1) % star.size] // 3
    return (
        state.triangles[middle, 2] != vertex
        and is_end_of(ends, one, begin)
        and is_end_of(ends, two, end)
        and other_end(ends, one, begin) == other_end(ends, two, end)
    )


@jit
def undo_swap(state, middle, events, n_events):
    """Turn the edge p-q of 4T-SS into the edge c-m of 4T-LE; ``middle`` holds (p, q, m)."""
    twins, triangles = state.twins, state.triangles
    p, q, m = triangles[middle, 0], triangles[middle, 1], triangles[middle, 2]
    to_p = twins[3 * middle]
    slot, p_to_c, c_to_q = to_p // 3, next_edge(to_p), previous_edge(to_p)
    c = triangles[slot, c_to_q % 3]
    behind_pc, behind_cq = twins[p_to_c], twins[c_to_q]
    behind_qm, behind_mp = twins[3 * middle + 1], twins[3 * middle + 2]
    m_to_c = write_leaf(state, slot, m, c, q, True)
    join(twins, next_edge(m_to_c), behind_cq)
    join(twins, previous_edge(m_to_c), behind_qm)
    c_to_m = write_leaf(state, middle, c, m, p, True)
    join(twins, next_edge(c_to_m), behind_mp)
    join(twins, previous_edge(c_to_m), behind_pc)
    join(twins, m_to_c, c_to_m)
    return log(events, n_events, MIX, slot, middle)


@jit
def log(events, n_events, kind, slot, other):
    """Write an event down; how many there are then."""
    events[n_events, 0], events[n_events, 1], events[n_events, 2] = kind, slot, other
    return n_events + 1


@jit
def write_leaf(state, slot, a, b, c, is_child):
    """Write a triangle, a child with its side to bisect next first; the half-edge from a to b."""
    vertices = state.vertices
    side = 0
    if is_child:
        x = vertices[a, 0], vertices[b, 0], vertices[c, 0]
        y = vertices[a, 1], vertices[b, 1], vertices[c, 1]
        side = side_to_bisect(x, y, 0, 1, 2)
    one, two, three = rotated(a, b, c, side)
    write_triangle(state.triangles, state.leaving, slot, one, two, three)
    return 3 * slot + (3 - side) % 3


@jit
def merge_side(state, vertex, right, left, events, n_events):
    """Merge two triangles at a midpoint; the half-edge along the whole edge.

    ``right`` leaves the midpoint along its edge, ``left`` towards the apex behind it. The parent
    takes the place of the left one, as its first child did.
    """
    triangles, twins = state.triangles, state.twins
    slot, freed = left // 3, right // 3
    to_apex, from_apex = next_edge(right), next_edge(left)
    begin, apex = triangles[freed, to_apex % 3], triangles[slot, from_apex % 3]
    end = triangles[slot, previous_edge(left) % 3]
    behind_one, behind_other = twins[to_apex], twins[from_apex]
    # Its apex came with the midpoint where the parent never was a triangle of the mesh.
    is_child = state.stamps[apex] == state.stamps[vertex]
    whole = write_leaf(state, slot, end, begin, apex, is_child)
    join(twins, next_edge(whole), behind_one)
    join(twins, previous_edge(whole), behind_other)
    state.levels[slot] -= 1
    state.marks[slot] = MERGED
    state.scratch[slot] = state.stamps[vertex]
    state.marks[freed] = 0
    triangles[freed, 0] = -1
    return whole, log(events, n_events, MEAN, slot, freed)


@jit
def removable_star(state, vertex, star, ring):
    """Size of the star of a vertex and the places of its edge's ends; 0 if it has to stay.

    Going on counter-clockwise from the first place one meets the triangles of the left side.
    """
    size, is_closed = walk_star(state, vertex, star, ring)
    if size == 0 or not may_merge(state, star, size, state.stamps[vertex]):
        return 0, 0, 0
    n_ring = size if is_closed else size + 1
    one = find(ring, n_ring, state.ends[vertex, 0])
    two = find(ring, n_ring, state.ends[vertex, 1])
    if one < 0 or two < 0:
        return 0, 0, 0
    one, two = min(one, two), max(one, two)
    star, ring = star[:size], ring[:n_ring]
    if not is_closed and two - one != size:
        return 0, 0, 0
    if not side_can_merge(state, vertex, star, ring, one, two - one):
        return 0, 0, 0
    if is_closed and not side_can_merge(state, vertex, star, ring, two, size - (two - one)):
        return 0, 0, 0
    return size, one, two


@jit
def undo_swaps(state, star, size, is_closed, one, two, events, n_events):
    """Make both sides of a vertex that is removed simple."""
    if two - one == 3:
        n_events = undo_swap(state, star[one + 1] // 3, events, n_events)
    if is_closed and size - (two - one) == 3:
        n_events = undo_swap(state, star[(two + 1) % size] // 3, events, n_events)
    return n_events


@jit
def remove(state, vertex, star, ring, events, n_events):
    """Undo the bisection at a vertex, if the mesh stays conforming.

    Returns how many vertices lie around it then, 0 if it has to stay, and the number of events.
    """
    size, one, two = removable_star(state, vertex, star, ring)
    if size == 0:
        return 0, n_events
    is_closed = state.twins[star[0]] >= 0
    n_events = undo_swaps(state, star, size, is_closed, one, two, events, n_events)
    size, _ = walk_star(state, vertex, star, ring)
    n_ring = size if is_closed else size + 1
    one = find(ring, n_ring, state.ends[vertex, 0])
    two = find(ring, n_ring, state.ends[vertex, 1])
    one, two = min(one, two), max(one, two)
    first, n_events = merge_side(state, vertex, star[one], star[one + 1], events, n_events)
    second = -1
    if is_closed:
        left = star[(two + 1) % size]
        second, n_events = merge_side(state, vertex, star[two], left, events, n_events)
    join(state.twins, first, second)
    free_vertex(state, vertex)
    return n_ring, n_events


@jit
def add_candidate(state, vertex, candidates, n_candidates):
    """Put a vertex that bisection has made on the stack, if it is not there yet."""
    if state.stamps[vertex] > 0 and not state.waits[vertex]:
        state.waits[vertex] = True
        candidates[n_candidates] = vertex
        n_candidates += 1
    return n_candidates


@jit
def coarsen_targets(state, targets):
    """Undo bisections among the targets, as far as one call of refine went.

    Removed vertices, events, and merged triangles. Each removal can make those around removable.
    """
    n_targets = targets.size
    candidates = np.empty(7 * n_targets, np.int32)
    removed = np.empty(n_targets, np.int32)
    events = np.empty((4 * n_targets, 3), np.int32)
    star, ring = np.empty(LARGEST_STAR, np.int64), np.empty(LARGEST_STAR + 1, np.int64)
    n_candidates, n_removed, n_events = 0, 0, 0
    for target in targets[::-1]:
        state.marks[target] = TARGET
        for vertex in state.triangles[target]:
            n_candidates = add_candidate(state, vertex, candidates, n_candidates)
    while n_candidates > 0:
        n_candidates -= 1
        vertex = candidates[n_candidates]
        state.waits[vertex] = False
        n_ring, n_events = remove(state, vertex, star, ring, events, n_events)
        if n_ring > 0:
            removed[n_removed] = vertex
            n_removed += 1
        for around in ring[:n_ring]:
            n_candidates = add_candidate(state, around, candidates, n_candidates)
    for target in targets:
        state.marks[target] = 0
    n_events = close_gaps(state, events, n_events)
    return removed[:n_removed], events[:n_events]


@jit
def close_gaps(state, events, n_events):
    """Move the last triangles into the slots that merging has freed."""
    freed = np.empty(n_events, np.int32)
    n_freed = 0
    for event in events[:n_events]:
        if event[0] == MEAN:
            freed[n_freed] = event[2]
            n_freed += 1
    freed = freed[:n_freed]
    freed.sort()
    end = state.counts[N_TRIANGLES] - n_freed
    mover = state.counts[N_TRIANGLES]
    for slot in freed:
        if slot >= end:
            break
        mover -= 1
        while state.triangles[mover, 0] < 0:
            mover -= 1
        move_triangle(state, mover, slot)
        n_events = log(events, n_events, COPY, slot, mover)
    state.counts[N_TRIANGLES] = end
    return n_events


@jit
def move_triangle(state, source, slot):
    """Move a triangle to another slot."""
    triangles, twins = state.triangles, state.twins
    a, b, c = triangles[source, 0], triangles[source, 1], triangles[source, 2]
    write_triangle(triangles, state.leaving, slot, a, b, c)
    for side in range(3):
        join(twins, 3 * slot + side, twins[3 * source + side])
    state.roots[slot], state.levels[slot] = state.roots[source], state.levels[source]


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
