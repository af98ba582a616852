r"""Arithmetic of local refinement: marks, midpoints, and the subdivision patterns.

Corners of a triangle are 0, 1, 2; sides 0, 1, 2 run from each to the next, so side 0 is the one to
bisect. The midpoint of side s is corner 3 + s of the patterns.

                 2                          2                            2
               / | \                      / | \                        /   \
             5   |   4      4T-LE:      5   |   4         4T-SS:      5 --- 4
           /     |     \              /  \  |  /  \                 /  \   /  \
         0 ----- 3 ----- 1          0 ----- 3 ----- 1             0 ----- 3 ---- 1
"""

import numpy as np

from rtin._kernels._jit import jit
from rtin._kernels.adjacency import has_area, next_side

# Of a squared length: sides that differ by less are equal. A million times the rounding of lengths,
# and far too little for a mesh to become worse where the other side of a tie is taken.
TIE = 1e-6
# Of equal sides the one most along this direction is taken (of no mesh that people would make).
EAST, NORTH = np.cos(1.0), np.sin(1.0)

LONGEST_EDGE, SELF_SIMILAR = 0, 1
ALL_SIDES = 7

# Bit s of the marks says that side s is bisected. One side: two triangles, two: three, three: four.
# Children end at their newest vertex. Bisecting (0, 1, 2) at 3 gives (2, 0, 3) and (1, 2, 3), in
# this order; patterns of more sides bisect these again in the same way.
N_CHILDREN = np.array([1, 2, 1, 3, 1, 3, 1, 4], np.int64)
CHILDREN = np.zeros((2, 8, 4, 3), np.uint8)
CHILDREN[:, 0, 0] = CHILDREN[:, 2, 0] = CHILDREN[:, 4, 0] = CHILDREN[:, 6, 0] = (0, 1, 2)
CHILDREN[:, 1, :2] = (2, 0, 3), (1, 2, 3)
CHILDREN[:, 3, :3] = (2, 0, 3), (3, 1, 4), (2, 3, 4)
CHILDREN[:, 5, :3] = (3, 2, 5), (0, 3, 5), (1, 2, 3)
CHILDREN[LONGEST_EDGE, 7] = (3, 2, 5), (0, 3, 5), (3, 1, 4), (2, 3, 4)
CHILDREN[SELF_SIMILAR, 7] = (5, 4, 2), (0, 3, 5), (3, 1, 4), (4, 5, 3)

# Whether a child is similar to its parent, corner by corner, so that its longest side is known.
IS_SIMILAR = np.zeros((2, 8, 4), np.bool_)
IS_SIMILAR[:, 0, 0] = IS_SIMILAR[:, 2, 0] = IS_SIMILAR[:, 4, 0] = IS_SIMILAR[:, 6, 0] = True
IS_SIMILAR[:, 3, 1] = IS_SIMILAR[:, 5, 1] = True
IS_SIMILAR[LONGEST_EDGE, 7, 1:3] = True
IS_SIMILAR[SELF_SIMILAR, 7] = True

# How many bisections a child is from its parent.
DEPTH = np.zeros((8, 4), np.uint8)
DEPTH[1, :2] = 1
DEPTH[3, :3] = 1, 2, 2
DEPTH[5, :3] = 2, 2, 1
DEPTH[7] = 2


# --- the longest edge; x and y are places of the corners a, b and c -------------------------------


@jit
def gather(vertices, corners, x, y):
    """Put the places of vertices side by side."""
    for label in range(corners.size):
        x[label], y[label] = vertices[corners[label], 0], vertices[corners[label], 1]


@jit
def squared_length(x, y, a, b):
    """Of the edge from a to b."""
    east, north = x[b] - x[a], y[b] - y[a]
    return east * east + north * north


@jit
def along_direction(x, y, a, b):
    """How far the edge from a to b goes along the direction that decides ties."""
    return abs(EAST * (x[b] - x[a]) + NORTH * (y[b] - y[a]))


@jit
def turn(x, y, a, b, c):
    """Twice the area of a triangle, positive where it is counter-clockwise."""
    return (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])


@jit
def longest_side(x, y, a, b, c):
    """Side of a triangle that is longest, ties decided as in the triangle behind it."""
    ab, bc, ca = (
        squared_length(x, y, a, b),
        squared_length(x, y, b, c),
        squared_length(x, y, c, a),
    )
    tied = (1.0 - TIE) * max(ab, bc, ca)
    if ab >= tied and bc < tied and ca < tied:
        return 0
    along_ab = along_direction(x, y, a, b) if ab >= tied else -1.0
    along_bc = along_direction(x, y, b, c) if bc >= tied else -1.0
    along_ca = along_direction(x, y, c, a) if ca >= tied else -1.0
    if along_ab >= along_bc and along_ab >= along_ca:
        return 0
    return 1 if along_bc >= along_ca else 2


@jit
def side_to_bisect(x, y, a, b, newest):
    """Side of a child to bisect next: the longest one, but the base if the legs at ``newest`` tie.

    They tie where a right triangle was bisected. All right-triangulated meshes stay so by this,
    on cells that are longer than wide too, where the base may be the shortest side.
    """
    left, right = squared_length(x, y, a, newest), squared_length(x, y, b, newest)
    if abs(left - right) <= TIE * max(left, right):
        return 0
    return longest_side(x, y, a, b, newest)


@jit
def rotated(a, b, c, first_side):
    """The corners in an order that starts with this side."""
    if first_side == 1:
        return b, c, a
    if first_side == 2:
        return c, a, b
    return a, b, c


