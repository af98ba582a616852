"""Which triangle lies behind each edge.

Half-edge ``3 * triangle + side`` runs from corner ``side`` of a triangle to the next corner. The
*twin* of a half-edge is the one that runs along the same edge in the neighbour, -1 on the boundary.
"""

import numpy as np

from rtin._kernels._jit import jit


@jit
def next_side(side):
    """The side that begins where this one ends."""
    return side + 1 if side < 2 else 0


@jit
def next_edge(half_edge):
    """The half-edge of the same triangle that begins where this one ends."""
    return half_edge - 2 if half_edge % 3 == 2 else half_edge + 1


@jit
def previous_edge(half_edge):
    """The half-edge of the same triangle that ends where this one begins."""
    return half_edge + 2 if half_edge % 3 == 0 else half_edge - 1


@jit
def pair_edges(triangles, first_vertex, end_vertex, latest, waiting, twins):
    """Write the twins of edges whose smaller vertex is in a range; False if one has a third side.

    The first half-edge of each edge waits in a list at the edge's smaller vertex. ``latest`` is the
    head of the list; ``waiting`` has, for each half-edge, the one before it (-1 ends the list), and
    the larger vertex if it runs there, -1 minus that if it comes from there.
    """
    for triangle in range(triangles.shape[0]):
        for side in range(3):
            start, end = triangles[triangle, side], triangles[triangle, next_side(side)]
            low, along, against = start, end, -1 - end
            if end < start:
                low, along, against = end, -1 - start, start
            if low < first_vertex or low >= end_vertex:
                continue
            half_edge, other = 3 * triangle + side, latest[low]
            while other >= 0 and waiting[other, 1] != against and waiting[other, 1] != along:
                other = waiting[other, 0]
            if other < 0:
                waiting[half_edge, 0], waiting[half_edge, 1] = latest[low], along
                latest[low], twins[half_edge] = half_edge, -1
            elif waiting[other, 1] == along or twins[other] >= 0:
                return False
            else:
                twins[half_edge], twins[other] = other, half_edge
    return True


@jit
def has_area(ax, ay, bx, by, cx, cy):
    """Whether a triangle is counter-clockwise by clearly more than rounding can make it.

    Never where ``validity`` sees no area: it wants half of this relative to the longest side, of
    whose square the extent is at least half.
    """
    along_x, along_y, to_x, to_y = bx - ax, by - ay, cx - ax, cy - ay
    area = along_x * to_y - along_y * to_x
    extent = along_x * along_x + along_y * along_y + to_x * to_x + to_y * to_y
    largest = max(abs(ax), abs(ay), abs(bx), abs(by), abs(cx), abs(cy))
    return area > 1e-11 * extent + 4e-15 * largest * np.sqrt(extent)


@jit
def all_turn_left(vertices, triangles, first, end):
    """Whether some triangles are clearly counter-clockwise, with finite corners."""
    for triangle in range(first, end):
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        height_sum = vertices[a, 2] + vertices[b, 2] + vertices[c, 2]
        if not np.isfinite(height_sum):
            return False
        ax, ay, bx, by = vertices[a, 0], vertices[a, 1], vertices[b, 0], vertices[b, 1]
        if not has_area(ax, ay, bx, by, vertices[c, 0], vertices[c, 1]):
            return False
    return True