@jit
def put_longest_sides_first(vertices, triangles):
    """Turn triangles counter-clockwise and rotate them until side 0 is the longest, in place."""
    x, y = np.empty(3), np.empty(3)
    for corners in triangles:
        gather(vertices, corners, x, y)
        a, b, c = 0, 1, 2
        if turn(x, y, a, b, c) < 0.0:
            a, c = c, a
        a, b, c = rotated(a, b, c, longest_side(x, y, a, b, c))
        corners[0], corners[1], corners[2] = corners[a], corners[b], corners[c]


# --- marks --------------------------------------------------------------------------------------


@jit
def mark_side(marks, twins, triangle, side, marked, n_marked):
    """Mark a side in its triangle and in the one behind, -1 if none.

    ``twins`` has a row for each triangle. Returns that triangle and the length of ``marked``, the
    list of triangles with marks.
    """
    if marks[triangle] == 0:
        marked[n_marked] = triangle
        n_marked += 1
    marks[triangle] |= 1 << side
    twin = twins[triangle, side]
    if twin < 0:
        return -1, n_marked
    behind = twin // 3
    if marks[behind] == 0:
        marked[n_marked] = behind
        n_marked += 1
    marks[behind] |= 1 << (twin % 3)
    return behind, n_marked


@jit
def mark_and_propagate(targets, sides, twins, marks, marked):
    """Mark these sides of the targets, then walk over longest edges to where marks conform.

    Paper, RTIN-Refinement, steps 2 to 4: where a triangle has a marked side and its longest one is
    not marked, mark that, and go on with the triangle behind it. Returns how many are marked.
    """
    n_marked = 0
    for target in targets:
        for side in range(3):
            if sides >> side & 1 == 0:
                continue
            triangle, n_marked = mark_side(marks, twins, target, side, marked, n_marked)
            while triangle >= 0 and marks[triangle] & 1 == 0:
                triangle, n_marked = mark_side(marks, twins, triangle, 0, marked, n_marked)
    return n_marked


# --- subdivision --------------------------------------------------------------------------------


@jit
def owns(half_edge, twin):
    """Whether the midpoint of an edge counts for this triangle: the first one that has the edge.

    Midpoints' numbers are kept as the twin of the owner's half-edge, as ``-1 - number``. Boundary
    edges have -1 from the start, so this holds before and after.
    """
    return twin < 0 or twin > half_edge


@jit
def count_new(marks, twins, first, end):
    """Number of new vertices and of children that some triangles bring."""
    n_vertices, n_children = 0, 0
    for triangle in range(first, end):
        mark = marks[triangle]
        n_children += N_CHILDREN[mark]
        for side in range(3):
            half_edge = 3 * triangle + side
            if mark >> side & 1 and owns(half_edge, twins[half_edge]):
                n_vertices += 1
    return n_vertices, n_children


@jit
def set_midpoint(vertices, number, a, b):
    """Write the midpoint of a and b; exact up to the last bit, and the same from both sides."""
    for axis in range(3):
        vertices[number, axis] = 0.5 * vertices[a, axis] + 0.5 * vertices[b, axis]


@jit
def fill_midpoints(triangles, marks, twins, first, end, number, vertices):
    """Number the midpoints that some triangles own, triangle by triangle, and write them."""
    for triangle in range(first, end):
        mark = marks[triangle]
        for side in range(3):
            half_edge = 3 * triangle + side
            if mark >> side & 1 and owns(half_edge, twins[half_edge]):
                ends = triangles[triangle, side], triangles[triangle, next_side(side)]
                set_midpoint(vertices, number, ends[0], ends[1])
                twins[half_edge] = -1 - number
                number += 1


@jit
def midpoint_of(twins, half_edge):
    """Number of the midpoint of a marked edge."""
    known = twins[half_edge]
    return -1 - known if known < 0 else -1 - twins[known]


@jit
def child_of(x, y, scheme, mark, child):
    """Corners of one child, by their place in the pattern, the side to bisect next coming first."""
    a = CHILDREN[scheme, mark, child, 0]
    b = CHILDREN[scheme, mark, child, 1]
    c = CHILDREN[scheme, mark, child, 2]
    if IS_SIMILAR[scheme, mark, child]:
        return a, b, c
    return rotated(a, b, c, side_to_bisect(x, y, a, b, c))


@jit
def fill_children(triangles, marks, twins, scheme, first, end, vertices, at, children):
    """Write the children of some triangles; the first triangle too small to split, or -1.

    Float64 is too coarse where a child would have no area that a check would see.
    """
    # Unsigned, and places side by side: a quarter of the time that looking up vertices takes.
    corners, x, y = np.empty(6, np.uint32), np.empty(6), np.empty(6)
    too_small = -1
    for triangle in range(first, end):
        mark = marks[triangle]
        if mark == 0:
            for corner in range(3):
                children[at, corner] = triangles[triangle, corner]
            at += 1
            continue
        for side in range(3):
            corners[side] = corners[3 + side] = triangles[triangle, side]
            if mark >> side & 1:
                corners[3 + side] = midpoint_of(twins, 3 * triangle + side)
        gather(vertices, corners, x, y)
        for child in range(N_CHILDREN[mark]):
            a, b, c = child_of(x, y, scheme, mark, child)
            if too_small < 0 and not has_area(x[a], y[a], x[b], y[b], x[c], y[c]):
                too_small = triangle
            children[at, 0], children[at, 1], children[at, 2] = corners[a], corners[b], corners[c]
            at += 1
    return too_small
